"""Lists of photographs before any of them is read: light enough for `exmesh check`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.lens import Lens


class Ground(NamedTuple):
    """The flat colour that pictures without alpha stand on (`io.key`): display values [3] in [0, 1], and by how much a
    pixel of it may differ."""

    colour: tuple[float, float, float]
    off: float


@dataclass(frozen=True)
class Shot:
    """One photograph as a data set lists it, before any picture is read.

    name             unique over train and test
    image, mask      files; the mask may be None
    intrinsics       float64 [3, 3] in pixels of the full-size image, pixel centres at +0.5; None: `angle_x` is meant
    camera_to_world  float64 [4, 4], OpenCV axes, the data set's own world
    size             (width, height) the data set states, or None
    angle_x          full horizontal field of view in radians, where only that is known
    places           float32 [H, W, 2], (x, y) in the file of every pixel of the view, where a lens is undone on reading
    ground           what is no object in a picture without alpha, or None
    lens             what bends the picture's lines, in pixels of the file; None: nothing does (`io.one_size` undoes it)
    """

    name: str
    image: Path
    camera_to_world: np.ndarray
    intrinsics: np.ndarray | None = None
    mask: Path | None = None
    size: tuple[int, int] | None = None
    angle_x: float = 0.0
    places: np.ndarray | None = None
    ground: Ground | None = None
    lens: Lens | None = None


def hold_out(count: int, every: int, first: int) -> tuple[list[int], list[int]]:
    """Indices (train, test) of `count` views: test are `first`, `first` + `every`, ... (0-based)."""
    test = list(range(first, count, every)) if every > 0 else []
    return [i for i in range(count) if i not in set(test)], test


def split(shots: Sequence[Shot], every: int, first: int, path: Path, most: int = 0) -> tuple[list[Shot], list[Shot]]:
    """(train, at most `most`, evenly spread; test) of a ring of views. DataError where either would be empty."""
    kept, held = hold_out(len(shots), every, first)
    if not kept or not held:
        raise DataError(
            f"{len(shots)} views cannot be split: every {every}-th from index {first} is for testing",
            where=str(path), fix="lower `holdout` or `first`",
        )  # fmt: skip
    return [shots[kept[i]] for i in spread(len(kept), most)], [shots[i] for i in held]


def all_or_none(files: list[Path], what: str, fix: str) -> list[Path]:
    """`files`, one of each test view, or none of them; DataError where only some are there."""
    there = [file for file in files if file.is_file()]
    if there and len(there) < len(files):
        missing = next(file for file in files if not file.is_file())
        raise DataError(f"{what} does not exist, though those of other test views do", where=str(missing), fix=fix)
    return there


def spread(count: int, most: int) -> list[int]:
    """At most `most` of `count` indices, evenly spread (all of them for most = 0)."""
    if most <= 0 or most >= count:
        return list(range(count))
    return sorted({int((i + 0.5) * count / most) for i in range(most)})


def shot_files(shots: Sequence[Shot]) -> list[Path]:
    """Pictures and masks of the shots."""
    return [file for shot in shots for file in (shot.image, shot.mask) if file is not None]


def relative_names(folder: Path, files: Sequence[Path]) -> dict[str, Path]:
    """{name relative to the folder (or the file's own name, when outside): file}; DataError for a missing one."""
    names: dict[str, Path] = {}
    for file in files:
        if not file.is_file():
            raise DataError("the file does not exist", where=str(file), fix="restore it, or correct the scene file")
        inside = file.is_relative_to(folder)
        names[file.relative_to(folder).as_posix() if inside else f"{file.parent.name}/{file.name}"] = file
    return names


def need_file(path: Path) -> dict[str, Path]:
    """{its name: `path`}, the source of a node that reads one file; DataError if it is not there."""
    if not path.is_file():
        raise DataError("the file does not exist", where=str(path), fix="correct `path`")
    return {path.name: path}


def need_folder(path: Path) -> Path:
    """`path`, or DataError if it is not a folder."""
    path = Path(path)
    if not path.is_dir():
        raise DataError("the scene folder does not exist", where=str(path), fix="correct the loader's `path`")
    return path
