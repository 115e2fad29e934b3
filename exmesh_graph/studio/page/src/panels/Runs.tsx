// Runs: those of this studio and those that others started on the same store; one of them lies over the graph.
import { useState } from "react";
import { address } from "../api";
import { follow, resumeRun, stopRun } from "../state/actions";
import { set, useStudio } from "../state/store";
import { Busy } from "./Busy";
import { ago, count, figure, seconds } from "../text";
import type { Run } from "../types";

export const LIVE = ["starting", "running", "stopping"];
const SIGN: { [state: string]: string } = { starting: "…", running: "◐", stopping: "❚❚", done: "✓", failed: "✕", interrupted: "❚❚", killed: "✕", unreadable: "?" };

export function RunMenu() {
  const runs = useStudio((s) => s.runs), followed = useStudio((s) => s.followed);
  const [open, setOpen] = useState(false);
  const live = runs.filter((run) => LIVE.includes(run.state)).length;
  return (
    <span className="menu-holder" onKeyDown={(event) => { if (event.key === "Escape") setOpen(false); }}>
      <button onClick={() => setOpen(!open)} aria-expanded={open} title="Runs, also those started elsewhere">Runs{live ? <span className="chip live">{live}</span> : ""} <span className="soft">▾</span></button>
      {open && (
        <div className="menu runs" role="menu">
          {runs.length === 0 && <p className="soft">No run yet. Press Run.</p>}
          {followed !== null && <button role="menuitem" onClick={() => { void follow(null); setOpen(false); }}>Show the graph without a run</button>}
          {runs.map((run) => <RunLine key={run.id} run={run} followed={run.id === followed} close={() => setOpen(false)} />)}
        </div>
      )}
    </span>
  );
}

function RunLine({ run, followed, close }: { run: Run; followed: boolean; close: () => void }) {
  const name = useStudio((s) => s.document?.name);
  const first = Object.entries(run.headline ?? {})[0];
  return (
    <div className={`run-line${followed ? " followed" : ""}`}>
      <button role="menuitem" onClick={() => { void follow(run.id, run.graph !== name || run.sweep); if (run.sweep) set({ tab: "compare", dock: "open" }); close(); }} title={`${run.id}\n${run.file}`}>
        <span className={`sign is-${run.state}`}>{LIVE.includes(run.state) ? <Busy /> : SIGN[run.state] ?? "?"}</span>
        <span><b>{run.label || run.graph}</b>{run.variant && <span className="chip">{run.variant}</span>}{run.sweep && <span className="chip">sweep</span>}{!run.ours && <span className="chip" title="started elsewhere">elsewhere</span>}
          <br /><span className="soft">{ago(run.started)} · {run.state} · {seconds(run.seconds)} · {run.ready}/{run.nodes}{first ? ` · ${first[0]} ${figure(first[1].value)}` : ""}</span></span>
      </button>
      {run.report && <a className="button quiet" href={`/api/runs/${encodeURIComponent(run.id)}/report`} target="_blank" rel="noreferrer" title="The run's report">report</a>}
    </div>
  );
}

export function RunCard({ run }: { run: Run }) {
  const live = LIVE.includes(run.state), own = useStudio((s) => s.runGraph !== null);
  const now = useStudio((s) => s.runs.find((other) => other.id === run.id)) ?? run;
  const failures = useStudio((s) => s.details?.nodes_detail.filter((node) => node.failure) ?? []);
  return (
    <section className={`card run-card is-${now.state}`}>
      <h3><span className={`sign is-${now.state}`}>{live ? <Busy /> : SIGN[now.state]}</span> Run {now.label || now.id} <button className="quiet" onClick={() => void follow(null)} aria-label="Put away" title="Show the graph without this run">✕</button></h3>
      <p>{now.state}, {now.ready} of {now.nodes} nodes{now.hits ? `, ${now.hits} of them from the store` : ""}, {seconds(now.seconds)}{live && now.left ? `, about ${seconds(now.left)} left` : ""}</p>
      <div className="meter"><i style={{ width: `${(100 * now.ready) / Math.max(1, now.nodes)}%` }} /></div>
      {failures.map((node) => <FailureNote key={node.name} name={node.name} failure={node.failure!} />)}
      {Object.keys(now.headline ?? {}).length > 0 && (
        <table><tbody>{Object.entries(now.headline).slice(0, 8).map(([label, told]) => <tr key={label}><td>{label}</td><td className="n">{figure(told.value)} <span className="soft">{told.unit}</span></td></tr>)}</tbody></table>
      )}
      <div className="buttons">
        {live && <button className="stop" onClick={() => void stopRun(run.id)} disabled={!now.can_stop}>■ Stop</button>}
        {!live && now.can_resume && <button className="run" onClick={() => void resumeRun(run.id)}>▶ Go on</button>}
        {now.report && <a className="button" href={`/api/runs/${encodeURIComponent(run.id)}/report`} target="_blank" rel="noreferrer">Report</a>}
        <button onClick={() => set({ tab: "log", dock: "open", selected: null })}>Log</button>
        <button onClick={() => set({ tab: "curves", dock: "open" })}>Curves</button>
        {own ? <button onClick={() => void follow(null)}>Back to the open graph</button> : <button onClick={() => void follow(run.id, true)} title="The graph as this run ran it, with the values that it had then">Its graph</button>}
      </div>
    </section>
  );
}

export function FailureNote({ name, failure }: { name: string; failure: { message: string; error?: string; traceback?: string; replay?: string; run_again?: string } }) {
  return (
    <div className="failure">
      <p><b>✕ {name} failed.</b> {failure.message || failure.error}</p>
      {failure.replay && <Command words="Replay it alone" line={failure.replay} />}
      {failure.traceback && <details><summary>Traceback</summary><pre>{failure.traceback}</pre></details>}
    </div>
  );
}

export function Command({ words, line }: { words: string; line: string }) {
  const [copied, setCopied] = useState(false);
  return <p className="command">{words}: <code>{line}</code> <button className="quiet" onClick={() => { void navigator.clipboard?.writeText(line).then(() => { setCopied(true); setTimeout(() => setCopied(false), 1500); }); }}>{copied ? "copied" : "copy"}</button></p>;
}

export const reportAddress = (id: string) => address(`/api/runs/${encodeURIComponent(id)}/report`);
export { count };
