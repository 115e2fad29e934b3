// The state of a box: the plan's, with the followed run's over it.
import type { State } from "../state/store";
import type { GraphNode, Layer, NodeState, Planned } from "../types";

export type Shown = "hit" | "run" | "unknown" | "running" | "done" | "failed" | "blocked" | "waiting" | "interrupted" | "idle" | "bypassed" | "none";

export const WORDS: { [state in Shown]: string } = {
  hit: "in the store", run: "would run", unknown: "depends on what runs before", running: "running", done: "ran", failed: "failed",
  blocked: "blocked by a failure", waiting: "waits", interrupted: "was stopped", idle: "nothing needs it", bypassed: "bypassed: what used its output gets what its input got", none: "",
};
// Shapes as well as colours: each state has its own sign.
export const SIGNS: { [state in Shown]: string } = {
  hit: "●", run: "▷", unknown: "?", running: "◐", done: "✓", failed: "✕", blocked: "⊘", waiting: "…", interrupted: "❚❚", idle: "–", bypassed: "⤳", none: "",
};

export interface BoxState { state: Shown; seconds: number | null; expected: boolean; done: number; of: number; part: number; figures: string; memory: number; reason: string }

const LIVE = new Set(["starting", "running", "stopping"]);
const ORDER: Shown[] = ["failed", "running", "interrupted", "blocked", "waiting", "run", "unknown", "done", "hit", "idle"];

export const worst = (states: Shown[]): Shown => ORDER.find((state) => states.includes(state)) ?? states[0] ?? "none";

export function stateOf(s: State, id: string, names: string[]): BoxState {
  const planned = s.runGraph ? undefined : s.document?.plan?.nodes[id];
  const run = s.runs.find((other) => other.id === s.followed), live = Boolean(run && LIVE.has(run.state));
  const told = names.map((name) => s.states.get(name));
  const known = told.filter((node): node is NodeState => Boolean(node && node.state !== ""));
  const over = s.runGraph !== null || (live && known.length > 0) || known.some((node) => node.state === "failed" && sameWork(node, planned));
  if (over && known.length) return fromRun(names, told);
  return fromPlan(names, planned, known);
}

// A failure stands until an edit makes other work of the node: then its state is that of the plan.
function sameWork(node: NodeState, planned: Planned | undefined): boolean {
  const round = planned?.rounds.find((one) => one.name === node.name);
  return planned === undefined || (round?.state === "run" && (!node.key || !round.key || node.key === round.key));
}

// Whether a node is bypassed in all rounds, or in one: the settings of single rounds count more than those of all.
export function isBypassed(node: GraphNode, round: number | null): boolean {
  const says = (when: string, fits: (layer: Layer) => boolean) => node.layers.filter((layer) => layer.when === when && "bypass" in layer.set && fits(layer)).map((layer) => layer.set.bypass !== null).pop();
  return round === null ? node.bypassed : says("at", (layer) => layer.round === round) ?? says("every", (layer) => round % layer.round === 0) ?? node.bypassed;
}

function fromRun(names: string[], told: (NodeState | undefined)[]): BoxState {
  const states = told.map((node): Shown => (!node || !node.state ? "waiting" : node.state === "pending" ? "waiting" : (node.state as Shown)));
  const done = states.filter((state) => state === "done" || state === "hit").length;
  const running = told.find((node) => node?.state === "running"), progress = running?.progress;
  let state = worst(states);
  if (state === "waiting" && done && done < names.length) state = "running"; // between two rounds
  const seconds = told.reduce((sum, node) => sum + (node?.seconds ?? 0), 0);
  const within = progress && progress.total ? Math.min(1, progress.step / progress.total) : 0;
  return { state, seconds: seconds || null, expected: false, done, of: names.length, part: (done + within) / Math.max(1, names.length), figures: figuresOf(progress?.figures), memory: Math.max(0, ...told.map((node) => node?.peak_memory ?? 0)), reason: "" };
}

function fromPlan(names: string[], planned: Planned | undefined, known: NodeState[]): BoxState {
  const memory = Math.max(0, ...known.map((node) => node.peak_memory ?? 0));
  if (!planned) return { state: "none", seconds: null, expected: false, done: 0, of: names.length, part: 0, figures: "", memory, reason: "" };
  const own = planned.rounds.filter((round) => names.includes(round.name)), rounds = own.length ? own : planned.rounds; // of a round that is drawn by itself, that one
  const hits = rounds.filter((round) => round.state === "hit").length, state = (rounds.length === 1 ? rounds[0].state : planned.state) as Shown;
  const ranNow = state === "hit" && known.length === names.length && known.some((node) => node.state === "done");
  return { state: ranNow ? "done" : state, seconds: planned.known ? planned.seconds : null, expected: state !== "hit", done: hits, of: rounds.length, part: 0, figures: "", memory, reason: planned.reason };
}

const SHOWN_FIGURES = ["psnr", "loss", "error", "rmse"];
export function figuresOf(figures: { [name: string]: number } | undefined): string {
  const name = SHOWN_FIGURES.find((wanted) => figures && wanted in figures) ?? Object.keys(figures ?? {})[0];
  if (!name || !figures) return "";
  const value = figures[name];
  return `${name === "psnr" ? "PSNR" : name} ${Math.abs(value) >= 0.01 || value === 0 ? value.toFixed(Math.abs(value) >= 10 ? 1 : 3) : value.toExponential(1)}`;
}
