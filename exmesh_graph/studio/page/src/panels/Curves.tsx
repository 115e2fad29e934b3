// Curves of the followed run, growing while it runs; of one node where one is selected.
import { useEffect, useState } from "react";
import { get } from "../api";
import { tell } from "../state/actions";
import { useStudio } from "../state/store";
import type { Curve } from "../types";
import { Charts } from "./Chart";

export function Curves() {
  const followed = useStudio((s) => s.followed), selected = useStudio((s) => s.selected), beat = useStudio((s) => Math.floor(s.beat / 2)), state = useStudio((s) => s.details?.state);
  const [curves, setCurves] = useState<Curve[] | null>(null), [axis, setAxis] = useState<"" | "t">(""), [only, setOnly] = useState(false);
  useEffect(() => {
    if (!followed) return;
    let gone = false;
    get<{ curves: Curve[] }>(`/api/runs/${encodeURIComponent(followed)}/curves`).then((found) => { if (!gone) setCurves(found.curves); }).catch(tell);
    return () => { gone = true; };
  }, [followed, beat, state]);
  if (!followed) return <p className="soft pad">Curves of a run stand here. Press <b>Run</b>, or choose a run above.</p>;
  const mine = (curve: Curve) => curve.node.replace(/\[\d+\]/g, "") === selected;
  const shown = only && selected ? (curves ?? []).filter(mine) : curves ?? [];
  return (
    <div className="scroll">
      <div className="tools">
        <span className="group"><button aria-pressed={axis === ""} onClick={() => setAxis("")}>over steps</button><button aria-pressed={axis === "t"} onClick={() => setAxis("t")}>over seconds</button></span>
        {selected && <label><input type="checkbox" checked={only} onChange={(event) => setOnly(event.target.checked)} /> only {selected}</label>}
      </div>
      {curves ? <Charts curves={shown} axis={axis} /> : <p className="soft pad">…</p>}
    </div>
  );
}
