"""Hull and clean-up of the sample scene: seconds and error of every grid and method, in one run.

python benchmarks/coarse_start.py [scene in the NeRF-Synthetic layout with a true mesh]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from exmesh_graph.geometry.clean import clean_mesh, taubin
from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.io.blender import load_blender
from exmesh_graph.metrics.mesh import bounding_radius, chamfer

SAMPLE = Path(__file__).parents[1] / "graphs" / "samples" / "spot"


def main() -> None:
    scene = load_blender(Path(sys.argv[1]) if len(sys.argv) > 1 else SAMPLE)
    views, truth = scene.train, scene.truth
    if truth is None or truth.mesh_vertices is None or truth.mesh_faces is None:
        sys.exit("the scene has no true mesh")
    radius = bounding_radius(truth.mesh_vertices)

    def show(name: str, seconds: float, vertices: np.ndarray, faces: np.ndarray) -> None:
        error = chamfer(vertices, faces, truth.mesh_vertices, truth.mesh_faces).scaled(1000 / radius)
        edges = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
        print(
            f"{name:22s} {len(faces):7d} faces {seconds:6.2f} s   chamfer {error['chamfer']:6.2f}"
            f"  p95 {error['p95']:6.2f}  max {error['max']:6.1f}   edge spread {edges.std() / edges.mean():.2f}"
        )

    print("distances in thousandths of the true mesh's bounding radius")
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), int)
    for resolution in (96, 128):
        start = time.perf_counter()
        field = SilhouetteField.from_masks(views.alpha, views.intrinsics, views.world_to_camera)
        vertices, faces = visual_hull(field, resolution=resolution)
        vertices = taubin(vertices, faces, 10)
        show(f"hull {resolution}", time.perf_counter() - start, vertices, faces)
    for budget in (2000, 5000, 20000):
        for method in ("builtin", "pymeshlab", "open3d"):
            start = time.perf_counter()
            result = clean_mesh(vertices, faces, faces_budget=budget, method=method)  # type: ignore[arg-type]
            show(f"{method} {budget}", time.perf_counter() - start, *result)


if __name__ == "__main__":
    main()
