// A picture that is magnified by the wheel and moved by dragging; a small one is there at once, the full one follows.
import { useEffect, useRef, useState } from "react";
import { setLook, useLook } from "./options";

export function Picture({ source, quick = "", title }: { source: string; quick?: string; title: string }) {
  const { x, y, zoom } = useLook(), holder = useRef<HTMLDivElement>(null), [shape, setShape] = useState<[number, number]>([0, 0]), [full, setFull] = useState(""), [failed, setFailed] = useState(false);
  const [area, setArea] = useState<[number, number]>([1, 1]);
  useEffect(() => { setFailed(false); const image = new Image(); image.onload = () => setFull(source); image.onerror = () => setFailed(true); image.src = source; return () => { image.onload = image.onerror = null; }; }, [source]);
  useEffect(() => {
    const element = holder.current!, watch = new ResizeObserver(() => setArea([element.clientWidth, element.clientHeight]));
    watch.observe(element);
    const wheel = (event: WheelEvent) => {
      event.preventDefault();
      const now = useLook.getState(), next = Math.min(60, Math.max(1, now.zoom * Math.exp(-event.deltaY / 400)));
      const rect = element.getBoundingClientRect(), side = fit([rect.width, rect.height], shapeNow.current, 1);
      const dx = (event.clientX - rect.left - rect.width / 2) / side[0], dy = (event.clientY - rect.top - rect.height / 2) / side[1];
      setLook({ zoom: next, x: clamp(now.x + dx * (1 / now.zoom - 1 / next)), y: clamp(now.y + dy * (1 / now.zoom - 1 / next)) });
    };
    element.addEventListener("wheel", wheel, { passive: false });
    return () => { watch.disconnect(); element.removeEventListener("wheel", wheel); };
  }, []);
  const shapeNow = useRef(shape);
  shapeNow.current = shape;
  const [width, height] = fit(area, shape, zoom);
  const move = (event: React.PointerEvent) => { if (event.buttons) setLook({ x: clamp(x - event.movementX / width), y: clamp(y - event.movementY / height) }); };
  const address = full === source ? source : quick || source;
  return (
    <div className="picture" ref={holder} onPointerDown={(event) => event.currentTarget.setPointerCapture(event.pointerId)} onPointerMove={move} onDoubleClick={() => setLook({ zoom: 1, x: 0.5, y: 0.5 })}>
      <img src={address} alt={title} draggable={false} onLoad={(event) => setShape([event.currentTarget.naturalWidth, event.currentTarget.naturalHeight])}
        className={width > 3 * shape[0] ? "pixels" : ""} style={{ width, height, left: area[0] / 2 - x * width, top: area[1] / 2 - y * height }} />
      {failed && <p className="over">⚠ This picture could not be made.</p>}
    </div>
  );
}

const clamp = (value: number) => Math.min(1, Math.max(0, value));
function fit(area: [number, number], shape: [number, number], zoom: number): [number, number] {
  if (!shape[0] || !shape[1]) return [1, 1];
  const scale = Math.min(area[0] / shape[0], area[1] / shape[1]) * zoom;
  return [shape[0] * scale, shape[1] * scale];
}
