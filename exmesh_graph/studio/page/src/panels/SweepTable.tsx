// The table of a sweep: each figure with its spread and its difference to the base.
import { useEffect, useState } from "react";
import { Refusal, get } from "../api";
import { tell } from "../state/actions";
import { figure, seconds } from "../text";
import type { Run, SweepFigure, SweepResult } from "../types";

export function SweepTable({ run }: { run: Run }) {
  const [result, setResult] = useState<SweepResult | null>(null);
  useEffect(() => {
    let gone = false;
    get<SweepResult>(`/api/runs/${encodeURIComponent(run.id)}/sweep`).then((found) => { if (!gone) setResult(found); }).catch((error) => { if (!gone) { setResult(null); if (!(error instanceof Refusal && error.status === 404)) tell(error); } });
    return () => { gone = true; };
  }, [run.id, run.state]);
  if (!result) return <p className="soft">{["running", "starting"].includes(run.state) ? "It runs; the table stands here when it ends." : "This sweep left no table."}</p>;
  const { labels, rows } = result.table;
  return (
    <div className="table-holder">
      <table className="sweep"><thead><tr><th>Variant</th>{labels.map((label) => <th className="n" key={label}>{label} <span className="soft">{rows[0]?.figures[label]?.unit}</span></th>)}<th className="n">Seconds</th><th className="n">shared</th></tr></thead>
        <tbody>{rows.map((row) => <tr key={row.variant}><td><b>{row.variant}</b>{row.state !== "done" && <span className="warning"> {row.state}</span>}</td>{labels.map((label) => <Cell key={label} told={row.figures[label]} />)}<td className="n">{seconds(row.seconds)}</td><td className="n">{row.shared}/{row.nodes}</td></tr>)}</tbody></table>
      <p><a className="button" href={result.page} target="_blank" rel="noreferrer">The sweep's page, with pictures</a> <span className="soft">▲ better, ▼ worse than the base; ≈ within the spread over seeds</span></p>
    </div>
  );
}

function Cell({ told }: { told: SweepFigure | undefined }) {
  if (!told || told.mean === null) return <td className="n soft">–</td>;
  const { difference, exceeds, better } = told, way = !difference || !better ? "" : (difference > 0) === (better === "higher" || better === "more" || better === "high") ? "better" : "worse";
  return <td className="n">{figure(told.mean)}{told.spread ? <span className="soft"> ± {figure(told.spread, 2)}</span> : ""}
    {difference !== null && difference !== undefined && <span className={exceeds === false ? "soft" : way}> {exceeds === false ? "≈" : way === "better" ? "▲" : way === "worse" ? "▼" : ""}{difference > 0 ? "+" : ""}{figure(difference, 3)}</span>}</td>;
}
