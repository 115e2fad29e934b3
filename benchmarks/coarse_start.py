"""Coarse meshes of a scene with a true mesh: seconds and error of every start, in one run.

python -m benchmarks.coarse_start [SCENE] [--pgsr N ...] [--clean] [--sweep] [--quick] [--json FILE] [--picture PNG]

SCENE is a folder in the NeRF-Synthetic layout (default: the sample in the repository). Distances are in thousandths of
the true mesh's radius; seconds are of this process on one thread, each start from the photographs on.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from exmesh_graph.geometry.carve import carve
from exmesh_graph.geometry.clean import clean_mesh, largest_components, taubin
from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.geometry.tsdf import fuse
from exmesh_graph.io.blender import BlenderOptions, load_blender
from exmesh_graph.io.images import encode_rgba, write_image
from exmesh_graph.metrics.mesh import bounding_radius, chamfer
from exmesh_graph.priors.plane_sweep import SweepSettings, plane_sweep
from exmesh_graph.raster import project, rasterize_projected
from exmesh_graph.splat.depths import depth_maps
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.pgsr import pgsr
from exmesh_graph.splat.planes import normals_of_depth, pixel_rays
from exmesh_graph.splat.settings import FitSettings
from exmesh_graph.stage1.targets import prepare_targets
from exmesh_graph.types import DepthMaps, Views

SAMPLE = Path(__file__).parents[1] / "graphs" / "samples" / "spot"
Surface = tuple[np.ndarray, np.ndarray]


def main() -> None:
    options = arguments()
    torch.set_num_threads(1)
    scene = load_blender(options.scene, BlenderOptions(downscale=options.downscale, max_views=options.views))
    views, truth = scene.train, scene.truth
    if truth is None or truth.mesh_vertices is None or truth.mesh_faces is None:
        sys.exit("the scene has no true mesh")
    radius = bounding_radius(truth.mesh_vertices)
    rows, shown = [], [(truth.mesh_vertices, truth.mesh_faces)]

    def measure(name: str, make: Callable[[], Surface]) -> Surface:
        start = time.process_time()
        vertices, faces = make()
        seconds = time.process_time() - start
        error = chamfer(vertices, faces, truth.mesh_vertices, truth.mesh_faces).scaled(1000 / radius)
        edges = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
        rows.append({"start": name, "faces": len(faces), "seconds": seconds, **error})
        print(
            f"{name:24s} {len(faces):7d} faces {seconds:7.1f} s   chamfer {error['chamfer']:6.2f}"
            f"  p95 {error['p95']:6.2f}  max {error['max']:6.1f}   edge spread {edges.std() / edges.mean():.2f}",
            flush=True,
        )
        return vertices, faces

    field = SilhouetteField.from_masks(views.alpha, views.intrinsics, views.world_to_camera)
    hull: Surface = (np.zeros((0, 3)), np.zeros((0, 3), int))
    for resolution in (96, 128):
        hull = measure(f"hull {resolution}", lambda n=resolution: _smooth(visual_hull(field, resolution=n)))
    shown.append(hull)
    if options.clean:
        for budget in (2000, 5000, 20000):
            for method in ("builtin", "pymeshlab", "open3d"):
                measure(f"{method} {budget}",
                        lambda b=budget, m=method: clean_mesh(*hull, faces_budget=b, method=m))  # fmt: skip
    for iterations in options.pgsr:
        kept: list[DepthMaps] = []
        made = measure(f"pgsr {iterations}, solid", lambda n=iterations, k=kept: _solid(field, views, n, k))
        shown.append(made)
        # the same depth maps fused without the hull: what they saw, open elsewhere; the fit's seconds are above
        measure(f"pgsr {iterations}, fused", lambda k=kept: largest_components(*fuse(views, k[0], voxel=2 / 192), 1))
    if options.sweep:
        measure("plane sweep, solid", lambda: carve(field, views, plane_sweep(views, SweepSettings())))
    if options.json:
        options.json.write_text(json.dumps({"scene": str(options.scene), "rows": rows}, indent=1) + "\n")
    if options.picture:
        write_image(options.picture, encode_rgba(*_picture(views, shown, options.shown)))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="?", default=SAMPLE)
    parser.add_argument("--pgsr", type=int, nargs="*", default=[500, 1500], help="lengths of the fits, in iterations")
    parser.add_argument("--clean", action="store_true", help="clean-up methods and face budgets too")
    parser.add_argument("--sweep", action="store_true", help="depth maps by plane sweep too")
    parser.add_argument("--downscale", type=int, default=1, help="reduce the pictures by this factor")
    parser.add_argument("--views", type=int, default=0, help="at most so many training views; 0: all")
    parser.add_argument("--quick", action="store_true", help="reduced pictures and one fit of 100 iterations")
    parser.add_argument("--json", type=Path, help="write the table here too")
    parser.add_argument("--picture", type=Path, help="normals of the truth, the hull and each fit, from three views")
    parser.add_argument("--shown", type=int, nargs="+", default=[0, 9, 20], help="training views in the picture")
    options = parser.parse_args()
    if options.quick:
        options.downscale, options.pgsr = 4 * options.downscale, [100]
    return options


def _smooth(mesh: Surface) -> Surface:
    return taubin(*mesh, 10), mesh[1]


def _solid(field: SilhouetteField, views: Views, iterations: int, kept: list[DepthMaps]) -> Surface:
    settings = FitSettings(iterations=iterations, max_gaussians=40000)
    gaussians, history = pgsr(views, settings)
    print(f"{'':24s} {len(gaussians)} Gaussians, {history['psnr'][-1]:.1f} dB", flush=True)
    kept.append(depth_maps(Gaussians.of(gaussians), prepare_targets(views))[0])
    return largest_components(*carve(field, views, kept[0]), 1)


def _picture(views: Views, meshes: list[Surface], shown: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Normals in camera axes, a row a view, a column a mesh, as (linear colour premultiplied, alpha)."""
    rows = []
    intrinsics, poses = torch.from_numpy(views.intrinsics), torch.from_numpy(views.world_to_camera)
    for view in (i % len(views) for i in shown):
        row = []
        for vertices, faces in meshes:
            points = project(
                torch.from_numpy(np.ascontiguousarray(vertices, np.float32)), intrinsics[view], poses[view]
            )
            depth = rasterize_projected(points, torch.from_numpy(np.ascontiguousarray(faces, np.int32)), views.height,
                                        views.width).depth  # fmt: skip
            rays = pixel_rays(intrinsics[view], views.height, views.width, depth)
            normals, known = normals_of_depth(depth, depth > 0, rays)
            row.append(torch.where(known[..., None], 0.5 + 0.5 * normals * torch.tensor([1.0, -1, -1]), 0.0))
        rows.append(torch.cat(row, dim=1))
    image = torch.cat(rows).numpy()
    return image**2.2, np.ones(image.shape[:2], np.float32)


if __name__ == "__main__":
    main()
