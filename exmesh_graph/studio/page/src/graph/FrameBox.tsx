// A repeat block or a sub-graph that is open: a frame with the ends it shows inwards and outwards.
import { Handle, Position, type NodeProps } from "@xyflow/react";
import { memo } from "react";
import { shallow } from "zustand/shallow";
import { useStoreWithEqualityFn } from "zustand/traditional";
import { set, useStudio, type BlockView } from "../state/store";
import { innerSides } from "./ends";
import { wireKind } from "./NodeBox";
import type { Frame } from "./picture";
import { refusal, useDrawing } from "./wires";

export interface FrameEnds { inputs: Map<string, number>; outputs: Map<string, number> }

export const FrameBox = memo(function FrameBox({ data, selected }: NodeProps & { data: { frame: Frame; ends: FrameEnds } }) {
  const { frame, ends } = data, { node } = frame, [start, end] = innerSides(node);
  const view = useStudio((s) => s.blocks[node.id] ?? "open");
  const at = useStoreWithEqualityFn(useStudio, (s) => (frame.round === null ? progress(s.states, node.id) : null), shallow);
  const times = node.kind === "block" && frame.round === null ? `× ${node.repeat ?? node.repeat_text ?? ""}` : "";
  return (
    <div className={`frame${selected ? " selected" : ""}`} data-frame={frame.id}>
      <div className="frame-title">
        <span>{frame.label}</span> <span className="soft">{node.kind === "part" ? node.graph : times}</span>
        {at && at.round > 0 && <span className="soft">round {at.round}</span>}
        {frame.round === null || frame.round === 1 ? <ViewSwitch id={node.id} view={view} rounds={node.kind === "block"} /> : null}
      </div>
      {frame.round === null && node.inputs.map((port) => (
        <Ends key={port.port} node={node.id} port={port.port} label={port.label} top={ends.inputs.get(port.port) ?? 40} left outer={`in:${port.port}`} inner={`${start}:${port.port}`} />
      ))}
      {frame.round === null && node.outputs.map((port) => (
        <Ends key={port.port} node={node.id} port={port.port} label={port.label} top={ends.outputs.get(port.port) ?? 40} outer={`out:${port.port}`} inner={`${end}:${port.port}`} />
      ))}
    </div>
  );
});

function progress(states: Map<string, { state: string }>, id: string): { round: number } {
  let round = 0;
  for (const [name, node] of states) {
    if (node.state !== "running" || !name.startsWith(`${id}[`)) continue;
    round = Math.max(round, parseInt(name.slice(id.length + 1), 10) || 0);
  }
  return { round };
}

const show = (id: string, view: BlockView) => set((s) => ({ blocks: { ...s.blocks, [id]: view } }));

export function ViewSwitch({ id, view, rounds }: { id: string; view: BlockView; rounds: boolean }) {
  return (
    <span className="switch nodrag" role="group" aria-label="how the block is shown">
      <button onClick={() => show(id, "folded")} title="fold into one box" aria-pressed={view === "folded"}>▭</button>
      <button onClick={() => show(id, "open")} title="open: rounds as one" aria-pressed={view === "open"}>⊞</button>
      {rounds && <button onClick={() => show(id, "rounds")} title="each round by itself" aria-pressed={view === "rounds"}>⋯</button>}
    </span>
  );
}

interface EndsProps { node: string; port: string; label: string; top: number; left?: boolean; outer: string; inner: string }
function Ends({ node, port, label, top, left = false, outer, inner }: EndsProps) {
  const fits = (handle: string) => (s: ReturnType<typeof useDrawing.getState>) => (s.drawing ? (refusal(s.drawing, node, handle) === null && s.drawing.ends ? "fits" : "unfit") : "");
  const outerFit = useDrawing(fits(outer)), innerFit = useDrawing(fits(inner)), kind = wireKind(label);
  return (
    <>
      <span className={`port frame-port ${left ? "in" : "out"}`} style={{ top }}>{port}</span>
      <Handle id={outer} type={left ? "target" : "source"} position={left ? Position.Left : Position.Right} className={`handle wire-${kind} ${outerFit}`} style={{ top }} title={`${port}: ${label}`} />
      <Handle id={inner} type={left ? "source" : "target"} position={left ? Position.Left : Position.Right} className={`handle inner ${left ? "inner-left" : "inner-right"} wire-${kind} ${innerFit}`} style={{ top }}
        title={left ? `${port}, as a round begins with it: ${label}` : `${port}, as a round hands it on: ${label}`} />
    </>
  );
}
