// What an artifact tells in numbers: tables, figures, curves.
import { useEffect, useState } from "react";
import { get } from "../api";
import { figure } from "../text";
import { tell } from "../state/actions";
import type { Curve, Headline, Json, Table } from "../types";
import { Charts } from "../panels/Chart";

function useAnswer<T>(path: string, digest: string, show = ""): T | null {
  const [found, setFound] = useState<T | null>(null);
  useEffect(() => {
    let gone = false;
    get<T>(path, { digest, ...(show ? { show } : {}) }).then((answer) => { if (!gone) setFound(answer); }).catch(tell);
    return () => { gone = true; };
  }, [path, digest, show]);
  return found;
}

export function TableOf({ digest, show }: { digest: string; show: string }) {
  const table = useAnswer<Table>("/api/artifact/table", digest, show);
  if (!table) return <p className="soft pad">…</p>;
  return <div className="told"><table><thead><tr>{table.columns.map((column) => <th key={column}>{column.replace(/_/g, " ")}</th>)}</tr></thead>
    <tbody>{table.rows.map((row, k) => <tr key={k}>{row.map((value, c) => <td key={c} className={typeof value === "number" ? "n" : ""}>{figure(value)}</td>)}</tr>)}</tbody></table>{table.note && <p className="soft">{table.note}</p>}</div>;
}

export function FiguresOf({ digest }: { digest: string }) {
  const told = useAnswer<{ headline: ({ label: string } & Headline)[]; values: { [name: string]: Json } }>("/api/artifact/figures", digest);
  if (!told) return <p className="soft pad">…</p>;
  const plain = Object.entries(told.values).filter(([, value]) => value === null || typeof value !== "object");
  if (!told.headline.length && !plain.length) return <p className="soft pad">No single figures; what it tells stands under the other names above.</p>;
  return (
    <div className="told">
      {told.headline.length > 0 && <div className="tiles">{told.headline.map((entry) => <div className="tile" key={entry.label}><p className="soft">{entry.label}</p><p className="large">{figure(entry.value)} <span className="soft">{entry.unit}</span></p>{entry.floor !== undefined && entry.floor !== null && <p className="soft">uninformed guess {figure(entry.floor)}</p>}</div>)}</div>}
      <table><tbody>{plain.map(([name, value]) => <tr key={name}><td>{name.replace(/_/g, " ")}</td><td className="n">{figure(value, 5)}</td></tr>)}</tbody></table>
    </div>
  );
}

export function CurvesOf({ digest }: { digest: string }) {
  const told = useAnswer<{ curves: Curve[] }>("/api/artifact/curves", digest);
  return <div className="told">{told ? <Charts curves={told.curves} /> : <p className="soft">…</p>}</div>;
}
