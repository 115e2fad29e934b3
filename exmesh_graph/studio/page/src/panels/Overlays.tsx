// Windows over the page: add a node, open a graph, save, keys and signs.
import { useEffect, useRef, useState, type ReactNode } from "react";
import { get } from "../api";
import { edit, openGraph, revert, save, tell } from "../state/actions";
import { set, useStudio } from "../state/store";
import type { Json } from "../types";
import { SIGNS, WORDS, type Shown } from "../graph/states";
import { AddNode } from "./AddNode";
import { dedent } from "./Changes";

export function Overlays() {
  const overlay = useStudio((s) => s.overlay);
  if (!overlay) return null;
  if (overlay === "add") return <Window title="Add a node"><AddNode /></Window>;
  if (overlay === "open") return <Window title="Open a graph"><OpenGraph /></Window>;
  if (overlay === "save") return <Window title="Save"><Save /></Window>;
  return <Window title="Keys and signs"><Help /></Window>;
}

export const close = () => set({ overlay: null, addAt: null });

function Window({ title, children }: { title: string; children: ReactNode }) {
  const holder = useRef<HTMLDialogElement>(null);
  useEffect(() => { holder.current?.showModal(); holder.current?.querySelector<HTMLElement>("input:not([type=radio])")?.focus(); }, []);
  return (
    <dialog ref={holder} className="window" aria-label={title} onCancel={close} onClose={close}
      onKeyDown={(event) => { if (event.key === "Escape") { event.preventDefault(); event.stopPropagation(); close(); } }} onClick={(event) => { if (event.target === holder.current) close(); }}>
      <div className="window-head"><h2>{title}</h2><button className="quiet" onClick={close} aria-label="Close">✕</button></div>
      {children}
    </dialog>
  );
}

function OpenGraph() {
  const [graphs, setGraphs] = useState<{ file: string; doc: string; variants: string[] }[] | null>(null), [query, setQuery] = useState("");
  const dirty = useStudio((s) => s.document?.dirty ?? false), here = useStudio((s) => s.document?.file);
  useEffect(() => { get<{ graphs: { file: string; doc: string; variants: string[] }[] }>("/api/graphs").then((found) => setGraphs(found.graphs)).catch(tell); }, []);
  const open = (file: string, variant = "") => { void openGraph(file, variant, dirty); close(); };
  return (
    <>
      {dirty && <p className="warning">Edits of {here} that are not saved are lost when another graph is opened.</p>}
      <input type="search" autoFocus placeholder="Search" value={query} onChange={(event) => setQuery(event.target.value)} aria-label="search graphs" />
      <div className="list">
        {graphs === null && <p className="soft">…</p>}
        {graphs?.filter((graph) => `${graph.file} ${graph.doc}`.toLowerCase().includes(query.toLowerCase())).map((graph) => (
          <div key={graph.file} className="list-row">
            <button onClick={() => open(graph.file)}><b>{graph.file}</b> <span className="soft">{graph.doc}</span></button>
            {graph.variants.map((variant) => <button key={variant} className="chip" onClick={() => open(graph.file, variant)} title={`variant ${variant}`}>{variant}</button>)}
          </div>
        ))}
      </div>
    </>
  );
}

function Save() {
  const document = useStudio((s) => s.document)!;
  const [as, setAs] = useState<"file" | "variant" | "child">("variant"), [name, setName] = useState(""), [doc, setDoc] = useState("");
  const child = `${(name || "mine").replace(/\.ya?ml$/, "")}.yaml`;
  const body: { [name: string]: Json } = as === "file" ? { as } : as === "variant" ? { as, name, doc } : { as, file: child, name: child.replace(/\.yaml$/, "") };
  const faulty = document.problems.length > 0;
  return (
    <form onSubmit={(event) => { event.preventDefault(); void save(faulty ? { ...body, faulty: true } : body).then((done) => { if (done) close(); }); }}>
      <label className="choice"><input type="radio" checked={as === "variant"} onChange={() => setAs("variant")} /> <span><b>As a variant</b> in {document.file}: the graph stays as it is, the variant has a name</span></label>
      <label className="choice"><input type="radio" checked={as === "child"} onChange={() => setAs("child")} /> <span><b>As a new file</b> that extends {document.file}</span></label>
      <label className="choice"><input type="radio" checked={as === "file"} onChange={() => setAs("file")} /> <span><b>In place</b>: {document.file} itself, comments and order kept</span></label>
      {as !== "file" && <p><label>Name <input autoFocus required pattern={as === "variant" ? "[A-Za-z_][A-Za-z0-9_]*" : "[A-Za-z0-9_\\-./]+"} title="letters, digits, _" value={name} onChange={(event) => setName(event.target.value)} placeholder={as === "variant" ? "direct" : "mine.yaml"} /></label></p>}
      {as === "variant" && <p><label>What it is for <input value={doc} onChange={(event) => setDoc(event.target.value)} placeholder="shown in tables" /></label></p>}
      <p className="soft">What is saved:</p>
      <pre className="patch">{dedent(document.patch) || "no edits"}</pre>
      {faulty && <p className="warning">The graph has faults. It can be saved, and cannot run before they are mended.</p>}
      <div className="buttons end"><button type="button" onClick={() => { void revert(); close(); }} className="danger">Throw the edits away</button><button type="submit" className="run">Save</button></div>
    </form>
  );
}

const KEYS: [string, string][] = [["Ctrl Enter", "run"], ["A", "add a node"], ["← → ↑ ↓", "from node to node"], ["Enter", "look at what the node made"], ["B", "bypass"], ["Del", "remove"], ["M", "mark for with and without"],
  ["Ctrl Z", "undo"], ["Ctrl Shift Z", "redo"], ["Ctrl S", "save"], ["F", "the whole graph"], ["L", "look larger, smaller"], ["Esc", "close, select nothing"], ["double click", "fold or open a block"]];

function Help() {
  return (
    <div className="help">
      <div>
        <h3>What to do here</h3>
        <p>Boxes are nodes, lines carry results from left to right. Click a node: its <b>results</b>, <b>parameters</b>, <b>wires</b> and why it runs stand at the right; what it made is shown below.</p>
        <p>Change a parameter: boxes that would run again are marked at once, with the time it takes. Press <b>Run</b>: only these run.</p>
        <p>Draw a wire from a dot to another; dots that take it light up. Let it go on the empty ground to add a node there.</p>
        <p><b>Mark</b> nodes, then <b>Compare</b>: the graph with and without them, as a table.</p>
      </div>
      <div>
        <h3>Keys</h3>
        <table><tbody>{KEYS.map(([keys, what]) => <tr key={keys}><td><kbd>{keys}</kbd></td><td>{what}</td></tr>)}</tbody></table>
      </div>
      <div>
        <h3>Signs</h3>
        <table><tbody>{(Object.keys(SIGNS) as Shown[]).filter((state) => SIGNS[state]).map((state) => <tr key={state}><td><span className={`sign is-${state}`}>{SIGNS[state]}</span></td><td>{WORDS[state]}</td></tr>)}</tbody></table>
      </div>
    </div>
  );
}

export { edit };
