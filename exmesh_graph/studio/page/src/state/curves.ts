// What progress events tell is put on to the curves that the server gave, so that these need not be asked for again and again.
import type { Curve } from "../types";
import type { ProgressEvent } from "./live";

let run = "";
let since: ProgressEvent[] = []; // those of `run` since its curves were asked for

export function grow(event: ProgressEvent): void {
  if (event.run === run && since.push(event) > 5000) since = since.filter((_, k) => k % 2);
}

// Called when the curves of a run are asked for.
export function begin(id: string): void { run = id; since = []; }

// The curves with what came since; those that nothing came for stay the same objects.
export function grown(curves: Curve[]): Curve[] {
  const all = [...curves], at = new Map(all.map((curve, k) => [`${curve.node} ${curve.name}`, k])), own = new Set<number>();
  for (const { name: node, figures, step, t } of since)
    for (const [name, value] of Object.entries(figures)) {
      const k = at.get(`${node} ${name}`) ?? all.length;
      at.set(`${node} ${name}`, k);
      if (!own.has(k)) { const old = all[k]; all[k] = old ? { ...old, x: [...old.x], y: [...old.y], t: old.t && [...old.t] } : { node, name, axis: "step", x: [], y: [], t: [] }; own.add(k); }
      const { x, y, t: times } = all[k];
      if (x.length && x[x.length - 1] >= step) continue;
      x.push(step); y.push(value); times?.push(t);
    }
  return all;
}
