// A wire along the corners that the layout gave it, and the one that is being drawn.
import { type ConnectionLineComponentProps, type EdgeProps } from "@xyflow/react";
import { memo } from "react";
import type { Point } from "../layout/shapes";
import type { Line } from "./picture";
import { refusal, useDrawing } from "./wires";
import { wireKind } from "./NodeBox";

export function curve(points: readonly Point[]): string {
  let text = `M${points[0][0]} ${points[0][1]}`;
  for (let k = 1; k < points.length; k++) {
    const [x0, y0] = points[k - 1], [x1, y1] = points[k];
    if (Math.abs(y1 - y0) < 0.5 && x1 >= x0) { text += `L${x1} ${y1}`; continue; }
    const bend = Math.max(18, Math.abs(x1 - x0) / 2);
    text += `C${x0 + bend} ${y0} ${x1 - bend} ${y1} ${x1} ${y1}`;
  }
  return text;
}

export const WireEdge = memo(function WireEdge({ data, sourceX, sourceY, targetX, targetY, selected }: EdgeProps & { data: { line: Line; points: Point[] | undefined } }) {
  const { line, points } = data, { wire } = line;
  const path = curve([[sourceX, sourceY], ...(points ?? []).slice(1, -1), [targetX, targetY]]);
  const kind = wire.kind === "component" ? "component" : wireKind(wire.label);
  return (
    <g className={`wire wire-${kind}${wire.problem ? " bad" : ""}${selected ? " selected" : ""}${wire.rounds ? " some" : ""}`}>
      <path className="wire-grip" d={path}><title>{`${wire.text} → ${wire.target}  ${wire.label}${wire.rounds ? `, ${wire.rounds}` : ""}`}</title></path>
      <path className="wire-line" d={path} />
    </g>
  );
});

export function DrawnWire({ fromX, fromY, toX, toY, toNode, toHandle, fromHandle }: ConnectionLineComponentProps) {
  const drawing = useDrawing((s) => s.drawing), back = fromHandle.type === "target";
  const why = toNode && toHandle?.id && drawing ? refusal(drawing, toNode.id, toHandle.id) : null;
  const path = back ? curve([[toX, toY], [fromX, fromY]]) : curve([[fromX, fromY], [toX, toY]]);
  return (
    <g className={`wire drawn${why ? " bad" : ""}`}>
      <path className="wire-line" d={path} />
      {why && <foreignObject x={toX + 14} y={toY + 12} width={340} height={120}><div className="why-not" role="alert">✕ {why}</div></foreignObject>}
    </g>
  );
}
