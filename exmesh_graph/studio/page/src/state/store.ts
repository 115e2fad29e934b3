// All that the page knows, in one store; actions live in actions.ts, events from the server in live.ts.
import { create } from "zustand";
import type { Artifact, Catalog, Document, Graph, GraphNode, NodeState, Run, RunDetail } from "../types";

export type DockTab = "look" | "curves" | "log" | "changes" | "compare";
export type BlockView = "folded" | "open" | "rounds";
export interface Toast { id: number; kind: "info" | "error"; text: string; more?: string }
// What is looked at: an artifact by digest, with where it came from.
export interface Looked { digest: string; node: string; port: string; run: string; label: string; type: string }
export interface Preview { for: string; seconds: number; run: number; names: string[] }

export interface State {
  connection: "connecting" | "open" | "lost" | "denied";
  document: Document | null;
  catalog: Catalog | null;
  runs: Run[];
  awaiting: number | null; // seconds since 1970 when a run was asked for that has no name yet
  followed: string | null; // the run whose states lie over the graph
  details: RunDetail | null;
  runGraph: { run: string; graph: Graph } | null; // where a run's own graph is shown in place of the document
  states: Map<string, NodeState>; // of the followed run, by name (rounds not folded)
  selected: string | null; // a node's id
  round: number | null; // of the selected node: which of its rounds, null: the last
  marked: Set<string>;
  pursue: boolean; // what runs is kept in view
  blocks: { [id: string]: BlockView };
  tab: DockTab;
  dock: "open" | "closed" | "full";
  looked: [Looked | null, Looked | null];
  before: Looked | null; // what was looked at before, to be put beside
  artifacts: Map<string, Artifact>;
  busy: boolean;
  preview: Preview | null;
  toasts: Toast[];
  overlay: null | "add" | "help" | "save" | "open";
  addAt: { node: string; port: string; output: boolean; types: string[] } | null; // an end that the new node is wired to
  beat: number; // grows when what a run does is drawn anew
  logTick: number;
}

export const useStudio = create<State>(() => ({
  connection: "connecting", document: null, catalog: null, runs: [], awaiting: null, followed: null, details: null, runGraph: null,
  states: new Map(), selected: null, round: null, marked: new Set(), pursue: true, blocks: {}, tab: "look", dock: "closed",
  looked: [null, null], before: null, artifacts: new Map(), busy: false, preview: null, toasts: [], overlay: null, addAt: null,
  beat: 0, logTick: 0,
}));

export const set = useStudio.setState;
export const now = useStudio.getState;

let toasts = 0;
export function toast(kind: Toast["kind"], text: string, more = ""): void {
  const id = ++toasts;
  set((s) => ({ toasts: [...s.toasts.filter((t) => t.text !== text).slice(-3), { id, kind, text, more }] }));
  setTimeout(() => set((s) => ({ toasts: s.toasts.filter((t) => t.id !== id) })), kind === "error" ? 12000 : 5000);
}

export const shownGraph = (s: State): Graph | null => s.runGraph?.graph ?? s.document;
// The names of a node in the rounds of its block, those among them in which it is bypassed.
export function roundsOf(node: GraphNode): string[] {
  const block = nodeOf(now(), node.parent), nested = node.names.some((name) => name.split("[").length > 2);
  const count = block?.kind === "block" && !nested ? block.repeat ?? 0 : 0;
  return count ? Array.from({ length: count }, (_, k) => `${node.parent}[${k + 1}].${node.name}`) : node.names;
}
export const nodeOf = (s: State, id: string | null) => (id === null ? undefined : shownGraph(s)?.nodes.find((node) => node.id === id));
