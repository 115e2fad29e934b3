// Server-sent events: what changed, as it changes. The browser reconnects by itself; then everything is asked for anew.
import { get } from "../api";
import type { NodeState, Outputs, Plan, Progress, Run } from "../types";
import { meetAwaited, loadCatalog, loadDetails, loadDocument, loadRuns, tell } from "./actions";
import { now, set } from "./store";

let server = "";

export function listen(): () => void {
  const source = new EventSource("/api/events");
  const on = <T,>(kind: string, act: (data: T) => void) =>
    source.addEventListener(kind, (event) => { act(JSON.parse((event as MessageEvent<string>).data) as T); });

  on<{ server: string }>("hello", (hello) => {
    if (server && server !== hello.server) set({ catalog: null }); // another process: its packs may differ
    server = hello.server;
    set({ connection: "open" });
    void refresh();
  });
  on("lagged", () => void refresh());
  on<{ revision: number }>("document", ({ revision }) => {
    if (now().document?.revision !== revision) loadDocument().catch(tell);
  });
  on("disk", () => loadDocument().catch(tell));
  on("plan", () => get<{ revision: number; plan: Plan | null }>("/api/plan").then(({ revision, plan }) => set((s) => (s.document && plan && s.document.revision === revision ? { document: { ...s.document, plan, plan_pending: false } } : {}))).catch(tell));
  on<{ id: string }>("runs", ({ id }) => loadRuns().then(() => (id === now().followed ? loadDetails(id) : null)).catch(tell));
  on<Run>("run", (run) => { if (news(run)) { waiting.delete(`run ${run.id}`); takeRun(run); } else buffered(`run ${run.id}`, () => takeRun(run), CALM); });
  on<NodeEvent>("node", (event) => buffered(`node ${event.name} ${event.state}`, () => takeNode(event)));
  on<ProgressEvent>("progress", (event) => buffered(`progress ${event.name}`, () => takeProgress(event), CALM));
  on("log", () => buffered("log", () => set((s) => ({ logTick: s.logTick + 1 })), CALM));
  source.onerror = () => { if (now().connection !== "denied") set({ connection: "lost" }); };
  const watch = setInterval(() => { if (source.readyState === EventSource.CLOSED) { clearInterval(watch); probe(); } }, 1500);
  return () => { clearInterval(watch); source.close(); };
}

async function refresh(): Promise<void> {
  try {
    await Promise.all([loadDocument(), loadRuns(), now().catalog ? null : loadCatalog()]);
    const { followed, runs, document } = now();
    const live = runs.find((run) => ["starting", "running", "stopping"].includes(run.state) && run.graph === document?.name);
    const id = followed ?? live?.id;
    if (id) { set({ followed: id }); await loadDetails(id); }
  } catch (error) { tell(error); }
}

// The browser gave up (a proxy's or server's refusal): ask until it answers again.
function probe(): void {
  get("/api/session").then(() => listen()).catch((error) => { tell(error); setTimeout(probe, 2000); });
}

interface NodeEvent { run: string; name: string; id: string; state: string; seconds: number | null; peak_memory: number | null; outputs?: Outputs; message: string }
interface ProgressEvent { run: string; name: string; id: string; step: number; total: number; left: number | null; figures: { [name: string]: number }; time: number; t: number }

function takeRun(run: Run): void {
  const { runs, followed, document } = now(), known = runs.find((other) => other.id === run.id);
  if (known && known.state === run.state && known.ready === run.ready && known.seconds === run.seconds) return;
  set({ runs: known ? runs.map((other) => (other.id === run.id ? { ...other, ...run } : other)) : [run, ...runs] });
  meetAwaited();
  if (!known && followed === null && run.graph === document?.name) { set({ followed: run.id }); loadDetails(run.id).catch(tell); }
  else if (followed === run.id && known?.state !== run.state) loadDetails(run.id).catch(tell);
}

const blank = (name: string, id: string): NodeState => ({ name, id, type: "", state: "waiting", seconds: null, spent: null, peak_memory: null, began: null, progress: null, warnings: [], outputs: null, failure: null });

function takeNode(event: NodeEvent): void {
  if (event.run !== now().followed) return;
  set((s) => {
    const old = s.states.get(event.name) ?? blank(event.name, event.id);
    const state: NodeState = { ...old, state: event.state, seconds: event.seconds ?? old.seconds, peak_memory: event.peak_memory ?? old.peak_memory,
      outputs: event.outputs ?? old.outputs, began: event.state === "running" ? Date.now() / 1000 : old.began, progress: event.state === "running" ? old.progress : null };
    return { states: new Map(s.states).set(event.name, state), logTick: s.logTick + 1 };
  });
  if (event.state === "failed") loadDetails(event.run).catch(tell);
}

function takeProgress(event: ProgressEvent): void {
  if (event.run !== now().followed) return;
  set((s) => {
    const old = s.states.get(event.name) ?? blank(event.name, event.id);
    const progress: Progress = { step: event.step, total: event.total, left: event.left, figures: event.figures };
    return { states: new Map(s.states).set(event.name, { ...old, state: "running", progress }) };
  });
}

// A run that began, or is in another state now.
const news = (run: Run): boolean => now().runs.find((other) => other.id === run.id)?.state !== run.state;

// What happens is drawn together, of each thing the last: states of nodes at once, progress every three seconds, since a
// page that is drawn often takes time from the run that it watches. A page that nobody sees waits until somebody does.
const SOON = 250, CALM = 3000;
const waiting = new Map<string, () => void>();
let due = Infinity, timer = 0;
function buffered(what: string, act: () => void, within = SOON): void {
  waiting.delete(what);
  waiting.set(what, act);
  const at = Date.now() + within;
  if (at >= due) return;
  due = at;
  clearTimeout(timer);
  timer = window.setTimeout(flush, within);
}

function flush(): void {
  if (document.hidden) return; // `due` stays: no other timer is set meanwhile
  due = Infinity;
  const all = [...waiting.values()];
  waiting.clear();
  for (const one of all) one();
  if (all.length) set((s) => ({ beat: s.beat + 1 }));
}
document.addEventListener("visibilitychange", flush);
