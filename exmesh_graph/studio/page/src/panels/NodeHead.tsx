// Name, type, what it is for, its faults, and what can be done with it.
import { useState } from "react";
import { get } from "../api";
import { edit, startRun, tell } from "../state/actions";
import { now, roundsOf, set, useStudio } from "../state/store";
import { isBypassed } from "../graph/states";
import type { GraphNode } from "../types";
import { ProblemList } from "./Problems";

interface Swap { type: string; ok: boolean; why: string; ports?: { [old: string]: string } }

export function NodeHead({ node }: { node: GraphNode }) {
  const readOnly = useStudio((s) => s.runGraph !== null), marked = useStudio((s) => s.marked.has(node.id)), all = useStudio((s) => s.document?.problems);
  const [swaps, setSwaps] = useState<Swap[] | null>(null);
  const round = useStudio((s) => s.round), rounds = roundsOf(node), one = round !== null && rounds.length > 1; // one round of a block is chosen
  const name = one ? rounds[round - 1] : node.id, here = one ? ` in round ${round}` : "", out = isBypassed(node, one ? round : null);
  const can = (what: string) => !readOnly && node.editable.includes(what);
  const problems = (all ?? []).filter((problem) => problem.node === node.id || problem.node.replace(/\[\d+\]/g, "") === node.id);
  return (
    <div className="head">
      <h2>{node.name} {node.parent && <span className="soft">in {node.parent}</span>}</h2>
      <p className="type"><code>{node.type || node.graph || "repeat"}</code>{node.traits.map((trait) => <span className="chip" key={trait}>{trait}</span>)}<span className="soft">{node.file}{node.line ? `:${node.line}` : ""}</span></p>
      <p className="doc">{node.doc}</p>
      {node.comment && <p className="comment"># {node.comment}</p>}
      <div className="buttons">
        {node.kind === "node" && !readOnly && <button onClick={() => void startRun([node.id])} title="Run this node and what it needs">▶ Run to here</button>}
        {can("bypass") && node.kind !== "component" && !out && <button onClick={() => void edit({ bypass: name })} title="Take it out; what used its output gets what its input got (B)">Bypass{here}</button>}
        {can("bypass") && out && <button onClick={() => void edit({ restore: name })} title="Take the edit back that bypassed it">Use it again{here}</button>}
        {can("replace") && (node.kind === "node" || node.kind === "component") && <button onClick={() => get<{ types: Swap[] }>("/api/swaps", { node: node.id }).then(({ types }) => setSwaps(types)).catch(tell)} title="Another type with the same ports">Swap{here}…</button>}
        {can("remove") && <button className="danger" onClick={() => void edit({ remove: node.id, force: true })} title="Remove, with optional wires that lead to it (Del)">Remove</button>}
        {!readOnly && (node.kind === "node" || node.kind === "component") && <button aria-pressed={marked} onClick={() => toggleMark(node.id)} title="Mark for the comparison with and without it (M)">◆ {marked ? "Marked" : "Mark"}</button>}
      </div>
      {swaps && (
        <div className="swaps">
          <p className="soft">Swap{here} for <button className="quiet" onClick={() => setSwaps(null)} aria-label="close">✕</button></p>
          {swaps.length === 0 && <p className="soft">No other type has ports that fit.</p>}
          {swaps.slice(0, 12).map((swap) => <button key={swap.type} disabled={!swap.ok} title={swap.why} onClick={() => { setSwaps(null); void edit({ replace: name, type: swap.type, ...(swap.ports && Object.keys(swap.ports).length ? { ports: swap.ports } : {}) }); }}><code>{swap.type}</code> {!swap.ok && <span className="soft">{swap.why}</span>}</button>)}
        </div>
      )}
      {problems.length > 0 && <ProblemList problems={problems} />}
    </div>
  );
}

export function toggleMark(id: string): void {
  const marked = new Set(now().marked);
  if (!marked.delete(id)) { marked.add(id); set({ tab: "compare", dock: now().dock === "closed" ? "open" : now().dock }); }
  set({ marked });
}
