// The graph: laid out by itself, moved and zoomed, walked with the arrow keys, rewired by drawing wires.
import { Background, BackgroundVariant, Controls, MiniMap, Position, ReactFlow, useReactFlow, useStore, type Connection, type Edge, type FinalConnectionState, type Node, type NodeHandle } from "@xyflow/react";
import { useCallback, useEffect, useMemo, useRef, useState } from "react";
import { edit } from "../state/actions";
import { nodeOf, now, set, shownGraph, toast, useStudio } from "../state/store";
import { lookAtNode } from "../panels/Results";
import type { Graph } from "../types";
import { FrameBox } from "./FrameBox";
import { NodeBox } from "./NodeBox";
import { picture, type Box, type Picture } from "./picture";
import { stateOf } from "./states";
import { DrawnWire, WireEdge } from "./WireEdge";
import { begin, cease, dropOn, join, offerNew, refusal, useDrawing } from "./wires";
import { endOf } from "./ends";

const NONE: Partial<Graph> = {};
const nodeTypes = { box: NodeBox, frame: FrameBox }, edgeTypes = { wire: WireEdge };

// Where the ends of a box lie, as the style sheet draws them from within its borders: a box whose ends are known is drawn only once it is in view.
function handlesOf(box: Box): NodeHandle[] {
  const { kind } = box.node, [left, side] = kind === "component" ? [1, 1] : kind === "node" ? [5, 1] : [6, 3];
  const at = (id: string, output: boolean, y: number, size: number): NodeHandle =>
    ({ id, type: output ? "source" : "target", position: output ? Position.Right : Position.Left, x: (output ? box.width - side : left) - size / 2, y: side + y - size / 2, width: size, height: size });
  return [...box.inputs.map((row) => at(row.handle, false, row.top, 11)), ...box.outputs.map((row) => at(row.handle, true, row.top, 11)), at("in:~", false, box.height / 2, 1), at("out:~", true, box.height / 2, 1)];
}

function flow(drawn: Picture, selected: string | null): { nodes: Node[]; edges: Edge[] } {
  const nodes: Node[] = [];
  for (const frame of drawn.frames) {
    const rect = drawn.layout.frames.get(frame.id);
    if (!rect) continue;
    nodes.push({ id: frame.id, type: "frame", position: { x: rect.x, y: rect.y }, width: rect.width, height: rect.height, measured: { width: rect.width, height: rect.height }, data: { frame, ends: rect }, zIndex: 1 + frame.scopes.length, // above wires, so that its inner ends can be taken hold of
      selected: frame.node.id === selected, draggable: false, style: { pointerEvents: "none" }, className: "frame-node" });
  }
  for (const box of drawn.boxes) {
    const rect = drawn.layout.boxes.get(box.id)!;
    nodes.push({ id: box.id, type: "box", position: { x: rect.x, y: rect.y }, width: box.width, height: box.height, measured: { width: box.width, height: box.height }, handles: handlesOf(box), data: { box }, zIndex: 50, selected: box.node.id === selected, draggable: false });
  }
  const edges = drawn.lines.map((line): Edge => ({ id: line.id, type: "wire", source: line.from.box, sourceHandle: line.from.handle, target: line.to.box, targetHandle: line.to.handle,
    data: { line, points: drawn.layout.paths.get(line.id) }, zIndex: 0 }));
  return { nodes, edges };
}

export function Canvas() {
  const graph = useStudio(shownGraph), blocks = useStudio((s) => s.blocks), selected = useStudio((s) => s.selected);
  const readOnly = useStudio((s) => s.runGraph !== null);
  const [allPorts, setAllPorts] = useState(false), [mapped, setMapped] = useState(false);
  useEffect(() => { const timer = setTimeout(() => setMapped(true), 400); return () => clearTimeout(timer); }, []); // the overview comes after the first picture
  const [chosenEdges, setChosenEdges] = useState<Set<string>>(new Set());
  const { nodes: parts, wires, outputs } = graph ?? NONE; // a new plan is no new picture
  const drawn = useMemo(() => (parts && wires && outputs ? picture({ nodes: parts, wires, outputs }, blocks, allPorts) : null), [parts, wires, outputs, blocks, allPorts]);
  const { nodes, edges } = useMemo(() => (drawn ? flow(drawn, selected) : { nodes: [], edges: [] }), [drawn, selected]);
  const shownEdges = useMemo(() => edges.map((edge) => {
    const near = selected !== null && (edge.data as { line: { wire: { from: { node: string }; to: { node: string } } } }).line.wire;
    const touches = near && (near.from.node === selected || near.to.node === selected);
    return { ...edge, selected: chosenEdges.has(edge.id), className: touches ? "touching" : "" };
  }), [edges, chosenEdges, selected]);

  const far = useStore((s) => s.transform[2] < 0.42);
  const flowing = useReactFlow(), { setCenter, getZoom, getViewport, setViewport } = flowing;
  const width = useStore((s) => s.width), height = useStore((s) => s.height), before = useRef(0);
  useEffect(() => { // when the part below opens or closes, the middle stays the middle
    if (before.current && height && before.current !== height) { const at = getViewport(); void setViewport({ ...at, y: at.y + (height - before.current) / 2 }); }
    before.current = height;
  }, [height, getViewport, setViewport]);
  const { place, start } = useFit(drawn, flowing);
  const reveal = useCallback((id: string, duration = still() ? 0 : 200) => {
    const rect = drawn?.layout.boxes.get(id) ?? drawn?.layout.frames.get(id);
    if (rect) void setCenter(rect.x + rect.width / 2, rect.y + rect.height / 2, { zoom: Math.max(getZoom(), 0.7 * large()), duration });
  }, [drawn, setCenter, getZoom]);
  useEffect(() => {
    const go = (event: Event) => reveal((event as CustomEvent<string>).detail);
    const step = (event: Event) => { if (drawn) walk((event as CustomEvent<string>).detail, drawn); };
    window.addEventListener("studio:reveal", go);
    window.addEventListener("studio:walk", step);
    return () => { window.removeEventListener("studio:reveal", go); window.removeEventListener("studio:walk", step); };
  }, [reveal, drawn]);

  // A run is followed with the eyes until somebody moves the graph.
  const running = useStudio((s) => { for (const node of s.states.values()) if (node.state === "running") return node.id; return null; });
  const pursue = useStudio((s) => s.pursue);
  useEffect(() => {
    if (!pursue || !running || !drawn) return;
    const rect = drawn.layout.boxes.get(running), { x, y, zoom } = getViewport();
    if (!rect) return;
    const left = rect.x * zoom + x, top = rect.y * zoom + y;
    if (left >= 20 && top >= 20 && left + rect.width * zoom <= width - 20 && top + rect.height * zoom <= height - 20) return;
    // At once, since a picture that glides takes time from the run; and at the left, where those that run next come into view too.
    const near = Math.max(zoom, 0.7 * large());
    void setCenter(rect.x - 40 / near + width / near / 2, rect.y + rect.height / 2, { zoom: near, duration: 0 });
  }, [running, pursue, drawn, width, height, setCenter, getViewport]);

  const valid = useCallback((connection: Connection | Edge) => {
    const { drawing } = useDrawing.getState();
    if (!drawing || !connection.sourceHandle || !connection.targetHandle) return false;
    const mine = drawing.output ? connection.target : connection.source, handle = drawing.output ? connection.targetHandle : connection.sourceHandle;
    return refusal(drawing, mine, handle) === null;
  }, []);
  const release = useCallback((event: MouseEvent | TouchEvent, state: FinalConnectionState) => {
    const { drawing } = useDrawing.getState();
    const at: [number, number] = "clientX" in event ? [event.clientX, event.clientY] : [event.changedTouches[0].clientX, event.changedTouches[0].clientY];
    if (drawing && !state.isValid) {
      const why = state.toHandle?.id && state.toNode ? refusal(drawing, state.toNode.id, state.toHandle.id) : null;
      const over = document.elementFromPoint(...at)?.closest<HTMLElement>("[data-node]")?.dataset.node;
      if (why) toast("error", why);
      else if (over && over !== drawing.node) void dropOn(over, at).finally(() => cease());
      else if (!over && document.elementFromPoint(...at)?.closest(".react-flow__pane")) offerNew();
    }
    if (!useDrawing.getState().choose) setTimeout(cease, 0);
  }, []);
  const remove = useCallback(async (gone: Edge[]) => {
    const targets = gone.map((edge) => (edge.data as { line: { wire: { target: string } } }).line.wire.target);
    if (targets.length) await edit(...[...new Set(targets)].map((target) => ({ disconnect: target })));
  }, []);

  if (!graph || !drawn) return <div ref={place} className="canvas empty" />;
  return (
    <div ref={place} className={`canvas${far ? " far" : ""}${readOnly ? " read-only" : ""}`}>
      <ReactFlow nodes={nodes} edges={shownEdges} nodeTypes={nodeTypes} edgeTypes={edgeTypes} defaultViewport={start} onlyRenderVisibleElements minZoom={0.05} maxZoom={2.5}
        nodesDraggable={false} nodesConnectable={!readOnly} elementsSelectable deleteKeyCode={null} selectionOnDrag={false} multiSelectionKeyCode={null} zoomOnDoubleClick={false}
        disableKeyboardA11y connectionLineComponent={DrawnWire} connectionRadius={26} isValidConnection={valid} proOptions={{ hideAttribution: true }}
        onConnectStart={(_, { nodeId, handleId }) => { if (nodeId && handleId) void begin(nodeId, handleId); }}
        onConnect={(c) => {
          const { drawing } = useDrawing.getState();
          if (drawing && c.sourceHandle && c.targetHandle) void join(drawing, drawing.output ? { node: c.target, handle: c.targetHandle } : { node: c.source, handle: c.sourceHandle });
        }}
        onConnectEnd={release}
        onNodeClick={(_, node) => { setChosenEdges(new Set()); choose(node); }}
        onNodeDoubleClick={(_, node) => { const id = idOf(node), found = nodeOf(now(), id); if (found && (found.kind === "block" || found.kind === "part")) set((s) => ({ blocks: { ...s.blocks, [id]: s.blocks[id] === "folded" ? "open" : "folded" } })); else if (found) lookAtNode(found); }}
        onMoveStart={(event) => { if (event && now().pursue) set({ pursue: false }); }}
        onEdgeClick={(_, edge) => setChosenEdges(new Set([edge.id]))}
        onPaneClick={() => { set({ selected: null }); setChosenEdges(new Set()); useDrawing.setState({ choose: null }); }}>
        <Background variant={BackgroundVariant.Dots} gap={22} size={1.2} />
        <Controls showInteractive={false} position="bottom-left" />
        {mapped && drawn.boxes.length > 14 && <MiniMap pannable zoomable position="bottom-right" style={{ width: 170, height: Math.min(110, Math.max(44, (170 * drawn.layout.height) / drawn.layout.width + 16)) }} offsetScale={2} nodeColor={mapColour} nodeBorderRadius={6} ariaLabel="overview of the graph" />}
      </ReactFlow>
      <div className="canvas-tools">
        <button onClick={() => setAllPorts(!allPorts)} aria-pressed={allPorts} title="show optional inputs that nothing is wired to">All ports</button>
        {running && !pursue && <button onClick={() => set({ pursue: true })} title="keep what runs in view">Follow the run</button>}
        {chosenEdges.size > 0 && !readOnly && <button className="danger" onClick={() => { void remove(shownEdges.filter((edge) => chosenEdges.has(edge.id))); setChosenEdges(new Set()); }}>Cut this wire</button>}
      </div>
      <ChooseEnd />
    </div>
  );
}

const idOf = (node: Node): string => (node.data as { box?: { node: { id: string } }; frame?: { node: { id: string } } }).box?.node.id ?? (node.data as { frame: { node: { id: string } } }).frame.node.id;
function choose(node: Node): void {
  set({ selected: idOf(node), round: (node.data as { box?: Box }).box?.round ?? null });
}

function mapColour(node: Node): string {
  const box = (node.data as { box?: { node: { id: string; kind: string }; names: string[] } }).box;
  if (!box || box.node.kind === "component") return "transparent";
  const { state } = stateOf(now(), box.node.id, box.names);
  return `var(--state-${state === "idle" ? "none" : state})`;
}

// Where a graph that is too large to be read as a whole begins: at its left. Null where it fits.
function beginning(drawn: Picture, width: number, height: number): { x: number; y: number; zoom: number } | null {
  const tall = height / drawn.layout.height;
  if (Math.min(width / drawn.layout.width, tall) >= 0.5 * large()) return null;
  const zoom = large() * Math.min(0.95, Math.max(0.55, (0.96 * tall) / large()));
  const first = drawn.boxes.map((box) => drawn.layout.boxes.get(box.id)!).reduce((best, box) => (box.x < best.x ? box : best));
  const middle = tall > 0.55 * large() ? drawn.layout.height / 2 : first.y + first.height / 2;
  return { x: 10 * zoom, y: height / 2 - middle * zoom, zoom };
}

// The first picture of a graph is fitted, or begins at its left. What the page draws first stands there from the start, so that
// nothing is drawn that is out of view at once.
function useFit(drawn: Picture | null, { fitView, setViewport }: ReturnType<typeof useReactFlow>) {
  const fitted = useRef(""), file = useStudio((s) => (s.runGraph ? s.runGraph.run : `${s.document?.path}|${s.document?.variant}`));
  const width = useStore((s) => s.width), height = useStore((s) => s.height), place = useRef<HTMLDivElement>(null), start = useRef<ReturnType<typeof beginning> | undefined>(undefined);
  if (drawn?.boxes.length && start.current === undefined) start.current = place.current && beginning(drawn, place.current.clientWidth, place.current.clientHeight);
  useEffect(() => {
    if (!drawn?.boxes.length || !width || !height || fitted.current === file) return;
    const there = !fitted.current && start.current, view = there ? null : beginning(drawn, width, height);
    fitted.current = file;
    if (view) void setViewport(view);
    else if (!there) void fitView({ padding: 0.04, maxZoom: 1.1 * large() });
  }, [drawn, file, width, height, fitView, setViewport]);
  return { place, start: start.current ?? undefined };
}

// Arrow keys: along wires to the left and right, to the next box above or below.
function walk(key: string, drawn: Picture): void {
  const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[key];
  if (!step) return;
  const here = drawn.boxes.find((box) => box.node.id === now().selected), start = here ? drawn.layout.boxes.get(here.id)! : null;
  let best: string | null = null, least = Infinity;
  for (const box of drawn.boxes) {
    const rect = drawn.layout.boxes.get(box.id)!;
    if (!start) { if (rect.x + rect.y < least) { least = rect.x + rect.y; best = box.id; } continue; }
    const dx = rect.x + rect.width / 2 - start.x - start.width / 2, dy = rect.y + rect.height / 2 - start.y - start.height / 2;
    const along = step[0] ? dx * step[0] : dy * step[1], across = Math.abs(step[0] ? dy : dx);
    if (along < 12) continue;
    const wired = step[0] !== 0 && drawn.lines.some((line) => (line.from.box === here!.id && line.to.box === box.id) || (line.to.box === here!.id && line.from.box === box.id));
    const cost = along + 2.2 * across - (wired ? 4000 : 0);
    if (cost < least) { least = cost; best = box.id; }
  }
  const found = drawn.boxes.find((box) => box.id === best);
  if (found) { set({ selected: found.node.id, round: null }); window.dispatchEvent(new CustomEvent("studio:reveal", { detail: found.id })); }
}

function ChooseEnd() {
  const chosen = useDrawing((s) => s.choose), drawing = useDrawing((s) => s.drawing);
  if (!chosen || !drawing) return null;
  const done = () => useDrawing.setState({ choose: null, drawing: null });
  return (
    <div className="menu floating" style={{ left: chosen.at[0], top: chosen.at[1] }} role="menu" aria-label="which end">
      <p className="soft">Wire {endOf(drawing.node, drawing.handle).port || drawing.node} to…</p>
      {chosen.ends.map((end) => (
        <button key={`${end.port}${end.side}`} role="menuitem" onClick={() => { void join(drawing, { node: chosen.node, handle: `${end.side || (drawing.output ? "in" : "out")}:${end.port}` }); done(); }}>
          {end.port} {end.in_use && <span className="soft">replaces its wire</span>}
        </button>
      ))}
      <button onClick={done}>Cancel</button>
    </div>
  );
}

// Boxes grow with the screen as the words beside them do.
const large = () => Math.min(2.2, Math.max(1, window.innerHeight / 1080));
const still = () => window.matchMedia("(prefers-reduced-motion: reduce)").matches;
