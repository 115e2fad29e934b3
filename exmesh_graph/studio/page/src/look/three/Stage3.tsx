// One canvas with one model on it, by the viewer of `exmesh view`. A small level is there at once, the whole one follows.
import { useEffect, useRef, useState } from "react";
import { Viewer, readModel, type Model } from "viewer";
import { getBytes } from "../../api";
import type { Show } from "../../types";
import { useKinds } from "../kinds";
import { useLook } from "../options";
import { join } from "./cameras";
import { camerasOf, pointsOf, type Extra } from "./extras";
import { lightNamed } from "./lights";
import { withExtraMaterials } from "./materials";

interface Loaded { model: Model; extra?: Extra }

async function load(digest: string, show: Show, level: number, source: string, signal: AbortSignal): Promise<{ loaded: Loaded; levels: number }> {
  if (show.kind === "points") return { loaded: await pointsOf(digest, level, signal), levels: show.levels ?? 1 };
  if (show.kind === "cameras") return { loaded: await camerasOf(digest, signal), levels: 1 };
  const { bytes, headers } = await getBytes(source || "/api/artifact/model", source ? {} : { digest, show: show.id, level }, signal);
  const model = withExtraMaterials(await readModel(bytes));
  return { loaded: { model }, levels: source ? 1 : Number(headers.get("X-Levels") ?? show.levels ?? 1) };
}

export default function Stage3({ digest, show, source = "" }: { digest: string; show: Show; source?: string }) {
  const canvas = useRef<HTMLCanvasElement>(null), viewer = useRef<Viewer | null>(null), extra = useRef<Extra | null>(null);
  const [loaded, setLoaded] = useState<Loaded | null>(null), [failed, setFailed] = useState(""), [more, setMore] = useState(false);
  const look = useLook();

  useEffect(() => { // first, so that the server works while WebGL begins
    const stop = new AbortController();
    setFailed("");
    void (async () => {
      try {
        const first = await load(digest, show, 0, source, stop.signal);
        if (stop.signal.aborted) return;
        setLoaded(first.loaded);
        if (first.levels > 1 && look.full) {
          setMore(true);
          const whole = await load(digest, show, first.levels - 1, source, stop.signal);
          if (!stop.signal.aborted) setLoaded(whole.loaded);
        }
      } catch (error) { if (!stop.signal.aborted) setFailed(error instanceof Error ? error.message : String(error)); } finally { if (!stop.signal.aborted) setMore(false); }
    })();
    return () => stop.abort();
  }, [digest, show.id, show.kind, source, look.full]); // eslint-disable-line

  useEffect(() => {
    const element = canvas.current!;
    let made: Viewer;
    try { made = new Viewer(element, { azimuth: 30 }); } catch { setFailed("This browser has no WebGL 2: models cannot be shown."); return; }
    viewer.current = made;
    const leave = join(made), holder = element.parentElement!;
    const fit = () => { if (holder.clientWidth && holder.clientHeight) made.resize(holder.clientWidth, holder.clientHeight); };
    const watch = new ResizeObserver(fit);
    watch.observe(holder);
    fit();
    made.run();
    return () => { watch.disconnect(); leave(); made.renderer.setAnimationLoop(null); made.controls.dispose(); made.renderer.dispose(); made.renderer.forceContextLoss(); viewer.current = null; };
  }, []);

  useEffect(() => {
    if (!loaded) return;
    const { model } = loaded, indexed = model.geometry.index, faces = indexed ? indexed.count / 3 : 0;
    useKinds.setState({ kinds: loaded.extra ? [] : Object.keys(model.materials), levels: show.levels ?? 1, faces, whole: show.faces ?? faces });
  }, [loaded, show]);

  useEffect(() => {
    const made = viewer.current;
    if (!made || !loaded) return;
    let gone = false;
    void lightNamed(look.light, loaded.model.light).then((light) => {
      if (gone || viewer.current !== made) return;
      if (extra.current) made.scene.remove(extra.current.object);
      extra.current = loaded.extra ?? null;
      if (loaded.extra) made.scene.add(loaded.extra.object);
      made.plain.set(getComputedStyle(canvas.current!).getPropertyValue("--stage").trim() || "#222222");
      made.show(loaded.model, { light, shown: look.shown, turn: look.turn, exposure: look.exposure, behind: look.behind && look.shown === "shaded", turntable: look.turntable });
      made.mesh.visible = !loaded.extra;
      requestAnimationFrame(() => requestAnimationFrame(() => { if (canvas.current) canvas.current.dataset.drawn = "1"; }));
      canvas.current!.dataset.faces = String(loaded.model.geometry.index ? loaded.model.geometry.index.count / 3 : 0);
    }).catch((error: Error) => setFailed(error.message));
    return () => { gone = true; };
  }, [loaded, look.light, look.shown, look.turn, look.exposure, look.behind, look.turntable]);

  return (
    <div className="stage">
      <canvas ref={canvas} aria-label={show.title} tabIndex={0} />
      {!loaded && !failed && <p className="over soft">…</p>}
      {more && <p className="over soft">the whole one is on its way…</p>}
      {failed && <p className="over">⚠ {failed}</p>}
    </div>
  );
}
