// The page: bar, graph over what is looked at, inspector at the right.
import { ReactFlowProvider } from "@xyflow/react";
import { Component, useEffect, type ReactNode } from "react";
import { Canvas } from "./graph/Canvas";
import { keys } from "./keys";
import { Dock } from "./panels/Dock";
import { Inspector } from "./panels/Inspector";
import { Overlays } from "./panels/Overlays";
import { TopBar } from "./panels/TopBar";
import { listen } from "./state/live";
import { set, useStudio } from "./state/store";

export function App() {
  useEffect(() => {
    const stop = listen();
    window.addEventListener("keydown", keys);
    return () => { stop(); window.removeEventListener("keydown", keys); };
  }, []);
  const dock = useStudio((s) => s.dock), name = useStudio((s) => s.document?.name), running = useStudio((s) => s.runs.some((run) => ["starting", "running"].includes(run.state)));
  useEffect(() => { document.title = `${running ? "◐ " : ""}${name ?? "exmesh"} · studio`; }, [name, running]);
  return (
    <ReactFlowProvider>
      <div className={`page dock-${dock}`}>
        <TopBar />
        <Connection />
        <main className="middle">{dock !== "full" && <Guard><Canvas /></Guard>}<Guard><Dock /></Guard></main>
        <Guard><Inspector /></Guard>
        <Overlays />
        <Toasts />
      </div>
    </ReactFlowProvider>
  );
}

// A fault in one part of the page leaves the others standing.
class Guard extends Component<{ children: ReactNode }, { fault: string }> {
  state = { fault: "" };
  static getDerivedStateFromError(error: unknown) { return { fault: String(error) }; }
  render() {
    if (!this.state.fault) return this.props.children;
    return <div className="pad"><p className="warning">⚠ This part of the page failed: {this.state.fault}</p><button onClick={() => this.setState({ fault: "" })}>Try again</button></div>;
  }
}

function Connection() {
  const connection = useStudio((s) => s.connection), loaded = useStudio((s) => s.document !== null);
  if (connection === "open") return null;
  if (connection === "connecting") return loaded ? null : <div className="banner" role="status">Reading the graph…</div>;
  if (connection === "denied") return <div className="banner bad" role="alert">This address is no longer good: the studio was started again. Open the address that it printed.</div>;
  return <div className="banner bad" role="alert"><i className="spin turning" /> The server does not answer. Runs go on without it; this page comes back by itself when <code>exmesh studio</code> runs again.</div>;
}

function Toasts() {
  const toasts = useStudio((s) => s.toasts);
  return (
    <div className="toasts" aria-live="polite">
      {toasts.map((each) => (
        <div key={each.id} className={`toast ${each.kind}`} role={each.kind === "error" ? "alert" : "status"}>
          <p>{each.kind === "error" ? "✕ " : ""}{each.text}</p>{each.more && <p className="soft">{each.more}</p>}
          <button className="quiet" aria-label="put away" onClick={() => set((s) => ({ toasts: s.toasts.filter((other) => other.id !== each.id) }))}>✕</button>
        </div>
      ))}
    </div>
  );
}
