"""What benchmarks.coarse_start measures: scenes of three layouts, the starts, and pictures of them."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from exmesh_graph.geometry.carve import carving
from exmesh_graph.geometry.clean import largest_components, taubin
from exmesh_graph.geometry.hull import SilhouetteField, surface, visual_hull
from exmesh_graph.geometry.settings import TsdfSettings
from exmesh_graph.geometry.tsdf import fuse
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.depth import load_depths
from exmesh_graph.io.idr import load_idr
from exmesh_graph.io.middlebury import load_middlebury
from exmesh_graph.io.scene import Scene
from exmesh_graph.io.settings import BlenderOptions, DepthOptions, IdrOptions, MiddleburyOptions
from exmesh_graph.masks.regained import regained
from exmesh_graph.priors.align import align
from exmesh_graph.priors.depth_filter import normals_of_depth
from exmesh_graph.priors.patch_match.estimate import patch_match
from exmesh_graph.priors.plane_sweep import plane_sweep
from exmesh_graph.priors.settings import PatchMatchSettings, SweepSettings
from exmesh_graph.raster import project, rasterize_projected
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.splat.depths import depth_maps
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.pgsr import pgsr
from exmesh_graph.splat.settings import DepthSettings, PgsrSettings
from exmesh_graph.targets import prepare_targets
from exmesh_graph.types import DepthMaps, Views

Surface = tuple[np.ndarray, np.ndarray]
MOST_GAUSSIANS = 40000


@dataclass
class Case:
    """Views to start from and to score on, the true surface where there is one, what is known beside."""

    train: Views
    held_out: Views
    truth: Surface | None
    field: SilhouetteField | None
    mono: DepthMaps | None
    measured: DepthMaps | None = None

    def sweep(self) -> DepthMaps:
        """Depth by plane sweep, made once."""
        if self.measured is None:
            self.measured = plane_sweep(self.train, SweepSettings())
        return self.measured


def load_case(path: Path, downscale: int, most: int) -> Case:
    """A folder in the NeRF-Synthetic, the IDR (with mono_depth/ beside, where there is one) or Middlebury's layout.

    Real scenes hold out every eighth view. Masks give the hull's field, one wrong mask allowed in Middlebury's.
    """
    return load_scene(path, downscale, most)[1]


def load_scene(path: Path, downscale: int, most: int) -> tuple[Scene, Case]:
    """The scene as loaded, and `load_case` of it."""
    mono, wrong_masks = None, 0
    if (path / "transforms_train.json").is_file():
        scene = load_blender(path, BlenderOptions(downscale=downscale, max_views=most))
    elif any(path.glob("cameras*.npz")):
        scene = load_idr(path, IdrOptions(downscale=downscale, max_views=most))
        if (path / "mono_depth").is_dir():
            mono = load_depths(scene.train, path / "mono_depth", DepthOptions(units="relative"))
    elif any(path.glob("*_par.txt")):
        scene, wrong_masks = load_middlebury(path, MiddleburyOptions(downscale=downscale, max_views=most)), 1
    else:
        sys.exit(f"{path}: expected transforms_train.json, cameras*.npz or *_par.txt")
    views, truth, field = scene.train, scene.truth, None
    if views.masked.all():
        field = SilhouetteField.from_masks(
            views.alpha, views.intrinsics, views.world_to_camera, names=views.names, wrong_masks=wrong_masks
        )
    has_mesh = truth is not None and truth.mesh_vertices is not None and truth.mesh_faces is not None
    mesh = (truth.mesh_vertices, truth.mesh_faces) if has_mesh else None
    return scene, Case(views, scene.test, mesh, field, mono)


def hull(case: Case, resolution: int) -> Surface:
    vertices, faces = visual_hull(case.field, resolution=resolution)
    return taubin(vertices, faces, 10), faces


def fitted(case: Case, iterations: int) -> DepthMaps:
    """Depth maps of planar Gaussians, from points in the hull, or at random in the unit sphere without masks."""
    gaussians, history = pgsr(
        case.train,
        PgsrSettings(iterations=iterations, max_gaussians=MOST_GAUSSIANS, wrong_masks=1 if case.truth is None else 0),
    )
    print(f"{'':24s} {len(gaussians)} Gaussians, {history['psnr'][-1]:.1f} dB", flush=True)
    return depth_maps(Gaussians.of(gaussians), prepare_targets(case.train), DepthSettings())[0]


def stereo(case: Case) -> DepthMaps:
    """Depth maps of PatchMatch stereo."""
    return patch_match(case.train, PatchMatchSettings()).depths


def solid(case: Case, depths: DepthMaps, clear: float = 1.0, blur: float = 0.0) -> Surface:
    """The hull, less what the depth maps look through."""
    settings = TsdfSettings(truncation=3, min_weight=2, clear=clear, blur=blur)
    found = carving(case.field, case.train, depths, settings)
    return largest_components(*surface(regained(found.field(), found, case.train), found.grid), 1)


def fused(case: Case, depths: DepthMaps) -> Surface:
    """The depth maps alone: open where nothing was seen. Without masks only what lies inside the unit sphere."""
    settings = TsdfSettings(resolution=192)
    if case.field is None:
        settings = TsdfSettings(resolution=128, radius=1.0, masked=False, truncation=6.0, min_weight=2.0)
    return largest_components(*fuse(case.train, depths, settings), 1)


def monocular(case: Case, reach: float) -> DepthMaps:
    """The network's maps, scale and shift from the plane sweep; `reach` as in prior.align."""
    assert case.mono is not None
    return align(case.mono, case.sweep(), reach).depths


def picture(views: Views, meshes: list[Surface], shown: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """The photograph and normals in camera axes, a row a view, a column a mesh, as (linear colour, alpha)."""
    rows = []
    intrinsics, poses = torch.from_numpy(views.intrinsics), torch.from_numpy(views.world_to_camera)
    for view in (i % len(views) for i in shown):
        row = [torch.from_numpy(linear_to_srgb(np.clip(views.images[view], 0, 1))).float()]
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
