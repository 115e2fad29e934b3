// A node as drawn: name, type, state with its sign, seconds, ports.
import { Handle, Position, type NodeProps } from "@xyflow/react";
import { memo } from "react";
import { shallow } from "zustand/shallow";
import { useStoreWithEqualityFn } from "zustand/traditional";
import { useStudio } from "../state/store";
import { seconds } from "../text";
import type { Box, Row } from "./picture";
import { Busy } from "../panels/Busy";
import { SIGNS, WORDS, isBypassed, stateOf } from "./states";
import { refusal, useDrawing } from "./wires";

export const wireKind = (label: string): string => {
  if (/Views|Photo|Pictures/.test(label)) return "views";
  if (/Mesh|Carrier|Stage1State|Hull/.test(label)) return "mesh";
  if (/Transport|Light|Environment/.test(label)) return "light";
  if (/Asset|Files|Material/.test(label)) return "asset";
  if (/Metrics|Gallery|Scored|Needs|Truth/.test(label)) return "told";
  return "other";
};

export const NodeBox = memo(function NodeBox({ data, selected }: NodeProps & { data: { box: Box } }) {
  const { box } = data, { node } = box;
  const state = useStoreWithEqualityFn(useStudio, (s) => stateOf(s, node.id, box.names), shallow);
  const marked = useStudio((s) => s.marked.has(node.id));
  const again = useStudio((s) => Boolean(s.preview?.names.includes(node.id)));
  const rounds = state.of > 1 ? (state.state === "running" || (state.done && state.done < state.of) ? `${state.done}/${state.of}` : `×${state.of}`) : "";
  const component = node.kind === "component", out = isBypassed(node, box.round), shown = component ? "none" : out ? "bypassed" : state.state;
  const words = [WORDS[shown], state.reason].filter(Boolean).join(": ");
  return (
    <div className={`box is-${shown} kind-${node.kind}${selected ? " selected" : ""}${again ? " again" : ""}`} title={words}
      aria-label={`${node.name}, ${node.type || node.kind}${words ? `, ${words}` : ""}`} data-node={node.id} data-state={shown}>
      <div className="box-head">
        <span className="box-name">{node.name}</span>
        {marked && <span className="box-mark" title="marked for the comparison with and without">◆</span>}
        {node.problems > 0 && <span className="box-bad" title="has faults">⚠</span>}
        {!component && <span className="box-sign" aria-hidden>{shown === "running" ? <Busy /> : SIGNS[shown]}</span>}
      </div>
      <div className="box-type">
        <span>{node.type || (node.kind === "part" ? node.graph : `repeat × ${node.repeat ?? ""}`)}</span>
        <span className="box-seconds">{!out && (state.figures || [rounds, state.seconds !== null ? `${state.expected ? "≈ " : ""}${seconds(state.seconds)}` : ""].filter(Boolean).join(" · "))}</span>
      </div>
      {shown === "running" && <div className="box-bar"><i style={{ width: `${100 * state.part}%` }} /></div>}
      {box.inputs.map((row) => <End key={row.handle} box={box} row={row} />)}
      {box.outputs.map((row) => <End key={row.handle} box={box} row={row} output />)}
      <Handle id="in:~" type="target" position={Position.Left} className="handle-hidden" isConnectable={false} />
      <Handle id="out:~" type="source" position={Position.Right} className="handle-hidden" isConnectable={false} />
    </div>
  );
});

function End({ box, row, output = false }: { box: Box; row: Row; output?: boolean }) {
  const fit = useDrawing((s) => (s.drawing ? (refusal(s.drawing, box.node.id, row.handle) === null && s.drawing.ends !== null ? "fits" : "unfit") : ""));
  const { port } = row;
  return (
    <>
      {(port.port || !output) && <span className={`port ${output ? "out" : "in"}${port.wired || output ? "" : " open"}${!output && !port.optional && !port.wired ? " needed" : ""}`} style={{ top: row.top }}>{port.port}</span>}
      <Handle id={row.handle} type={output ? "source" : "target"} position={output ? Position.Right : Position.Left} isConnectable={!box.fixed}
        className={`handle wire-${port.component || box.node.kind === "component" ? "component" : wireKind(port.label)} ${fit}`} style={{ top: row.top }}
        title={`${port.port || box.node.name}: ${port.label}${port.optional ? ", optional" : ""}${Object.keys(port.facets ?? {}).length ? ` (${Object.entries(port.facets).map(([k, v]) => `${k}: ${String(v)}`).join(", ")})` : ""}`} />
    </>
  );
}
