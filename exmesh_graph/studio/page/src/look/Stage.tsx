// Meshes, carriers, assets, Gaussians and cameras in three dimensions; the library for it is loaded when first needed.
import { Suspense, lazy } from "react";
import type { Show } from "../types";

const Stage3 = lazy(() => import("./three/Stage3"));

export function Stage(props: { digest: string; show: Show; source?: string }) {
  return <Suspense fallback={<p className="soft pad">…</p>}><Stage3 {...props} /></Suspense>;
}
