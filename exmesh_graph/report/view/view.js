// The page of `exmesh view`: one glTF asset of this project under one of several lights. State may come in the address
// after '#', e.g. #light=studio&shown=normals&map=base_color&azimuth=40, which is how a picture of a state can be taken.
import { Viewer, lightOf, readModel } from "viewer";

const $ = (id) => document.getElementById(id);
const fail = (error) => { $("error").hidden = false; $("error").textContent = `Cannot show this asset: ${error.message || error}`; document.title = "error"; };
window.addEventListener("error", (event) => fail(event.error || event.message));
window.addEventListener("unhandledrejection", (event) => fail(event.reason));

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const data = JSON.parse($("data").textContent);
const asked = new URLSearchParams(location.hash.slice(1));

async function main() {
  const model = await readModel(bytes(data.glb));
  const viewer = new Viewer($("view"), { azimuth: Number(asked.get("azimuth") ?? 30) });
  const lights = Object.fromEntries(data.lights.map((entry) => [entry.name, lightOf({ ...entry, data: new Uint16Array(bytes(entry.data).buffer) })]));
  for (const entry of data.lights) $("light").add(new Option(entry.name, entry.name));
  for (const name of Object.keys(model.maps)) $("map").add(new Option({ base_color: "base colour", orm: "roughness and metal", normal: "normal" }[name], name));
  for (const option of $("shown").options) option.disabled = !model.materials[option.value];
  $("title").textContent = data.title;
  $("facts").textContent = `${data.faces.toLocaleString("en")} faces, maps ${data.maps[1]} × ${data.maps[0]}`;
  for (const id of ["light", "shown", "map", "turn", "exposure"]) if (asked.has(id)) $(id).value = asked.get(id);
  for (const id of ["behind", "turntable"]) if (asked.has(id)) $(id).checked = asked.get(id) === "1";

  const apply = () => {
    viewer.show(model, { light: lights[$("light").value], shown: $("shown").value, turn: Number($("turn").value),
      exposure: Number($("exposure").value), behind: $("behind").checked, turntable: $("turntable").checked });
    const map = model.maps[$("map").value];
    $("figure").hidden = !map;
    if (map) { $("picture").src = map.image.src; $("caption").textContent = `${map.image.width} × ${map.image.height}, row 0 is v = 1`; }
  };
  $("controls").addEventListener("input", apply);
  $("controls").addEventListener("submit", (event) => event.preventDefault());
  apply();
  const resize = () => viewer.resize(window.innerWidth, window.innerHeight);
  window.addEventListener("resize", resize);
  resize();
  viewer.run(() => { document.documentElement.dataset.state = "shown"; });
}

main().catch(fail);
