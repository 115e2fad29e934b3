"""The IDR / NeuS layout (DTU and others): cameras_sphere.npz with world_mat_i and scale_mat_i, image/*.png.

P_i = (world_mat_i @ scale_mat_i)[:3] takes points of the unit sphere to pixels; scale_mat is the data set's own
normalisation, which is kept.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import camera_to_world_from_rt, decompose_projection
from exmesh_graph.io.settings import IdrOptions, known_offset
from exmesh_graph.io.shots import Shot, need_folder, relative_names, shot_files, split

if TYPE_CHECKING:
    from exmesh_graph.io.scene import Scene

_CAMERAS = ("cameras_sphere.npz", "cameras.npz")


def list_idr(path: Path, options: IdrOptions) -> tuple[list[Shot], list[Shot], tuple[np.ndarray, float]]:
    """(train, test, sphere (centre, radius) in the data set's units) without reading a picture."""
    folder = need_folder(path)
    images = sorted(f for f in (folder / "image").glob("*") if f.suffix.lower() in (".png", ".jpg", ".jpeg"))
    matrices, file = _read_matrices(folder)
    count = sum(name.startswith("world_mat_") and name.removeprefix("world_mat_").isdigit() for name in matrices)
    if count != len(images) or not images:
        raise DataError(
            f"there are {len(images)} pictures in image/ but {count} cameras", where=str(file),
            expected="world_mat_0, world_mat_1, ... in the order of the pictures' names",
            fix="remove pictures without a camera, or export the cameras again",
        )  # fmt: skip
    masks = _masks(folder, images, options.masks)
    shots = []
    for i, image in enumerate(images):
        world = matrices[f"world_mat_{i}"]
        k, rotation, translation = decompose_projection(world[:3], f"{file}, world_mat_{i} (view {image.stem})")
        k[:2, 2] += known_offset(options)
        shots.append(Shot(image.stem, image, camera_to_world_from_rt(rotation, translation), k, masks[i]))
    train, test = split(shots, options.holdout, options.first, path, options.max_views)
    return train, test, _sphere(matrices, file, count)


def load_idr(path: Path, options: IdrOptions | None = None) -> Scene:
    """Load; normalised by the file's scale_mat."""
    from exmesh_graph.io.scene import load_scene

    options = options or IdrOptions()
    train, test, sphere = list_idr(path, options)
    return load_scene(
        train, test, up=options.up, downscale=options.downscale, sphere=sphere,
        metres_per_unit=options.metres_per_unit, checks=options.checks, half_pixel=options.pixel_offset == "auto",
        size=options,
    )  # fmt: skip


def idr_files(path: Path, options: IdrOptions) -> dict[str, Path]:
    """Every file that `load_idr` reads, by a name that does not depend on where the scene lies."""
    train, test, _ = list_idr(path, options)
    return relative_names(path, [camera_file(path), *shot_files([*train, *test])])


def camera_file(folder: Path) -> Path:
    """The npz with the cameras; DataError where there is none."""
    file = next((folder / name for name in _CAMERAS if (folder / name).is_file()), None)
    if file is None:
        raise DataError("there is no camera file", where=str(folder), expected=" or ".join(_CAMERAS))
    return file


def _read_matrices(folder: Path) -> tuple[dict[str, np.ndarray], Path]:
    file = camera_file(folder)
    try:
        with np.load(file, allow_pickle=False) as stored:
            return {name: np.array(stored[name], dtype=np.float64) for name in stored.files}, file
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise DataError(f"the camera file cannot be read ({error})", where=str(file), fix="copy it again") from error


def _sphere(matrices: dict[str, np.ndarray], file: Path, count: int) -> tuple[np.ndarray, float]:
    scales = [matrices.get(f"scale_mat_{i}", np.eye(4)) for i in range(count)]
    first = scales[0]
    same = all(np.allclose(s, first, rtol=1e-6, atol=1e-6) for s in scales)
    if not same or not np.allclose(first[:3, :3], np.eye(3) * first[0, 0]) or first[0, 0] <= 0:
        raise DataError(
            "scale_mat is not one scale and translation for all views", where=str(file),
            expected="[[s, 0, 0, tx], [0, s, 0, ty], [0, 0, s, tz], [0, 0, 0, 1]], s > 0",
        )  # fmt: skip
    return first[:3, 3], float(first[0, 0])


def _masks(folder: Path, images: list[Path], choice: str) -> list[Path | None]:
    if choice == "none" or (choice == "auto" and not (folder / "mask").is_dir()):
        return [None] * len(images)
    place = folder / ("mask" if choice == "auto" else choice)
    if not place.is_dir():
        raise DataError(
            "the folder of masks does not exist", where=str(place), fix="correct `masks`: auto, none, folder"
        )
    files = sorted(f for f in place.glob("*.png"))
    by_stem = {f.stem: f for f in files}
    if all(image.stem in by_stem for image in images):
        return [by_stem[image.stem] for image in images]
    if len(files) == len(images):  # DTU's masks are numbered 000.png where the pictures are 000000.png
        return list(files)
    raise DataError(
        f"there are {len(files)} masks for {len(images)} pictures", where=str(place),
        expected="one PNG for each picture, of the same name", fix="restore the missing ones, or set masks: none",
    )  # fmt: skip
