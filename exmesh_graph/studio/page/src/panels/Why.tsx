// Why a node is taken from the store or must run; what it cost; each of its rounds; its failure with the line to replay it.
import { useEffect, useState } from "react";
import { get } from "../api";
import { startRun, tell } from "../state/actions";
import { roundsOf, set, useStudio } from "../state/store";
import { bytes, seconds } from "../text";
import type { GraphNode } from "../types";
import { SIGNS, WORDS, isBypassed, type Shown } from "../graph/states";
import { Command, FailureNote } from "./Runs";

interface Reason { node: string; state: string; key: string; reason: string; made: string; lines: string[]; waits_for: string }

export function Why({ node }: { node: GraphNode }) {
  const planned = useStudio((s) => s.document?.plan?.nodes[node.id]), states = useStudio((s) => s.states), round = useStudio((s) => s.round), inRun = useStudio((s) => s.runGraph !== null);
  const name = (round !== null ? roundsOf(node)[round - 1] : node.names.at(-1)) ?? node.id, told = states.get(name), out = isBypassed(node, round);
  const [reason, setReason] = useState<Reason | null>(null);
  const revision = useStudio((s) => s.document?.revision), state = planned?.state;
  useEffect(() => {
    if (inRun || out) return;
    let gone = false;
    setReason(null);
    get<Reason>("/api/why", { node: name }).then((found) => { if (!gone) setReason(found); }).catch(tell);
    return () => { gone = true; };
  }, [name, revision, state, inRun, out]);
  return (
    <div className="why">
      {told?.failure && <FailureNote name={name} failure={told.failure} />}
      {out && <section className="card"><h3>{SIGNS.bypassed} {name}: bypassed</h3><p>What used its output gets what its input got.</p></section>}
      {!inRun && !out && reason && (
        <section className="card">
          <h3>{SIGNS[reason.state as Shown]} {name}: {WORDS[reason.state as Shown] || reason.state}</h3>
          {reason.reason && <p>{reason.reason}</p>}
          {reason.lines?.filter((line) => line !== reason.reason).map((line, k) => <p key={k} className="line">{line}</p>)}
          {reason.made && <p className="soft">made {reason.made}</p>}
          {reason.waits_for && <p className="soft">waits for {reason.waits_for}</p>}
          {reason.key && <p className="soft">key <code>{reason.key.slice(0, 16)}</code></p>}
          {reason.state === "hit" && <button onClick={() => void startRun([node.id], node.names)} title="Although its result is in the store">Make it again</button>} {reason.state === "hit" && <button onClick={() => void startRun([], [], [node.id])} title="This node and all that follows from it">and all below it</button>}
        </section>
      )}
      {told && (
        <section className="card">
          <h3>In the run</h3>
          <p>{SIGNS[told.state as Shown] ?? ""} {WORDS[told.state as Shown] ?? told.state}{told.seconds ? `, ${seconds(told.seconds)}` : ""}{told.peak_memory ? `, memory up to ${bytes(told.peak_memory)}` : ""}</p>
          {told.progress && <><div className="meter"><i style={{ width: `${(100 * told.progress.step) / Math.max(1, told.progress.total)}%` }} /></div>
            <p>{told.progress.step} of {told.progress.total}{told.progress.left ? `, ${seconds(told.progress.left)} left` : ""}{told.progress.message ? `, ${told.progress.message}` : ""}</p>
            <p className="soft">{Object.entries(told.progress.figures).map(([figure, value]) => `${figure} ${Number(value.toPrecision(4))}`).join(", ")}</p></>}
          {told.warnings.map((warning, k) => <p key={k} className="warning">⚠ {warning}</p>)}
          <button onClick={() => set({ tab: "log", dock: "open" })}>Log of this node</button>
        </section>
      )}
      {planned && planned.rounds.length > 1 && (
        <table><thead><tr><th>Round</th><th>State</th><th className="n">Seconds</th><th>Why</th></tr></thead><tbody>
          {planned.rounds.map((one, k) => {
            const live = states.get(one.name), shown = (live && live.state === "running" ? "running" : one.state) as Shown;
            return <tr key={one.name} className={round === k + 1 ? "chosen" : ""} onClick={() => set({ round: k + 1 })}><td><button className="link">{k + 1}</button></td><td><span className={`sign is-${shown}`}>{SIGNS[shown]}</span> {WORDS[shown]}</td><td className="n">{seconds(one.seconds)}</td><td className="soft">{one.reason}</td></tr>;
          })}
        </tbody></table>
      )}
      <p className="soft small">{node.version ? `version ${node.version}` : ""}</p>
      {!inRun && <Command words="In a terminal" line={`exmesh why GRAPH '${name}'`} />}
    </div>
  );
}
