"""Depth maps from files: EXR or NPY in the stated units, 16-bit PNG with a scale."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.images import check_finite, read_raw
from exmesh_graph.io.settings import DepthOptions
from exmesh_graph.types import DepthMaps, Frame, Views

ENDINGS = (".exr", ".npy", ".png")


def depth_file(folder: Path, pattern: str, name: str) -> Path:
    """The depth map of a view: `pattern` with {name} and {stem} (the name after its last "_") filled in."""
    try:
        stem = folder / pattern.format(name=name, stem=name.rsplit("_", 1)[-1])
    except (KeyError, IndexError) as error:
        raise DataError(f"the pattern {pattern!r} cannot be filled in ({error})", where=str(folder),
                        expected="{name} or {stem}") from error  # fmt: skip
    candidates = [stem] if stem.suffix in ENDINGS else [stem.with_name(stem.name + e) for e in ENDINGS]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise DataError(
        "the depth map does not exist", where=str(stem), expected=" or ".join(c.name for c in candidates),
        fix="check `folder` and `pattern`",
    )  # fmt: skip


def read_depth(path: Path, scale: float = 1.0) -> np.ndarray:
    """Depth float32 [H, W], file values (integers as integers, not divided by 65535) times `scale`; 0 = none.

    DataError naming file, count and first pixel for NaN, Inf or negative depths.
    """
    path = Path(path)
    if path.suffix == ".npy":
        try:
            values = np.load(path, allow_pickle=False)
        except (ValueError, OSError, EOFError) as error:
            raise DataError(f"the depth map cannot be read ({error})", where=str(path), fix="save it again") from error
        values = values[..., 0] if values.ndim == 3 and values.shape[2] == 1 else values
        if values.ndim != 2:
            raise DataError(f"the depth map has shape {values.shape}", where=str(path), expected="(H, W)")
    else:
        values = read_raw(path)[..., 0]
    if values.dtype == np.uint8:
        raise DataError("an 8-bit depth map is too coarse", where=str(path), expected="16-bit PNG, EXR or NPY")
    depth = values.astype(np.float32)
    check_finite(depth[..., None], path)
    if (depth < 0).any():
        row, column = np.argwhere(depth < 0)[0]
        raise DataError(
            f"{int((depth < 0).sum())} depths are negative, the first at column {column}, row {row}", where=str(path),
            expected="distance along the camera's viewing axis, 0 for none", fix="turn the sign, or set them to 0",
        )  # fmt: skip
    return depth * np.float32(scale)


def load_depths(
    views: Views,
    folder: Path,
    options: DepthOptions | None = None,
    frame: Frame | None = None,
) -> DepthMaps:
    """Depth maps of all views in normalised units; files in the scene's units need its `frame`.

    Relative files grow with depth, up to a scale and a shift of each: every value counts (0 too), and each map is
    brought to [1, 2], so that a range kept beside the files is not needed.
    Maps of a whole multiple of the views' size are reduced by taking the block's middle sample: a mean across an edge
    would be the depth of nothing. Raises DataError for missing maps, other sizes, and scene units without a frame.
    """
    from exmesh_graph.io.normalise import frame_scale  # brings scipy, which listing the files does not need

    options = options or DepthOptions()
    relative, unit = options.units == "relative", options.scale
    if options.units == "scene":
        if frame is None:
            raise DataError(
                "depth maps in scene units need the scene's frame",
                fix='wire `frame: "@<loader>.frame"`, or set units: normalised',
            )
        unit = options.scale / frame_scale(frame)
    maps = []
    for name in views.names:
        file = depth_file(Path(folder), options.pattern, name)
        depth = read_depth(file, 1.0 if relative else unit)
        maps.append(_fit(_unit_range(depth, file) if relative else depth, views.height, views.width, file))
    return DepthMaps(views.names, np.stack(maps), "relative" if relative else "normalised")


def _unit_range(depth: np.ndarray, file: Path) -> np.ndarray:
    low, high = float(depth.min()), float(depth.max())
    if low == high:
        raise DataError("all depths are equal", where=str(file), expected="a depth map that tells near from far")
    return (1 + (depth - low) / (high - low)).astype(np.float32)


def depth_files(folder: Path) -> Sequence[Path]:
    """Every file in the folder that may be a depth map."""
    if not Path(folder).is_dir():
        raise DataError("the folder of depth maps does not exist", where=str(folder), fix="correct `folder`")
    return sorted(f for f in Path(folder).iterdir() if f.suffix in ENDINGS)


def _fit(depth: np.ndarray, height: int, width: int, file: Path) -> np.ndarray:
    factor = depth.shape[0] // height
    if factor < 1 or depth.shape != (height * factor, width * factor):
        raise DataError(
            f"the depth map is {depth.shape[1]} x {depth.shape[0]}, its view {width} x {height}", where=str(file),
            expected="the view's size or a whole multiple of it", fix="render or resize the depth maps",
        )  # fmt: skip
    return np.ascontiguousarray(depth[factor // 2 :: factor, factor // 2 :: factor])
