// The edits as text: the patch, and what the file would become.
import { useEffect, useState } from "react";
import { get } from "../api";
import { redo, revert, tell, undo } from "../state/actions";
import { set, useStudio } from "../state/store";
import type { TextView } from "../types";

export function Changes() {
  const document = useStudio((s) => s.document), [text, setText] = useState<TextView | null>(null), [whole, setWhole] = useState(false);
  const revision = document?.revision;
  useEffect(() => {
    let gone = false;
    get<TextView>("/api/text").then((found) => { if (!gone) setText(found); }).catch(tell);
    return () => { gone = true; };
  }, [revision]);
  if (!document) return null;
  return (
    <div className="changes scroll">
      <div className="tools">
        <button onClick={() => void undo()} disabled={!document.can_undo}>↶ Undo</button><button onClick={() => void redo()} disabled={!document.can_redo}>↷ Redo</button>
        <button onClick={() => set({ overlay: "save" })} disabled={!document.dirty}>Save…</button><button className="danger" onClick={() => void revert()} disabled={!document.ops.length}>Throw away</button>
        <span className="spring" /><label><input type="checkbox" checked={whole} onChange={(event) => setWhole(event.target.checked)} /> whole file</label>
      </div>
      {!document.ops.length && !whole && <p className="soft">No edits. What you change stands here as a patch on {document.file}.</p>}
      {document.ops.length > 0 && <div className="two">
        <div><h3>Patch</h3><pre className="patch">{dedent(document.patch)}</pre></div>
        <div><h3>What becomes of {document.file}</h3>{text?.why_not ? <p className="warning">It cannot be saved in place: {text.why_not.what} {text.why_not.fix}</p> : <Diff text={text?.diff ?? ""} />}</div>
      </div>}
      {whole && <pre className="patch">{text?.new_text || text?.text}</pre>}
    </div>
  );
}

const Diff = ({ text }: { text: string }) => (
  <pre className="patch">{text.split("\n").map((line, k) => <span key={k} className={line.startsWith("+") && !line.startsWith("+++") ? "plus" : line.startsWith("-") && !line.startsWith("---") ? "minus" : ""}>{line}{"\n"}</span>)}</pre>
);

export const dedent = (text: string): string => {
  const lines = text.split("\n"), margin = Math.min(...lines.filter((line) => line.trim()).map((line) => line.length - line.trimStart().length), 99);
  return lines.map((line) => line.slice(margin)).join("\n");
};
