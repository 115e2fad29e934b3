// Server-sent events: what changed, as it changes. The browser reconnects by itself; then everything is asked for anew.
import { get } from "../api";
import type { NodeState, Outputs, Plan, Progress, Run } from "../types";
import { meetAwaited, loadCatalog, loadDetails, loadDocument, loadRuns, tell } from "./actions";
import { grow } from "./curves";
import { now, set, type State } from "./store";

let server = "";

export function listen(): () => void {
  const source = new EventSource("/api/events");
  let retry = 0;
  const on = <T,>(kind: string, act: (data: T) => void) =>
    source.addEventListener(kind, (event) => { act(JSON.parse((event as MessageEvent<string>).data) as T); });

  const first = server ? null : loadDocument().then(() => now().document!.events, () => null); // index.html asks for it; a failure is told by the refresh
  on<{ server: string; events: number }>("hello", async (hello) => {
    if (server && server !== hello.server) set({ catalog: null }); // another process: its packs may differ
    server = hello.server;
    set({ connection: "open" });
    const events = await first;
    void refresh(typeof events !== "number" ? "anew" : events === hello.events ? "known" : "checked");
  });
  on("lagged", () => void refresh());
  on<{ revision: number }>("document", ({ revision }) => {
    if (now().document?.revision !== revision) loadDocument().catch(tell);
  });
  on("disk", () => loadDocument().catch(tell));
  on("plan", () => get<{ revision: number; plan: Plan | null }>("/api/plan").then(({ revision, plan }) => set((s) => (s.document && plan && s.document.revision === revision ? { document: { ...s.document, plan, plan_pending: false } } : {}))).catch(tell));
  on<{ id: string }>("runs", ({ id }) => loadRuns().then(() => (id === now().followed ? loadDetails(id) : null)).catch(tell));
  on<Run>("run", (run) => { if (news(run)) { waiting.delete(`run ${run.id}`); takeRun(run); } else buffered(`run ${run.id}`, (s) => withRun(s, run), CALM); });
  on<NodeEvent>("node", (event) => buffered(`node ${event.name} ${event.state}`, (s) => takeNode(s, event)));
  on<ProgressEvent>("progress", (event) => { grow(event); buffered(`progress ${event.name}`, (s) => takeProgress(s, event), CALM); });
  on("log", () => buffered("log", (s) => ({ logTick: s.logTick + 1 }), CALM));
  source.onerror = () => {
    if (now().connection !== "denied") set({ connection: "lost" });
    if (source.readyState === EventSource.CLOSED) retry = window.setTimeout(probe, 1500); // it will not try again by itself
  };
  return () => { clearTimeout(retry); source.close(); };
}

// The document is known where nothing happened between its answer and this stream; what did may be no more than its plan.
async function refresh(document: "anew" | "checked" | "known" = "anew"): Promise<void> {
  try {
    await Promise.all([document === "known" ? null : loadDocument(document === "checked"), loadRuns(), now().catalog ? null : loadCatalog()]);
    const { followed, runs, document: open } = now();
    const live = runs.find((run) => ["starting", "running", "stopping"].includes(run.state) && run.graph === open?.name);
    const id = followed ?? live?.id;
    if (id) { set({ followed: id }); await loadDetails(id); }
  } catch (error) { tell(error); }
}

// The browser gave up (a proxy's or server's refusal): ask until it answers again.
function probe(): void {
  get("/api/session").then(() => listen()).catch((error) => { tell(error); setTimeout(probe, 2000); });
}

interface NodeEvent { run: string; name: string; id: string; state: string; seconds: number | null; peak_memory: number | null; outputs?: Outputs; message: string }
export interface ProgressEvent { run: string; name: string; id: string; step: number; total: number; left: number | null; figures: { [name: string]: number }; time: number; t: number }

// A run that began, or is in another state now.
const news = (run: Run): boolean => now().runs.find((other) => other.id === run.id)?.state !== run.state;

function takeRun(run: Run): void {
  const { runs, followed, document } = now(), known = runs.find((other) => other.id === run.id);
  set(known ? withRun(now(), run) : { runs: [run, ...runs] });
  meetAwaited();
  if (!known && followed === null && run.graph === document?.name) { set({ followed: run.id }); loadDetails(run.id).catch(tell); }
  else if (followed === run.id) loadDetails(run.id).catch(tell);
}

const withRun = (s: State, run: Run): Partial<State> => ({ runs: s.runs.map((other) => (other.id === run.id ? { ...other, ...run } : other)) });

const blank = (name: string, id: string): NodeState => ({ name, id, type: "", state: "waiting", seconds: null, spent: null, peak_memory: null, began: null, progress: null, warnings: [], outputs: null, failure: null });

function takeNode(s: State, event: NodeEvent): Partial<State> {
  if (event.run !== s.followed) return {};
  if (event.state === "failed") loadDetails(event.run).catch(tell);
  const old = s.states.get(event.name) ?? blank(event.name, event.id);
  const state: NodeState = { ...old, state: event.state, seconds: event.seconds ?? old.seconds, peak_memory: event.peak_memory ?? old.peak_memory,
    outputs: event.outputs ?? old.outputs, began: event.state === "running" ? Date.now() / 1000 : old.began, progress: event.state === "running" ? old.progress : null };
  return { states: new Map(s.states).set(event.name, state), logTick: s.logTick + 1 };
}

function takeProgress(s: State, event: ProgressEvent): Partial<State> {
  if (event.run !== s.followed) return {};
  const old = s.states.get(event.name) ?? blank(event.name, event.id);
  if (!["", "waiting", "pending", "running"].includes(old.state)) return {}; // it has ended meanwhile
  const progress: Progress = { step: event.step, total: event.total, left: event.left, figures: event.figures };
  return { states: new Map(s.states).set(event.name, { ...old, state: "running", progress }) };
}

// What happens is drawn together, of each thing the last. A page that is drawn often takes time from the run that it
// watches, so it measures what a draw costs and rests in proportion: states of nodes come sooner than progress.
// A page that nobody sees waits until somebody does.
const SOON = 250, STATES = { times: 300, most: 4000 }, CALM = { times: 900, most: 8000 };
type Act = (s: State) => Partial<State>;
const waiting = new Map<string, Act>();
let due = Infinity, timer = 0, cost = 8, drawn = -Infinity;
function buffered(what: string, act: Act, rest = STATES): void {
  waiting.delete(what);
  waiting.set(what, act);
  const at = Math.max(performance.now() + SOON, drawn + Math.min(rest.most, rest.times * cost));
  if (at >= due) return;
  due = at;
  clearTimeout(timer);
  timer = window.setTimeout(flush, at - performance.now());
}

function flush(): void {
  if (document.hidden) return; // `due` stays: no other timer is set meanwhile
  due = Infinity;
  const all = [...waiting.values()], began = performance.now();
  waiting.clear();
  if (!all.length) return;
  drawn = began;
  set((s) => all.reduce((sum, act) => ({ ...sum, ...act(sum) }), { ...s, beat: s.beat + 1 })); // at once: each change asks every box
  queueMicrotask(() => measure(performance.now() - began));
}

// A draw costs its scripts, and what the browser does between the next frame and the task after it.
function measure(scripts: number): void {
  requestAnimationFrame((frame) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => { cost = 0.7 * cost + 0.3 * (scripts + performance.now() - frame); port1.close(); };
    port2.postMessage(null);
  });
}
document.addEventListener("visibilitychange", flush);
