// What a node made: one row for each output, to be looked at alone or beside another.
import { useEffect, useState } from "react";
import { address } from "../api";
import { artifactOf, tell } from "../state/actions";
import { now, roundsOf, set, useStudio, type Looked, type State } from "../state/store";
import { bytes } from "../text";
import type { Artifact, GraphNode, Outputs } from "../types";

// The outputs of one round: those of the followed run where it has made them, else what the plan finds in the store.
export function outputsOf(s: State, name: string, id: string): Outputs {
  const run = s.states.get(name)?.outputs;
  const planned = s.runGraph ? undefined : s.document?.plan?.nodes[id]?.rounds.find((round) => round.name === name)?.outputs;
  if (s.runGraph) return run ?? {};
  return planned ?? run ?? {};
}

export function look(side: 0 | 1, digest: string, node: string, port: string, type: string, run = ""): void {
  const label = `${node}${port ? `.${port}` : ""}${run ? ` · ${run}` : ""}`;
  set((s) => {
    const looked: State["looked"] = [...s.looked];
    looked[side] = { digest, node, port, run, label, type };
    const left = side === 0 && !looked[1] && s.looked[0]?.digest !== digest ? s.looked[0] : null;
    return { looked, ...(left ? { before: left } : {}), tab: "look", dock: s.dock === "closed" ? "open" : s.dock };
  });
}

export function Results({ node }: { node: GraphNode }) {
  const round = useStudio((s) => s.round), rounds = roundsOf(node);
  const states = useStudio((s) => s.states), plan = useStudio((s) => s.document?.plan);
  const made = node.names.map((name) => ({ name, outputs: outputsOf(now(), name, node.id) })).filter(({ outputs }) => Object.keys(outputs).length);
  const chosen = (round !== null ? made.find(({ name }) => name === rounds[round - 1]) : undefined) ?? made[made.length - 1];
  void states; void plan; // what `made` reads
  if (!chosen) return <p className="soft pad">Nothing yet. Press <b>Run to here</b>; what this node makes can then be looked at.</p>;
  return (
    <div className="results">
      {rounds.length > 1 && (
        <label className="round-choice">Round <select value={chosen.name} onChange={(event) => set({ round: rounds.indexOf(event.target.value) + 1 })}>
          {made.map(({ name }) => <option key={name} value={name}>{rounds.indexOf(name) + 1}</option>)}
        </select></label>
      )}
      {inOrder(node, chosen.outputs).map(([port, output]) => <OutputCard key={`${port}${output.digest}`} digest={output.digest} type={output.type} size={output.bytes} name={chosen.name} port={port} />)}
    </div>
  );
}

// As the type declares its outputs: the first is what the node is for.
export function inOrder(node: GraphNode, outputs: Outputs): [string, Outputs[string]][] {
  const place = (port: string) => { const at = node.outputs.findIndex((other) => other.port === port); return at < 0 ? 99 : at; };
  return Object.entries(outputs).sort(([a], [b]) => place(a) - place(b));
}

const SURFACES = ["Mesh", "Carrier", "Stage1State", "Asset", "SceneTruth"];
export const alike = (one: string, two: string) => one === two || (SURFACES.includes(one) && SURFACES.includes(two));

export const beside = (one: Looked, two: Looked): void => set((s) => ({ looked: [one, two], tab: "look", dock: s.dock === "closed" ? "open" : s.dock }));

// The first output of the round that is chosen, or of the last one that is there.
export function lookAtNode(node: GraphNode): void {
  const s = now(), names = s.round !== null ? [roundsOf(node)[s.round - 1]] : [...node.names].reverse();
  for (const name of names) {
    const first = inOrder(node, outputsOf(s, name ?? node.id, node.id))[0];
    if (first) { look(0, first[1].digest, name ?? node.id, first[0], first[1].type); return; }
  }
}

function OutputCard({ digest, type, size, name, port }: { digest: string; type: string; size: number; name: string; port: string }) {
  const [artifact, setArtifact] = useState<Artifact | null>(null), here = useStudio((s) => s.looked[0]), before = useStudio((s) => s.before);
  const other = here && here.digest !== digest ? here : before;
  useEffect(() => {
    let gone = false;
    artifactOf(digest).then((found) => { if (!gone) setArtifact(found); }).catch(tell);
    return () => { gone = true; };
  }, [digest]);
  const [later, setLater] = useState(false); // an atlas comes after the model, which is looked at: both are work for the server
  useEffect(() => { const timer = setTimeout(() => setLater(true), now().dock === "closed" ? 0 : 1500); return () => clearTimeout(timer); }, []);
  const sheet = artifact?.shows.find((show) => show.kind === "sheet"), atlas = artifact?.shows.find((show) => show.kind === "picture");
  const thumb = sheet ? address("/api/artifact/contact", { digest, show: sheet.id, layer: sheet.layers?.[0], size: 64, from: 0, count: 10 }) : atlas && later ? address("/api/artifact/picture", { digest, show: atlas.id, layer: atlas.layers?.[0], size: 128 }) : "";
  return (
    <div className="card output">
      <p><b>{port}</b> <span className="soft">{type} · {bytes(size)}</span></p>
      <p className="doc">{artifact?.title ?? "…"}</p>
      {thumb && <button className="thumb" onClick={() => look(0, digest, name, port, type)} aria-label={`look at ${port}`}><img src={thumb} alt="" loading="lazy" /></button>}
      <div className="buttons">
        <button onClick={() => look(0, digest, name, port, type)}>Look</button>
        {other && other.digest !== digest && alike(other.type, type) && <button onClick={() => beside(other, { digest, node: name, port, run: "", label: `${name}.${port}`, type })} title="Both with one camera, side by side or under a wipe">Beside {other.label}</button>}
      </div>
    </div>
  );
}
