// The table of a sweep: each figure with its spread and its difference to the base.
import { useEffect, useState } from "react";
import { Refusal, get } from "../api";
import { tell } from "../state/actions";
import { figure, seconds } from "../text";
import type { Run, RunDetail, SweepFigure, SweepMember, SweepResult } from "../types";
import { look } from "./Results";

export function SweepTable({ run }: { run: Run }) {
  const [result, setResult] = useState<SweepResult | null>(null), [tries, setTries] = useState(0);
  const live = ["running", "starting", "stopping"].includes(run.state), late = !live && tries < 15;
  useEffect(() => setTries(0), [run.id, run.state]);
  useEffect(() => {
    let gone = false, timer = 0;
    get<SweepResult>(`/api/runs/${encodeURIComponent(run.id)}/sweep`).then((found) => { if (!gone) setResult(found); }).catch((error) => {
      if (gone) return;
      setResult(null);
      if (!(error instanceof Refusal && error.status === 404)) tell(error);
      else if (late) timer = window.setTimeout(() => setTries((count) => count + 1), 1500); // its nodes are done, its table is being written
    });
    return () => { gone = true; clearTimeout(timer); };
  }, [run.id, run.state, tries]); // eslint-disable-line
  if (!result) return <p className="soft">{live ? "It runs; the table stands here when it ends." : late ? "Its table is being written…" : "This sweep left no table."}</p>;
  const { labels, rows } = result.table;
  return (
    <div className="table-holder">
      <table className="sweep"><thead><tr><th>Variant</th>{labels.map((label) => <th className="n" key={label}>{label} <span className="soft">{rows[0]?.figures[label]?.unit}</span></th>)}<th className="n">Seconds</th><th className="n">shared</th></tr></thead>
        <tbody>{rows.map((row) => <tr key={row.variant}><td><b>{row.variant}</b>{row.state && row.state !== "done" && <span className="warning"> {row.state}</span>}</td>{labels.map((label) => <Cell key={label} told={row.figures[label]} />)}<td className="n">{seconds(row.seconds)}</td><td className="n">{row.shared}/{row.nodes}</td></tr>)}</tbody></table>
      {result.table.members && <LookAtVariants run={run} members={result.table.members} />}
      <p><a className="button" href={result.page} target="_blank" rel="noreferrer">The sweep's page, with pictures</a> <span className="soft">▲ better, ▼ worse than the base; ≈ within the spread over seeds</span></p>
    </div>
  );
}

function Cell({ told }: { told: SweepFigure | undefined }) {
  if (!told || told.mean === null) return <td className="n soft">–</td>;
  const { difference, exceeds, verdict } = told, within = exceeds === false || verdict === "same", way = verdict === "better" || verdict === "worse" ? verdict : "";
  return <td className="n">{figure(told.mean)}{told.spread ? <span className="soft"> ± {figure(told.spread, 2)}</span> : ""}
    {difference !== null && difference !== undefined && <span className={within ? "soft" : way}> {within ? "≈" : way === "better" ? "▲" : way === "worse" ? "▼" : ""}{difference > 0 ? "+" : ""}{figure(difference, 3)}</span>}</td>;
}

// Any result of any two variants beside each other: of a sweep, which node of the merged run stands for a variant's own.
function LookAtVariants({ run, members }: { run: Run; members: SweepMember[] }) {
  const [details, setDetails] = useState<RunDetail | null>(null), [chosen, choose] = useState("");
  useEffect(() => {
    let gone = false;
    get<RunDetail>(`/api/runs/${encodeURIComponent(run.id)}`).then((found) => { if (!gone) setDetails(found); }).catch(tell);
    return () => { gone = true; };
  }, [run.id, run.state]);
  if (!details?.nodes_detail) return null;
  const outputs = new Map(details.nodes_detail.map((node) => [node.name, node.outputs ?? {}])), first = members.filter((member) => member.repeat <= 1);
  const place = new Map(details.nodes_detail.map((node, k) => [node.name, k])), ports = new Map<string, [type: string, place: number]>(); // of node.port of variants
  for (const member of first) for (const [own, merged] of Object.entries(member.nodes)) for (const [port, output] of Object.entries(outputs.get(merged) ?? {})) ports.set(`${own}.${port}`, [output.type, place.get(merged) ?? 0]);
  const order = ["Asset", "Gallery", "Stage1State", "Carrier", "Mesh"], rank = (type: string) => { const at = order.indexOf(type); return at < 0 ? 9 : at; };
  const sorted = [...ports].sort(([, [one, a]], [, [two, b]]) => rank(one) - rank(two) || b - a), wanted = chosen || sorted[0]?.[0] || ""; // what is made last is the result
  const cut = wanted.lastIndexOf("."), node = wanted.slice(0, cut), port = wanted.slice(cut + 1);
  return (
    <p className="variants-look"><label>Look at <select value={wanted} onChange={(event) => choose(event.target.value)}>{sorted.map(([name, [type]]) => <option key={name} value={name}>{name} ({type})</option>)}</select></label>
      {first.map((member) => {
        const output = outputs.get(member.nodes[node] ?? "")?.[port];
        if (!output) return <span key={member.variant} className="soft"> {member.variant}: none</span>;
        return <span key={member.variant}> {member.variant} <span className="group"><button onClick={() => look(0, output.digest, node, port, output.type, member.variant)}>A</button><button onClick={() => look(1, output.digest, node, port, output.type, member.variant)}>B</button></span></span>;
      })}</p>
  );
}
