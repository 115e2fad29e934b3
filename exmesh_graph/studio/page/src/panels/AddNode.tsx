// Node types by search; where a wire was let go, those that fit its end come first and are wired at once.
import { useEffect, useMemo, useState } from "react";
import { get } from "../api";
import { edit, endsOf, tell } from "../state/actions";
import { now, set, useStudio } from "../state/store";
import { targetOf } from "../graph/ends";
import type { NodeType } from "../types";
import { close } from "./Overlays";

export function AddNode() {
  const catalog = useStudio((s) => s.catalog), at = useStudio((s) => s.addAt), graph = useStudio((s) => s.document);
  const [query, setQuery] = useState(""), [found, setFound] = useState<string[] | null>(null), [chosen, setChosen] = useState(0), [name, setName] = useState(""), [block, setBlock] = useState(graph?.nodes.find((node) => node.id === at?.node)?.parent ?? "");
  useEffect(() => {
    if (!query.trim()) { setFound(null); return; }
    const stop = new AbortController();
    const timer = setTimeout(() => get<{ types: string[] }>("/api/catalog/search", { q: query, limit: 40 }, stop.signal).then(({ types }) => { setFound(types); setChosen(0); }).catch(tell), 80);
    return () => { stop.abort(); clearTimeout(timer); };
  }, [query]);
  const types = useMemo(() => {
    const all = new Map((catalog?.types ?? []).map((type) => [type.type, type]));
    const names = found ?? (at ? at.types : [...all.keys()]);
    const fits = (type: string) => !at || at.types.includes(type);
    return names.map((type) => all.get(type)).filter((type): type is NodeType => Boolean(type)).map((type) => ({ type, fits: fits(type.type) })).sort((a, b) => Number(b.fits) - Number(a.fits));
  }, [catalog, found, at]);
  if (!catalog || !graph) return <p className="soft">…</p>;
  const picked = types[Math.min(chosen, types.length - 1)];
  const blocks = graph.nodes.filter((node) => node.kind === "block" || node.kind === "part");
  const free = (wanted: string, inside: string) => { let name = wanted, k = 2; while (graph.nodes.some((node) => node.id === (inside ? `${inside}.${name}` : name))) name = `${wanted}${k++}`; return name; };
  const suggested = (type: NodeType) => free(type.type.split(".").pop()!.replace(/\W/g, "_"), block);
  const add = async (type: NodeType) => {
    const short = name.trim() || suggested(type), full = block ? `${block}.${short}` : short;
    close();
    if (!(await edit({ add: { name: full, type: type.type } }))) return;
    set({ selected: full });
    window.dispatchEvent(new CustomEvent("studio:reveal", { detail: full }));
    if (at) await wire(full, at);
  };
  return (
    <div className="add-node" onKeyDown={(event) => {
      if (event.key === "ArrowDown" || event.key === "ArrowUp") { event.preventDefault(); setChosen(Math.max(0, Math.min(types.length - 1, chosen + (event.key === "ArrowDown" ? 1 : -1)))); }
      if (event.key === "Enter" && picked) { event.preventDefault(); void add(picked.type); }
    }}>
      {at && <p className="soft">{at.output ? `that takes ${at.node}.${at.port}` : `that makes ${at.node}.${at.port}`} <button className="link" onClick={() => set({ addAt: null })}>any node</button></p>}
      <input type="search" autoFocus placeholder="What should it do? e.g. unwrap, decimate, score" value={query} onChange={(event) => setQuery(event.target.value)} aria-label="search node types" role="combobox" aria-expanded="true" aria-controls="types" />
      <div className="two">
        <div className="list" id="types" role="listbox">
          {types.map(({ type, fits }, k) => (
            <button key={type.type} role="option" aria-selected={k === chosen} className={k === chosen ? "chosen" : ""} ref={(element) => { if (k === chosen) element?.scrollIntoView({ block: "nearest" }); }}
              onClick={() => setChosen(k)} onDoubleClick={() => void add(type)}>
              <code>{type.type}</code> {type.kind === "component" && <span className="chip">component</span>}{!fits && <span className="soft"> does not fit the wire</span>}<span className="soft clamp">{type.doc || type.title}</span>
            </button>
          ))}
          {types.length === 0 && <p className="soft">Nothing found.</p>}
        </div>
        {picked && (
          <div className="type-card">
            <h3><code>{picked.type.type}</code></h3>
            <p className="doc">{picked.type.doc || picked.type.title}</p>
            <p><span className="soft">takes</span> {picked.type.inputs.map((port) => `${port.port}: ${port.label}${port.optional ? "?" : ""}`).join(", ") || "nothing"}</p>
            <p><span className="soft">{picked.type.kind === "component" ? "plugs in as" : "makes"}</span> {picked.type.kind === "component" ? picked.type.plug || picked.type.outputs[0]?.label : picked.type.outputs.map((port) => `${port.port}: ${port.label}`).join(", ") || "nothing"}</p>
            <p><label>Name <input value={name} placeholder={suggested(picked.type)} onChange={(event) => setName(event.target.value)} /></label></p>
            {blocks.length > 0 && <p><label>In <select value={block} onChange={(event) => setBlock(event.target.value)}><option value="">the graph</option>{blocks.map((node) => <option key={node.id} value={node.id}>{node.id}</option>)}</select></label></p>}
            <button className="run" onClick={() => void add(picked.type)}>Add{at ? " and wire" : ""}</button>
          </div>
        )}
      </div>
    </div>
  );
}

// Joins the new node to the end that the wire was drawn from.
async function wire(name: string, at: { node: string; port: string; output: boolean }): Promise<void> {
  try {
    const { ends, target } = await endsOf(at.node, at.port, at.output), end = ends.find((choice) => choice.node === name && choice.ok);
    const input = at.output ? end?.target : target || targetOf(now().document!, { node: at.node, port: at.port, side: "" });
    if (end && input) await edit({ connect: input, to: end.link });
  } catch (error) { tell(error); }
}
