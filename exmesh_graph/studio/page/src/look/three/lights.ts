// Lights by name, as the server keeps them; "recovered" is the model's own.
import type { Texture } from "three";
import { lightOf } from "viewer";
import { getBytes } from "../../api";

const known = new Map<string, Promise<Texture>>();

export async function lightNamed(name: string, own: Texture | null): Promise<Texture> {
  if (name === "recovered" && own) return own;
  const wanted = name === "recovered" ? "studio" : name;
  let light = known.get(wanted);
  if (!light) { known.set(wanted, (light = fetched(wanted))); light.catch(() => known.delete(wanted)); }
  return light;
}

async function fetched(name: string): Promise<Texture> {
  const { bytes } = await getBytes("/api/light", { name });
  const [width, height] = new Uint32Array(bytes.slice(0, 8).buffer);
  return lightOf({ width, height, data: new Uint16Array(bytes.slice(8, 8 + 8 * width * height).buffer) });
}
