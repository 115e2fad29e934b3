// One artifact, or two side by side or under a line that is dragged, with one camera and one magnification.
import { useEffect, useRef, useState } from "react";
import { artifactOf } from "../state/actions";
import { set, useStudio, type Looked } from "../state/store";
import { bytes } from "../text";
import { alike, beside } from "../panels/Results";
import type { Artifact, Show } from "../types";
import { setLook, useLook } from "./options";
import { LookTools } from "./LookTools";
import { ShowView } from "./ShowView";

function useArtifact(looked: Looked | null): { artifact: Artifact | null; failed: string } {
  const [artifact, setArtifact] = useState<Artifact | null>(null), [failed, setFailed] = useState("");
  const digest = looked?.digest;
  useEffect(() => {
    setFailed("");
    if (!digest) { setArtifact(null); return; }
    let gone = false;
    artifactOf(digest).then((found) => { if (!gone) setArtifact(found); }).catch((error: Error) => { if (!gone) { setArtifact(null); setFailed(error.message); } });
    return () => { gone = true; };
  }, [digest]);
  return { artifact: artifact?.digest === digest ? artifact ?? null : null, failed };
}

// The same kind of thing in the other artifact, where it has one.
const partner = (artifact: Artifact | null, show: Show | null): Show | null =>
  artifact?.shows.find((other) => other.id === show?.id) ?? artifact?.shows.find((other) => other.kind === show?.kind) ?? artifact?.shows[0] ?? null;

// Decisions tell more than the figures beside them.
const first = ({ shows }: Artifact): Show | null => (shows[0]?.kind === "figures" ? shows.find((show) => show.kind === "table") : undefined) ?? shows[0] ?? null;

export function Look() {
  const [one, two] = useStudio((s) => s.looked), before = useStudio((s) => s.before), mode = useLook((s) => s.mode), wanted = useLook((s) => s.show), cut = useLook((s) => s.cut);
  const a = useArtifact(one), b = useArtifact(two);
  const show = a.artifact ? a.artifact.shows.find((other) => other.id === wanted) ?? first(a.artifact) : null;
  const other = partner(b.artifact, show);
  const area = useRef<HTMLDivElement>(null);
  if (!one) return <div className="look empty"><p>Select a node, then <b>Look</b> at what it made. A second result can be put beside it.</p></div>;
  const wipe = two !== null && mode === "wipe";
  const drag = (event: React.PointerEvent) => {
    const rect = area.current!.getBoundingClientRect();
    setLook({ cut: Math.min(0.98, Math.max(0.02, (event.clientX - rect.left) / rect.width)) });
  };
  return (
    <div className="look">
      <div className="look-head">
        <Title looked={one} artifact={a.artifact} side="A" close={() => set((s) => ({ looked: [s.looked[1], null] }))} />
        {two && <Title looked={two} artifact={b.artifact} side="B" close={() => set((s) => ({ looked: [s.looked[0], null] }))} />}
        {two && <span className="group">
          <button aria-pressed={mode === "beside"} onClick={() => setLook({ mode: "beside" })}>Side by side</button>
          <button aria-pressed={mode === "wipe"} onClick={() => setLook({ mode: "wipe" })}>Wipe</button>
          <button title="swap the sides" aria-label="swap the sides" onClick={() => set((s) => ({ looked: [s.looked[1], s.looked[0]] }))}>⇄</button></span>}
        {!two && before && before.digest !== one.digest && alike(before.type, one.type) && <button onClick={() => beside(before, one)} title="Both with one camera, side by side or under a wipe">⇆ Beside {before.label}</button>}
        {a.artifact && a.artifact.shows.length > 1 && <span className="group shows" role="tablist" aria-label="what is shown">{a.artifact.shows.map((each) => <button role="tab" key={each.id} aria-selected={each.id === show?.id} onClick={() => setLook({ show: each.id, single: false })}>{each.title || each.kind}</button>)}</span>}
        {show && a.artifact && <LookTools show={show} />}
      </div>
      <div className={`look-area${two ? (wipe ? " wipe" : " beside") : ""}`} ref={area}>
        <div className="side">{a.artifact && show ? <ShowView key={`${a.artifact.digest}${show.id}`} artifact={a.artifact} show={show} /> : <Waiting failed={a.failed} />}</div>
        {two && <div className="side" style={wipe ? { clipPath: `inset(0 0 0 ${100 * cut}%)` } : undefined}>
          {b.artifact && other ? <ShowView key={`${b.artifact.digest}${other.id}b`} artifact={b.artifact} show={other} /> : <Waiting failed={b.failed} />}</div>}
        {wipe && <div className="cut" style={{ left: `${100 * cut}%` }} role="slider" tabIndex={0} aria-label="line between A and B" aria-valuenow={Math.round(100 * cut)} aria-valuemin={2} aria-valuemax={98}
          onPointerDown={(event) => event.currentTarget.setPointerCapture(event.pointerId)} onPointerMove={(event) => { if (event.buttons) drag(event); }}
          onKeyDown={(event) => { if (event.key === "ArrowLeft") setLook({ cut: Math.max(0.02, cut - 0.02) }); if (event.key === "ArrowRight") setLook({ cut: Math.min(0.98, cut + 0.02) }); }}><i /></div>}
      </div>
    </div>
  );
}

const Waiting = ({ failed }: { failed: string }) => <div className="look empty"><p>{failed ? `⚠ ${failed}` : "…"}</p></div>;

function Title({ looked, artifact, side, close }: { looked: Looked; artifact: Artifact | null; side: string; close: () => void }) {
  const two = useStudio((s) => s.looked[1] !== null);
  return (
    <span className={`look-title side-${side}`} title={artifact ? `${artifact.type}, ${bytes(artifact.bytes)}\n${looked.digest}` : ""}>
      {two && <b className="badge">{side}</b>} <b>{looked.label}</b> <span className="soft">{artifact?.title.replace(/^\w+: /, "")}</span>
      <button className="quiet" onClick={close} aria-label={`close ${side}`}>✕</button>
    </span>
  );
}
