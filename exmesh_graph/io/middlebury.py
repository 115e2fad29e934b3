"""The Middlebury multi-view layout: `<name>_par.txt`, pictures beside it or in image/, masks in mask/.

A line per view: file name, K (9 numbers), R (9), t (3), with x ~ K (R X + t) and OpenCV axes.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import camera_to_world_from_rt
from exmesh_graph.io.settings import MiddleburyOptions, known_offset
from exmesh_graph.io.shots import Shot, need_folder, relative_names, shot_files, split

if TYPE_CHECKING:
    from exmesh_graph.io.scene import Scene


def list_middlebury(path: Path, options: MiddleburyOptions) -> tuple[list[Shot], list[Shot]]:
    """(train, test) without reading a picture. Test views are `first`, `first` + `holdout`, ... (0-based)."""
    return split(read_par(find_par(path), options), options.holdout, options.first, path, options.max_views)


def load_middlebury(path: Path, options: MiddleburyOptions | None = None) -> Scene:
    """Load and normalise; by the masks' hull where there are masks, else by `box` or the cameras."""
    from exmesh_graph.io.scene import load_scene

    options = options or MiddleburyOptions()
    train, test = list_middlebury(path, options)
    return load_scene(
        train, test, up=options.up, downscale=options.downscale, wrong_masks=options.wrong_masks, box=options.box,
        metres_per_unit=options.metres_per_unit, checks=options.checks, half_pixel=options.pixel_offset == "auto",
        size=options,
    )  # fmt: skip


def middlebury_files(path: Path, options: MiddleburyOptions) -> dict[str, Path]:
    """Every file that `load_middlebury` reads, by a name that does not depend on where the scene lies."""
    train, test = list_middlebury(path, options)
    return relative_names(path, [find_par(path), *shot_files([*train, *test])])


def find_par(path: Path) -> Path:
    """The one *_par.txt of the folder; DataError for none or several."""
    files = sorted(need_folder(path).glob("*_par.txt"))
    if len(files) != 1:
        raise DataError(
            f"the folder holds {len(files)} camera files", where=str(path), expected="one <name>_par.txt",
            fix="check the path, or remove the other files",
        )  # fmt: skip
    return files[0]


def read_par(file: Path, options: MiddleburyOptions) -> list[Shot]:
    """The views of a *_par.txt. DataError names file and line for anything but 21 numbers after a file name."""
    lines = [line for line in file.read_text(encoding="utf-8").splitlines() if line.strip()]
    if not lines or not lines[0].strip().isdigit() or int(lines[0]) != len(lines) - 1:
        raise DataError(
            f"the first line should be the number of views ({len(lines) - 1} follow)", where=str(file), fix="mend it"
        )
    if len(lines) == 1:
        raise DataError("the file lists no views", where=str(file))
    return [_shot(file, number, line, options) for number, line in enumerate(lines[1:], start=2)]


def _shot(file: Path, number: int, line: str, options: MiddleburyOptions) -> Shot:
    words = line.split()
    try:
        values = np.array(words[1:], dtype=np.float64)
    except ValueError:
        values = np.zeros(0)
    if len(values) != 21:
        raise DataError(
            f"line {number} does not hold 21 numbers after the file name", where=str(file),
            expected="name, K (9), R (9), t (3)",
        )  # fmt: skip
    intrinsics = values[:9].reshape(3, 3)
    intrinsics[:2, 2] += known_offset(options)  # from the file's pixel centres to ours at +0.5
    rotation, translation = values[9:18].reshape(3, 3), values[18:]
    folder = file.parent
    image = folder / "image" / words[0]
    image = image if image.is_file() else folder / words[0]
    if not image.is_file():
        raise DataError(
            "the image does not exist", where=str(folder / "image" / words[0]),
            expected=f"a picture for line {number} of {file.name}", fix="restore it, or remove the line",
        )  # fmt: skip
    return Shot(
        name=Path(words[0]).stem,
        image=image,
        mask=_mask(folder, image) if options.masks else None,
        intrinsics=intrinsics,
        # a singular or sheared R is left in place for `check_camera` to name
        camera_to_world=camera_to_world_from_rt(rotation, translation),
    )


def _mask(folder: Path, image: Path) -> Path | None:
    if not (folder / "mask").is_dir():
        return None
    mask = folder / "mask" / f"{image.stem}.png"
    if not mask.is_file():
        raise DataError(
            "the mask does not exist, though the folder mask/ does", where=str(mask),
            fix="restore it, or set masks: false",
        )  # fmt: skip
    return mask
