// One model on a canvas, under one of several lights: shared by `exmesh view`, run reports and sweep pages. Models are
// the .glb files that this project writes, plain or quantised (export/gltf.py, export/gltf_compact.py).
import * as THREE from "three";
import { OrbitControls } from "orbit";

const KINDS = { 5120: [Int8Array, 127], 5123: [Uint16Array, 65535], 5125: [Uint32Array, 1], 5126: [Float32Array, 1] };
const COLUMNS = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };
const ATTRIBUTES = { POSITION: "position", NORMAL: "normal", TEXCOORD_0: "uv", TANGENT: "tangent", COLOR_0: "color" };

function readGlb(buffer) {
  const view = new DataView(buffer.buffer, buffer.byteOffset);
  if (view.getUint32(0, true) !== 0x46546c67) throw new Error("not a binary glTF file");
  const length = view.getUint32(12, true);
  const document = JSON.parse(new TextDecoder().decode(buffer.subarray(20, 20 + length)));
  return { document, binary: buffer.subarray(28 + length) };
}

function part({ document, binary }, number) {
  const { byteOffset, byteLength } = document.bufferViews[number];
  return binary.slice(byteOffset, byteOffset + byteLength);
}

// A tight array: as it is stored, or as floats where codes stand for them.
function accessor(glb, number) {
  const entry = glb.document.accessors[number], [Kind, top] = KINDS[entry.componentType], columns = COLUMNS[entry.type];
  const stored = new Kind(part(glb, entry.bufferView).buffer);
  if (!entry.normalized) return new THREE.BufferAttribute(stored, columns);
  const stride = glb.document.bufferViews[entry.bufferView].byteStride / Kind.BYTES_PER_ELEMENT;
  const values = new Float32Array(entry.count * columns);
  for (let k = 0; k < entry.count; k++) for (let c = 0; c < columns; c++) values[k * columns + c] = stored[k * stride + c] / top;
  return new THREE.BufferAttribute(values, columns);
}

function geometryOf(glb) {
  const primitive = glb.document.meshes[0].primitives[0], geometry = new THREE.BufferGeometry();
  for (const [name, number] of Object.entries(primitive.attributes)) geometry.setAttribute(ATTRIBUTES[name], accessor(glb, number));
  geometry.setIndex(accessor(glb, primitive.indices));
  const { translation = [0, 0, 0], scale = [1, 1, 1] } = glb.document.nodes[0];
  geometry.scale(...scale).translate(...translation);
  geometry.computeBoundingSphere();
  return geometry;
}

// What each picture of the file is for, as its material uses it.
function roles({ document }) {
  const entry = document.materials?.[0] ?? {}, surface = entry.pbrMetallicRoughness ?? {};
  const used = { base_color: surface.baseColorTexture, orm: surface.metallicRoughnessTexture, normal: entry.normalTexture };
  return Object.entries(used).filter(([, slot]) => slot).map(([name, { index }]) => {
    const { source, extensions } = document.textures[index];
    return [name, document.images[source ?? extensions.EXT_texture_webp.source]];
  });
}

async function textures(glb) {
  const found = {};
  for (const [name, image] of roles(glb)) {
    const picture = new Image();
    picture.src = URL.createObjectURL(new Blob([part(glb, image.bufferView)], { type: image.mimeType }));
    await picture.decode();
    const texture = new THREE.Texture(picture);
    texture.flipY = false; // glTF: v down
    texture.colorSpace = name === "base_color" ? THREE.SRGBColorSpace : THREE.NoColorSpace;
    texture.generateMipmaps = true;
    texture.minFilter = THREE.LinearMipmapLinearFilter;
    texture.anisotropy = 8;
    texture.needsUpdate = true;
    found[name] = texture;
  }
  return found;
}

// One channel of a packed map as gray, its value on the screen as it is stored: no light, no colour conversion.
function channelMaterial(texture, channel) {
  return new THREE.ShaderMaterial({
    uniforms: { map: { value: texture } },
    vertexShader: "varying vec2 place; void main() { place = uv; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }",
    fragmentShader: `uniform sampler2D map; varying vec2 place; void main() { gl_FragColor = vec4(vec3(texture2D(map, place).${channel}), 1.0); }`,
  });
}

// What of the model can be shown, by name; an unlit one holds appearance, not material; one without pictures is gray.
function materialsOf(glb, maps) {
  const entry = glb.document.materials?.[0] ?? {}, metalness = entry.pbrMetallicRoughness?.metallicFactor ?? 1;
  const flat = new THREE.MeshBasicMaterial({ map: maps.base_color });
  const bare = {
    normals: new THREE.MeshNormalMaterial({ normalMap: maps.normal || null }),
    wireframe: new THREE.MeshBasicMaterial({ wireframe: true, color: 0x9fd0ff, transparent: true, opacity: 0.55 }),
  };
  if (!maps.base_color) return { shaded: new THREE.MeshStandardMaterial({ color: 0xb9bcc0, roughness: 0.85, metalness: 0, side: THREE.DoubleSide }), ...bare };
  if (entry.extensions?.KHR_materials_unlit) return { texture: flat, ...bare };
  return {
    shaded: new THREE.MeshStandardMaterial({ map: maps.base_color, roughnessMap: maps.orm, metalnessMap: maps.orm, metalness, roughness: 1, normalMap: maps.normal || null }),
    base_color: flat,
    roughness: channelMaterial(maps.orm, "g"),
    ...(metalness ? { metallic: channelMaterial(maps.orm, "b") } : {}),
    ...bare,
  };
}

// Each texel, of four values, as two by two of them.
function doubled(data, width, height) {
  const large = new data.constructor(4 * data.length);
  for (let row = 0; row < 2 * height; row++)
    for (let column = 0; column < 2 * width; column++) {
      const from = 4 * ((row >> 1) * width + (column >> 1));
      large.set(data.subarray(from, from + 4), 4 * (2 * row * width + column));
    }
  return large;
}

// {width, height, data: RGBA halves as Uint16Array}: centre at +X, the lowest row first.
export function lightOf({ width, height, data }) {
  for (; width < 64; width *= 2, height *= 2) data = doubled(data, width, height); // three.js makes no light of fewer columns
  const texture = new THREE.DataTexture(data, width, height, THREE.RGBAFormat, THREE.HalfFloatType);
  texture.mapping = THREE.EquirectangularReflectionMapping;
  texture.minFilter = texture.magFilter = THREE.LinearFilter;
  texture.wrapS = THREE.RepeatWrapping;
  texture.needsUpdate = true;
  return texture;
}

// bytes of a .glb -> {geometry, maps, materials, light (its own, or null), eye (where to look from, or undefined)}
export async function readModel(bytes) {
  const glb = readGlb(bytes), maps = await textures(glb), geometry = geometryOf(glb);
  const { light: own, eye } = glb.document.scenes[0].extras ?? {};
  const light = own ? lightOf({ ...own, data: new Uint16Array(part(glb, own.bufferView).buffer) }) : null;
  return { geometry, maps, materials: materialsOf(glb, maps), light, eye };
}

export class Viewer {
  // Throws where the browser has no WebGL 2. `azimuth` in degrees from +Z towards +X.
  constructor(canvas, { azimuth = 30, background = 0x222222 } = {}) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.toneMapping = THREE.LinearToneMapping; // exposure only: what is above 1 is cut off, as in the report's pictures
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
    this.mesh = new THREE.Mesh();
    this.solid = new THREE.Mesh(undefined, new THREE.MeshBasicMaterial({ color: 0x11161a, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 }));
    this.scene.add(this.mesh, this.solid);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.controls.autoRotateSpeed = 4;
    this.controls.addEventListener("change", () => { this.stale = true; });
    this.plain = new THREE.Color(background);
    this.azimuth = THREE.MathUtils.degToRad(azimuth);
    this.stale = true;
  }

  // The first model also places the camera.
  show(model, { light = null, shown: wanted, turn = 0, exposure = 0, behind = false, turntable = false }) {
    const shown = wanted in model.materials ? wanted : Object.keys(model.materials)[0];
    const angle = THREE.MathUtils.degToRad(turn), material = model.materials[shown];
    if (!this.model) this.#look(model);
    this.model = model;
    this.mesh.geometry = this.solid.geometry = model.geometry;
    this.solid.visible = shown === "wireframe"; // hides the wires behind
    this.mesh.material = material;
    material.toneMapped = shown === "shaded";
    this.scene.environment = light;
    this.scene.background = behind && light ? light : this.plain;
    this.scene.environmentRotation.set(0, angle, 0);
    this.scene.backgroundRotation.set(0, angle, 0);
    this.renderer.toneMappingExposure = 2 ** exposure;
    this.controls.autoRotate = turntable;
    this.stale = true;
  }

  #look({ geometry, eye }) {
    const { center, radius } = geometry.boundingSphere, distance = (1.15 * radius) / Math.sin(THREE.MathUtils.degToRad(17.5));
    const toward = eye ? new THREE.Vector3(...eye).normalize() : new THREE.Vector3(Math.sin(this.azimuth) * 0.94, 0.34, Math.cos(this.azimuth) * 0.94);
    this.camera.position.copy(toward).multiplyScalar(distance).add(center);
    this.camera.near = distance / 100;
    this.camera.far = distance * 20;
    this.controls.target.copy(center);
  }

  resize(width, height) {
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.stale = true;
  }

  // Draws when something changed; `drawn` is called after the second picture.
  run(drawn) {
    let frames = 0;
    this.renderer.setAnimationLoop(() => {
      this.controls.update();
      if (!this.stale && frames >= 2) return;
      this.stale = false;
      this.renderer.render(this.scene, this.camera);
      if (++frames === 2) drawn?.();
    });
  }
}
