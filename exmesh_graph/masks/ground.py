"""A picture of the table that an object stands on, without the object.

Places that views show beside the object are sure. Below it the picture comes from pixels within the outline that no
depth of the object explains (`explained`), or beside it, where stereo has no table: they show the table in its shade,
or what the outline lacks of a plain pot. Shade is the table's colour, darker; and only a table has a pattern that the
views see at the same places.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy.ndimage import distance_transform_edt, find_objects, gaussian_filter, median_filter

from exmesh_graph.geometry.robust import robust
from exmesh_graph.gpu.cores import share
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.io.resample import bilinear
from exmesh_graph.masks.pinhole import pixels_of, rays_of
from exmesh_graph.masks.plane import Plane
from exmesh_graph.types import Views

_VIEWS = 64
"""Views that the picture of the table is made of, at most."""
_LEAST = 3
_TEXELS = (64, 512)
_PART = 1 << 16
_BESIDE = 3.0
"""How far around the object the table is known, in half diagonals of its base."""
_SURE = 0.99
"""Of a mean of pixels, which are of one kind."""
_PATTERN, _FLECK = 9, 0.01
"""Texels: the neighbourhood in which a pattern is looked for; deviation of display values in it, at least."""
_NEAR, _SHADE, _HUE = 16.0, 0.45, 0.5
"""Texels: standard deviation over which the table beside a place is asked for its colour; of that linear colour, the
share that is left in the shade, at most; of what is left, how far it may be off in hue."""
_NOISE = 0.02
_UNSURE = 0.08
"""Deviations of display values: of one picture, and between views, from which on a place of the table says nothing."""
_LIGHT = 0.05
"""Of the picture's longer side: over what distance a view's light on the table is taken for even."""
_FINE = 4.0
"""Pixels that the width of a mean over a view's light keeps in a smaller picture."""


class Kind(IntEnum):
    """How surely a pixel shows the table: it does not; deep inside the outline, unexplained; so near its rim, or beside
    it where stereo has no table; beside it."""

    NOT, DEEP, RIM, BESIDE = 0, 1, 2, 3


@dataclass(frozen=True)
class Ground:
    """A table's picture.

    colour   float32 [T, T, 3], display colour of its texels, the median over the views; NaN: not known
    spread   float32 [T, T], its robust deviation from view to view
    origin   [3], the outer corner of texel (0, 0); across [2, 3], the steps from texel to texel
    """

    colour: np.ndarray
    spread: np.ndarray
    origin: np.ndarray
    across: np.ndarray
    plane: Plane

    def alike(self, picture: np.ndarray, outline: np.ndarray, k: np.ndarray, to_camera: np.ndarray) -> np.ndarray:
        """float64 [h, w] in [0, 1]: how well a pixel has the table's colour, 1 perfectly; NaN where none is known.

        picture  [h, w, 3], display colour; outline bool [h, w], about where the object is
        k, to_camera  [3, 3] in pixels of this picture, [4, 4]
        """
        place, there = self._places(picture.shape, k, to_camera)
        found = bilinear(np.concatenate([self.colour, self.spread[..., None]], axis=-1), place)
        shown, spread = found[..., :3], found[..., 3]
        known = there & np.isfinite(shown).all(axis=-1) & (spread < _UNSURE)
        off = np.where(known[..., None], picture - shown, 0)
        off = off - _light(off, known & ~outline, _LIGHT * max(picture.shape[:2]))
        distance = np.square(off).mean(axis=-1) / (_NOISE**2 + np.square(np.where(known, spread, 0)))
        return np.where(known, np.exp(-distance / 2), np.nan)

    def _places(self, shape: tuple[int, ...], k: np.ndarray, to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(row and column on the table [2, h, w] of what each pixel looks at, whether it looks down on it [h, w])."""
        rays, eye = rays_of(shape, k, to_camera), -to_camera[:3, :3].T @ to_camera[:3, 3]
        far = self.plane.met(rays, to_camera)
        there = np.isfinite(far)
        steps = self.across / np.square(self.across).sum(axis=1, keepdims=True)
        place = (eye + np.where(there, far, 0)[..., None] * rays - self.origin) @ steps.T
        return np.moveaxis(place, -1, 0) - 0.5, there


def ground_of(
    plane: Plane, views: Views, pictures: np.ndarray, kinds: np.ndarray, vertices: np.ndarray
) -> Ground | None:
    """The picture of the plane around the base of vertices [V, 3]; kinds uint8 [N, h, w], each pixel's `Kind`.

    What fewer than three views show `BESIDE` the object, less sure pixels tell where they have a `_patterned` colour,
    and those of the `RIM` a `_shaded` one as well. None where no place is known.
    """
    chosen = np.unique(np.linspace(0, len(views) - 1, min(_VIEWS, len(views))).round().astype(int))
    origin, across, size = _grid(plane, vertices, views)
    texels = np.moveaxis(np.indices((size, size)), 0, -1).reshape(-1, 2) + 0.5
    points, square = origin + texels @ across, (size, size)

    def shown(view: int) -> np.ndarray:
        place, _ = pixels_of(points, views.intrinsics[view], views.world_to_camera[view])
        kind = kinds[view][..., None]
        known = np.concatenate([pictures[view], kind >= Kind.RIM, kind >= Kind.BESIDE], axis=-1, dtype=np.float32)
        return bilinear(np.where(kind > Kind.NOT, known, np.float32(np.nan)), place)

    seen = np.stack(share(shown, chosen))
    rim, beside = (seen[..., channel : channel + 1] > _SURE for channel in (3, 4))
    colour, spread, count = _middle(np.where(beside, seen[..., :3], np.float32(np.nan)))
    few = count < _LEAST
    table = np.where(few[:, None], np.float32(np.nan), colour).reshape(*square, 3)
    for kind in (Kind.RIM, Kind.DEEP):
        counted = seen[:, few, :3]
        if kind == Kind.RIM:
            counted = np.where(rim[:, few], counted, np.float32(np.nan))
        colour[few], spread[few], count[few] = _middle(counted)
        here, found = (few & (count >= _LEAST)).reshape(square), colour.reshape(*square, 3)
        told = _patterned(found, np.where(here, spread.reshape(square), np.nan))
        if kind == Kind.RIM:
            told |= here & _shaded(found, table)
        few &= ~told.ravel()
    if few.all():
        return None
    colour[few], spread[few] = np.nan, np.nan
    return Ground(colour.reshape(*square, 3), spread.reshape(square), origin, across, plane)


def _patterned(colour: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """bool [T, T]: texels around which colours [T, T, 3] vary more than views disagree on them.

    spread  [T, T], from view to view; NaN: not asked
    By medians: the border of two plain things is no pattern.
    """
    told, asked = np.zeros(spread.shape, bool), np.isfinite(spread)
    if not asked.any():
        return told
    box = find_objects(asked.astype(np.uint8))[0]
    known = tuple(distance_transform_edt(~asked[box], return_distances=False, return_indices=True))
    gray, spread = colour[box].mean(axis=-1)[known], spread[box][known]
    off = np.abs(gray - median_filter(gray, _PATTERN))
    varied, noise = 1.4826 * median_filter(off, _PATTERN), median_filter(spread, _PATTERN)
    told[box] = asked[box] & (varied > np.maximum(noise, _FLECK))
    return told


def _shaded(colour: np.ndarray, table: np.ndarray) -> np.ndarray:
    """bool [T, T]: the display colour [T, T, 3] is that of the `table` [T, T, 3] nearby (NaN: unknown), but darker."""
    known = np.isfinite(table[..., :1])
    near = np.concatenate([np.where(known, srgb_to_linear(table), 0), known], axis=-1)
    near = gaussian_filter(near, (_NEAR, _NEAR, 0))
    lit, own = near[..., :3] / np.maximum(near[..., 3:], 1e-6), srgb_to_linear(colour)
    left = (own * lit).sum(axis=-1) / np.maximum(np.square(lit).sum(axis=-1), 1e-6)
    off = np.linalg.norm(own - left[..., None] * lit, axis=-1)
    return (near[..., 3] > 1e-3) & (left < _SHADE) & (off < _HUE * left * np.linalg.norm(lit, axis=-1))


def _middle(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`robust` of many points, shared by the cores."""
    parts = share(robust, np.array_split(seen, max(1, seen.shape[1] // _PART), axis=1))
    colour, spread, count = (np.concatenate(part) for part in zip(*parts, strict=True))
    return colour, spread, count


def _grid(plane: Plane, vertices: np.ndarray, views: Views) -> tuple[np.ndarray, np.ndarray, int]:
    """(origin [3], across [2, 3], texels along a side): a square around the object's base, a texel a pixel wide."""
    side = np.linalg.svd(plane.normal[None])[2][1:]
    flat = vertices @ side.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    reach = _BESIDE * float(np.linalg.norm(high - low)) / 2
    centre = plane.normal * plane.offset + (low + high) / 2 @ side
    away = np.linalg.norm(views.camera_to_world[:, :3, 3] - centre, axis=1)
    pixel = float(np.median(away / views.intrinsics[:, 0, 0]))
    size = int(np.clip(2 * reach / pixel, *_TEXELS))
    return centre - reach * side.sum(axis=0), side * (2 * reach / size), size


def _light(off: np.ndarray, free: np.ndarray, width: float) -> np.ndarray:
    """What `off` [h, w, 3] is on average around each pixel where `free`: gloss and exposure of this view."""
    sure = (free & (np.abs(off).max(axis=-1) < 4 * _UNSURE)).astype(np.float32)
    factor = max(1, int(width / _FINE))  # so wide a mean needs no small pixels
    sums = _pooled(np.concatenate([sure[..., None] * off, sure[..., None]], axis=-1), factor)
    sums = gaussian_filter(sums, (width / factor, width / factor, 0))
    light = sums[..., :3] / np.maximum(sums[..., 3:], 1e-4)
    if factor == 1:
        return light
    most = np.array(light.shape[:2])[:, None, None] - 1
    return bilinear(light, np.clip((np.indices(sure.shape) + 0.5) / factor - 0.5, 0, most))


def _pooled(values: np.ndarray, factor: int) -> np.ndarray:
    """Means of squares of `factor` pixels of [h, w, C], beyond its edges what is at them."""
    rows, columns = (-side % factor for side in values.shape[:2])
    values = np.pad(values, ((0, rows), (0, columns), (0, 0)), mode="edge")
    height, width, channels = values.shape
    return values.reshape(height // factor, factor, width // factor, factor, channels).mean(axis=(1, 3))
