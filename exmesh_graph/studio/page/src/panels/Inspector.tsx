// The right side: the selected node, or the graph itself.
import { useEffect, useState } from "react";
import { nodeOf, now, set, shownGraph, useStudio } from "../state/store";
import type { GraphNode } from "../types";
import { GraphPanel } from "./GraphPanel";
import { NodeHead } from "./NodeHead";
import { Parameters } from "./Parameters";
import { Ports } from "./Ports";
import { Results, lookAtNode } from "./Results";
import { Why } from "./Why";

type Tab = "parameters" | "ports" | "results" | "why";
const TABS: [Tab, string][] = [["results", "Results"], ["parameters", "Parameters"], ["ports", "Wires"], ["why", "State"]];

export function Inspector() {
  const node = useStudio((s) => nodeOf(s, s.selected)), graph = useStudio(shownGraph);
  if (!graph) return <aside className="inspector" />;
  return <aside className="inspector" aria-label="inspector">{node ? <NodePanel key={node.id} node={node} /> : <GraphPanel />}</aside>;
}

let last: Tab = "parameters";
function NodePanel({ node }: { node: GraphNode }) {
  const allowed = node.kind === "node" ? TABS : TABS.filter(([tab]) => tab === "parameters" || tab === "ports");
  const [tab, setTab] = useState<Tab>(() => (allowed.some(([name]) => name === last) ? last : "parameters"));
  useEffect(() => { last = tab; }, [tab]);
  useEffect(() => { // what is looked at follows the selection, unless two things are compared
    const s = now();
    if (s.dock !== "closed" && s.tab === "look" && !s.looked[1]) lookAtNode(node);
  }, [node.id]); // eslint-disable-line
  return (
    <>
      <NodeHead node={node} />
      <div className="tabs" role="tablist">
        {allowed.map(([name, words]) => <button key={name} role="tab" aria-selected={tab === name} onClick={() => setTab(name)}>{words}</button>)}
        <span className="spring" />
        <button className="quiet" onClick={() => set({ selected: null })} title="Close (Esc): back to the graph's own settings" aria-label="Close">✕</button>
      </div>
      <div className="scroll" role="tabpanel">
        {tab === "parameters" && <Parameters node={node} />}
        {tab === "ports" && <Ports node={node} />}
        {tab === "results" && <Results node={node} />}
        {tab === "why" && <Why node={node} />}
      </div>
    </>
  );
}
