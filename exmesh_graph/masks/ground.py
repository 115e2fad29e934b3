"""The table that an object stands on, as all views together show it: a picture of it without the object.

Where a view's pixel looks at the table, other views that look past the object from elsewhere know its colour. A pixel
of this colour shows the table, one of another colour the object, even where both are of the same wood; and gaps through
which the table is seen are found inside the outline. Below the object the picture comes from pixels that no depth of
the object explains (`explained`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter

from exmesh_graph.geometry.robust import robust
from exmesh_graph.gpu.cores import share
from exmesh_graph.io.resample import bilinear
from exmesh_graph.masks.cut import together
from exmesh_graph.masks.explained import explained
from exmesh_graph.masks.pinhole import pixels_of, rays_of
from exmesh_graph.masks.plane import Plane
from exmesh_graph.types import DepthMaps, Views

_VIEWS = 64
"""Views that the picture of the table is made of, at most."""
_LEAST = 3
_TEXELS = (64, 512)
_PART = 1 << 16
_BESIDE = 3.0
"""How far around the object the table is known, in half diagonals of its base."""
_LOOSE = 2
"""Pixels by which an outline may be off."""
_RIM, _SURE = 8, 0.99
"""Pixels inside an outline that are more likely the table's than those deeper in, where the object hides it, explained
or not; and of a mean of such pixels."""
_NOISE = 0.02
_UNSURE = 0.08
"""Deviations of display values: of one picture, and between views, from which on a place of the table says nothing."""
_LIGHT = 0.05
"""Of the picture's longer side: over what distance a view's light on the table is taken for even."""
_FINE = 4.0
"""Pixels that the width of a mean over a view's light keeps in a smaller picture."""
_BINS = 12
_LEAST_CHANCE, _MOST = 0.02, 0.85
"""Chances that colour alone can give."""
_OWN, _FOREIGN = 0.2, 0.7
"""Chances that a pixel inside the outline shows the table: where the object's depth explains it, and where it does not
but the table's colour does."""


@dataclass(frozen=True)
class Table:
    """The plane that an object stands on, and the views' depth maps that it was found by."""

    plane: Plane
    depths: DepthMaps


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
        slope = rays @ self.plane.normal
        down = slope < -1e-6
        far = (self.plane.offset - eye @ self.plane.normal) / np.where(down, slope, -1)
        steps = self.across / np.square(self.across).sum(axis=1, keepdims=True)
        place = (eye + far[..., None] * rays - self.origin) @ steps.T
        return np.moveaxis(place, -1, 0) - 0.5, down & (far > 0)


def table_shown(
    plane: Plane, views: Views, pictures: np.ndarray, depth: np.ndarray, outlines: np.ndarray, vertices: np.ndarray
) -> np.ndarray | None:
    """float64 [N, h, w] in (0, 1): how likely pixels show the table and not the object; 0.5 where that is not known.

    pictures  float32 [N, h, w, 3], the views' display colour
    depth     [N, h, w], found by stereo; 0 where there is none
    outlines  bool [N, h, w], about what shows the object (vertices [V, 3])
    None where no place of the table is seen by three views.
    """
    own = explained(views, depth, pictures, outlines)
    outside = np.stack([~binary_dilation(one, iterations=_LOOSE) for one in outlines])
    usable = outside | (outlines & ~own)
    rim = np.stack(share(lambda one: distance_transform_edt(one) <= _RIM, outlines))
    ground = ground_of(plane, views, pictures, usable, usable & rim, vertices)
    if ground is None:
        return None
    alike = np.stack(share(ground.alike, pictures, outlines, views.intrinsics, views.world_to_camera))
    by_colour = chances(alike, outside, own)
    by_depth = np.where(own, _OWN, np.where(by_colour > 0.5, _FOREIGN, 0.5))
    return together(by_colour, np.where(outlines & np.isfinite(alike), by_depth, 0.5))


def chances(alike: np.ndarray, table: np.ndarray, own: np.ndarray) -> np.ndarray:
    """float64, as `alike`: the chance that a pixel shows the table, even odds given; 0.5 where `alike` is NaN.

    By how often pixels that show the `table` and pixels of the object's `own` are so alike: where the object has the
    table's colours too, as before a black ground, likeness says little. The more alike the likelier.
    """
    known = np.isfinite(alike)
    if not (table & known).any() or not (own & known).any():
        return np.full(alike.shape, 0.5)
    bins = np.minimum((np.where(known, alike, 0) * _BINS).astype(int), _BINS - 1)
    there, here = (np.bincount(bins[part & known], minlength=_BINS) + 1.0 for part in (table, own))
    odds = np.maximum.accumulate((there / there.sum()) / (here / here.sum()))
    chance = np.clip(odds / (1 + odds), _LEAST_CHANCE, _MOST)
    return np.where(known, chance[bins], 0.5)


def ground_of(
    plane: Plane, views: Views, pictures: np.ndarray, usable: np.ndarray, likely: np.ndarray, vertices: np.ndarray
) -> Ground | None:
    """The picture of the plane around the base of vertices [V, 3], from the pixels `usable` bool [N, h, w].

    likely  bool [N, h, w], which of them alone count where enough of these show a place

    None where no place of it is seen by three views.
    """
    chosen = np.unique(np.linspace(0, len(views) - 1, min(_VIEWS, len(views))).round().astype(int))
    origin, across, size = _grid(plane, vertices, views)
    texels = np.moveaxis(np.indices((size, size)), 0, -1).reshape(-1, 2) + 0.5
    points = origin + texels @ across

    def shown(view: int) -> np.ndarray:
        place, _ = pixels_of(points, views.intrinsics[view], views.world_to_camera[view])
        known = np.concatenate([pictures[view], likely[view][..., None]], axis=-1, dtype=np.float32)
        return bilinear(np.where(usable[view][..., None], known, np.float32(np.nan)), place)

    seen = np.stack(share(shown, chosen))
    colour, spread, count = _middle(np.where(seen[..., 3:] > _SURE, seen[..., :3], np.float32(np.nan)))
    few = count < _LEAST
    colour[few], spread[few], count[few] = _middle(seen[:, few, :3])
    enough = count >= _LEAST
    if not enough.any():
        return None
    colour[~enough], spread[~enough] = np.nan, np.nan
    square = size, size
    return Ground(colour.reshape(*square, 3), spread.reshape(square), origin, across, plane)


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
