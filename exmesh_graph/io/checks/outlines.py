"""Do masks and cameras have a common shape? Rays through pixels of each mask, and what the other masks say of them.

A ray is explained where one of its points lies in all masks, which is where the visual hull drawn back would cover its
pixel. Masks are widened by `LOOSE` pixels first; those of views that lack one hold everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.close_ups import close_ups, cuts_off
from exmesh_graph.io.checks.readings import Cameras, Reading
from exmesh_graph.io.normalise import centre_of_masks

_LOOSE = 200  # masks are widened by one pixel for so many of their side
_ROOM = 1.2


@dataclass(frozen=True)
class Outlines:
    """Masks of N views with their cameras: `masks` bool [N, H, W], and widened, `wide`; `partial` bool [N], the
    close-ups, which say nothing of what lies beyond their edges."""

    masks: np.ndarray
    wide: np.ndarray
    cameras: Cameras
    partial: np.ndarray

    @classmethod
    def of(cls, masks: np.ndarray, cameras: Cameras) -> Outlines:
        cut = np.array([cuts_off(mask) for mask in masks], bool)
        return cls(masks, np.stack([widened(mask) for mask in masks]), cameras, close_ups(cut))

    def __len__(self) -> int:
        return len(self.masks)

    def subset(self, rows: Sequence[int] | np.ndarray) -> Outlines:
        chosen = list(rows)
        return Outlines(self.masks[chosen], self.wide[chosen], self.cameras.subset(chosen), self.partial[chosen])

    def read(self, reading: Reading, rows: Sequence[int]) -> Outlines:
        """Some of the views as `reading` has them."""
        columns, lines = (slice(None, None, -1) if mirror else slice(None) for mirror in reading.over)
        masks, wide = self.masks[list(rows)][:, lines, columns], self.wide[list(rows)][:, lines, columns]
        cameras = reading.change(self.cameras).subset(rows)
        return (
            Outlines.of(~masks, cameras)
            if reading.inverted
            else Outlines(masks, wide, cameras, self.partial[list(rows)])
        )


@dataclass(frozen=True)
class Rays:
    """Points along rays through pixels of each view: `points` [N, R, D, 3], NaN where the ray misses the sphere."""

    points: np.ndarray

    def held(self, outlines: Outlines) -> np.ndarray:
        """bool [M, N, R, D]: whether each of the M masks holds each point."""
        flat = self.points.reshape(-1, 3)
        votes = np.stack([holds(outlines, view, flat) for view in range(len(outlines))])
        return votes.reshape(len(outlines), *self.points.shape[:3])


def rays_of_masks(outlines: Outlines, centre: np.ndarray, radius: float, rays: int, depths: int) -> Rays:
    """Rays through pixels of each mask, evenly over its rows; all pixels where there are fewer."""
    return Rays(np.stack([
        _along(outlines.cameras, view, _spread(mask, rays), centre, radius, depths)
        for view, mask in enumerate(outlines.masks)
    ]))  # fmt: skip


def depths_of(outlines: Outlines) -> int:
    """Points on a ray so that they lie about a pixel and a half apart as other views see them: thin parts are met."""
    sides = [
        np.hypot(np.ptp(np.flatnonzero(m.any(0))), np.ptp(np.flatnonzero(m.any(1)))) for m in outlines.masks if m.any()
    ]
    return int(np.clip(_ROOM * np.median(sides or [0]) / 1.5, 40, 256))


def covered(outlines: Outlines, centre: np.ndarray, radius: float, most: int = 4000) -> np.ndarray:
    """Share [N] of each mask's rays that the shape common to all masks explains, by about `most` points a view."""
    if not np.isfinite(radius) or radius <= 0:
        return np.zeros(len(outlines))
    depths = depths_of(outlines)
    points = rays_of_masks(outlines, centre, radius, max(24, most // depths), depths).points
    flat = points.reshape(-1, 3)
    live = np.flatnonzero(np.isfinite(flat[:, 0]))
    for view in _far_apart(len(outlines)):  # masks from unlike sides first: what is left for the others is little
        live = live[holds(outlines, view, flat[live])]
    explained = np.zeros(points.shape[:3], bool)
    explained.ravel()[live] = True
    return explained.any(axis=2).mean(axis=1)


def common_shape(outlines: Outlines) -> float:
    """What the shape common to the masks explains of them, all but a tenth of the views at least; 0: there is none."""
    try:
        centre, radius = centre_of_masks(outlines.masks, outlines.cameras.intrinsics, outlines.cameras.camera_to_world)
    except DataError:
        return 0.0
    return float(np.quantile(covered(outlines, centre, radius, 2400), 0.1))


def overlap(rest: Outlines, camera: Cameras, masks: Sequence[np.ndarray], rays: int = 600) -> list[float]:
    """Intersection over union of the hull of `rest`, drawn by one more camera, and each of `masks` bool [H, W].

    Pixels at a mask's rim count for neither side.
    """
    centre, radius = centre_of_masks(rest.masks, rest.cameras.intrinsics, rest.cameras.camera_to_world)
    pixels = _spread(np.ones(masks[0].shape, bool), 4 * rays)
    points = _along(camera, 0, pixels, centre, radius, depths_of(rest))
    flat = points.reshape(-1, 3)
    live = np.flatnonzero(np.isfinite(flat[:, 0]))
    for view in _far_apart(len(rest)):
        live = live[holds(rest, view, flat[live])]
    inside = np.zeros(points.shape[:2], bool)
    inside.ravel()[live] = True
    drawn = inside.any(axis=1)
    shares = []
    for mask in masks:
        wide = widened(mask)
        own, near = (m[pixels[:, 1], pixels[:, 0]] for m in (mask, wide))
        both = (own & drawn).sum()
        shares.append(float(both / max(int((own | (drawn & ~near)).sum()), 1)))
    return shares


def widened(mask: np.ndarray) -> np.ndarray:
    """A mask and what lies within half a per cent of its side around it: what drawing and matting may be off by."""
    grown: np.ndarray = binary_dilation(mask, iterations=max(1, round(max(mask.shape) / _LOOSE)))
    return grown


def _far_apart(count: int) -> list[int]:
    step = max(1, int(0.382 * count))
    while np.gcd(step, count) != 1:
        step += 1
    return [i * step % count for i in range(count)]


def holds(outlines: Outlines, view: int, points: np.ndarray) -> np.ndarray:
    """Whether one mask holds points [P, 3]: bool [P]. Behind its camera it holds none.

    Beyond the picture's edge the object may go on where its outline touches the edge, and only there; anywhere beyond
    those of a close-up.
    """
    height, width = outlines.wide.shape[1:]
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, depth = outlines.cameras.project(view, points)
        front = depth > 0
        column = np.clip(np.nan_to_num(x), 0, width - 1).astype(np.int32)
        row = np.clip(np.nan_to_num(y), 0, height - 1).astype(np.int32)
    held = outlines.wide[view].ravel()[row * width + column]
    if outlines.partial[view]:
        held |= (x < 0) | (x >= width) | (y < 0) | (y >= height)
    return front & held


def _spread(mask: np.ndarray, count: int) -> np.ndarray:
    """`count` pixels [count, 2] (column, row) of a mask; some twice where it has fewer."""
    inside = np.flatnonzero(mask)
    chosen = (
        inside[((np.arange(count) + 0.5) * len(inside) / count).astype(int)] if len(inside) else np.zeros(count, int)
    )
    return np.stack([chosen % mask.shape[1], chosen // mask.shape[1]], axis=1)


def _along(
    cameras: Cameras, view: int, pixels: np.ndarray, centre: np.ndarray, radius: float, depths: int
) -> np.ndarray:
    """Points [R, depths, 3] on the rays through pixels, inside the sphere with some room; NaN where they miss it."""
    pose = cameras.camera_to_world[view]
    uv = np.concatenate([pixels + 0.5, np.ones((len(pixels), 1))], axis=1)
    rays = uv @ np.linalg.inv(cameras.intrinsics[view]).T @ pose[:3, :3].T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    to = centre - pose[:3, 3]
    middle = rays @ to
    half = (_ROOM * radius) ** 2 - (to @ to - middle**2)
    half = np.sqrt(np.where(half > 0, half, np.nan))
    steps = (np.arange(depths) + 0.5) / depths * 2 - 1
    along = middle[:, None] + half[:, None] * steps
    along = np.where(along > 0, along, np.nan)
    return pose[:3, 3] + along[..., None] * rays[:, None]
