"""Visual hull: the largest shape that agrees with all silhouettes, as a closed triangle mesh.

A point's field is the smallest, over the views, of the silhouette's signed distance at its projection, turned from
pixels into world units by depth / f; the hull is where it is positive. Real masks err here and there, so `wrong_masks`
views may be outvoted at each point (the (wrong_masks + 1)-th smallest value counts).

Close-ups show a part of the object: where some views show it whole, those that cut much of it off say nothing of what
lies beyond their edges (`geometry.close_ups`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.geometry.adjacency import signed_volume
from exmesh_graph.geometry.close_ups import close_ups, cuts_off
from exmesh_graph.geometry.pixels import FINENESS, pixel_width
from exmesh_graph.gpu.cores import share, split
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.types import Views
from exmesh_graph.types.pictures import Pictures

# A field this many voxels below zero is certainly outside: the remaining views need not be asked.
_DROP = 2.5
_COARSE = 48
_RESOLUTIONS = 64, 192
GRAIN = 1 << 14
"""Points that a core takes at a time."""
_FIELD_BYTES = 2 << 30
"""Distances that would take more are those of reduced masks: 200 of them still have 1600 pixels a side, more than the
finest hull has voxels, and their contours are placed to a fraction of a pixel."""


def silhouette_distance(alpha: np.ndarray) -> np.ndarray:
    """Signed distance float32 [H, W], in pixels, to the alpha = 1/2 contour; positive inside.

    Inside the soft rim (0 < alpha < 1) it is alpha - 1/2, which places the contour to a fraction of a pixel.
    """
    inside = alpha >= 0.5
    if not inside.any():
        return np.full(alpha.shape, -float(np.hypot(*alpha.shape)), np.float32)
    distance = 0.5 - distance_transform_edt(~inside)
    if not inside.all():
        distance = np.where(inside, distance_transform_edt(inside) - 0.5, distance)
    else:
        distance = np.full(alpha.shape, float(np.hypot(*alpha.shape)))
    rim = (alpha > 0) & (alpha < 1) & (np.abs(distance) < 1.5)
    return np.where(rim, alpha - 0.5, distance).astype(np.float32)


@dataclass(frozen=True)
class SilhouetteField:
    """The hull's implicit function over N views.

    distances        float32 [N, H, W], from `silhouette_distance`, of the part of each mask around its silhouette
    intrinsics       float64 [N, 3, 3], of these parts;  world_to_camera float64 [N, 4, 4], OpenCV
    wrong_masks      number of views that may be outvoted at each point
    reach            how far from the origin a hull is looked for along every axis, unless a box is given

    A point that projects outside a part takes the value of the nearest border pixel, less its distance to the part
    where that pixel is background: the object may go on beyond an edge that its silhouette touches, and only there.
    The parts of `close_ups` have a border of large values beyond the edges of their pictures: no vote either.
    A point behind a camera gets no vote from it.
    """

    distances: np.ndarray
    intrinsics: np.ndarray
    world_to_camera: np.ndarray
    wrong_masks: int = 0
    reach: float = 1.05

    @classmethod
    def from_masks(
        cls,
        alpha: np.ndarray | Pictures,
        intrinsics: np.ndarray,
        world_to_camera: np.ndarray,
        *,
        wrong_masks: int = 0,
        names: Sequence[str] = (),
    ) -> SilhouetteField:
        """Field of alpha [N, H, W], reduced by area means where the distances would take more than 2 GiB.

        DataError for no views, empty silhouettes, or `wrong_masks` >= N.
        """
        shapes = [tuple(np.shape(array)) for array in (alpha, intrinsics, world_to_camera)]
        if len(shapes[0]) != 3 or shapes[1:] != [(len(alpha), 3, 3), (len(alpha), 4, 4)]:
            raise DataError(
                f"masks, intrinsics and cameras have the shapes {', '.join(str(list(shape)) for shape in shapes)}",
                where="SilhouetteField.from_masks", expected="[N, H, W], [N, 3, 3] and [N, 4, 4] with the same N",
            )  # fmt: skip
        names = list(names) or [f"view {i}" for i in range(len(alpha))]
        if len(alpha) == 0:
            raise DataError("the visual hull needs views, there are none", expected="at least one training view")
        count, height, width = alpha.shape
        factor = next(f for f in range(1, height + width) if 4 * count * (height // f) * (width // f) <= _FIELD_BYTES)

        def outline(view: int) -> tuple[tuple[int, int, int, int] | None, bool]:
            inside = reduced_mask(alpha[view], factor) >= 0.5
            return _box(inside), cuts_off(inside)

        boxes, cut = zip(*share(outline, range(count)), strict=True)
        empty = [name for name, box in zip(names, boxes, strict=True) if box is None]
        if empty:
            raise DataError(
                "the mask is empty: no pixel has alpha >= 0.5", where=", ".join(empty),
                expected="a silhouette in every view", fix="leave these views out, or mend their masks",
            )  # fmt: skip
        if wrong_masks >= len(alpha):
            raise DataError(
                f"wrong_masks {wrong_masks} leaves no view to decide", expected=f"fewer than the {len(alpha)} views"
            )
        shape = height // factor, width // factor
        partial = close_ups(np.array(cut))
        rim = int(partial.any())
        corners, size = _windows(np.array(boxes) + rim, (shape[0] + 2 * rim, shape[1] + 2 * rim))
        distances = np.empty((count, *size), np.float32)

        def fill(view: int, corner: np.ndarray) -> None:
            top, left = np.maximum(corner - rim, 0)
            bottom, right = np.minimum(corner + size - rim, shape)
            shown = silhouette_distance(reduced_mask(alpha[view], factor)[top:bottom, left:right])
            beyond = [(place, end - place - n) for place, end, n in zip(
                (top - corner[0] + rim, left - corner[1] + rim), size, shown.shape, strict=True)]  # fmt: skip
            distances[view] = _bordered(shown, beyond, partial[view])

        share(fill, range(count), corners)
        k = np.array(intrinsics, float)
        k[:, :2] /= factor
        k[:, :2, 2] -= corners[:, ::-1] - rim
        return cls(distances, k, np.asarray(world_to_camera, float), wrong_masks)

    @classmethod
    def of_views(cls, views: Views, wrong_masks: int = 0) -> SilhouetteField:
        """Field of the masks of `views`. Raises as `from_masks`."""
        cameras = (views.intrinsics, views.world_to_camera)
        return cls.from_masks(views.alpha, *cameras, wrong_masks=wrong_masks, names=views.names)

    def __call__(self, points: np.ndarray, floor: float = -np.inf) -> np.ndarray:
        """Field float32 [P], world units, at points [P, 3]. Values below `floor` may be any value below it."""
        kernels = field_kernels()
        if self.wrong_masks > kernels.MOST_WRONG:  # in parts: it holds the votes of all views
            return np.concatenate([self.plain(points[k : k + GRAIN]) for k in range(0, max(len(points), 1), GRAIN)])
        focals = np.sqrt(self.intrinsics[:, 0, 0] * self.intrinsics[:, 1, 1]).astype(np.float32)
        points = np.ascontiguousarray(points, np.float32)
        values = np.empty(len(points), np.float32)
        given = (points, self.distances, projections(self.intrinsics, self.world_to_camera), focals, values)
        split(
            kernels.outline_field, len(points), self.wrong_masks, float(floor), *map(tensor_of, given),
            grain=GRAIN,
        )  # fmt: skip
        return values

    def plain(self, points: np.ndarray) -> np.ndarray:
        """The same in numpy, at every point [P, 3]."""
        points = np.asarray(points, np.float32)
        votes = [self._vote(view, points) for view in range(len(self.distances))]
        return np.partition(votes, self.wrong_masks, axis=0)[self.wrong_masks]

    def against(self, points: np.ndarray) -> np.ndarray:
        """Indices of the views whose masks leave out that one of `points` [P, 3] which most masks hold."""
        held = np.stack([self._vote(view, np.asarray(points, np.float32)) >= 0 for view in range(len(self.distances))])
        return np.flatnonzero(~held[:, held.sum(axis=0).argmax()])

    def _vote(self, view: int, points: np.ndarray) -> np.ndarray:
        k, matrix = self.intrinsics[view], projections(self.intrinsics[[view]], self.world_to_camera[[view]])[0]
        image = points @ matrix[:, :3].T + matrix[:, 3]
        depth = image[:, 2]
        front = depth > 1e-6
        inverse = 1 / np.where(front, depth, 1)
        x, y = image[:, 0] * inverse - np.float32(0.5), image[:, 1] * inverse - np.float32(0.5)
        height, width = self.distances.shape[1:]
        x_in, y_in = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
        value = _bilinear(self.distances[view], x_in, y_in)
        outside = np.hypot(x - x_in, y - y_in)
        value = np.where(value < 0, value - outside, value)
        focal = np.float32(np.sqrt(k[0, 0] * k[1, 1]))
        return np.where(front, value * depth / focal, np.inf).astype(np.float32)


def projections(intrinsics: np.ndarray, world_to_camera: np.ndarray) -> np.ndarray:
    """float32 [N, 3, 4], world to homogeneous pixels."""
    return (intrinsics @ world_to_camera[:, :3]).astype(np.float32)


@cache
def field_kernels() -> Any:
    """The module of Warp kernels, imported after `warp()` has been configured."""
    warp()
    from exmesh_graph.geometry import kernels_field

    return kernels_field


def _box(inside: np.ndarray) -> tuple[int, int, int, int] | None:
    """(top, left, bottom, right) of what is inside, the last two exclusive; None where nothing is."""
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    return (rows[0], columns[0], rows[-1] + 1, columns[-1] + 1) if len(rows) else None


def _bordered(distance: np.ndarray, beyond: list[tuple[int, int]], partial: bool) -> np.ndarray:
    """`distance` [h, w] with so many pixels more before and after its rows and columns, beyond the picture's edges."""
    if not any(map(any, beyond)):
        return distance
    if partial:
        return np.pad(distance, beyond, constant_values=float(np.hypot(*distance.shape)))
    wider = np.pad(distance, beyond, mode="edge")
    off = np.pad(np.ones(distance.shape, bool), beyond)
    return np.where(off | (wider >= 0), wider, wider - 1)


def _windows(boxes: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, tuple[int, int]]:
    """(top and left [N, 2], height and width) of windows of one size around the boxes [N, 4] in pictures of `shape`.

    Around each box a sixth of the largest is left and a few pixels: more than the voxels beyond the surface that a hull
    asks for. What lies farther off is as far as the window's edge and that from it: outside in any case.
    """
    low, high = boxes[:, :2], boxes[:, 2:]
    margin = (high - low).max() // 6 + 8
    size = np.minimum((high - low).max(axis=0) + 2 * margin, shape)
    corners = np.clip((low + high) // 2 - size // 2, 0, np.array(shape) - size)
    return corners, (int(size[0]), int(size[1]))


def reduced_mask(mask: np.ndarray, factor: int) -> np.ndarray:
    """Area means of a mask [H, W] over blocks of `factor` pixels a side; rows and columns left over are dropped."""
    height, width = (n // factor for n in mask.shape)
    cells = mask[: height * factor, : width * factor].reshape(height, factor, width, factor)
    return mask if factor == 1 else cells.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Values at pixel-index coordinates x (columns), y (rows) that lie inside the array."""
    height, width = image.shape
    column = np.minimum(x.astype(np.int32), max(width - 2, 0))
    row = np.minimum(y.astype(np.int32), max(height - 2, 0))
    s, t = x - column, y - row
    flat = image.ravel()
    corner = row * width + column
    right, below = int(width > 1), width * int(height > 1)
    top = flat[corner] * (1 - s) + flat[corner + right] * s
    bottom = flat[corner + below] * (1 - s) + flat[corner + below + right] * s
    return top * (1 - t) + bottom * t


@dataclass(frozen=True)
class Grid:
    """A regular grid: point (i, j, k) lies at origin + step * (i, j, k)."""

    origin: np.ndarray
    step: float
    shape: tuple[int, int, int]

    @classmethod
    def over(cls, low: np.ndarray, high: np.ndarray, resolution: int) -> Grid:
        """Cubic cells, `resolution` of them along the longest side of the box, the box centred in the grid."""
        step = float((high - low).max() / resolution)
        cells = np.maximum(np.ceil((high - low) / step - 1e-6).astype(int), 1)
        origin = (low + high) / 2 - cells * step / 2
        return cls(origin, step, (int(cells[0]) + 1, int(cells[1]) + 1, int(cells[2]) + 1))

    def points(self) -> np.ndarray:
        """float32 [P, 3], in C order of (i, j, k)."""
        axes = [self.origin[a] + self.step * np.arange(self.shape[a]) for a in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)


def occupied_box(field: SilhouetteField, low: np.ndarray, high: np.ndarray, resolution: int = _COARSE) -> tuple[
    np.ndarray, np.ndarray
]:  # fmt: skip
    """Box (low, high) around the part of the box where the hull may be, to within a coarse voxel.

    Raises DataError where no point of the grid comes within a voxel of the hull.
    """
    grid = Grid.over(low, high, resolution)
    points = grid.points()
    near = field(points, -_DROP * grid.step) > -grid.step
    if not near.any():
        raise DataError(
            f"the silhouettes of {len(field.distances)} views have no common part inside the search box",
            expected="cameras and masks of one object",
            fix="check the cameras' convention (axes, intrinsics for this image size) and the masks; "
            "with loose masks raise `wrong_masks`",
        )
    margin = 1.5 * grid.step
    return points[near].min(0) - margin, points[near].max(0) + margin


def goes_on(field: SilhouetteField) -> bool:
    """Whether the hull touches the border of the cube in which it is looked for. Raises as `occupied_box`."""
    ends = np.full(3, field.reach)
    low, high = occupied_box(field, -ends, ends)
    return bool((low < -ends).any() or (high > ends).any())


def visual_hull(
    field: SilhouetteField,
    *,
    resolution: int,
    low: Sequence[float] | None = None,
    high: Sequence[float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Mesh (vertices float32 [V, 3], faces int32 [F, 3]) of the hull: closed, counter-clockwise from outside.

    As `hull_field`. Raises DataError where the silhouettes have nothing in common.
    """
    return surface(*hull_field(field, resolution=resolution, low=low, high=high))


def hull_field(
    field: SilhouetteField,
    *,
    resolution: int,
    low: Sequence[float] | None = None,
    high: Sequence[float] | None = None,
) -> tuple[np.ndarray, Grid]:
    """The hull's field float32 [I, J, K], positive inside, and its grid.

    `resolution` is the number of voxels along the longest side of the object's box, which a coarse pass over
    [low, high] (by default as far as `field.reach`) finds; 0: `shown_resolution`. Only a band around the coarse surface
    is evaluated finely: the field changes by about the distance moved, so two coarse voxels hold every sign change.
    Raises DataError where the silhouettes have nothing in common.
    """
    least, most = (
        np.full(3, end) if given is None else given for given, end in ((low, -field.reach), (high, field.reach))
    )
    box_low, box_high = occupied_box(field, np.asarray(least, float), np.asarray(most, float))
    coarse = Grid.over(box_low, box_high, _COARSE)
    coarse_values = field(coarse.points(), -4 * coarse.step).reshape(coarse.shape)
    grid = Grid.over(box_low, box_high, resolution or shown_resolution(field, box_low, box_high))
    axes = [
        (grid.origin[a] + grid.step * np.arange(count) - coarse.origin[a]) / coarse.step
        for a, count in enumerate(grid.shape)
    ]
    at = np.stack(np.meshgrid(*axes, indexing="ij"))
    values = map_coordinates(coarse_values, at, order=1, mode="nearest").ravel()
    band = np.flatnonzero(np.abs(values) <= 2 * coarse.step)
    values[band] = field(grid.points()[band], -_DROP * grid.step)
    return values.reshape(grid.shape), grid


def resampled(values: np.ndarray, grid: Grid, resolution: int) -> tuple[np.ndarray, Grid]:
    """A field [I, J, K] on cells of which `resolution` span the longest side of its grid, trilinear, and that grid."""
    high = grid.origin + grid.step * (np.array(grid.shape) - 1)
    other = Grid.over(grid.origin, high, resolution)
    at = (other.points().astype(np.float64) - grid.origin) / grid.step
    found = map_coordinates(values, at.T, order=1, mode="nearest")
    return found.reshape(other.shape).astype(np.float32), other


def shown_resolution(field: SilhouetteField, low: np.ndarray, high: np.ndarray) -> int:
    """Voxels along the longest side of the box [low, high] of which each spans 1.25 pixels, 64 to 192.

    By the median, over the views, of a pixel's width at the middle of the box. Parts thinner than two voxels come apart
    or vanish between grid points; finer voxels than pixels add nothing.
    """
    pixel = pixel_width(field.intrinsics, field.world_to_camera, (low + high) / 2)
    return int(np.clip(round(float((high - low).max()) / (FINENESS * pixel)), *_RESOLUTIONS))


def surface(values: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Marching cubes at 0 of a field that is positive inside; the grid's outer layer is made outside, so it closes."""
    from skimage.measure import marching_cubes

    values = np.clip(values, -4 * grid.step, 4 * grid.step)
    # Exact zeros at grid points make faces of no area; a thousandth of a voxel is below the field's own error.
    nudge = 1e-3 * grid.step
    values = np.where(np.abs(values) < nudge, np.where(values < 0, -nudge, nudge), values)
    for axis in range(3):
        end = np.moveaxis(values, axis, 0)
        end[0] = np.minimum(end[0], -nudge)
        end[-1] = np.minimum(end[-1], -nudge)
    if not (values > 0).any():
        raise GeometryError(
            "the surface is empty: no grid point lies inside", where="visual hull",
            fix="raise `resolution`, or `wrong_masks` where masks are too tight",
        )  # fmt: skip
    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="ascent", allow_degenerate=False)
    vertices = (grid.origin + grid.step * vertices).astype(np.float32)
    faces = faces.astype(np.int32)
    if signed_volume(vertices, faces) < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    return vertices, faces
