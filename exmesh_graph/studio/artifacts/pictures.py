"""Looks at artifacts that are pictures: single views, contact sheets, maps, atlases, environments."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from exmesh_graph.gallery.atlas import atlas_panels
from exmesh_graph.gallery.levels import bytes_of, reduced
from exmesh_graph.gallery.pictures import error_map, false_colours, marked
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.images import display
from exmesh_graph.studio.artifacts.shelf import Arrays, NoArtifact, Shelf
from exmesh_graph.types import Asset, Carrier, DepthMaps, EnvMap, Region, SceneTruth, ScoredViews, Views

_EDGE = np.array([1.0, 0.85, 0.1])
MOST_SIDE = 8192


class Sheet(NamedTuple):
    """A contact sheet: WebP bytes, and how its tiles lie."""

    data: bytes
    columns: int
    rows: int
    width: int
    height: int


def picture(shelf: Shelf, digest: str, show: str, layer: str, index: int, side: int, exposure: float) -> np.ndarray:
    """A look as display values [H, W, 3] in [0, 1], no side above `side` (0: as it is). Raises NoArtifact."""
    kind = shelf.kind(digest)
    if issubclass(kind, Views | DepthMaps | Region | SceneTruth | ScoredViews) and show != "environment":
        try:
            made = _of_stack(shelf.arrays(digest), kind, show, layer, index)
        except (IndexError, KeyError):
            raise NoArtifact(f"there is no picture {index} of {show} ({layer})") from None
        return _small(made, side)
    value = shelf.value(digest)
    if show == "environment":
        radiance = (
            getattr(value, "radiance", None) if isinstance(value, EnvMap) else getattr(value, "environment", None)
        )
        if radiance is not None:
            return _small(_tone(radiance, exposure), side)
    if show == "atlas" and isinstance(value, Carrier) and len(value.uvs):
        return _atlas(value, layer, side or 1024)
    if show == "maps" and isinstance(value, Carrier):
        return _map(value, layer, side)
    raise NoArtifact(f"{kind.type_name} has no look {show!r}")


def contact_sheet(shelf: Shelf, digest: str, show: str, layer: str, side: int, first: int, count: int) -> Sheet:
    """Pictures from `first` on in a grid, each in a tile of `side` at most, row by row. Raises NoArtifact."""
    tiles: list[np.ndarray] = []
    for index in range(first, first + count):
        try:
            tiles.append(picture(shelf, digest, show, layer, index, side, 0.0))
        except NoArtifact:
            if not tiles:
                raise
            break
    height, width = max(t.shape[0] for t in tiles), max(t.shape[1] for t in tiles)
    columns = max(1, round(np.sqrt(len(tiles) * 1.6 * height / width)))
    rows = -(-len(tiles) // columns)
    canvas = np.zeros((rows * height, columns * width, 3), np.uint8)
    for number, tile in enumerate(tiles):
        y, x = number // columns * height, number % columns * width
        canvas[y : y + tile.shape[0], x : x + tile.shape[1]] = bytes_of(tile)
    return Sheet(encoded(canvas), columns, rows, width, height)


def encoded(values: np.ndarray, *, exact: bool = False) -> bytes:
    """Display values as WebP; `exact`: as PNG, for masks and what is measured by eye."""
    from PIL import Image

    out = io.BytesIO()
    made = Image.fromarray(bytes_of(values)).convert("RGB")
    made.save(out, "PNG", compress_level=1) if exact else made.save(out, "WEBP", quality=90, method=0)
    return out.getvalue()


def _of_stack(arrays: Arrays, kind: Any, show: str, layer: str, index: int) -> np.ndarray:
    if issubclass(kind, ScoredViews):
        return _scored(arrays, layer, index)
    if issubclass(kind, DepthMaps):
        return _depth(arrays.row("depth", index))
    if issubclass(kind, Region):
        name = {"mask": "inside"}.get(layer, layer)
        row = arrays.row(name, index)
        return _gray(np.asarray(row, np.float32)) if name == "inside" else _depth(row)
    if issubclass(kind, SceneTruth):
        return _truth(arrays, show, layer, index)
    if show == "lights":
        return _tone(arrays.row("environments", index), 0.0)
    alpha = arrays.row("alpha", index)
    if layer == "mask":
        return _gray(alpha)
    image = display(arrays.row("images", index), alpha)
    return _outlined(image, alpha) if layer == "overlay" else image


def _scored(arrays: Arrays, layer: str, index: int) -> np.ndarray:
    ours, truth = (np.asarray(one, np.float32) for one in arrays.row("images", index))
    looks: dict[str, Callable[[], np.ndarray]] = {
        "ours": lambda: ours, "truth": lambda: truth, "error": lambda: error_map(ours, truth),
        "marks": lambda: marked(truth, arrays.row("marks", index)),
        "beside": lambda: np.concatenate([ours, truth], axis=1),
    }  # fmt: skip
    return looks[layer if layer in looks else "beside"]()


def _truth(arrays: Arrays, show: str, layer: str, index: int) -> np.ndarray:
    if show.startswith("relit/"):
        return display(arrays.row(f"{show}/images", index), arrays.row(f"{show}/alpha", index))
    row = arrays.row(layer if layer in ("albedo", "roughness", "depth", "normal") else "albedo", index)
    if layer == "depth":
        return _depth(row)
    if layer == "normal":
        return np.where((row != 0).any(axis=-1, keepdims=True), 0.5 + 0.5 * row, 0.0)
    return _gray(row) if row.ndim == 2 else linear_to_srgb(np.clip(row, 0, 1))


def _depth(depth: np.ndarray) -> np.ndarray:
    """Near bright, far dark, over the range of what was measured; black where nothing was."""
    known = np.isfinite(depth) & (depth > 0)
    if not known.any():
        return np.zeros((*depth.shape, 3), np.float32)
    low, high = np.quantile(depth[known], [0.01, 0.99])
    near = 1.0 - np.clip((depth - low) / max(high - low, 1e-12), 0, 1)
    return np.where(known[..., None], false_colours(0.08 + 0.92 * near), 0.0)


def _map(carrier: Carrier, name: str, side: int) -> np.ndarray:
    if name == "texture" or not isinstance(carrier, Asset):
        return reduced(carrier.texture, side)
    values = getattr(carrier, name, None) if name in Asset.layout else None
    if values is None or values.ndim < 2 or values.shape[:2] != carrier.base_color.shape[:2]:
        raise NoArtifact(f"the asset has no map {name!r}")
    small = reduced(values.astype(np.float32), side)
    if name == "base_color":
        return linear_to_srgb(np.clip(small, 0, 1))
    return 0.5 + 0.5 * small if name == "normal" else _gray(small)


def _atlas(carrier: Carrier, layer: str, side: int) -> np.ndarray:
    size = min(max(side, 64), 2048)
    if layer == "texture":
        return reduced(carrier.texture, size)
    panels, _ = atlas_panels(carrier, size)
    named = dict(zip(("stretch", "anisotropy", "texture"), panels, strict=True))
    return named[layer] if layer in named else np.concatenate(panels, axis=1)


def _tone(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """A light at an exposure (in stops) beside the one that its 90th percentile asks for."""
    scale = 0.7 / max(float(np.quantile(radiance, 0.9)), 1e-6) * 2.0**exposure
    return linear_to_srgb(np.clip(radiance * scale, 0, 1))


def _outlined(image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """The picture with the edge of its mask in yellow."""
    inside = alpha > 0.5
    edge = np.zeros_like(inside)
    for axis in (0, 1):
        change = np.diff(inside, axis=axis)
        for sides in ((0, 1), (1, 0)):
            edge |= np.pad(change, [sides if k == axis else (0, 0) for k in (0, 1)])
    return np.where(edge[..., None], _EDGE, image)


def _gray(values: np.ndarray) -> np.ndarray:
    return np.repeat(np.asarray(values, np.float32)[..., None], 3, axis=-1)


def _small(image: np.ndarray, side: int) -> np.ndarray:
    """Reduced by whole blocks first, then by the picture library to the very size."""
    if not side or max(image.shape[:2]) <= side:
        return image
    from PIL import Image

    longer = max(image.shape[:2])
    coarse = bytes_of(reduced(image, max(side, longer // max(longer // side, 1))))
    scale = side / max(coarse.shape[:2])
    size = max(1, round(coarse.shape[1] * scale)), max(1, round(coarse.shape[0] * scale))
    return np.asarray(Image.fromarray(coarse).resize(size, Image.Resampling.BOX))
