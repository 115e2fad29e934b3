// With and without: marked nodes become variants, a sweep runs them, a table tells what each was worth. Two runs beside each other.
import { useEffect, useState } from "react";
import { post } from "../api";
import { follow, loadRuns, tell } from "../state/actions";
import { set, toast, useStudio } from "../state/store";
import { count } from "../text";
import type { Ablation, Run } from "../types";
import { toggleMark } from "./NodeHead";
import { RunPair } from "./RunPair";
import { SweepTable } from "./SweepTable";

export function Compare() {
  const [view, setView] = useState<"without" | "runs">("without");
  return (
    <div className="compare scroll">
      <div className="tools"><span className="group"><button aria-pressed={view === "without"} onClick={() => setView("without")}>With and without</button><button aria-pressed={view === "runs"} onClick={() => setView("runs")}>Two runs</button></span></div>
      {view === "without" ? <WithAndWithout /> : <RunPair />}
    </div>
  );
}

function WithAndWithout() {
  const marked = useStudio((s) => s.marked), sweeps = useStudio((s) => s.runs.filter((run) => run.sweep)), document = useStudio((s) => s.document);
  const [plan, setPlan] = useState<Ablation | null>(null), [repeats, setRepeats] = useState(1), [shown, setShown] = useState<string | null>(null), [busy, setBusy] = useState(false);
  const nodes = [...marked], key = nodes.join(" ");
  useEffect(() => {
    if (!nodes.length) { setPlan(null); return; }
    let gone = false;
    post<Ablation>("/api/ablation", { nodes, repeats, name: "ablation" }).then((found) => { if (!gone) setPlan(found); }).catch((error) => { if (!gone) { setPlan(null); tell(error); } });
    return () => { gone = true; };
  }, [key, repeats, document?.revision]); // eslint-disable-line
  const start = async () => {
    setBusy(true);
    try {
      const { run } = await post<{ run: Run }>("/api/sweep", { nodes, repeats });
      await loadRuns();
      setShown(run.id || null);
      toast("info", "The sweep runs. Its table stands here when it ends.");
    } catch (error) { tell(error); } finally { setBusy(false); }
  };
  const save = async () => {
    try { await post("/api/ablation", { nodes, repeats, name: "ablation", save: "ablation.yaml" }); toast("info", "Saved ablation.yaml beside the graph."); } catch (error) { tell(error); }
  };
  const chosen = sweeps.find((run) => run.id === shown) ?? sweeps[0];
  return (
    <>
      <div className="two">
        <div>
          <h3>1 · Mark nodes</h3>
          {nodes.length === 0 ? <p className="soft">Select a node and press <b>◆ Mark</b> (M). Each marked node is left out once; the graph with all of them is the base.</p>
            : <p>{nodes.map((id) => <span className="chip" key={id}>◆ {id} <button className="quiet" onClick={() => toggleMark(id)} aria-label={`unmark ${id}`}>✕</button></span>)} <button className="link" onClick={() => set({ marked: new Set() })}>none</button></p>}
          {plan && <>
            <table><thead><tr><th>Variant</th><th>How</th><th className="n">shared with the base</th><th className="n">would run</th></tr></thead><tbody>
              {plan.variants.map((variant) => { const told = plan.plan.variants.find((other) => other.name === variant.name); return (
                <tr key={variant.name}><td>{variant.name}</td><td>{variant.how === "refused" ? <span className="warning">⚠ {variant.why}</span> : variant.how}</td><td className="n">{told ? `${told.shared} of ${told.nodes}` : ""}</td><td className="n">{told ? (told.counts.run ?? 0) + (told.counts.unknown ?? 0) : ""}</td></tr>); })}
            </tbody></table>
            <p className="soft">{plan.plan.nodes} nodes in all, {plan.plan.distinct} after sharing.</p>
          </>}
        </div>
        {plan && <div>
          <h3>2 · Run</h3>
          <p><label>Seeds <input type="number" min={1} max={9} value={repeats} onChange={(event) => setRepeats(Math.max(1, Number(event.target.value) || 1))} /></label></p>
          <div className="buttons"><button className="run" disabled={busy || plan.variants.every((variant) => variant.how === "refused")} onClick={() => void start()}>▶ Compare with and without</button><button onClick={() => void save()}>Save as ablation.yaml</button></div>
          <details><summary>As a file</summary><pre className="patch">{plan.text}</pre></details>
        </div>}
      </div>
      {chosen && <div>
        <h3>{nodes.length ? "3 · " : ""}Table <select value={chosen.id} onChange={(event) => setShown(event.target.value)} aria-label="sweep">{sweeps.map((run) => <option key={run.id} value={run.id}>{run.id}</option>)}</select> <span className="soft">{chosen.state}, {count(chosen.ready, "node")} of {chosen.nodes}</span> <button className="link" onClick={() => void follow(chosen.id, true)}>watch it</button></h3>
        <SweepTable run={chosen} />
      </div>}
    </>
  );
}
