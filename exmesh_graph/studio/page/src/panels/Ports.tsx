// The wires of a node as lists: what feeds each input, chosen from what fits; the keyboard's way to rewire.
import { useState } from "react";
import { endsOf, edit, tell } from "../state/actions";
import { set, shownGraph, useStudio } from "../state/store";
import { targetOf } from "../graph/ends";
import type { Ends, GraphNode, Port } from "../types";

const facets = (port: Port) => Object.entries(port.facets ?? {}).map(([name, value]) => `${name}: ${String(value)}`).join(", ");

export function Ports({ node }: { node: GraphNode }) {
  return (
    <div className="ports">
      <h3>Inputs</h3>
      {node.inputs.length === 0 && <p className="soft">none</p>}
      {node.inputs.map((port) => <Input key={port.port} node={node} port={port} />)}
      <h3>Outputs</h3>
      {node.outputs.map((port) => <Output key={port.port} node={node} port={port} />)}
    </div>
  );
}

function Input({ node, port }: { node: GraphNode; port: Port }) {
  const graph = useStudio(shownGraph)!, readOnly = useStudio((s) => s.runGraph !== null) || !node.editable.includes("connect");
  const wires = graph.wires.filter((wire) => wire.to.node === node.id && wire.to.port === port.port && (wire.to.side === "" || node.kind === "node" || node.kind === "component"));
  const [ends, setEnds] = useState<Ends | null>(null);
  const target = ends?.target || targetOf(graph, { node: node.id, port: port.port, side: "" });
  const ask = () => { if (!ends) endsOf(node.id, port.port, false).then(setEnds).catch(tell); };
  const now = wires.find((wire) => !wire.rounds)?.text ?? "";
  return (
    <div className="port-row">
      <p><b>{port.port}</b> <span className="soft">{port.label}{port.optional ? ", optional" : ""}{facets(port) ? ` (${facets(port)})` : ""}</span></p>
      {port.doc && <p className="doc">{port.doc}</p>}
      <span className="control">
        <select disabled={readOnly} value={now} onFocus={ask} onPointerDown={ask} aria-label={`what feeds ${port.port}`}
          onChange={(event) => { setEnds(null); void edit(event.target.value ? { connect: target, to: event.target.value } : { disconnect: target }); }}>
          <option value="" disabled={!port.optional && now !== ""}>{port.optional ? "nothing" : "nothing yet"}</option>
          {now && !ends?.ends.some((end) => end.link === now) && <option value={now}>{now}</option>}
          {ends && <optgroup label="fits">{ends.ends.filter((end) => end.ok).map((end) => <option key={end.link} value={end.link}>{end.link}</option>)}</optgroup>}
          {ends && <optgroup label="does not fit">{ends.ends.filter((end) => !end.ok).slice(0, 60).map((end) => <option key={`${end.link}${end.node}`} disabled title={end.why}>{end.link || end.node}: {end.why}</option>)}</optgroup>}
        </select>
        {!readOnly && <button className="quiet" title="A new node that makes this" aria-label={`new node for ${port.port}`} onClick={() => endsOf(node.id, port.port, false).then((found) => set({ overlay: "add", addAt: { node: node.id, port: port.port, output: false, types: found.types } })).catch(tell)}>+</button>}
      </span>
      {wires.filter((wire) => wire.rounds).map((wire) => <p className="soft" key={wire.id}>{wire.rounds}: {wire.text}</p>)}
    </div>
  );
}

function Output({ node, port }: { node: GraphNode; port: Port }) {
  const graph = useStudio(shownGraph)!, readOnly = useStudio((s) => s.runGraph !== null);
  const users = graph.wires.filter((wire) => wire.from.node === node.id && wire.from.port === port.port);
  const published = graph.outputs.find((output) => output.node === node.id && output.port === port.port);
  return (
    <div className="port-row">
      <p><b>{port.port || "plugs into"}</b> <span className="soft">{port.label}{facets(port) ? ` (${facets(port)})` : ""}</span></p>
      {port.doc && <p className="doc">{port.doc}</p>}
      <p>{users.length ? users.map((wire) => <button className="link" key={wire.id} onClick={() => { set({ selected: wire.to.node }); window.dispatchEvent(new CustomEvent("studio:reveal", { detail: wire.to.node })); }}>{wire.to.node}.{wire.to.port}</button>) : <span className="soft">nothing uses it</span>}
        {published && <span className="chip">published as {published.name}</span>}
        {!readOnly && !published && node.kind === "node" && <button className="link" onClick={() => void edit({ output: `${node.name}_${port.port}`, to: `@${node.id}.${port.port}` })}>publish</button>}
        {!readOnly && published && <button className="link" onClick={() => void edit({ disconnect: `outputs.${published.name}` })}>do not publish</button>}
        {!readOnly && node.kind === "node" && <button className="link" onClick={() => endsOf(node.id, port.port, true).then((found) => set({ overlay: "add", addAt: { node: node.id, port: port.port, output: true, types: found.types } })).catch(tell)}>+ node that takes it</button>}
      </p>
    </div>
  );
}
