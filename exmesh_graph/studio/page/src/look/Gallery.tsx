// A gallery: its pictures with their captions, one of them large; its models turn.
import { useState } from "react";
import { address } from "../api";
import type { GalleryItem } from "../types";
import { Picture } from "./Picture";
import { Stage } from "./Stage";

export function Gallery({ digest, items }: { digest: string; items: GalleryItem[] }) {
  const [chosen, choose] = useState<number | null>(null), item = chosen === null ? null : items[chosen];
  const source = (file: string) => address("/api/artifact/gallery", { digest, file });
  if (item) return (
    <div className="gallery-one">
      <div className="tools"><button onClick={() => choose(null)}>▦ All</button><button onClick={() => choose((chosen! - 1 + items.length) % items.length)} aria-label="previous">‹</button><button onClick={() => choose((chosen! + 1) % items.length)} aria-label="next">›</button><b>{item.title}</b> <span className="soft">{item.caption}</span></div>
      {item.model ? <Stage digest={digest} show={{ kind: "model", id: item.file, title: item.title }} source={source(item.file)} /> : <Picture source={source(item.file)} title={item.title} />}
    </div>
  );
  return (
    <div className="gallery">
      {items.map((each, k) => (
        <button key={each.file} onClick={() => choose(k)}>
          {each.model ? <span className="model-sign">⟳ model</span> : <img src={source(each.file)} alt={each.title} loading="lazy" />}
          <b>{each.title}</b><span className="soft">{each.caption}</span>
        </button>
      ))}
    </div>
  );
}
