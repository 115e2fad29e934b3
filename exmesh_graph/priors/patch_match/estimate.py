"""Depth, normals and confidence of every view by PatchMatch stereo, coarse to fine.

Bleyer, Rhemann and Rother 2011 (slanted planes), Galliani, Lasinger and Schindler 2015 (checkerboard), Xu and Tao 2019
(the neighbours' best planes, geometric consistency between views). Written from the papers. It computes on the CPU.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.priors.patch_match.agree import agreed_planes, normals_of
from exmesh_graph.priors.patch_match.layout import level_of, planes_of, state_of
from exmesh_graph.priors.patch_match.propagate import Comparison, iterate
from exmesh_graph.priors.patch_match.sources import choose_sources, search_bounds, transfers
from exmesh_graph.priors.patch_match.start import begin_at_points, enlarged, finer, random_planes
from exmesh_graph.priors.settings import PatchMatchSettings
from exmesh_graph.targets import Targets, prepare_targets
from exmesh_graph.types import DepthMaps, PointCloud, Views

SCHEDULE = ((4, 1), (2, 1), (1, 2))
"""Iterations of a level, the coarsest first: by the photographs alone, then with the sources' own depths."""
GEOMETRIC = 0.3
"""Cost of each pixel by which a point misses its own, there and back, up to three (`propagate.iterate`)."""
_ASKED = 8
_LEAST_SIDE = 24


@dataclass(frozen=True)
class Stereo:
    """What `patch_match` finds.

    depths      of the views at their full size, 0 where unknown
    normals     float32 [N, h, w, 3], unit, towards the camera, in its OpenCV axes, at the size compared; likewise
    confidence  float32 [N, h, w] in [0, 1]: correlation of the windows, less what the sources' depths miss
    lonely      views without any other to compare with: they have no depth
    """

    depths: DepthMaps
    normals: np.ndarray
    confidence: np.ndarray
    lonely: tuple[str, ...]

    def of(self, rows: np.ndarray) -> Stereo:
        """What was found for these of the views, in this order."""
        names = tuple(self.depths.names[row] for row in rows)
        return Stereo(
            replace(self.depths, names=names, depth=self.depths.depth[rows]), self.normals[rows],
            self.confidence[rows], tuple(name for name in names if name in self.lonely),
        )  # fmt: skip


def patch_match(
    views: Views,
    settings: PatchMatchSettings,
    *,
    points: PointCloud | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Stereo:
    """Depth of `views` inside the unit sphere, where `settings.agreeing` others show the same point.

    points  (normalised units) choose the views compared and where the search begins; they bind nothing
    Pixels outside a view's mask are neither searched nor compared. Equal arguments give equal bytes on any number of
    cores. Raises DataError for fewer than two views.
    """
    if len(views) < 2:
        raise DataError("one view alone has no parallax", where="prior.patch_match", expected="two views or more")
    factor = max(1, -(-max(views.width, views.height) // settings.side))
    targets = prepare_targets(views, downscale=factor)
    known = None if points is None else points.points
    count = max(_ASKED, settings.sources)
    cameras = targets.intrinsics.numpy(), targets.world_to_camera.numpy()
    chosen = choose_sources(cameras[0], views.camera_to_world, targets.height, targets.width, count, known)
    planes, inside = _searched(targets, chosen[:, : settings.sources], settings, known, seed, progress)

    # a flat ground has a depth that views agree on: without a mask only windows that match count
    sure = 1 - planes[:, 3] > torch.where(targets.masked, -1e9, settings.min_score)[:, None, None]
    found = planes[:, :3] * (inside & sure)[:, None]
    alone = (chosen < 0).all(axis=1)
    found[torch.from_numpy(alone)] = 0.0
    normals = normals_of(found, targets.intrinsics)
    in_world = torch.einsum("nhwj,njk->nhwk", normals, targets.world_to_camera[:, :3, :3].to(normals))
    asked = np.ascontiguousarray(chosen[:, :_ASKED])
    kept, _ = agreed_planes(
        found.contiguous(), in_world.contiguous(), torch.from_numpy(transfers(*cameras, asked)),
        torch.from_numpy(asked), needed=settings.agreeing, tolerance=settings.tolerance,
    )  # fmt: skip
    there = kept > 0
    return Stereo(
        depths=DepthMaps(views.names, _depths(views, kept, found[:, 1:], factor)),
        normals=torch.where(there[..., None], normals, 0.0).numpy(),
        confidence=torch.where(there, (1 - planes[:, 3]).clamp(0, 1), 0.0).numpy(),
        lonely=tuple(views.names[i] for i in np.flatnonzero(alone)),
    )


def _searched(
    targets: Targets,
    chosen: np.ndarray,
    settings: PatchMatchSettings,
    points: np.ndarray | None,
    seed: int,
    progress: Callable[[int, int], None] | None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """(planes [N, 4, h, w] of the finest level, inside bool [N, h, w])."""
    grey = torch.stack([image.mean(dim=-1) for image in targets.images])
    inside = torch.stack([alpha > 0.5 for alpha in targets.alpha])
    pictures = pyramid(grey, inside)
    schedule = SCHEDULE[-len(pictures) :]
    total, turn = sum(map(sum, schedule)), 0
    poses = targets.world_to_camera.numpy()
    planes: torch.Tensor | None = None
    for number, ((picture, shown), (photometric, geometric)) in enumerate(zip(pictures, schedule, strict=True)):
        intrinsics = targets.intrinsics.numpy().copy()
        intrinsics[:, :2] /= 2 ** (len(pictures) - 1 - number)
        level = level_of(picture, shown)
        comparison = _comparison(intrinsics, poses, chosen, settings)
        if planes is None:
            planes = random_planes(level, comparison.bounds, seed)
            if points is not None:
                begin_at_points(planes, points, intrinsics, poses, comparison.bounds)
        else:
            planes = finer(planes, level.height, level.width)
        state = state_of(planes, level.inside)
        for k in range(photometric + geometric):
            fine = k >= photometric
            first = number == 0 and k < 3  # nothing is known yet: trials as large as the search
            iterate(
                level, state, comparison, turn=turn + 1000 * seed, refresh=k == 0 or fine,
                sizes=(-4.0, 0.0) if fine else (-3.0, 4.0 if first else 1.0),
                bend=-2.0 if fine else (0.0 if number == 0 else -1.0), weight=GEOMETRIC if fine else 0.0,
            )  # fmt: skip
            turn += 1
            if progress is not None:
                progress(turn, total)
        planes = planes_of(state, level.width)
    assert planes is not None
    return planes, inside


def pyramid(grey: torch.Tensor, inside: torch.Tensor) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Pictures [N, H, W] and masks bool, coarsest first, each half the next one's size: means over what masks hold."""
    levels = [(grey, inside)]
    while len(levels) < len(SCHEDULE) and min(levels[0][0].shape[1:]) >= 2 * _LEAST_SIDE:
        picture, shown = levels[0]
        height, width = (n // 2 * 2 for n in picture.shape[1:])
        held = shown[:, :height, :width].to(picture)
        share = torch.nn.functional.avg_pool2d(held, 2)
        small = torch.nn.functional.avg_pool2d(picture[:, :height, :width] * held, 2) / share.clamp(min=0.25)
        levels.insert(0, (small, share >= 0.5))
    return levels


def _comparison(
    intrinsics: np.ndarray, poses: np.ndarray, chosen: np.ndarray, settings: PatchMatchSettings
) -> Comparison:
    matrices = transfers(intrinsics, poses, chosen)
    bounds = search_bounds(intrinsics, poses, chosen, matrices)
    return Comparison(
        torch.from_numpy(matrices), torch.from_numpy(np.ascontiguousarray(chosen)), torch.from_numpy(bounds),
        best=min(settings.best, settings.sources), radius=settings.window // 2, step=settings.step,
        trials=settings.trials,
    )  # fmt: skip


def _depths(views: Views, kept: torch.Tensor, slopes: torch.Tensor, factor: int) -> np.ndarray:
    """float32 [N, H, W] at the pictures' size, 0 outside masks."""
    depths = np.zeros((len(views), views.height, views.width), np.float32)
    for view, (w, bend) in enumerate(zip(kept, slopes, strict=True)):
        full = enlarged(w, bend, views.height, views.width, factor).numpy()
        held = full > 0
        if views.has_masks:
            held &= views.alpha[view] > 0.5
        depths[view][held] = 1 / full[held]
    return depths
