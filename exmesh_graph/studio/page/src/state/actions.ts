// What the page does on the server's side: edits, runs, saving. A refusal becomes a message with the server's words.
import { Refusal, get, post } from "../api";
import type { Artifact, Catalog, Document, Ends, Graph, Json, NodeState, Op, Run, RunDetail } from "../types";
import { now, set, toast } from "./store";
import { wholeDocument, wholeGraph, type Sent } from "./whole";

export function tell(error: unknown): void {
  if (error instanceof DOMException && error.name === "AbortError") return;
  if (error instanceof Refusal) {
    if (error.code === "unreachable") { set({ connection: "lost" }); return; }
    if (error.status === 401) set({ connection: "denied" });
    toast("error", error.message, [error.where, error.fix].filter(Boolean).join(" · "));
  } else {
    console.error(error);
    toast("error", error instanceof Error ? error.message : String(error));
  }
}

function take(sent: object): Document {
  const document = wholeDocument(sent);
  set((s) => ({ document, preview: null, selected: s.runGraph || !s.selected || document.nodes.some((n) => n.id === s.selected) ? s.selected : null }));
  return document;
}

// With `keep` what is drawn stays where the graph is the same: then only its plan, or its file on the disk, may be others.
export async function loadDocument(keep = false): Promise<void> {
  const sent = await get<Document>("/api/document"), { document } = now();
  if (keep && document?.revision === sent.revision) set({ document: { ...document, plan: sent.plan, plan_pending: sent.plan_pending, disk: sent.disk } });
  else take(sent);
}

export async function loadCatalog(): Promise<void> {
  set({ catalog: await get<Catalog>("/api/catalog") });
}

async function change(path: string, body: { [name: string]: Json | undefined }): Promise<Document | null> {
  set({ busy: true });
  try {
    return take(await post<object>(path, body));
  } catch (error) {
    if (error instanceof Refusal && error.status === 409 && path === "/api/edit") {
      await loadDocument().catch(tell);
      toast("error", "The graph was changed elsewhere meanwhile; the edit was not made.", "The page shows the present state. Make the edit again.");
    } else tell(error);
    return null;
  } finally {
    set({ busy: false });
  }
}

export const edit = (...ops: Op[]): Promise<Document | null> => {
  const { document, runGraph } = now();
  if (!document || runGraph) { toast("info", "This is a finished run's graph. Go back to the open graph to edit it."); return Promise.resolve(null); }
  return change("/api/edit", { revision: document.revision, ops });
};
export const undo = () => change("/api/undo", {});
export const redo = () => change("/api/redo", {});
export const revert = () => change("/api/revert", {});
export const reload = () => change("/api/reload", {});

export async function openGraph(file: string, variant = "", discard = false): Promise<void> {
  if (await change("/api/open", { file, variant, ...(discard ? { discard: true } : {}) }))
    set({ runGraph: null, followed: null, details: null, states: new Map(), selected: null, marked: new Set(), looked: [null, null] });
}

// What would run again with an edit that is not made yet.
let trial: AbortController | null = null;
export async function tryEdit(target: string, ...ops: Op[]): Promise<void> {
  trial?.abort();
  const mine = (trial = new AbortController()), { document, runGraph } = now();
  if (!document || runGraph) return;
  try {
    const answer = await post<{ document: Document }>("/api/try", { revision: document.revision, ops }, mine.signal);
    const plan = answer.document.plan;
    if (mine.signal.aborted || !plan) return;
    const names = Object.entries(plan.nodes).filter(([, planned]) => planned.state !== "hit").map(([id]) => id);
    set({ preview: { for: target, seconds: plan.seconds, run: plan.counts.run + plan.counts.unknown, names } });
  } catch { if (!mine.signal.aborted) set({ preview: null }); }
}
export function forgetPreview(): void { trial?.abort(); set({ preview: null }); }

export async function save(body: { [name: string]: Json }): Promise<boolean> {
  try {
    const { document, saved } = await post<{ document: object; saved: string }>("/api/save", body);
    take(document);
    toast("info", body.as === "variant" ? `Saved as variant ${String(body.name)} of ${saved}` : `Saved ${saved}`);
    return true;
  } catch (error) { tell(error); return false; }
}

// Answers may come in another order than they were asked for: one that is older than what is shown is dropped.
let asked = 0;
const taken: { [what: string]: number } = {};
const isNews = (what: string, number: number): boolean => number > (taken[what] ?? 0) && Boolean((taken[what] = number));

export async function loadRuns(): Promise<void> {
  const mine = ++asked, { runs } = await get<{ runs: Run[] }>("/api/runs", { last: 60 });
  if (!isNews("runs", mine)) return;
  set({ runs });
  meetAwaited();
}

// A run that was asked for gets its name when its process has begun, which takes seconds on a busy machine.
export function meetAwaited(): void {
  const { awaiting, runs } = now();
  if (awaiting === null) return;
  const found = runs.find((run) => run.started >= awaiting - 1);
  if (!found) return;
  set({ awaiting: null });
  void follow(found.id);
}

// Puts a run's states over the graph; with `itsGraph` shows the graph as that run ran it.
export async function follow(id: string | null, itsGraph = false): Promise<void> {
  if (id === null) { set({ followed: null, details: null, states: new Map(), runGraph: null }); return; }
  set((s) => ({ followed: id, states: s.followed === id ? s.states : new Map(), details: s.followed === id ? s.details : null, ...(itsGraph ? {} : { runGraph: null }) }));
  try {
    await loadDetails(id);
    if (itsGraph || !agrees()) {
      const sent = await get<Sent & Graph>(`/api/runs/${encodeURIComponent(id)}/graph`);
      if (now().followed === id) set({ runGraph: { run: id, graph: { outputs: sent.outputs, ...wholeGraph(sent) } }, selected: null });
    }
  } catch (error) { tell(error); }
}

// Whether the open graph has all nodes of the followed run; else the run is shown with its own.
function agrees(): boolean {
  const { document, details } = now(), known = new Set(document?.nodes.flatMap((node) => node.names));
  return details?.nodes_detail?.every((node) => known.has(node.name)) ?? true;
}

export async function loadDetails(id: string): Promise<void> {
  const mine = ++asked, details = await get<RunDetail>(`/api/runs/${encodeURIComponent(id)}`);
  if (now().followed !== id || !details.nodes_detail || !isNews("details", mine)) return; // a run that is starting has no nodes yet
  set((s) => ({ details, states: new Map<string, NodeState>(details.nodes_detail.map((node) => [node.name, node])), beat: s.beat + 1 }));
}

export async function startRun(nodes: string[] = [], force: string[] = [], start: string[] = []): Promise<void> {
  const { document } = now();
  if (!document) return;
  const begun = Date.now() / 1000;
  set({ busy: true });
  try {
    const { run } = await post<{ run: Run }>("/api/runs", { nodes, force, start });
    set((s) => ({ runGraph: null, pursue: true, ...(s.dock === "closed" ? { dock: "open" as const, tab: "curves" as const } : {}) }));
    if (!run.id) set({ awaiting: begun, followed: null, details: null, states: new Map() });
    await loadRuns();
    if (run.id) await follow(run.id);
  } catch (error) { tell(error); } finally { set({ busy: false }); }
}

export async function stopRun(id: string): Promise<void> {
  try { await post("/api/runs/stop", { id }); await loadRuns(); } catch (error) { tell(error); }
}

export async function resumeRun(id: string): Promise<void> {
  try {
    const begun = Date.now() / 1000, { run } = await post<{ run: Run }>("/api/runs/resume", { id });
    if (!run.id) set({ awaiting: begun });
    await loadRuns();
    if (run.id) await follow(run.id);
  } catch (error) { tell(error); }
}

export async function artifactOf(digest: string): Promise<Artifact> {
  const known = now().artifacts.get(digest);
  if (known) return known;
  const artifact = await get<Artifact>("/api/artifact", { digest });
  set((s) => ({ artifacts: new Map(s.artifacts).set(digest, artifact) }));
  return artifact;
}

export const endsOf = (node: string, port: string, output: boolean, side = "", signal?: AbortSignal) =>
  get<Ends>("/api/ends", { node, port, ...(output ? { output: 1 } : {}), ...(side ? { side } : {}) }, signal);
