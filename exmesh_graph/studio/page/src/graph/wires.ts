// While a wire is drawn: which ends take it, and why others do not. The server says it, with the checks of a graph file.
import { create } from "zustand";
import { edit, endsOf, tell } from "../state/actions";
import { now, set, shownGraph, toast } from "../state/store";
import type { EndChoice, Graph } from "../types";
import { endOf, targetOf } from "./ends";

interface Drawing { node: string; handle: string; output: boolean; ends: Map<string, EndChoice> | null; types: string[] }

export const useDrawing = create<{ drawing: Drawing | null; choose: { node: string; at: [number, number]; ends: EndChoice[] } | null }>(() => ({ drawing: null, choose: null }));

const named = (node: string, port: string, side: string) => `${node}|${port}|${side}`;
let asked: AbortController | null = null;

export async function begin(node: string, handle: string): Promise<void> {
  const end = endOf(node, handle);
  asked?.abort();
  asked = new AbortController();
  useDrawing.setState({ drawing: { node, handle, output: end.output, ends: null, types: [] }, choose: null });
  try {
    const { ends, types } = await endsOf(end.node, end.port, end.output, end.side, asked.signal);
    const map = new Map(ends.map((choice) => [named(choice.node, choice.port, choice.side ?? ""), choice]));
    const { drawing } = useDrawing.getState();
    if (drawing?.node === node && drawing.handle === handle) useDrawing.setState({ drawing: { ...drawing, ends: map, types } });
  } catch (error) { tell(error); }
}

export function cease(): void { useDrawing.setState({ drawing: null }); }

// null: takes it; a text: why not.
export function refusal(drawing: Drawing | null, node: string, handle: string): string | null {
  if (!drawing) return null;
  const end = endOf(node, handle);
  if (end.output === drawing.output) return drawing.output ? "an output feeds inputs" : "an input is fed by an output";
  if (end.node === drawing.node && !end.side && !endOf(drawing.node, drawing.handle).side) return "a node cannot feed itself";
  if (!drawing.ends) return null; // not answered yet: the edit itself is checked again
  const choice = drawing.ends.get(named(end.node, end.port, end.side));
  if (!choice) return "these two cannot be joined";
  return choice.ok ? null : choice.why || "these two cannot be joined";
}

export async function join(one: { node: string; handle: string }, two: { node: string; handle: string }): Promise<void> {
  const a = endOf(one.node, one.handle), b = endOf(two.node, two.handle);
  const [from, to] = a.output ? [a, b] : [b, a], graph = shownGraph(now());
  if (!graph) return;
  try {
    await edit({ connect: targetOf(graph, to), to: await linkTo(graph, from, to) });
  } catch (error) { tell(error); }
}

// How a file writes the source of a wire, seen from where it ends.
async function linkTo(graph: Graph, from: { node: string; port: string; side: string }, to: { node: string; port: string; side: string }): Promise<string> {
  const { ends } = await endsOf(to.node, to.port, false, to.side);
  const found = ends.find((end) => end.node === from.node && end.port === from.port && (end.side ?? "") === from.side);
  if (found?.link) return found.link;
  const node = graph.nodes.find((other) => other.id === from.node);
  return node?.kind === "component" || !from.port ? `@${from.node}` : `@${from.node}.${from.port}`;
}

// A wire let go over a box: the one input (or output) of it that fits, or a choice.
export async function dropOn(node: string, at: [number, number]): Promise<void> {
  const { drawing } = useDrawing.getState();
  if (!drawing?.ends) return;
  const here = [...drawing.ends.values()].filter((choice) => choice.node === node);
  const fitting = here.filter((choice) => choice.ok), free = fitting.filter((choice) => !choice.in_use);
  const side = (choice: EndChoice) => `${choice.side || (drawing.output ? "in" : "out")}:${choice.port}`;
  if (!fitting.length) {
    toast("error", here[0]?.why ? here[0].why : "Nothing of this node fits.", "");
    return;
  }
  const one = fitting.length === 1 ? fitting[0] : free.length === 1 ? free[0] : null;
  if (one) await join(drawing, { node, handle: side(one) });
  else useDrawing.setState({ choose: { node, at, ends: fitting } });
}

export function offerNew(): void {
  const { drawing } = useDrawing.getState();
  if (!drawing) return;
  const end = endOf(drawing.node, drawing.handle);
  set({ overlay: "add", addAt: { node: end.node, port: end.port, output: end.output, types: drawing.types } });
}
