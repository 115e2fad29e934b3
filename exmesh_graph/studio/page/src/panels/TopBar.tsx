// What is open, what would run, and the buttons that one needs at any time.
import { edit, forgetPreview, openGraph, redo, reload, startRun, stopRun, undo } from "../state/actions";
import { set, useStudio } from "../state/store";
import { count, seconds } from "../text";
import { RunMenu } from "./Runs";
import { useTheme } from "./theme";

export function TopBar() {
  const document = useStudio((s) => s.document), busy = useStudio((s) => s.busy), runGraph = useStudio((s) => s.runGraph);
  const [theme, turn] = useTheme();
  if (!document) return <header className="top"><Brand /></header>;
  return (
    <header className="top">
      <Brand />
      <button className="file" onClick={() => set({ overlay: "open" })} title={`${document.path}\nOpen another graph`}>
        <b>{document.file}</b>{document.variant && <span className="chip">{document.variant}</span>}{document.dirty && <span className="dirty" title="edits that are not saved">●</span>} <span className="soft">▾</span>
      </button>
      {document.disk === "changed" && <button className="warn" onClick={() => void reload()} title="Somebody else wrote the file. Your edits are kept where they still apply.">File changed: read again</button>}
      <span className="group">
        <button onClick={() => void undo()} disabled={!document.can_undo || busy} title="Undo (Ctrl+Z)" aria-label="Undo">↶</button>
        <button onClick={() => void redo()} disabled={!document.can_redo || busy} title="Redo (Ctrl+Shift+Z)" aria-label="Redo">↷</button>
      </span>
      <button onClick={() => set({ overlay: "save" })} disabled={!document.dirty} title="Save (Ctrl+S)">Save…</button>
      <button onClick={() => set({ overlay: "add", addAt: null })} disabled={runGraph !== null} title="Add a node (A)">+ Node</button>
      <PlanWords />
      <span className="spring" />
      <RunMenu />
      <RunButton />
      <button className="icon" onClick={turn} title={`Theme: ${theme}`} aria-label="Theme">{theme === "light" ? "☀" : theme === "dark" ? "☾" : "◑"}</button>
      <button className="icon" onClick={() => set({ overlay: "help" })} title="Keys and signs (?)" aria-label="Help">?</button>
    </header>
  );
}

const Brand = () => <span className="brand"><svg viewBox="0 0 32 32" width="20" height="20" aria-hidden><rect width="32" height="32" rx="7" fill="currentColor" /><path d="M16 5 27 24H5Z" fill="none" stroke="#fff" strokeWidth="2.4" strokeLinejoin="round" /></svg> exmesh <b>studio</b></span>;

// "12 of 39 would run, about 1 min 35 s": of the edit that is being tried, else of the document.
function PlanWords() {
  const plan = useStudio((s) => s.document?.plan), problems = useStudio((s) => s.document?.problems.length ?? 0), preview = useStudio((s) => s.preview);
  const live = useStudio((s) => s.runs.some((run) => run.id === s.followed && ["starting", "running", "stopping"].includes(run.state)));
  const busy = useStudio((s) => s.busy), pending = useStudio((s) => s.document?.plan_pending ?? false);
  if (problems) return <button className="plan bad" onClick={() => set({ selected: null })} title="shown at the right">⚠ {count(problems, "fault")}</button>;
  if (preview) return <span className="plan trying" role="status">with this: {preview.run ? `${count(preview.run, "node")} would run, about ${seconds(preview.seconds) || "?"}` : "nothing would run"}</span>;
  if (!plan || pending) return <span className="plan soft" role="status">{busy || pending ? "looking what would run…" : ""}</span>;
  if (live) return null; // the run itself says how far it is
  const { hit, run, unknown } = plan.counts, all = hit + run + unknown;
  if (run + unknown === 0) return <span className="plan" role="status">✓ all {all} in the store</span>;
  return <span className="plan" role="status" title={plan.complete ? "from earlier runs on this machine" : "of some nodes no earlier run tells the time"}>
    ▷ <b>{run + unknown}</b> of {all} would run{plan.seconds ? `, ${plan.complete ? "about" : "more than"} ${seconds(plan.seconds)}` : ""}</span>;
}

function RunButton() {
  const run = useStudio((s) => s.runs.find((other) => other.id === s.followed)), busy = useStudio((s) => s.busy);
  const awaiting = useStudio((s) => s.awaiting !== null), faulty = useStudio((s) => (s.document?.problems.length ?? 0) > 0), live = run && ["starting", "running", "stopping"].includes(run.state);
  if (live) return (
    <span className="group">
      <span className="plan live" role="status">{run.ready}/{run.nodes}{run.left ? ` · ${seconds(run.left)} left` : ""}</span>
      <button className="stop" onClick={() => void stopRun(run.id)} disabled={!run.can_stop} title={run.state === "stopping" ? "Stop at once" : "Stop; running nodes write a checkpoint"}>■ {run.state === "stopping" ? "Stopping…" : "Stop"}</button>
    </span>
  );
  if (awaiting) return <button className="stop" disabled><i className="spin turning" /> Starting…</button>;
  return <button className="run" onClick={() => { forgetPreview(); void startRun(); }} disabled={busy || faulty} title={faulty ? "The graph has faults." : "Run (Ctrl+Enter). What is in the store is taken from it."}>▶ Run</button>;
}

export const openVariant = (file: string, name: string) => openGraph(file, name);
export { edit };
