// Curves over steps or seconds, in SVG; the pointer reads values.
import { memo, useState } from "react";
import { figure } from "../text";
import type { Curve } from "../types";

const W = 330, H = 170, LEFT = 54, RIGHT = 10, TOP = 24, BOTTOM = 26;
const NAMES: { [name: string]: string } = { psnr: "PSNR (dB)", loss: "loss", ssim: "SSIM" };
const SHAPES = ["", "6 3", "2 3", "9 3 2 3"]; // dashes beside colours

// One chart for each figure of each node; rounds follow one another in it.
export function Charts({ curves, axis = "" }: { curves: Curve[]; axis?: "" | "t" }) {
  const groups = new Map<string, Curve[]>();
  for (const curve of curves) {
    const key = `${(curve.node ?? "").replace(/\[\d+\]/g, "")}|${curve.name}`;
    groups.set(key, [...(groups.get(key) ?? []), curve]);
  }
  if (!groups.size) return <p className="soft pad">No curves yet. They grow here while a run fits something.</p>;
  const order = (key: string) => (key.endsWith("|psnr") ? 0 : key.endsWith("|loss") ? 1 : 2);
  return <div className="charts">{[...groups].sort(([a], [b]) => order(a) - order(b)).map(([key, list]) => <Joined key={key} title={`${key.split("|")[0]} ${NAMES[list[0].name] ?? list[0].name.replace(/_/g, " ")}`} list={list} axis={axis} />)}</div>;
}

// Drawn anew only where one of its curves is another.
const Joined = memo(
  function Joined({ title, list, axis }: { title: string; list: Curve[]; axis: "" | "t" }) {
    return <Chart title={title} curves={joined(list, axis)} axis={axis ? "seconds" : list[0].axis || "step"} />;
  },
  (old, next) => old.title === next.title && old.axis === next.axis && old.list.length === next.list.length && old.list.every((curve, k) => curve === next.list[k]),
);

// Rounds laid one after the other along the axis.
function joined(curves: Curve[], axis: string): { label: string; x: number[]; y: number[] }[] {
  let from = 0;
  return curves.map((curve) => {
    const xs = axis && curve.t ? curve.t : curve.x, shift = axis && curve.t ? 0 : from, x = xs.map((value) => value + shift);
    if (curves.length > 1 && !(axis && curve.t)) from = x[x.length - 1] ?? from;
    return { label: /\[(\d+)\]/.exec(curve.node ?? "")?.[1] ?? "", x, y: curve.y };
  });
}

export function Chart({ title, curves, axis }: { title: string; curves: { label: string; x: number[]; y: number[] }[]; axis: string }) {
  const [at, setAt] = useState<number | null>(null);
  const xs = curves.flatMap((curve) => curve.x), ys = curves.flatMap((curve) => curve.y).filter((y) => Number.isFinite(y));
  if (!ys.length) return null;
  const x0 = Math.min(...xs), x1 = Math.max(...xs, x0 + 1e-9), sorted = [...ys].sort((a, b) => a - b);
  const log = sorted[0] > 0 && sorted[sorted.length - 1] / sorted[0] > 30, f = log ? Math.log10 : (y: number) => y;
  const low = f(sorted[0]), high = Math.max(f(sorted[sorted.length - 1]), low + 1e-9);
  const px = (x: number) => LEFT + ((x - x0) / (x1 - x0)) * (W - LEFT - RIGHT), py = (y: number) => H - BOTTOM - ((f(y) - low) / (high - low)) * (H - TOP - BOTTOM);
  let near: { x: number; y: number } | null = null;
  if (at !== null) for (const curve of curves) curve.x.forEach((x, k) => { if (Number.isFinite(curve.y[k]) && (near === null || Math.abs(x - at) < Math.abs(near.x - at))) near = { x, y: curve.y[k] }; });
  const spot = near as { x: number; y: number } | null, ends = [sorted[0], sorted[sorted.length - 1]];
  return (
    <svg className="chart" viewBox={`0 0 ${W} ${H}`} role="img" aria-label={`${title}: from ${figure(ys[0])} to ${figure(ys[ys.length - 1])}`}
      onPointerMove={(event) => { const rect = event.currentTarget.getBoundingClientRect(); setAt(x0 + (((event.clientX - rect.left) / rect.width) * W - LEFT) / (W - LEFT - RIGHT) * (x1 - x0)); }} onPointerLeave={() => setAt(null)}>
      <text className="title" x={LEFT - 36} y={14}>{title}</text>
      {ends.map((y, k) => <g key={k}><line className="grid" x1={LEFT} x2={W - RIGHT} y1={py(y)} y2={py(y)} /><text className="tick" x={LEFT - 6} y={py(y) + 3.5} textAnchor="end">{figure(y, 3)}</text></g>)}
      <text className="tick" x={LEFT} y={H - 10}>{figure(x0, 3)}</text><text className="tick" x={W - RIGHT} y={H - 10} textAnchor="end">{figure(x1, 4)} {axis}</text>
      {curves.map((curve, k) => <path key={k} className={`curve c${k % 4}`} strokeDasharray={curves.length > 1 ? SHAPES[Math.floor(k / 4) % 4] : ""} d={curve.x.map((x, i) => (Number.isFinite(curve.y[i]) ? `${i && Number.isFinite(curve.y[i - 1]) ? "L" : "M"}${px(x).toFixed(1)} ${py(curve.y[i]).toFixed(1)}` : "")).join("")} />)}
      {spot && <g><circle cx={px(spot.x)} cy={py(spot.y)} r={3} className="spot" /><text className="read" x={W - RIGHT} y={14} textAnchor="end">{figure(spot.y)} at {figure(spot.x)}</text></g>}
      {!spot && <text className="read" x={W - RIGHT} y={14} textAnchor="end">{figure(ys[ys.length - 1])}</text>}
    </svg>
  );
}
