// The server tells of a node only what differs from its type and from the usual; this puts it together again.
import type { Document, End, Graph, GraphNode, Json, Layer, NodeType, Parameter, Port, Wire } from "../types";

interface Given { value: Json; text?: string; reference?: string }
interface SentNode {
  id: string; kind: GraphNode["kind"]; line: number; type?: string; parent?: string; comment?: string; file?: string; inside?: boolean; bypassed?: boolean;
  wired?: string[]; given?: { [name: string]: Given }; differ?: string[]; layers?: Layer[]; names?: string[]; problems?: number;
  repeat?: number; repeat_text?: string; graph?: string; inputs?: Port[]; outputs?: Port[]; parameters?: Parameter[];
}
interface SentWire { from: [string, string, string]; to: [string, string, string]; text: string; label: string; target?: string; rounds?: string }
export interface Sent { types: { [type: string]: NodeType }; nodes: SentNode[]; wires: SentWire[] }

const INSIDE = ["set", "connect", "bypass", "remove", "replace"], EVERYWHERE = [...INSIDE, "rename"];
const REPEAT = {
  name: "repeat", type: "int", default: null, required: true, unit: "rounds", doc: "How often the block is unrolled.", ge: 0, gt: null, le: 1000, lt: null,
  multiple_of: null, choices: null, optional: false, tuning: false, auto: "", path: false, value: null, text: "", set: true, reference: "", rounds_differ: false, target: "",
} satisfies Parameter;

export const wholeDocument = (sent: object): Document => ({ ...(sent as Document), ...wholeGraph(sent as Sent, (sent as Document).file) });

export function wholeGraph(sent: Sent, file = ""): Pick<Graph, "nodes" | "wires"> {
  return { nodes: sent.nodes.map((node) => whole(node, sent.types[node.type ?? ""], file)), wires: sent.wires.map(wireOf) };
}

function whole(sent: SentNode, type: NodeType | undefined, file: string): GraphNode {
  const { id, kind, wired = [], outputs } = sent;
  const block = kind === "block", inputs = sent.inputs ?? (block ? outputs : type?.inputs) ?? [];
  let parameters: Parameter[] | null = null;
  return {
    id, kind, name: id.slice(id.lastIndexOf(".") + 1), type: block ? "repeat" : sent.type ?? "", family: block ? "repeat" : type?.family ?? (kind === "part" ? "part" : ""), parent: sent.parent ?? "",
    doc: type?.title ?? "", comment: sent.comment ?? "", version: type?.version ?? "", traits: type?.traits ?? [], file: sent.file ?? file, line: sent.line,
    names: sent.names ?? [id], problems: sent.problems ?? 0, editable: sent.inside ? INSIDE : EVERYWHERE, bypassed: sent.bypassed ?? false,
    inputs: inputs.map((port) => ({ ...port, wired: block || wired.includes(port.port) })), outputs: outputs ?? type?.outputs ?? [],
    layers: sent.layers ?? [], repeat: sent.repeat, repeat_text: sent.repeat_text, graph: sent.graph,
    get parameters() { return (parameters ??= sent.parameters ?? (block ? [REPEAT] : type?.parameters ?? []).map((parameter) => filled(parameter, sent))); },
  };
}

function filled(declared: Parameter, { id, given, differ }: SentNode): Parameter {
  const own = given?.[declared.name], value = own ? own.value : declared.default;
  return { ...declared, value, text: own?.text ?? written(value), set: own !== undefined, reference: own?.reference ?? "", rounds_differ: differ?.includes(declared.name) ?? false, target: `${id}.${declared.name}` };
}

const written = (value: Json): string => (value === null ? "" : typeof value === "string" ? value : JSON.stringify(value));

function wireOf({ from, to, text, label, target, rounds }: SentWire): Wire {
  const [start, end] = [from, to].map(([node, port, side]): End => ({ node, port, side }));
  const id = `${[start, end].map(({ node, port, side }) => `${node}.${port}${side && `@${side}`}`).join(">")}${rounds ? `#${rounds}` : ""}`;
  return { id, from: start, to: end, text, label, kind: start.node && !start.port ? "component" : "artifact", problem: !start.node, rounds: rounds ?? null, target: target ?? (end.side === "outputs" ? "" : `${end.node}.${end.port}`) };
}
