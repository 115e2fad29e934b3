// Ways to show a mesh beside those of the viewer: UV coordinates as colours, a checker over them.
import { Color, MeshBasicMaterial, ShaderMaterial } from "three";
import type { Model } from "viewer";

const VERTEX = "varying vec2 place; varying vec3 way; void main() { place = uv; way = normalMatrix * normal; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }";
const LIT = "float lit = 0.55 + 0.45 * abs(normalize(way).z);";

const over = (fragment: string, uniforms = {}) => new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: `varying vec2 place; varying vec3 way; ${fragment}`, uniforms });

export function withExtraMaterials(model: Model): Model {
  const { geometry, materials } = model;
  if (geometry.getAttribute("uv")) {
    materials.uv = over(`void main() { ${LIT} gl_FragColor = vec4(lit * vec3(fract(place), 0.35), 1.0); }`);
    materials.checker = over(`void main() { ${LIT} vec2 cell = floor(place * 32.0); float odd = mod(cell.x + cell.y, 2.0); gl_FragColor = vec4(lit * mix(vec3(0.16, 0.25, 0.32), vec3(0.93, 0.9, 0.82), odd), 1.0); }`);
  }
  if (geometry.getAttribute("color")) materials.colors = new MeshBasicMaterial({ vertexColors: true });
  const wires = materials.wireframe as MeshBasicMaterial | undefined;
  if (wires?.color) wires.color = new Color(0x7fc4ff);
  return model;
}
