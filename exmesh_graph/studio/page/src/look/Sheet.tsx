// Views as a contact sheet; one by one with all their layers.
import { useEffect } from "react";
import { address } from "../api";
import type { Show } from "../types";
import { setLook, useLook } from "./options";
import { Picture } from "./Picture";

export function Sheet({ digest, show }: { digest: string; show: Show }) {
  const { single, index, layer: wanted } = useLook(), layer = show.layers?.includes(wanted) ? wanted : show.layers?.[0] ?? "image";
  const at = Math.min(index, (show.count ?? 1) - 1);
  useEffect(() => {
    if (!single) return;
    const key = (event: KeyboardEvent) => {
      if ((event.target as HTMLElement).closest("input, select, textarea, .canvas")) return;
      if (event.key === "ArrowRight") setLook({ index: (at + 1) % (show.count ?? 1) });
      if (event.key === "ArrowLeft") setLook({ index: (at - 1 + (show.count ?? 1)) % (show.count ?? 1) });
    };
    window.addEventListener("keydown", key);
    return () => window.removeEventListener("keydown", key);
  }, [single, at, show.count]);
  const source = (k: number, size: number) => address("/api/artifact/picture", { digest, show: show.id, index: k, layer, size });
  if (single) return <Picture source={source(at, 0)} quick={source(at, 256)} title={show.names?.[at] ?? String(at)} />;
  return (
    <div className="sheet">
      {Array.from({ length: show.count ?? 0 }, (_, k) => (
        <button key={k} onClick={() => setLook({ single: true, index: k })} title={show.names?.[k]} className={k === at ? "chosen" : ""}>
          <img src={source(k, 160)} alt={show.names?.[k] ?? `view ${k}`} loading="lazy" width={show.width} height={show.height} /><span>{show.names?.[k] ?? k}</span>
        </button>
      ))}
    </div>
  );
}
