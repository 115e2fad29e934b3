// The viewer: one glTF asset of this project under one of several lights. State may come in the address after '#',
// e.g. #light=studio&shown=normals&map=base_color&azimuth=40, which is how a picture of a state can be taken.
import * as THREE from "three";
import { OrbitControls } from "orbit";

const $ = (id) => document.getElementById(id);
const fail = (error) => { $("error").hidden = false; $("error").textContent = `Cannot show this asset: ${error.message || error}`; document.title = "error"; };
window.addEventListener("error", (event) => fail(event.error || event.message));
window.addEventListener("unhandledrejection", (event) => fail(event.reason));

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const data = JSON.parse($("data").textContent);
const asked = new URLSearchParams(location.hash.slice(1));

function readGlb(buffer) {
  const view = new DataView(buffer.buffer);
  const length = view.getUint32(12, true);
  const document = JSON.parse(new TextDecoder().decode(buffer.subarray(20, 20 + length)));
  return { document, binary: buffer.subarray(28 + length) };
}

function accessor({ document, binary }, number) {
  const entry = document.accessors[number], part = document.bufferViews[entry.bufferView];
  const size = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 }[entry.type];
  const own = binary.slice(part.byteOffset, part.byteOffset + part.byteLength).buffer;
  const array = entry.componentType === 5125 ? new Uint32Array(own) : new Float32Array(own);
  return new THREE.BufferAttribute(array, size);
}

async function textures(glb) {
  const found = {};
  for (const image of glb.document.images) {
    const part = glb.document.bufferViews[image.bufferView];
    const blob = new Blob([glb.binary.slice(part.byteOffset, part.byteOffset + part.byteLength)], { type: "image/png" });
    const picture = new Image();
    picture.src = URL.createObjectURL(blob);
    await picture.decode();
    const texture = new THREE.Texture(picture);
    texture.flipY = false; // glTF: v down
    texture.colorSpace = image.name === "base_color" ? THREE.SRGBColorSpace : THREE.NoColorSpace;
    texture.generateMipmaps = true;
    texture.minFilter = THREE.LinearMipmapLinearFilter;
    texture.anisotropy = 8;
    texture.needsUpdate = true;
    found[image.name] = texture;
  }
  return found;
}

function geometryOf(glb) {
  const primitive = glb.document.meshes[0].primitives[0], geometry = new THREE.BufferGeometry();
  const names = { POSITION: "position", NORMAL: "normal", TEXCOORD_0: "uv", TANGENT: "tangent" };
  for (const [name, number] of Object.entries(primitive.attributes)) geometry.setAttribute(names[name], accessor(glb, number));
  geometry.setIndex(accessor(glb, primitive.indices));
  return geometry;
}

function lightOf(entry) {
  const texture = new THREE.DataTexture(new Uint16Array(bytes(entry.data).buffer), entry.width, entry.height, THREE.RGBAFormat, THREE.HalfFloatType);
  texture.mapping = THREE.EquirectangularReflectionMapping;
  texture.minFilter = texture.magFilter = THREE.LinearFilter;
  texture.wrapS = THREE.RepeatWrapping;
  texture.needsUpdate = true;
  return texture;
}

// One channel of a packed map as gray, its value on the screen as it is stored: no light, no colour conversion.
function channelMaterial(texture, channel) {
  return new THREE.ShaderMaterial({
    uniforms: { map: { value: texture } },
    vertexShader: "varying vec2 place; void main() { place = uv; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }",
    fragmentShader: `uniform sampler2D map; varying vec2 place; void main() { gl_FragColor = vec4(vec3(texture2D(map, place).${channel}), 1.0); }`,
  });
}

async function main() {
  const glb = readGlb(bytes(data.glb)), maps = await textures(glb), geometry = geometryOf(glb);
  const renderer = new THREE.WebGLRenderer({ canvas: $("view"), antialias: true, preserveDrawingBuffer: true });
  renderer.toneMapping = THREE.LinearToneMapping; // exposure only: what is above 1 is cut off, as in the report's pictures
  const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
  const pbr = glb.document.materials[0].pbrMetallicRoughness;
  const materials = {
    shaded: new THREE.MeshStandardMaterial({ map: maps.base_color, roughnessMap: maps.orm, metalnessMap: maps.orm, metalness: pbr.metallicFactor, roughness: 1, normalMap: maps.normal || null }),
    base_color: new THREE.MeshBasicMaterial({ map: maps.base_color }),
    roughness: channelMaterial(maps.orm, "g"),
    metallic: channelMaterial(maps.orm, "b"),
    normals: new THREE.MeshNormalMaterial({ normalMap: maps.normal || null }),
    wireframe: new THREE.MeshBasicMaterial({ wireframe: true, color: 0x9fd0ff }),
  };
  geometry.computeBoundingSphere();
  const { center, radius } = geometry.boundingSphere, mesh = new THREE.Mesh(geometry, materials.shaded);
  scene.add(mesh);
  const azimuth = THREE.MathUtils.degToRad(Number(asked.get("azimuth") ?? 30)), distance = (1.15 * radius) / Math.sin(THREE.MathUtils.degToRad(17.5));
  camera.position.set(Math.sin(azimuth) * 0.94, 0.34, Math.cos(azimuth) * 0.94).multiplyScalar(distance).add(center);
  camera.near = distance / 100;
  camera.far = distance * 20;
  const controls = new OrbitControls(camera, renderer.domElement);
  controls.target.copy(center);
  controls.enableDamping = true;
  controls.autoRotateSpeed = 4;

  const lights = Object.fromEntries(data.lights.map((entry) => [entry.name, lightOf(entry)]));
  for (const entry of data.lights) $("light").add(new Option(entry.name, entry.name));
  for (const name of Object.keys(maps)) $("map").add(new Option({ base_color: "base colour", orm: "roughness and metal", normal: "normal" }[name], name));
  if (!pbr.metallicFactor) $("shown").querySelector("[value=metallic]").disabled = true;
  $("title").textContent = data.title;
  $("facts").textContent = `${data.faces.toLocaleString("en")} faces, maps ${data.maps[1]} × ${data.maps[0]}`;
  for (const id of ["light", "shown", "map", "turn", "exposure"]) if (asked.has(id)) $(id).value = asked.get(id);
  for (const id of ["behind", "turntable"]) if (asked.has(id)) $(id).checked = asked.get(id) === "1";

  const apply = () => {
    const light = lights[$("light").value], angle = THREE.MathUtils.degToRad(Number($("turn").value));
    scene.environment = light;
    scene.background = $("behind").checked ? light : new THREE.Color(0x222222);
    scene.environmentRotation.set(0, angle, 0);
    scene.backgroundRotation.set(0, angle, 0);
    renderer.toneMappingExposure = 2 ** Number($("exposure").value);
    mesh.material = materials[$("shown").value];
    for (const material of Object.values(materials)) material.toneMapped = material === materials.shaded;
    controls.autoRotate = $("turntable").checked;
    const map = maps[$("map").value];
    $("figure").hidden = !map;
    if (map) { $("picture").src = map.image.src; $("caption").textContent = `${map.image.width} × ${map.image.height}, row 0 is v = 1`; }
  };
  $("controls").addEventListener("input", apply);
  $("controls").addEventListener("submit", (event) => event.preventDefault());
  apply();
  const resize = () => {
    renderer.setPixelRatio(window.devicePixelRatio);
    renderer.setSize(window.innerWidth, window.innerHeight, false);
    camera.aspect = window.innerWidth / window.innerHeight;
    camera.updateProjectionMatrix();
  };
  window.addEventListener("resize", resize);
  resize();
  let frames = 0;
  renderer.setAnimationLoop(() => {
    controls.update();
    renderer.render(scene, camera);
    if (++frames === 2) document.documentElement.dataset.state = "shown";
  });
}

main().catch(fail);
