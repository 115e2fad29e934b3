// Below the graph: what is looked at, curves, log, changes, comparisons.
import { useRef, useState } from "react";
import { Look } from "../look/Look";
import { set, useStudio, type DockTab } from "../state/store";
import { Changes } from "./Changes";
import { Compare } from "./Compare";
import { Curves } from "./Curves";
import { Log } from "./Log";

const TABS: [DockTab, string][] = [["look", "Look"], ["curves", "Curves"], ["log", "Log"], ["changes", "Changes"], ["compare", "Compare"]];

export function Dock() {
  const tab = useStudio((s) => s.tab), dock = useStudio((s) => s.dock), edits = useStudio((s) => s.document?.ops.length ?? 0), marked = useStudio((s) => s.marked.size);
  const [height, setHeight] = useState(() => Number(localStorage.getItem("exmesh-dock")) || 0), moved = useRef(false);
  const drag = (event: React.PointerEvent) => {
    if (!event.buttons) return;
    moved.current = true;
    const share = Math.min(0.85, Math.max(0.15, (window.innerHeight - event.clientY) / window.innerHeight));
    setHeight(share);
    localStorage.setItem("exmesh-dock", String(share));
  };
  const count = (name: DockTab) => (name === "changes" ? edits : name === "compare" ? marked : 0);
  return (
    <section className={`dock ${dock}`} style={dock === "open" && height ? { height: `${100 * height}vh` } : undefined} aria-label="results">
      <div className="dock-grip" onPointerDown={(event) => event.currentTarget.setPointerCapture(event.pointerId)} onPointerMove={drag} aria-hidden />
      <div className="tabs" role="tablist">
        {TABS.map(([name, words]) => <button key={name} role="tab" aria-selected={tab === name && dock !== "closed"} onClick={() => set((s) => ({ tab: name, dock: s.dock === "closed" ? "open" : s.dock }))}>{words}{count(name) > 0 && <span className="chip">{count(name)}</span>}</button>)}
        <span className="spring" />
        <button className="quiet" onClick={() => set({ dock: dock === "full" ? "open" : "full" })} title="Larger or smaller (L)" aria-label={dock === "full" ? "smaller" : "larger"}>{dock === "full" ? "⤡" : "⤢"}</button>
        <button className="quiet" onClick={() => set({ dock: dock === "closed" ? "open" : "closed" })} title={dock === "closed" ? "Open" : "Close"} aria-label={dock === "closed" ? "open" : "close"}>{dock === "closed" ? "▴" : "▾"}</button>
      </div>
      {dock !== "closed" && <div className="dock-body" role="tabpanel">
        {tab === "look" && <Look />}
        {tab === "curves" && <Curves />}
        {tab === "log" && <Log />}
        {tab === "changes" && <Changes />}
        {tab === "compare" && <Compare />}
      </div>}
    </section>
  );
}
