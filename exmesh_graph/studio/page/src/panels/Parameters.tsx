// All parameters of a node: those that are set first, the rest below; with a choice of round for nodes of a block.
import { useState } from "react";
import { roundsOf, set, useStudio } from "../state/store";
import type { GraphNode, Parameter } from "../types";
import { Field } from "./Field";
import { toggleMark } from "./NodeHead";

export function Parameters({ node }: { node: GraphNode }) {
  const readOnly = useStudio((s) => s.runGraph !== null) || !node.editable.includes("set"), round = useStudio((s) => s.round);
  const [query, setQuery] = useState("");
  const rounds = roundsOf(node), block = rounds.length > 1;
  const shown = node.parameters.filter((p) => !query || `${p.name} ${p.doc}`.toLowerCase().includes(query.toLowerCase()));
  const own = shown.filter((p) => p.set || p.required), rest = shown.filter((p) => !p.set && !p.required);
  const target = (p: Parameter) => (round !== null && block ? `${rounds[round - 1] ?? node.id}.${p.name}` : p.target || `${node.id}.${p.name}`);
  return (
    <div className="parameters">
      {node.parameters.length > 8 && <input type="search" placeholder="Search parameters" value={query} onChange={(event) => setQuery(event.target.value)} aria-label="search parameters" />}
      {block && (
        <label className="round-choice">Rounds <select value={round ?? 0} onChange={(event) => set({ round: Number(event.target.value) || null })}>
          <option value={0}>all {rounds.length}</option>{rounds.map((_, k) => <option key={k} value={k + 1}>only round {k + 1}</option>)}
        </select></label>
      )}
      {node.layers.map((layer, k) => <p className="soft layer" key={k}>{layer.when} {layer.round}: {layer.type && <code>{layer.type} </code>}{Object.entries(layer.set).map(([name, value]) => `${name} ${JSON.stringify(value)}`).join(", ")}</p>)}
      {node.parameters.length === 0 && <p className="soft">No parameters.</p>}
      {own.map((p) => <Field key={p.name} parameter={p} target={target(p)} readOnly={readOnly} />)}
      {own.length > 0 && rest.length > 0 && <p className="divider">by default</p>}
      {rest.map((p) => <Field key={p.name} parameter={p} target={target(p)} readOnly={readOnly} />)}
      {!readOnly && node.kind === "node" && <p className="soft small">To see what a node is worth, <button className="link" onClick={() => toggleMark(node.id)}>mark it</button> and compare with and without.</p>}
    </div>
  );
}
