// Curves of the followed run, growing while it runs; of one node where one is selected.
import { useEffect, useState } from "react";
import { get } from "../api";
import { tell } from "../state/actions";
import { begin, grown } from "../state/curves";
import { useStudio } from "../state/store";
import type { Curve } from "../types";
import { Charts } from "./Chart";
import { LIVE } from "./Runs";

const ANEW = 20000; // milliseconds between two askings: in between curves grow by what progress tells

export function Curves() {
  const followed = useStudio((s) => s.followed), selected = useStudio((s) => s.selected), state = useStudio((s) => s.details?.state);
  useStudio((s) => s.beat); // drawn with what progress told
  const [told, setTold] = useState<Curve[] | null>(null), [axis, setAxis] = useState<"" | "t">(""), [only, setOnly] = useState(false);
  const live = useStudio((s) => s.runs.some((run) => run.id === s.followed && LIVE.includes(run.state)));
  useEffect(() => {
    if (!followed) return;
    let gone = false;
    const ask = () => {
      if (document.hidden) return;
      begin(followed);
      get<{ curves: Curve[] }>(`/api/runs/${encodeURIComponent(followed)}/curves`).then((found) => { if (!gone) setTold(found.curves); }).catch(tell);
    };
    ask();
    const timer = live ? setInterval(ask, ANEW) : 0;
    return () => { gone = true; clearInterval(timer); };
  }, [followed, live, state]);
  const curves = told && grown(told);
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
