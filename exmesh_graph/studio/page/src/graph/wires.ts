// While a wire is drawn: which ends take it, and why others do not. The server says it, with the checks of a graph file.
import { create } from "zustand";
import { edit, endsOf, tell } from "../state/actions";
import { now, set, shownGraph, toast } from "../state/store";
import type { EndChoice } from "../types";
import { endOf, targetOf } from "./ends";

export interface Drawing { node: string; handle: string; output: boolean; target: string; ends: Map<string, EndChoice> | null; types: string[] }

export const useDrawing = create<{ drawing: Drawing | null; choose: { node: string; at: [number, number]; ends: EndChoice[] } | null }>(() => ({ drawing: null, choose: null }));

const named = (node: string, port: string, side: string) => `${node}|${port}|${side}`;
let asked: AbortController | null = null;

export async function begin(node: string, handle: string): Promise<void> {
  const end = endOf(node, handle);
  asked?.abort();
  asked = new AbortController();
  useDrawing.setState({ drawing: { node, handle, output: end.output, target: "", ends: null, types: [] }, choose: null });
  try {
    const { ends, types, target } = await endsOf(end.node, end.port, end.output, end.side, asked.signal);
    const map = new Map(ends.map((choice) => [named(choice.node, choice.port, choice.side ?? ""), choice]));
    const { drawing } = useDrawing.getState();
    if (drawing?.node === node && drawing.handle === handle) useDrawing.setState({ drawing: { ...drawing, ends: map, types, target: target ?? "" } });
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

// Joins two ends. The server has said for each end which input is named and how a file writes the source.
export async function join(drawing: Drawing, two: { node: string; handle: string }): Promise<void> {
  const other = endOf(two.node, two.handle), graph = shownGraph(now());
  const choice = drawing.ends?.get(named(other.node, other.port, other.side));
  if (!graph || !choice) return;
  const input = drawing.output ? other : endOf(drawing.node, drawing.handle);
  await edit({ connect: (drawing.output ? choice.target : drawing.target) || targetOf(graph, input), to: choice.link });
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
