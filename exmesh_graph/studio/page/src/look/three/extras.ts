// What is no mesh: Gaussians as points, cameras as small pyramids.
import { BufferAttribute, BufferGeometry, LineBasicMaterial, LineSegments, MeshBasicMaterial, Object3D, Points, ShaderMaterial, Sphere, Vector3 } from "three";
import type { Model } from "viewer";
import { get, getBytes } from "../../api";

export interface Extra { object: Object3D }

const empty = (center: Vector3, radius: number): Model => {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(0), 3));
  geometry.boundingSphere = new Sphere(center, radius || 1);
  return { geometry, maps: {}, materials: { points: new MeshBasicMaterial() }, light: null };
};

// Discs of the Gaussians' mean extent, in their own colour and opacity.
export async function pointsOf(digest: string, level: number, signal: AbortSignal): Promise<{ model: Model; extra: Extra }> {
  const { bytes } = await getBytes("/api/artifact/points", { digest, level }, signal);
  const [count, columns] = new Uint32Array(bytes.slice(0, 8).buffer), rows = new Float32Array(bytes.slice(8).buffer);
  const place = new Float32Array(3 * count), colour = new Float32Array(3 * count), size = new Float32Array(count), opacity = new Float32Array(count).fill(1);
  for (let k = 0; k < count; k++) {
    place.set(rows.subarray(columns * k, columns * k + 3), 3 * k);
    colour.set(rows.subarray(columns * k + 3, columns * k + 6), 3 * k);
    if (columns >= 9) { size[k] = 0.5 * (rows[columns * k + 6] + rows[columns * k + 7]); opacity[k] = rows[columns * k + 8]; }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(place, 3));
  geometry.setAttribute("color", new BufferAttribute(colour, 3));
  geometry.setAttribute("extent", new BufferAttribute(size, 1));
  geometry.setAttribute("opacity", new BufferAttribute(opacity, 1));
  geometry.computeBoundingSphere();
  const material = new ShaderMaterial({
    transparent: true,
    vertexShader: `attribute vec3 color; attribute float extent; attribute float opacity; varying vec4 tint;
      void main() { tint = vec4(color, opacity); vec4 eye = modelViewMatrix * vec4(position, 1.0); gl_Position = projectionMatrix * eye;
      gl_PointSize = clamp(extent > 0.0 ? 1400.0 * extent / -eye.z : 3.0, 1.5, 60.0); }`,
    fragmentShader: `varying vec4 tint; void main() { float r = 2.0 * length(gl_PointCoord - 0.5); if (r > 1.0 || tint.a < 0.02) discard; gl_FragColor = vec4(tint.rgb, tint.a * exp(-2.0 * r * r)); }`,
  });
  const sphere = geometry.boundingSphere!;
  return { model: empty(sphere.center.clone(), sphere.radius), extra: { object: new Points(geometry, material) } };
}

interface Told { name: string; camera_to_world: number[]; intrinsics: number[]; width: number; height: number }

export async function camerasOf(digest: string, signal: AbortSignal): Promise<{ model: Model; extra: Extra }> {
  const { cameras, center, radius } = await get<{ cameras: Told[]; center: [number, number, number]; radius: number }>("/api/artifact/cameras", { digest }, signal);
  const eyes = cameras.map((camera) => new Vector3(camera.camera_to_world[3], camera.camera_to_world[7], camera.camera_to_world[11])), middle = new Vector3(...center);
  const reach = Math.max(radius, ...eyes.map((eye) => eye.distanceTo(middle))), size = 0.09 * reach, lines: number[] = [];
  cameras.forEach((camera, k) => {
    const [fx, , cx, , fy, cy] = camera.intrinsics, m = camera.camera_to_world;
    const corner = (u: number, v: number) => { const p = [((u - cx) / fx) * size, ((v - cy) / fy) * size, size]; return [0, 1, 2].map((r) => m[4 * r] * p[0] + m[4 * r + 1] * p[1] + m[4 * r + 2] * p[2] + m[4 * r + 3]); };
    const corners = [corner(0, 0), corner(camera.width, 0), corner(camera.width, camera.height), corner(0, camera.height)], eye = eyes[k].toArray();
    corners.forEach((point, c) => { lines.push(...eye, ...point, ...point, ...corners[(c + 1) % 4]); });
  });
  for (const axis of [0, 1, 2]) { const end = [...center]; end[axis] += 0.3 * reach; lines.push(...center, ...end); }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(lines), 3));
  return { model: empty(middle, 1.1 * reach), extra: { object: new LineSegments(geometry, new LineBasicMaterial({ color: 0x56b4e9 })) } };
}
