"""Masks of views from a folder, by the views' names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.formats import PICTURES
from exmesh_graph.io.images import read_mask
from exmesh_graph.io.reduce import downscale_area
from exmesh_graph.io.shots import need_folder
from exmesh_graph.types import Views


def mask_files(folder: Path) -> Mapping[str, Path]:
    """Every PNG of the folder by its name, without reading pixels. DataError where there is no such folder, or none."""
    files = {file.name: file for file in sorted(need_folder(folder).iterdir()) if file.suffix.lower() == ".png"}
    if not files:
        raise DataError(
            "the folder holds no masks", where=str(folder), expected="a PNG for each view, white on the object",
            fix="correct `path`",
        )  # fmt: skip
    return files


def masks_for(views: Views, folder: Path) -> Iterator[np.ndarray]:
    """float32 [H, W] in [0, 1] of each view, in order; reduced by exact means where the views are smaller.

    A view is looked for by its name as NAME_mask.png, NAME.png, and NAME with its picture's ending and .png (COLMAP's
    way). Raises DataError naming the view and the files tried where it has none, and for a mask of another shape.
    """
    files = mask_files(folder)
    named = [(name, _file(files, name, folder)) for name in views.names]  # all are missed before any is read
    for name, file in named:
        yield _fitted(read_mask(file), views, file, name)


def _file(files: Mapping[str, Path], view: str, folder: Path) -> Path:
    name = Path(view).name
    plain = [f"{name}_mask.png", f"{name}.png"]
    known = {file.lower(): path for file, path in files.items()}
    for wanted in [*plain, *(f"{name}{ending}.png" for ending in PICTURES)]:
        found = files.get(wanted) or known.get(wanted.lower())
        if found is not None:
            return found
    raise DataError(
        f"view {view} has no mask", where=str(folder), expected=f"{', '.join(plain)}, {name}.jpg.png or the like",
        fix="add it, or leave the view out",
    )  # fmt: skip


def _fitted(mask: np.ndarray, views: Views, file: Path, view: str) -> np.ndarray:
    """The mask at the views' size: a whole multiple of it, but for last rows and columns, as `train_side` reduces."""
    factor = max(1, mask.shape[0] // views.height)
    if (mask.shape[0] // factor, mask.shape[1] // factor) != (views.height, views.width):
        raise DataError(
            f"the mask of view {view} is {mask.shape[1]} x {mask.shape[0]}", where=str(file),
            expected=f"{views.width} x {views.height}, or a whole multiple of it",
            fix="make it from the picture as the views have it: upright, and with its lens undone",
        )  # fmt: skip
    return downscale_area(mask[: views.height * factor, : views.width * factor], factor)
