"""Cameras that structure from motion found, adjusted to the photographs themselves.

Features are few where things are smooth, dark or out of focus, and each is off by a good part of a pixel: cameras are
then off by one pixel, some by ten. Photographs hold far more: every patch with paint on it, of table and object alike.
Depth by stereo says where patches of one photograph lie in the others; cameras and depths are then moved together until
they look alike there: photometric bundle adjustment (Alismail, Browning and Lucey 2016; Engel, Koltun, Cremers 2018).
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from exmesh_graph.gpu.torch_setup import sharing
from exmesh_graph.io.contrast import even_contrast
from exmesh_graph.priors.adjust.patches import Patches, patches_of
from exmesh_graph.priors.adjust.system import Level, Share, level_of, share_of
from exmesh_graph.priors.patch_match.estimate import Stereo, patch_match
from exmesh_graph.priors.patch_match.sources import choose_sources
from exmesh_graph.priors.settings import PatchMatchSettings
from exmesh_graph.priors.together import SIDE, zoomed_by
from exmesh_graph.resources import usable_cores
from exmesh_graph.targets import prepare_targets
from exmesh_graph.types import PointCloud, Views

#: Longer side of the pictures of stereo; sizes of the pictures compared, each half the one before.
STEREO_SIDE, SIZES = 360, 4
#: Turns and, at each size, Gauss-Newton steps at most; views that a patch is looked for in; damping over the mean
#: curvature.
TURNS, STEPS, SOURCES, DAMPING = 3, 20, 8, 1e-3
_STILL = 0.15
"""Pixels of a size (about; the largest part of a twist by the focal length): a lesser step is its last."""
_FAR = 2.0
"""Pixels, the mean of a view: where one moved farther there is another turn."""
_LEAST_SIDE = 48
_LEAST_KNOWN, _LEAST_ALIKE, _MOST_ASTRAY = 0.45, 0.75, 0.2
"""Of the medians; right cameras have had 0.64 and 0.83 of them at least, a wrong one 0.23 and 0.65. Of the views."""
_FOCAL = 1e5
"""Weight of the square of what focal lengths have grown by, beside a curvature of 3e5 (coarse) to 5e6 (fine) where
thirty photographs go around an object, and of 2e4 where nine from one side leave it open."""
_FARTHEST = 0.03
"""Change of a depth in one step, as a share of it, at most."""


@dataclass(frozen=True)
class Adjusted:
    """camera_to_world float64 [N, 4, 4]; `zoom`, what focal lengths are times those before; `moved` float64 [N], pixels
    by which its patches shifted in each view;
    mean correlation of patches with the other views, (before, after); the stereo by which that was found last; and
    `agreement` float64 [N], the correlation afterwards of each view's own patches."""

    camera_to_world: np.ndarray
    zoom: float
    moved: np.ndarray
    correlation: tuple[float, float]
    stereo: Stereo
    agreement: np.ndarray

    @property
    def astray(self) -> np.ndarray:
        """bool [N]: views whose cameras are wrong: others confirm far less of their depth and their patches than of
        most. None where they would be many, for then most may be wrong."""
        known = (self.stereo.depths.depth > 0).mean(axis=(1, 2))
        wrong = (known < _LEAST_KNOWN * np.median(known)) & (self.agreement < _LEAST_ALIKE * np.median(self.agreement))
        return wrong if wrong.mean() <= _MOST_ASTRAY else np.zeros_like(wrong)


def adjust_cameras(
    views: Views,
    points: PointCloud | None = None,
    *,
    seed: int = 0,
    threads: int = 0,
    tell: Callable[[str], None] = lambda _: None,
) -> Adjusted:
    """`views`, without masks and of a world that stands still, under cameras by which they agree best.

    The least squares of `system.share_of` in twists of all cameras, depths of all patches and one growth of all focal
    lengths, coarse to fine; the depths are eliminated patch by patch (Schur complement), and damping keeps the world
    where it was. Where some view moved far, stereo was wrong there: it is done again under the new cameras, and so are
    they. What lenses bend stays. Where patches agree no better afterwards, the cameras are those before. Equal
    arguments give equal bytes on any number of cores. Raises DataError for fewer than two views.
    """
    levels, known = _levels(views), None if points is None else points.points
    done, moved, growth = views, np.zeros(len(views)), 0.0
    agreement: list[float] = []
    alike = np.zeros(len(views))
    with sharing(threads), ThreadPoolExecutor(threads or usable_cores()) as pool:
        for turn in range(TURNS):
            tell(f"adjusting {len(views)} cameras, turn {turn + 1}: stereo")
            stereo = patch_match(done, PatchMatchSettings(side=STEREO_SIDE), points=points, seed=seed)
            zoomed = [level.zoomed(growth) for level in levels]
            patches = [
                patches_of(zoomed[-1].gray[k], zoomed[-1].intrinsics[k], stereo.depths.depth[k], stereo.normals[k])
                for k in range(len(views))
            ]
            chosen = choose_sources(done.intrinsics, done.camera_to_world, views.height, views.width, SOURCES, known)
            poses, grown, told = _fitted(zoomed, patches, chosen, done.camera_to_world, growth, pool, tell)
            before, after = (_mean(one) for one in told)
            agreement += [] if agreement else [before]
            if not after > before:
                alike = _each(told[0]) if turn == 0 else alike
                break
            agreement.append(after)
            alike = _each(told[1])
            far = _moved(done, patches, poses, grown).max()
            moved = _moved(views, [one.zoomed(-growth) for one in patches], poses, growth + grown)
            growth += grown
            done = replace(done, camera_to_world=poses, intrinsics=zoomed_by(views.intrinsics, float(np.exp(growth))))
            if far < _FAR:
                break
    zoom = float(np.exp(growth))
    return Adjusted(done.camera_to_world, zoom, moved, (agreement[0], agreement[-1]), stereo, alike)


def _fitted(
    levels: list[Level], patches: list[Patches], chosen: np.ndarray, poses: np.ndarray, start: float,
    pool: ThreadPoolExecutor, tell: Callable[[str], None],
) -> tuple[np.ndarray, float, tuple[np.ndarray, np.ndarray]]:  # fmt: skip
    """Where focal lengths have grown by `start` before: (poses, their further growth, what `_correlations` gives of the
    finest size before and after)."""
    logs, growth = [np.zeros(len(one)) for one in patches], 0.0
    before = _correlations(levels[-1], patches, logs, chosen, poses, pool)
    for k, level in enumerate(levels):
        tell(f"pictures of {level.gray.shape[2]} x {level.gray.shape[1]} pixels ({k + 1} of {len(levels)})")
        for _ in range(STEPS):
            now, seen = level.zoomed(growth), [one.zoomed(growth) for one in patches]
            poses, logs, grown, change = _step(now, seen, logs, chosen, poses, start + growth, pool)
            growth += grown
            if change * level.intrinsics[0, 0, 0] < _STILL:
                break
    seen = [one.zoomed(growth) for one in patches]
    return poses, growth, (before, _correlations(levels[-1].zoomed(growth), seen, logs, chosen, poses, pool))


def _levels(views: Views) -> list[Level]:
    """Even pictures, the coarsest first."""
    factor = max(1, -(-max(views.width, views.height) // SIDE))
    targets = prepare_targets(views, downscale=factor)
    gray = np.stack([even_contrast(image.numpy().mean(axis=2)) for image in targets.images]).astype(np.float32)
    levels = [level_of(gray, targets.intrinsics.numpy())]
    while len(levels) < SIZES and min(levels[0].gray.shape[1:]) >= 2 * _LEAST_SIDE:
        levels.insert(0, levels[0].halved())
    return levels


def _shares(
    level: Level, patches: list[Patches], logs: list[np.ndarray], chosen: np.ndarray, poses: np.ndarray,
    pool: ThreadPoolExecutor,
) -> list[Share | None]:  # fmt: skip
    """What each view's patches say, in the order of the views, whichever thread made it."""
    return list(pool.map(lambda k: share_of(level, k, patches[k], logs[k], chosen[k], poses), range(len(poses))))


def _correlations(
    level: Level, patches: list[Patches], logs: list[np.ndarray], chosen: np.ndarray, poses: np.ndarray,
    pool: ThreadPoolExecutor,
) -> np.ndarray:  # fmt: skip
    """float64 [N, 2], of each view's patches: the sum of what can be compared, negative ones as none; and how many."""
    shares = _shares(level, patches, logs, chosen, poses, pool)
    return np.array([(0.0, 0.0) if share is None else (share.agreement, share.compared) for share in shares])


def _each(correlations: np.ndarray) -> np.ndarray:
    return np.asarray(correlations[:, 0] / np.maximum(correlations[:, 1], 1.0))


def _mean(correlations: np.ndarray) -> float:
    return float(_each(correlations.sum(axis=0, keepdims=True))[0])


def _step(
    level: Level, patches: list[Patches], logs: list[np.ndarray], chosen: np.ndarray, poses: np.ndarray, growth: float,
    pool: ThreadPoolExecutor,
) -> tuple[np.ndarray, list[np.ndarray], float, float]:  # fmt: skip
    """One damped Gauss-Newton step where focal lengths have grown by `growth`: (poses, logarithms of depths over those
    of stereo, further growth, the largest part of a twist)."""
    shares = _shares(level, patches, logs, chosen, poses, pool)
    size = 6 * len(poses) + 1
    curvature, slope = np.zeros((size, size)), np.zeros(size)
    for share in shares:
        if share is not None:
            share.add(curvature, slope)
    scale = np.trace(curvature) / size
    if scale <= 0:
        return poses, logs, 0.0, 0.0
    with_focal = _stepped_back(patches, logs, poses)
    curvature, slope = with_focal.T @ curvature @ with_focal, slope @ with_focal
    curvature[-1, -1] += _FOCAL
    slope[-1] += _FOCAL * growth
    step = with_focal @ -np.linalg.solve(curvature + DAMPING * scale * np.eye(size), slope)
    twists, grown = step[:-1].reshape(-1, 6), float(step[-1])
    moved = np.stack([_motion(twist) @ pose for twist, pose in zip(twists, poses, strict=True)])
    changed = [
        log if share is None else log + np.clip(share.depths(step), -_FARTHEST, _FARTHEST)
        for log, share in zip(logs, shares, strict=True)
    ]
    return moved, changed, grown, float(np.abs(twists).max())


def _stepped_back(patches: list[Patches], logs: list[np.ndarray], poses: np.ndarray) -> np.ndarray:
    """[6 N + 1, 6 N + 1], twists and g of unknowns of which the last lets focal lengths grow while each camera steps
    back until its patches are as large as before: damping, which holds cameras where they are, does not hold that."""
    all_of = np.eye(6 * len(poses) + 1)
    for k, (one, log) in enumerate(zip(patches, logs, strict=True)):
        if len(one):
            all_of[6 * k + 3 : 6 * k + 6, -1] = -poses[k, :3, 2] * np.median(one.depths * np.exp(log))
    return all_of


def _motion(twist: np.ndarray) -> np.ndarray:
    """4 x 4 of a rotation vector and a shift in the world."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_rotvec(twist[:3]).as_matrix(), twist[3:]
    return matrix


def _moved(views: Views, patches: list[Patches], poses: np.ndarray, growth: float) -> np.ndarray:
    """Pixels of the views, the mean over a view's own patches: where its old camera shows them, and the new one, whose
    focal length has grown by `growth`."""
    shifts = np.zeros(len(views))
    for k, one in enumerate(patches):
        if len(one):
            world = (
                one.rays * one.depths[:, None] @ views.camera_to_world[k, :3, :3].T + views.camera_to_world[k, :3, 3]
            )
            local = (world - poses[k, :3, 3]) @ poses[k, :3, :3]
            off = np.exp(growth) * local[:, :2] / local[:, 2:] - one.rays[:, :2]
            shifts[k] = np.linalg.norm(off * views.intrinsics[k, [0, 1], [0, 1]], axis=1).mean()
    return shifts
