// What happened and what nodes printed: of the run, or of the selected node.
import { useEffect, useRef, useState } from "react";
import { get } from "../api";
import { tell } from "../state/actions";
import { nodeOf, roundsOf, useStudio } from "../state/store";
import type { LogLine } from "../types";

export function Log() {
  const followed = useStudio((s) => s.followed), node = useStudio((s) => nodeOf(s, s.selected)), round = useStudio((s) => s.round), tick = useStudio((s) => s.logTick);
  const [lines, setLines] = useState<LogLine[]>([]), [beat, setBeat] = useState(0), offset = useRef(0), end = useRef<HTMLDivElement>(null), stick = useRef(true);
  const running = useStudio((s) => node?.names.find((name) => s.states.get(name)?.state === "running"));
  const name = node && node.kind === "node" ? (round !== null ? roundsOf(node)[round - 1] : running ?? node.names[node.names.length - 1]) : "";
  useEffect(() => { const timer = setTimeout(() => setBeat((b) => b + 1), 700); return () => clearTimeout(timer); }, [tick]);
  useEffect(() => { offset.current = 0; setLines([]); }, [followed, name]);
  useEffect(() => {
    if (!followed) return;
    let gone = false;
    const from = offset.current;
    get<{ lines: LogLine[]; offset: number }>(`/api/runs/${encodeURIComponent(followed)}/log`, { offset: from, ...(name ? { node: name } : {}) }).then((found) => {
      if (gone || offset.current !== from) return;
      offset.current = found.offset;
      if (found.lines.length) setLines((old) => [...(from ? old : []), ...found.lines].slice(-3000));
    }).catch(tell);
    return () => { gone = true; };
  }, [followed, name, beat]);
  useEffect(() => { if (stick.current) end.current?.scrollIntoView({ block: "end" }); }, [lines]);
  if (!followed) return <p className="soft pad">The log of a run stands here. Press <b>Run</b>, or choose a run above.</p>;
  return (
    <div className="log scroll" onScroll={(event) => { const box = event.currentTarget; stick.current = box.scrollHeight - box.scrollTop - box.clientHeight < 40; }}>
      <p className="soft">{name || "the whole run"}</p>
      {lines.map((line, k) => <div key={k} className={`log-line ${line.kind}`}>{line.time ? <span className="soft">{new Date(line.time * 1000).toLocaleTimeString("en-GB")} </span> : null}{!name && line.node ? <b>{line.node}  </b> : null}{line.text}</div>)}
      {lines.length === 0 && <p className="soft">nothing yet</p>}
      <div ref={end} />
    </div>
  );
}
