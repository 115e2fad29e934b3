// Two runs beside each other: what differs, their figures, and any pair of what they made under one camera.
import { useEffect, useState } from "react";
import { get } from "../api";
import { tell } from "../state/actions";
import { set, useStudio } from "../state/store";
import { ago, figure } from "../text";
import type { Comparison, Json, Run } from "../types";
import { look } from "./Results";

export function RunPair() {
  const runs = useStudio((s) => s.runs.filter((run) => !run.sweep));
  const [a, setA] = useState(""), [b, setB] = useState(""), [found, setFound] = useState<Comparison | null>(null);
  const one = a || runs[1]?.id || "", two = b || runs[0]?.id || ""; // the newest beside the one before
  const state = runs.find((run) => run.id === two)?.state;
  useEffect(() => {
    if (!one || !two || one === two) { setFound(null); return; }
    let gone = false;
    get<Comparison>("/api/compare", { a: one, b: two }).then((answer) => { if (!gone) setFound(answer); }).catch(tell);
    return () => { gone = true; };
  }, [one, two, state]);
  if (runs.length < 2) return <p className="soft">Two runs are needed.</p>;
  return (
    <>
      <p><Pick runs={runs} value={one} pick={setA} words="A" /> <Pick runs={runs} value={two} pick={setB} words="B" /></p>
      {found && <div className="two">
        <div>
          <h3>Figures</h3>
          <table><thead><tr><th></th><th className="n">A</th><th className="n">B</th><th className="n">B − A</th></tr></thead><tbody>{found.figures.map((row) => <tr key={row.label}><td>{row.label} <span className="soft">{row.unit}</span></td><td className="n">{figure(row.a)}</td><td className="n">{figure(row.b)}</td><td className="n">{less(row.a, row.b, row.better)}</td></tr>)}</tbody></table>
          <h3>What differs</h3>
          {found.lines.length === 0 && <p className="soft">nothing</p>}
          <ul className="lines">{found.lines.map((line, k) => <li key={k}>{line}</li>)}</ul>
        </div>
        <div>
          <h3>Look at both</h3>
          <ul className="pairs">{found.nodes.filter((node) => !node.same && node.a && node.b).flatMap((node) => Object.keys(node.a!).filter((port) => node.b![port] && node.b![port].digest !== node.a![port].digest).map((port) => (
            <li key={`${node.name}${port}`}><button className="link" onClick={() => { look(0, node.a![port].digest, node.name, port, node.a![port].type, "A"); look(1, node.b![port].digest, node.name, port, node.b![port].type, "B"); set({ tab: "look" }); }}>{node.name}.{port}</button> <span className="soft">{node.a![port].type}</span></li>)))}</ul>
          {found.nodes.every((node) => node.same) && <p className="soft">Both made the same.</p>}
        </div>
      </div>}
    </>
  );
}

function less(a: Json, b: Json, better: string) {
  if (typeof a !== "number" || typeof b !== "number" || a === b) return "";
  const way = better ? ((b > a) === (better === "higher" || better === "more" || better === "high") ? "better" : "worse") : "";
  return <span className={way}>{way === "better" ? "▲" : way === "worse" ? "▼" : ""} {b > a ? "+" : ""}{figure(b - a, 3)}</span>;
}

const Pick = ({ runs, value, pick, words }: { runs: Run[]; value: string; pick: (id: string) => void; words: string }) => (
  <label>{words} <select value={value} onChange={(event) => pick(event.target.value)}>{runs.map((run) => <option key={run.id} value={run.id}>{run.label || run.graph}{run.variant ? ` ${run.variant}` : ""}, {ago(run.started)}, {run.state}</option>)}</select></label>
);
