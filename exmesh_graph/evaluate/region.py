"""What counts in held-out views that have no masks, found in the photographs and in nothing that is to be scored.

A pixel counts where the held-out view's own multi-view depth (`priors.patch_match`, with the training views as its
neighbours) lies inside the object's box and above the table that it stands on; or where masks of the training views
say so (`masked_region`), or a mask that was given for scoring only. With each pixel goes the interval of depths in
which the surface lies, so that a sheet behind the object covers nothing: around its own depth, or from where its ray
enters the masks' hull. With masks for scoring it is the box's: what stands in the wrong place shows the wrong colour,
as in views with masks.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.ndimage import binary_closing, binary_erosion, distance_transform_edt, label, maximum_filter, minimum_filter

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.evaluate.masked_region import Shown, pixel_directions, shown_by_masks
from exmesh_graph.evaluate.settings import RegionSettings
from exmesh_graph.geometry.settings import TsdfSettings
from exmesh_graph.geometry.tsdf import fuse
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.images import read_image
from exmesh_graph.io.reduce import downscale_area
from exmesh_graph.io.train_size import reduced
from exmesh_graph.masks.cut import moved_to_edges
from exmesh_graph.masks.plane import plane_below
from exmesh_graph.priors.depth_filter import neighbours, normals_of_depth
from exmesh_graph.priors.patch_match.estimate import patch_match
from exmesh_graph.priors.settings import PatchMatchSettings
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.targets import Targets, prepare_targets
from exmesh_graph.types import DepthMaps, Mesh, Region, Views
from exmesh_graph.types.pictures import Pictures

_FLAT = 0.003  # deviation [display units] of 3 x 3 pixels that hold nothing of their own: their depth is a neighbour's
_CLOSED = 3  # reduced pixels: holes that are closed, which the flat parts of a surface leave
_HOLE = 30  # reduced pixels: larger holes stay open
_FILLED = 0.02  # of what counts: holes in it that are filled
_SPECK = 0.05  # of the largest part: smaller ones are windows that match by chance
_BAND = 5.0  # reduced pixels by which the rim may move in, to the edge in the picture
_PARED = 2  # reduced pixels taken off the rim, where windows carry the object's depth onto the background
_SLOPE = 2.0  # a surface's steepest change of depth, in pixels' widths a pixel, where depth is carried over holes
_LEAST_SIDE = 32  # pixels, of stereo
_VOXELS = 128  # along the sphere's diameter, of the surface in which the table is looked for
_THICK = 1.5 * 2 / _VOXELS  # half the thickness of the table, which stereo's noise gives it
_WHITE = 0.95  # of a mask: a pixel of the rim shows the background in part, and is no picture of the surface
_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")


def find_region(
    views: Views, train: Views | None = None, settings: RegionSettings | None = None, ground: Mesh | None = None
) -> Region:
    """The region of held-out `views` without masks; `train` are other photographs of the same scene.

    With masks, of the settings or the views' own, their white pixels count. Else, where all of `train` have masks, a
    pixel counts that shows the hull of these above the `ground`. Else a pixel counts whose depth two neighbouring views
    confirm, that has structure of its own, is not seen at a grazing angle and lies inside the unit sphere (the object,
    as the loader found it) and the box, and not in or below the plane that the object stands on, where there is one
    that goes on beside it (`settings.table`). Small holes are closed, a rim of a few pixels is pared. Raises DataError
    for no two views, for masks that are missing, of another size or without a common shape, and where no pixel counts.
    """
    settings = settings or RegionSettings()
    given = None if settings.masks is None else _read_masks(settings.masks, views)
    if views.has_masks and given is None:
        given = np.stack([alpha > _WHITE for alpha in views.alpha])
    if given is not None:
        source, found = "masks", Shown(given, *_box_depths(views, settings))
    elif train is not None and train.has_masks and train.masked.all():
        source, found = "hull", _by_hull(views, train, ground, settings)
    else:
        source, found = "depth", _by_depth(views, train, settings)
    inside = found.inside & (found.end > found.start)
    if not inside.any():
        why, fix = {
            "depth": ("their depth was not found", "wire the training views to `train`, try another `downscale`, or "
                      "give `masks`"),
            "hull": ("they show nothing of the hull of the training masks", "look at the masks of `train`, or give "
                     "`masks`"),
            "masks": ("the masks are black, or what they show lies outside the box", "mend the masks, or widen `box`"),
        }[source]  # fmt: skip
        raise DataError(f"no pixel of the held-out views counts: {why}", where="evaluate.region", fix=fix)
    near, far = np.where(inside, found.start, 0), np.where(inside, found.end, 0)
    return Region(views.names, inside, near.astype(np.float32), far.astype(np.float32), source)


def _by_hull(views: Views, train: Views, ground: Mesh | None, settings: RegionSettings) -> Shown:
    """By the hull of the masks of `train`: surface counts from where a pixel's ray enters it to a little behind the
    depth that stereo finds inside, as far as it leaves it: what stands behind the object covers nothing."""
    inside, first, last = shown_by_masks(views, train, ground)
    slack = settings.tolerance
    depth = _own_depth(views, train, settings)
    start, end = first - slack, np.zeros_like(last)
    for i, seen in enumerate(depth):
        known = np.where(inside[i] & (seen > first[i] - slack) & (seen < last[i] + slack), seen, 0)
        far = _interval(known, views, i, slack)[1] if known.any() else np.inf
        end[i] = np.clip(far, first[i] + slack, last[i] + slack)
    if settings.box is not None:
        low, high = _box_depths(views, settings)
        start, end = np.maximum(start, low), np.minimum(end, high)
    return Shown(inside, start, end)


def _by_depth(views: Views, train: Views | None, settings: RegionSettings) -> Shown:
    """By the held-out views' own depth, with the interval around it."""
    if len(views) + (0 if train is None else len(train)) < 2:
        raise DataError("one view alone has no parallax", where="evaluate.region", expected="two views or more",
                        fix="wire the training views to `train`, or give `masks`")  # fmt: skip
    depth = _own_depth(views, train, settings)
    start, end = _box_depths(views, settings)
    known = (depth > start) & (depth < end)
    known &= ~_between(depth, known, settings)
    if settings.table == "auto":
        known &= ~_table(np.where(known, depth, 0), views, settings.downscale)
    inside = np.stack([_tidied(one, views.images[i], settings.downscale) for i, one in enumerate(known)])
    near, far = np.zeros_like(depth), np.zeros_like(depth)
    for i in range(len(views)):
        near[i], far[i] = _interval(np.where(known[i], depth[i], 0), views, i, settings.tolerance)
    return Shown(inside, np.maximum(near, start), np.minimum(far, end))


def mask_files(folder: Path | None) -> Mapping[str, Path]:
    """Every picture in the folder, by name; DataError where there is no such folder."""
    if folder is None:
        return {}
    if not folder.is_dir():
        raise DataError("the folder of masks for scoring does not exist", where=str(folder))
    return {file.name: file for file in sorted(folder.iterdir()) if file.suffix.lower() in _SUFFIXES}


def _read_masks(folder: Path, views: Views) -> np.ndarray:
    files = {Path(name).stem: file for name, file in mask_files(folder).items()}
    masks = []
    for name in views.names:
        file = files.get(Path(name).name) or files.get(Path(name).stem)
        if file is None:
            raise DataError("a held-out view has no mask", where=f"{folder}, view {name}",
                            expected=f"{Path(name).name}.png")  # fmt: skip
        mask = read_image(file)
        mask = mask[..., :3].mean(axis=-1) if mask.ndim == 3 else mask
        rows, columns = mask.shape[0] / views.height, mask.shape[1] / views.width
        if rows != columns or rows % 1 or rows < 1:
            raise DataError(f"the mask has {mask.shape[1]} x {mask.shape[0]} pixels", where=str(file),
                            expected=f"{views.width} x {views.height}, or a whole multiple of it")  # fmt: skip
        cells = mask.reshape(views.height, int(rows), views.width, int(rows))
        masks.append(cells.mean(axis=(1, 3)) > _WHITE)
    return np.stack(masks)


def _own_depth(views: Views, train: Views | None, settings: RegionSettings) -> np.ndarray:
    """Confirmed depth float32 [N, H, W] of the held-out views, 0 where there is none or it is not to be trusted."""
    ratio = 1 if train is None else views.width // max(train.width, 1)
    if train is not None and ratio > 1 and train.alpha.shape[1:] == (views.height // ratio, views.width // ratio):
        # the training pictures were reduced by their loader: what is left of `downscale` is done to both
        left = settings.replaced(downscale=max(1, settings.downscale // ratio))
        small = _own_depth(reduced(views, ratio), train, left)
        large = small.repeat(ratio, axis=1).repeat(ratio, axis=2)
        return np.pad(large, ((0, 0), (0, views.height - large.shape[1]), (0, views.width - large.shape[2])))
    factor = settings.downscale
    everyone = _joined(views, train)
    near = neighbours(everyone.camera_to_world, settings.neighbours)
    asked = sorted({*range(len(views)), *(int(other) for i in range(len(views)) for other in near[i])})
    side = max(_LEAST_SIDE, -(-max(views.width, views.height) // factor))
    stereo = patch_match(everyone.subset(asked), PatchMatchSettings(side=side)).depths.depth[: len(views)]
    targets = prepare_targets(views, downscale=factor)
    size, middle = (targets.height, targets.width), factor // 2
    out = np.zeros((len(views), views.height, views.width), np.float32)
    for i, full in enumerate(stereo):
        seen = torch.from_numpy(np.ascontiguousarray(full[middle::factor, middle::factor][: size[0], : size[1]]))
        trusted = _structured(targets.images[i].mean(dim=-1)) & ~_grazing(seen, targets, i, settings.incidence)
        large = (seen * trusted).numpy().repeat(factor, axis=0).repeat(factor, axis=1)
        out[i, : large.shape[0], : large.shape[1]] = large
    return out


def _table(depth: np.ndarray, views: Views, factor: int) -> np.ndarray:
    """bool [N, H, W], where the depth (0: none) is that of the table that the object stands on, or of what is below.

    The plane is that of the surface which the depth of all views gives, as for masks of the object (masks.object).
    """
    below = np.zeros(depth.shape, bool)
    small = reduced(views, factor)
    maps = np.ascontiguousarray(depth[:, ::factor, ::factor][:, : small.height, : small.width])
    voxels = TsdfSettings(resolution=_VOXELS, masked=False, truncation=6, min_weight=1, radius=1)
    try:
        surface = fuse(small, DepthMaps(views.names, maps), voxels)
    except GeometryError:  # too little depth for a surface
        return below
    plane = plane_below(*surface, views.camera_to_world[:, :3, 3], _THICK)
    if plane is None or not plane.is_table:
        return below
    for i, seen in enumerate(depth):
        points = views.camera_to_world[i][:3, 3] + seen[..., None] * pixel_directions(views, i)
        below[i] = (seen > 0) & (plane.height(points) < _THICK)
    return below


def _joined(views: Views, train: Views | None) -> Views:
    """Held-out views first; names are not used."""
    if train is None:
        return views
    if train.alpha.shape[1:] != views.alpha.shape[1:]:
        raise DataError(f"the training views have {train.width} x {train.height} pixels", where="evaluate.region",
                        expected=f"{views.width} x {views.height}, as the held-out ones, or a fraction")  # fmt: skip
    arrays: dict[str, Any] = {
        name: _concatenated(getattr(views, name), getattr(train, name))
        for name in ("images", "alpha", "intrinsics", "camera_to_world")
    }
    names = tuple(f"{number}" for number in range(len(views) + len(train)))
    return Views(names, split=views.split, has_masks=False, **arrays)


def _concatenated(first: Any, second: Any) -> Any:
    if isinstance(first, Pictures) and isinstance(second, Pictures):
        return first.joined(second)
    return np.concatenate([first, second])


def _structured(grey: torch.Tensor) -> torch.Tensor:
    """bool [H, W], where 3 x 3 pixels hold more than noise: flat ground takes the depth of an edge nearby."""
    mean = torch.nn.functional.avg_pool2d(torch.stack([grey, grey.square()])[:, None], 3, 1, 1, count_include_pad=False)
    return (mean[1, 0] - mean[0, 0].square()) > _FLAT**2


def _grazing(depth: torch.Tensor, targets: Targets, view: int, limit: float) -> torch.Tensor:
    """bool [H, W], where the normal is known by differences and turned further away than `limit` degrees."""
    rays = pixel_rays(targets.intrinsics[view], targets.height, targets.width, depth)
    normals, known = normals_of_depth(depth, depth > 0, rays)
    return known & (-(normals * rays).sum(-1) / rays.norm(dim=-1) < np.cos(np.radians(limit)))


def _between(depth: np.ndarray, known: np.ndarray, settings: RegionSettings) -> np.ndarray:
    """bool [N, H, W], where depths nearby lie further apart than a surface may be off: windows there hold two surfaces,
    and carry the depth of one onto the other."""
    reach = (1, 2 * settings.downscale + 1, 2 * settings.downscale + 1)
    near = minimum_filter(np.where(known, depth, np.inf), size=reach)
    far = maximum_filter(np.where(known, depth, -np.inf), size=reach)
    return far - near > settings.tolerance


def _tidied(known: np.ndarray, picture: np.ndarray, factor: int) -> np.ndarray:
    """bool [H, W] without the holes of a few reduced pixels, without specks, and without a rim.

    Windows carry depth onto what stands behind: the rim is cut to the edge in the picture [H, W, 3], inwards alone.
    """
    height, width = known.shape
    small, reach = known[::factor, ::factor], _CLOSED + 1
    closed = binary_closing(np.pad(small, reach), iterations=_CLOSED)[reach:-reach, reach:-reach]
    parts, _ = label(closed)
    size = np.bincount(parts.ravel())
    closed &= (size >= _SPECK * size[1:].max(initial=0))[parts]
    holes, _ = label(~closed)
    closed |= (np.bincount(holes.ravel()) < max(_HOLE, _FILLED * closed.sum()))[holes]
    whole = np.asarray(picture)[: height // factor * factor, : width // factor * factor]
    shown = linear_to_srgb(np.clip(downscale_area(whole, factor), 0, 1))
    rows, columns = shown.shape[:2]
    closed[:rows, :columns] &= moved_to_edges(shown.astype(np.float32), closed[:rows, :columns], _BAND)
    pared = binary_erosion(closed, iterations=_PARED, border_value=1)
    return pared.repeat(factor, axis=0).repeat(factor, axis=1)[:height, :width]


def _interval(depth: np.ndarray, views: Views, view: int, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """(nearest, farthest) depth [H, W]: around that of the nearest known pixel, wider the farther that is."""
    if not (depth > 0).any():
        return np.zeros_like(depth), np.zeros_like(depth)
    distance, (row, column) = distance_transform_edt(depth <= 0, return_indices=True)
    carried = depth[row, column]
    k = views.intrinsics[view]
    width = carried / np.sqrt(abs(np.linalg.det(k[:2, :2])))
    slack = tolerance + _SLOPE * distance * width
    return (carried - slack).astype(np.float32), (carried + slack).astype(np.float32)


def _box_depths(views: Views, settings: RegionSettings) -> tuple[np.ndarray, np.ndarray]:
    """Depths [N, H, W] at which each pixel's ray enters and leaves the unit sphere and the box; 0, 0 beside them."""
    shape = (len(views), views.height, views.width)
    start, end = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for i, pose in enumerate(views.camera_to_world):
        rays, place = pixel_directions(views, i), pose[:3, 3]
        square, half = (rays * rays).sum(-1), (rays * place).sum(-1)
        inner = half**2 - square * (place @ place - 1)
        root = np.sqrt(np.maximum(inner, 0))
        first, last = np.where(inner > 0, (-half - root) / square, 0), np.where(inner > 0, (-half + root) / square, 0)
        if settings.box is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                sides = np.sort((np.array(settings.box)[:, None, None] - place) / rays, axis=0)
            first = np.maximum(first, np.nan_to_num(sides[0], nan=-np.inf).max(-1))
            last = np.minimum(last, np.nan_to_num(sides[1], nan=np.inf).min(-1))
        first = np.maximum(first, 0)
        hit = last > first
        start[i], end[i] = np.where(hit, first, 0), np.where(hit, last, 0)
    return start, end
