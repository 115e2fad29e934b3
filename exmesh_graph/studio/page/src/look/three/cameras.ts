// One camera for all stages of the page: when one is turned, the others turn with it.
import { Vector3 } from "three";
import type { Viewer } from "viewer";

const viewers = new Set<Viewer>();
let last: { position: Vector3; target: Vector3; near: number; far: number; radius: number; center: Vector3 } | null = null;
let copying = false;

export function join(viewer: Viewer): () => void {
  const changed = () => {
    if (copying || !viewer.model) return;
    remember(viewer);
    copying = true;
    for (const other of viewers) if (other !== viewer && other.model && alike(other, viewer)) pose(other);
    copying = false;
  };
  viewer.controls.addEventListener("change", changed);
  const show = viewer.show.bind(viewer);
  viewer.show = (model, options) => { // the first model places the camera: where the last one stood, if it fits
    const first = !viewer.model;
    show(model, options);
    if (!first) return;
    const sphere = model.geometry.boundingSphere;
    if (last && sphere && sphere.center.distanceTo(last.center) < 0.5 * last.radius && sphere.radius < 2.5 * last.radius && last.radius < 2.5 * sphere.radius) { copying = true; pose(viewer); copying = false; }
    else remember(viewer);
  };
  viewers.add(viewer);
  return () => { viewers.delete(viewer); };
}

function remember(viewer: Viewer): void {
  const sphere = viewer.model!.geometry.boundingSphere!;
  last = { position: viewer.camera.position.clone(), target: viewer.controls.target.clone(), near: viewer.camera.near, far: viewer.camera.far, radius: sphere.radius, center: sphere.center.clone() };
}

function alike(one: Viewer, two: Viewer): boolean {
  const a = one.model?.geometry.boundingSphere, b = two.model?.geometry.boundingSphere;
  return Boolean(a && b && a.center.distanceTo(b.center) < 0.6 * Math.max(a.radius, b.radius));
}

function pose(viewer: Viewer): void {
  if (!last) return;
  viewer.camera.position.copy(last.position);
  viewer.controls.target.copy(last.target);
  viewer.camera.near = last.near;
  viewer.camera.far = last.far;
  viewer.camera.updateProjectionMatrix();
  viewer.controls.update();
  viewer.stale = true;
}
