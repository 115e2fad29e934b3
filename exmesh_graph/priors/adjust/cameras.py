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

from exmesh_graph.gpu.cores import share as shared
from exmesh_graph.gpu.torch_setup import sharing
from exmesh_graph.io.contrast import even_contrast
from exmesh_graph.io.lens import UNCHANGED, LensChange
from exmesh_graph.io.resample import bilinear
from exmesh_graph.priors.adjust.patches import Patches, patches_of
from exmesh_graph.priors.adjust.system import Level, Share, level_of, share_of
from exmesh_graph.priors.patch_match.estimate import Stereo, patch_match
from exmesh_graph.priors.patch_match.sources import choose_sources
from exmesh_graph.priors.settings import PatchMatchSettings
from exmesh_graph.priors.together import SIDE
from exmesh_graph.resources import usable_cores
from exmesh_graph.targets import prepare_targets
from exmesh_graph.types import PointCloud, Views

#: Longer side of the pictures of stereo, in the first turn and later; sizes of the pictures compared, each half the one
#: before, and how many of them, the finest, in later turns.
STEREO_SIDES, SIZES, LATER = (240, 360), 4, 2
#: Turns and, at each size, Gauss-Newton steps at most; views that a patch is looked for in; damping over the mean
#: curvature.
TURNS, STEPS, SOURCES, DAMPING = 3, 20, 8, 1e-3
_STILL = 0.15
"""Pixels of a size (about; the largest part of a twist by the focal length): a lesser step is its last."""
_FAR = 2.0
"""Pixels, the mean of a view: where one moved farther there is another turn."""
_LEAST_SIDE = 48
_LEAST_KNOWN, _LEAST_ALIKE, _MOST_ASTRAY = 0.48, 0.78, 0.2
"""Of the medians; right cameras have had 0.51 and 0.80 of them at least, wrong ones 0.45 and 0.76 at most. Of the
views."""
_FOCAL, _BEND = 1e5, 1e4
"""Weights of the squares of what lenses have grown by, focal lengths and, by bending, what lies in the corners of the
pictures; beside a curvature by focal lengths of 3e5 (coarse) to 5e6 (fine) where thirty photographs go around an
object, and of 2e4 where nine from one side leave it open."""
_BENT = 0.25
"""What pixels in the corners move outward, of their way from the middle, at most."""
_EITHER = np.array([-1.0, 1.0])
_FARTHEST = 0.03
"""Change of a depth in one step, as a share of it, at most."""


@dataclass(frozen=True)
class Adjusted:
    """camera_to_world float64 [N, 4, 4]; what lenses are other than before; `moved` float64 [N], pixels by which its
    patches shifted in each view; mean correlation of patches with the other views, (before, after); the stereo by which
    that was found last; and `agreement` float64 [N], the correlation afterwards of each view's own patches."""

    camera_to_world: np.ndarray
    lens: LensChange
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
    """`views`, without masks, under cameras by which they agree best: of a world that stands still, or of what turns
    before one (of which no depth is found).

    The least squares of `system.share_of` in twists of all cameras, depths of all patches and one change of all lenses,
    coarse to fine; the depths are eliminated patch by patch (Schur complement), and damping keeps the world where it
    was. Where some view moved far, stereo was wrong there: it is done again under the new cameras, and so are they.
    Where patches agree no better afterwards, the cameras are those before. Equal arguments give equal bytes on any
    number of cores. Raises DataError for fewer than two views.
    """
    levels, known = _levels(views), None if points is None else points.points
    done, lens, moved = views, UNCHANGED, np.zeros(len(views))
    agreement: list[float] = []
    alike = np.zeros(len(views))
    with sharing(threads), ThreadPoolExecutor(threads or usable_cores()) as pool:
        for turn in range(TURNS):
            tell(f"adjusting {len(views)} cameras, turn {turn + 1}: stereo")
            side, sizes = (STEREO_SIDES[0], SIZES) if turn == 0 else (STEREO_SIDES[1], LATER)
            stereo = patch_match(done, PatchMatchSettings(side=side), points=points, seed=seed)
            patches = _patches(levels[-1] if lens == UNCHANGED else _finest(done), stereo, lens)
            chosen = choose_sources(done.intrinsics, done.camera_to_world, views.height, views.width, SOURCES, known)
            poses, new, told = _fitted(levels[-sizes:], patches, chosen, done.camera_to_world, lens, pool, tell)
            before, after = (_mean(one) for one in told)
            agreement += [] if agreement else [before]
            if not after > before:
                alike = _each(told[0]) if turn == 0 else alike
                break
            agreement.append(after)
            alike = _each(told[1])
            far = _moved(done.camera_to_world, lens, patches, poses, new, views.intrinsics).max()
            moved = _moved(views.camera_to_world, UNCHANGED, patches, poses, new, views.intrinsics)
            lens, done = new, replace(through_lens(views, new), camera_to_world=poses)
            if far < _FAR:
                break
    return Adjusted(done.camera_to_world, lens, moved, (agreement[0], agreement[-1]), stereo, alike)


def through_lens(views: Views, lens: LensChange) -> Views:
    """Views as they are if their lenses are other than they were taken for."""
    intrinsics = lens.longer(views.intrinsics)
    if not lens.bend:
        return replace(views, intrinsics=intrinsics)
    x, y = np.meshgrid(np.arange(views.width) + 0.5, np.arange(views.height) + 0.5)
    pixels = np.stack([x, y], axis=-1)

    def one(view: int) -> np.ndarray:
        (focal, centre), (old, _) = ((k[[0, 1], [0, 1]], k[:2, 2]) for k in (intrinsics[view], views.intrinsics[view]))
        at = lens.shown((pixels - centre) / focal) * old + centre - 0.5
        most = np.array([views.height, views.width])[:, None, None] - 1
        return bilinear(np.asarray(views.images[view]), np.clip(np.moveaxis(at, -1, 0)[::-1], 0, most))

    return replace(views, images=np.stack(shared(one, range(len(views)))), intrinsics=intrinsics)


def _patches(finest: Level, stereo: Stereo, lens: LensChange) -> list[Patches]:
    """Of each view, where the pictures before `lens` show them."""
    return [
        patches_of(gray, matrix, depth, normals).as_shown(lens)
        for gray, matrix, depth, normals in zip(
            finest.gray, finest.intrinsics, stereo.depths.depth, stereo.normals, strict=True
        )
    ]


def _fitted(
    levels: list[Level], patches: list[Patches], chosen: np.ndarray, poses: np.ndarray, lens: LensChange,
    pool: ThreadPoolExecutor, tell: Callable[[str], None],
) -> tuple[np.ndarray, LensChange, tuple[np.ndarray, np.ndarray]]:  # fmt: skip
    """(poses, lenses, what `_correlations` gives of the finest size before and after), begun at `poses` and `lens`."""
    logs = [np.zeros(len(one)) for one in patches]
    before = _correlations(levels[-1].through(lens), patches, logs, chosen, poses, pool)
    for k, level in enumerate(levels):
        tell(f"pictures of {level.gray.shape[2]} x {level.gray.shape[1]} pixels ({k + 1} of {len(levels)})")
        for _ in range(STEPS):
            poses, logs, lens, change = _step(level.through(lens), patches, logs, chosen, poses, pool)
            if change * level.intrinsics[0, 0, 0] < _STILL:
                break
    return poses, lens, (before, _correlations(levels[-1].through(lens), patches, logs, chosen, poses, pool))


def _levels(views: Views) -> list[Level]:
    """Even pictures, the coarsest first."""
    levels = [_finest(views)]
    while len(levels) < SIZES and min(levels[0].gray.shape[1:]) >= 2 * _LEAST_SIDE:
        levels.insert(0, levels[0].halved())
    return levels


def _finest(views: Views) -> Level:
    factor = max(1, -(-max(views.width, views.height) // SIDE))
    targets = prepare_targets(views, downscale=factor)
    gray = np.stack([even_contrast(image.numpy().mean(axis=2)) for image in targets.images]).astype(np.float32)
    return level_of(gray, targets.intrinsics.numpy())


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
    level: Level, patches: list[Patches], logs: list[np.ndarray], chosen: np.ndarray, poses: np.ndarray,
    pool: ThreadPoolExecutor,
) -> tuple[np.ndarray, list[np.ndarray], LensChange, float]:  # fmt: skip
    """One damped Gauss-Newton step from the lenses of `level`: (poses, logarithms of depths over those of stereo,
    lenses, the largest part of a twist or of how far bending moves a corner)."""
    shares = _shares(level, patches, logs, chosen, poses, pool)
    size = 6 * len(poses) + 2
    curvature, slope = np.zeros((size, size)), np.zeros(size)
    for share in shares:
        if share is not None:
            share.add(curvature, slope)
    scale = np.trace(curvature[:-1, :-1]) / size
    if scale <= 0:
        return poses, logs, level.lens, 0.0
    corner = np.square(np.array(level.gray.shape[:0:-1]) / 2 / level.intrinsics[0, [0, 1], [0, 1]]).sum()
    natural = _stepped_back(patches, logs, poses, corner)
    curvature, slope = natural.T @ curvature @ natural, slope @ natural
    curvature[[-2, -1], [-2, -1]] += [_FOCAL, _BEND]
    slope[-2:] += [_FOCAL * level.lens.growth, _BEND * corner * level.lens.bend]
    step = natural @ -np.linalg.solve(curvature + DAMPING * scale * np.eye(size), slope)
    twists, (grown, bent) = step[:-2].reshape(-1, 6), (float(part) for part in step[-2:])
    moved = np.stack([_motion(twist) @ pose for twist, pose in zip(twists, poses, strict=True)])
    changed = [
        log if share is None else log + np.clip(share.depths(step), -_FARTHEST, _FARTHEST)
        for log, share in zip(logs, shares, strict=True)
    ]
    lens = LensChange(level.lens.growth + grown, float(np.clip(level.lens.bend + bent, *(_BENT / corner * _EITHER))))
    return moved, changed, lens, max(float(np.abs(twists).max()), abs(bent) * corner**1.5)


def _stepped_back(patches: list[Patches], logs: list[np.ndarray], poses: np.ndarray, corner: float) -> np.ndarray:
    """[6 N + 2, 6 N + 2], twists, g and b of unknowns of which the last two let focal lengths grow while each camera
    steps back until its patches are as large as before (damping, which holds cameras where they are, does not hold
    that), and bend lenses by what pixels in the corners, at the square `corner` of r, move outward."""
    all_of = np.eye(6 * len(poses) + 2)
    all_of[-1, -1] = 1 / corner
    for k, (one, log) in enumerate(zip(patches, logs, strict=True)):
        if len(one):
            all_of[6 * k + 3 : 6 * k + 6, -2] = -poses[k, :3, 2] * np.median(one.depths * np.exp(log))
    return all_of


def _motion(twist: np.ndarray) -> np.ndarray:
    """4 x 4 of a rotation vector and a shift in the world."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_rotvec(twist[:3]).as_matrix(), twist[3:]
    return matrix


def _moved(
    old: np.ndarray, old_lens: LensChange, patches: list[Patches], new: np.ndarray, new_lens: LensChange,
    intrinsics: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Pixels of the views, the mean over a view's own patches: between where its old and its new camera show them."""
    shifts = np.zeros(len(old))
    for k, one in enumerate(patches):
        if len(one):
            rays = np.concatenate([old_lens.rays(one.rays[:, :2]), one.rays[:, 2:]], axis=1)
            world = rays * one.depths[:, None] @ old[k, :3, :3].T + old[k, :3, 3]
            local = (world - new[k, :3, 3]) @ new[k, :3, :3]
            off = new_lens.shown(local[:, :2] / local[:, 2:]) - one.rays[:, :2]
            shifts[k] = np.linalg.norm(off * intrinsics[k, [0, 1], [0, 1]], axis=1).mean()
    return shifts
