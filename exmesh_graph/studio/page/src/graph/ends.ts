// How the ends of wires are called: by the server (node, port, side) and by the picture (box, handle).
import type { End, Graph, GraphNode } from "../types";

export const INNER = new Set(["carry", "next", "inputs", "outputs"]);

// Of the frame of a block or part: what it shows inwards at its left border, and takes at its right one.
export const innerSides = (node: GraphNode): [string, string] => (node.kind === "part" ? ["inputs", "outputs"] : ["carry", "next"]);

export const handleOf = (end: End, output: boolean): string => `${end.side || (output ? "out" : "in")}:${end.port}`;

export function endOf(node: string, handle: string): End & { output: boolean } {
  const cut = handle.indexOf(":"), side = handle.slice(0, cut), port = handle.slice(cut + 1);
  return { node, port, side: INNER.has(side) ? side : "", output: side === "out" || side === "carry" || side === "inputs" };
}

// What `{"connect": TARGET}` calls an input.
export function targetOf(graph: Graph, end: End): string {
  const wired = graph.wires.find((wire) => wire.to.node === end.node && wire.to.port === end.port && wire.to.side === end.side);
  if (wired) return wired.target;
  const node = graph.nodes.find((other) => other.id === end.node);
  if (end.side) return `${end.node}.${end.side}.${end.port}`;
  return node?.kind === "block" ? `${end.node}.carry.${end.port}` : `${end.node}.${end.port}`;
}
