// The document as boxes, frames and wires: repeat blocks and sub-graphs folded into a box, open as a frame, or with a frame
// for every round.
import type { BlockView } from "../state/store";
import type { End, Graph, GraphNode, Port, Wire } from "../types";
import { arrange } from "../layout/arrange";
import type { BoxShape, FrameShape, Layout, WireShape } from "../layout/shapes";
import { handleOf } from "./ends";

export const HEAD = 46, ROW = 19, FOOT = 8;

export interface Row { port: Port; handle: string; top: number }
export interface Box { id: string; node: GraphNode; names: string[]; inputs: Row[]; outputs: Row[]; hidden: number; width: number; height: number; scopes: string[]; fixed: boolean; round: number | null }
export interface Frame { id: string; node: GraphNode; label: string; scopes: string[]; round: number | null }
export interface Line { id: string; wire: Wire; from: { box: string; handle: string }; to: { box: string; handle: string } }
export interface Picture { boxes: Box[]; frames: Frame[]; lines: Line[]; layout: Layout }

export const isGroup = (node: GraphNode) => node.kind === "block" || node.kind === "part";

export function picture(graph: Graph, views: { [id: string]: BlockView }, allPorts: boolean): Picture {
  const places = new Places(graph, views);
  const boxes: Box[] = [], frames: Frame[] = [];
  for (const node of graph.nodes) {
    for (const copy of places.copies(node)) {
      if (isGroup(node) && places.view(node) !== "folded") {
        const rounds = places.view(node) === "rounds" ? Math.max(1, node.repeat ?? 1) : 0;
        if (!rounds) frames.push({ id: copy.id, node, label: node.name, scopes: copy.scopes, round: null });
        for (let k = 1; k <= rounds; k++) frames.push({ id: `${copy.id}[${k}]`, node, label: `${node.name}, round ${k}`, scopes: copy.scopes, round: k });
      } else boxes.push(boxOf(node, copy, allPorts));
    }
  }
  const lines = places.lines();
  const framed = new Set(frames.map((frame) => frame.id));
  const known = new Set([...boxes.map((box) => box.id), ...frames.map((frame) => frame.id)]);
  const drawn = lines.filter((line) => known.has(line.from.box) && known.has(line.to.box));
  return { boxes, frames, lines: drawn, layout: arrange(boxes.map(shapeOf), frames.map(frameShape), drawn.map((line) => wireShape(line, framed))) };
}

interface Copy { id: string; scopes: string[]; rounds: [string, number][] }

// Where every node lies, given which blocks are folded, open or unrolled.
class Places {
  private readonly byId: Map<string, GraphNode>;
  constructor(private readonly graph: Graph, private readonly views: { [id: string]: BlockView }) {
    this.byId = new Map(graph.nodes.map((node) => [node.id, node]));
  }

  view(node: GraphNode): BlockView {
    const view = this.views[node.id] ?? "open";
    return view === "rounds" && (node.kind !== "block" || !node.repeat) ? "open" : view;
  }

  private parents(node: GraphNode): GraphNode[] {
    const chain: GraphNode[] = [];
    for (let at = this.byId.get(node.parent); at; at = this.byId.get(at.parent)) chain.unshift(at);
    return chain;
  }

  // The boxes or frames that stand for a node: none inside a folded block, one for each round of an unrolled one.
  copies(node: GraphNode): Copy[] {
    let copies: Copy[] = [{ id: "", scopes: [], rounds: [] }];
    for (const parent of this.parents(node)) {
      const view = this.view(parent);
      if (view === "folded") return [];
      copies = copies.flatMap((copy) => {
        const id = copy.id ? `${copy.id}.${parent.name}` : parent.id;
        if (view === "open") return [{ id, scopes: [...copy.scopes, id], rounds: copy.rounds }];
        return Array.from({ length: parent.repeat ?? 1 }, (_, k) => ({ id: `${id}[${k + 1}]`, scopes: [...copy.scopes, `${id}[${k + 1}]`], rounds: [...copy.rounds, [parent.id, k + 1] as [string, number]] }));
      });
    }
    return copies.map((copy) => ({ ...copy, id: copy.id ? `${copy.id}.${node.name}` : node.id }));
  }

  lines(): Line[] {
    const lines = new Map<string, Line>();
    for (const wire of this.graph.wires)
      for (const [from, to] of this.pairs(wire)) {
        if (from.box === to.box && from.handle.startsWith("out") === to.handle.startsWith("in")) continue; // inside one folded box
        const id = `${from.box} ${from.handle}>${to.box} ${to.handle}`;
        if (!lines.has(id)) lines.set(id, { id, wire, from, to });
      }
    return [...lines.values()];
  }

  // Both ends of a wire in the picture, once for each round that is drawn.
  private pairs(wire: Wire): [{ box: string; handle: string }, { box: string; handle: string }][] {
    const to = this.byId.get(wire.to.node), from = this.byId.get(wire.from.node);
    if (!to || !from) return [];
    const unrolled = (node: GraphNode) => isGroup(node) && this.view(node) === "rounds";
    if (wire.to.side === "" && unrolled(to)) return []; // drawn from the wires of its rounds, below
    if (wire.to.side === "next" && unrolled(to)) return [];
    return this.spots(wire.to, to).flatMap((spot) => this.sources(wire.from, from, spot.rounds).map((source) =>
      [source, { box: spot.box, handle: spot.handle }] as [{ box: string; handle: string }, { box: string; handle: string }]));
  }

  private spots(end: End, node: GraphNode): { box: string; handle: string; rounds: [string, number][] }[] {
    const folded = [...this.parents(node)].find((parent) => this.view(parent) === "folded");
    if (folded) return this.copies(folded).map((copy) => ({ box: copy.id, handle: "in:~", rounds: copy.rounds }));
    if (end.side && this.view(node) === "folded") return [];
    return this.copies(node).map((copy) => ({ box: copy.id, handle: handleOf(end, false), rounds: copy.rounds }));
  }

  private sources(end: End, node: GraphNode, rounds: [string, number][]): { box: string; handle: string }[] {
    if (isGroup(node) && this.view(node) === "rounds") {
      const round = end.side === "carry" ? (rounds.find(([id]) => id === node.id)?.[1] ?? 1) - 1 : node.repeat ?? 1;
      const feeding = this.graph.wires.find((wire) => wire.to.node === node.id && wire.to.port === end.port && wire.to.side === (round ? "next" : ""));
      const source = feeding && this.byId.get(feeding.from.node);
      if (!source) return [];
      const outer = rounds.filter(([id]) => id !== node.id && node.id.startsWith(`${id}.`));
      return this.sources(feeding.from, source, round ? [...outer, [node.id, round]] : outer);
    }
    const folded = this.parents(node).find((parent) => this.view(parent) === "folded");
    if (folded) return this.copies(folded).filter((copy) => agrees(copy.rounds, rounds)).slice(-1).map((copy) => ({ box: copy.id, handle: "out:~" }));
    if (end.side && this.view(node) === "folded") return [];
    return this.copies(node).filter((copy) => agrees(copy.rounds, rounds)).slice(-1).map((copy) => ({ box: copy.id, handle: handleOf(end, true) }));
  }
}

const agrees = (mine: [string, number][], theirs: [string, number][]) => mine.every(([id, round]) => theirs.every(([other, at]) => other !== id || at === round));

function boxOf(node: GraphNode, copy: Copy, allPorts: boolean): Box {
  const shown = isGroup(node) ? node.inputs : node.inputs.filter((port) => allPorts || port.wired || !port.optional);
  const rows = (ports: Port[], output: boolean): Row[] => ports.map((port, k) => ({ port, handle: `${output ? "out" : "in"}:${port.port}`, top: HEAD + ROW * k + ROW / 2 }));
  const inputs = rows(shown, false), outputs = rows(node.outputs, true);
  const component = node.kind === "component";
  const text = (port: Port | undefined) => (port ? (port.port || "").length : 0);
  const count = component ? inputs.length : Math.max(inputs.length, outputs.length);
  const widest = Math.max(0, ...Array.from({ length: count }, (_, k) => text(inputs[k]?.port) + text(outputs[k]?.port)));
  const width = Math.max(126, 7.7 * node.name.length + 62, 5.7 * (node.type || node.graph || "").length + (node.kind === "component" ? 40 : 88), 6.2 * widest + 50);
  const outs = component ? outputs.map((row) => ({ ...row, top: HEAD / 2 })) : outputs;
  const names = copy.rounds.length ? node.names.filter((name) => copy.rounds.every(([id, round]) => name.startsWith(`${id}[${round}].`) || name.includes(`${id.split(".").pop()}[${round}].`))) : node.names;
  return { id: copy.id, node, names, inputs, outputs: outs, hidden: node.inputs.length - shown.length, width: Math.round(width), height: HEAD + ROW * count + (count ? FOOT : 0), scopes: copy.scopes, fixed: copy.rounds.length > 0, round: copy.rounds.at(-1)?.[1] ?? null };
}

function shapeOf(box: Box): BoxShape {
  const ports = (rows: Row[]) => new Map(rows.map((row) => [row.handle, row.top - box.height / 2]));
  return { id: box.id, width: box.width, height: box.height, scopes: box.scopes, inputs: ports(box.inputs), outputs: ports(box.outputs) };
}

function frameShape(frame: Frame): FrameShape {
  const ends = frame.round === null;
  const names = (ports: Port[]) => (ends ? ports.map((port) => port.port) : []);
  return { id: frame.id, scopes: frame.scopes, inputs: names(frame.node.inputs), outputs: names(frame.node.outputs) };
}

// Boxes call their ends by handle, frames by port: one port has an outer and an inner end at the same height.
function wireShape(line: Line, frames: Set<string>): WireShape {
  const end = ({ box, handle }: { box: string; handle: string }) => {
    const side = handle.slice(0, handle.indexOf(":"));
    return frames.has(box) ? { id: box, port: handle.slice(side.length + 1), inner: side !== "in" && side !== "out" } : { id: box, port: handle, inner: false };
  };
  return { id: line.id, from: end(line.from), to: end(line.to) };
}
