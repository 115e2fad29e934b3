// The controls above what is looked at; they act on both sides.
import { useEffect, useState } from "react";
import { get } from "../api";
import type { Show } from "../types";
import { setLook, useLook } from "./options";
import { useKinds } from "./kinds";

export function LookTools({ show }: { show: Show }) {
  const look = useLook();
  if (show.kind === "sheet") return (
    <div className="tools">
      {(show.layers ?? []).length > 1 && <Choice label="Layer" value={look.layer || show.layers![0]} values={show.layers!} pick={(layer) => setLook({ layer })} />}
      {look.single ? <>
        <button onClick={() => setLook({ single: false })}>▦ All views</button>
        <button onClick={() => setLook({ index: (look.index - 1 + (show.count ?? 1)) % (show.count ?? 1) })} aria-label="previous view">‹</button>
        <span>{show.names?.[look.index] ?? look.index} <span className="soft">{look.index + 1} of {show.count}</span></span>
        <button onClick={() => setLook({ index: (look.index + 1) % (show.count ?? 1) })} aria-label="next view">›</button>
        <Magnify />
      </> : <span className="soft">{show.count} views of {show.width} × {show.height}. Click one to see it large.</span>}
    </div>
  );
  if (show.kind === "maps") return <div className="tools"><Choice label="Map" value={look.map && show.names?.includes(look.map) ? look.map : show.names?.[0] ?? ""} values={show.names ?? []} pick={(map) => setLook({ map })} /><Magnify /></div>;
  if (show.kind === "picture") return <div className="tools">{(show.layers ?? []).length > 1 && <Choice label="Layer" value={look.layer && show.layers!.includes(look.layer) ? look.layer : show.layers![0]} values={show.layers!} pick={(layer) => setLook({ layer })} />}<Magnify /><span className="soft">{show.caption}</span></div>;
  if (show.kind === "environment") return <div className="tools"><Slider label="Exposure" min={-6} max={6} step={0.5} value={look.exposure} set={(exposure) => setLook({ exposure })} unit="EV" /><Magnify /></div>;
  if (show.kind === "model") return <ModelTools />;
  if (show.kind === "points" || show.kind === "cameras") return <div className="tools"><span className="soft">Drag to turn, wheel to come nearer, right button to move.</span></div>;
  return null;
}

function ModelTools() {
  const look = useLook(), { kinds, levels, faces, whole } = useKinds(), shown = kinds.includes(look.shown) ? look.shown : kinds[0] ?? "";
  const [lights, setLights] = useState<string[]>(["recovered", "studio", "overcast"]);
  useEffect(() => { get<{ lights: string[] }>("/api/lights").then((found) => setLights(found.lights)).catch(() => undefined); }, []);
  return (
    <div className="tools">
      <select className="narrow-only" aria-label="how the surface is shown" value={shown} onChange={(event) => setLook({ shown: event.target.value })}>{kinds.map((kind) => <option key={kind} value={kind}>{kind.replace("_", " ")}</option>)}</select>
      <span className="group wide-only" role="group" aria-label="how the surface is shown">{kinds.map((kind) => <button key={kind} aria-pressed={kind === shown} onClick={() => setLook({ shown: kind })}>{kind.replace("_", " ")}</button>)}</span>
      {shown === "shaded" && <>
        <Choice label="Light" value={look.light} values={lights} pick={(light) => setLook({ light })} />
        <Slider label="Turn" min={-180} max={180} step={1} value={look.turn} set={(turn) => setLook({ turn })} unit="°" />
        <Slider label="Exposure" min={-4} max={4} step={0.1} value={look.exposure} set={(exposure) => setLook({ exposure })} unit="EV" />
        <label><input type="checkbox" checked={look.behind} onChange={(event) => setLook({ behind: event.target.checked })} /> sky</label>
      </>}
      <label><input type="checkbox" checked={look.turntable} onChange={(event) => setLook({ turntable: event.target.checked })} /> turn</label>
      {levels > 1 && <button aria-pressed={look.full} onClick={() => setLook({ full: !look.full })} title="the whole mesh and maps">{whole ? `all ${whole.toLocaleString("en")} faces` : "whole"}</button>}
      <span className="soft">{faces ? `${faces.toLocaleString("en")} faces shown` : ""}</span>
    </div>
  );
}

export function Choice({ label, value, values, pick }: { label: string; value: string; values: string[]; pick: (value: string) => void }) {
  if (values.length <= 6) return <span className="group" role="group" aria-label={label}>{values.map((each) => <button key={each} aria-pressed={each === value} onClick={() => pick(each)}>{each.replace(/_/g, " ")}</button>)}</span>;
  return <label>{label} <select value={value} onChange={(event) => pick(event.target.value)}>{values.map((each) => <option key={each} value={each}>{shortest(each, values)}</option>)}</select></label>;
}

// A file's name, with the folder where two have the same.
const shortest = (file: string, files: string[]): string => {
  const name = file.split("/").pop()!;
  return files.filter((other) => other.split("/").pop() === name).length > 1 ? file.split("/").slice(-2).join("/") : name;
};

function Slider({ label, unit, set, ...rest }: { label: string; min: number; max: number; step: number; value: number; set: (value: number) => void; unit: string }) {
  return <label className="slider-label">{label} <input type="range" {...rest} onChange={(event) => set(Number(event.target.value))} onDoubleClick={() => set(0)} /> <span className="soft n">{rest.value} {unit}</span></label>;
}

function Magnify() {
  const zoom = useLook((s) => s.zoom);
  return <span className="group"><button onClick={() => setLook({ zoom: Math.max(1, zoom / 1.5) })} aria-label="smaller">−</button><button onClick={() => setLook({ zoom: 1, x: 0.5, y: 0.5 })} title="fit">{Math.round(100 * zoom)} %</button><button onClick={() => setLook({ zoom: Math.min(40, zoom * 1.5) })} aria-label="larger">+</button></span>;
}
