"""Cameras that another program found, in the files it writes: COLMAP (and who writes COLMAP's files, as RealityScan
does), nerfstudio, Metashape, RealityScan.

They lie in the folder of the pictures: `sparse/0/`, `sparse/` or `colmap/sparse/0/` with cameras, images and points3D;
`transforms.json`; a `.xml` of Metashape's ("Export Cameras"); `.xmp` files of RealityScan's ("XMP metadata"), each
beside its picture. Cameras are of the files' own pixels, or of those turned
upright where only that fits; lenses are kept as they are and undone later, as those of `io.motion` are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.blender import read_frames, read_json
from exmesh_graph.io.cameras import intrinsics_from_fov
from exmesh_graph.io.exported import Found, no_points, read_metashape, read_sidecars, sidecars
from exmesh_graph.io.formats import read_header
from exmesh_graph.io.lens import AnyLens, Behind, Lens, turn
from exmesh_graph.io.mapping import Mapped
from exmesh_graph.io.meshes import read_points
from exmesh_graph.io.motion import SEEN_BY, Motion, motion_of
from exmesh_graph.io.normalise import some
from exmesh_graph.io.working import Working
from exmesh_graph.native import import_pycolmap

_MODELS = ("sparse/0", "sparse", "colmap/sparse/0")
#: Where the pictures are, and with them their sidecars.
_PLACES = ("images", "image", ".")
_PARTS = ("cameras", "images", "points3D", "rigs", "frames")
#: Quarter turns to the left that make a stored picture upright, by Exif's orientation; the others mirror.
_QUARTERS = {1: 0, 3: 2, 6: -1, 8: 1}


class Export(NamedTuple):
    """Of whose program, and its file or folder."""

    program: str
    place: Path

    def files(self) -> list[Path]:
        """What is read of it."""
        if self.program == "nerfstudio":
            cloud = _nerfstudio_cloud(self.place)
            return [self.place] if cloud is None else [self.place, cloud]
        if self.program == "RealityScan":
            return sidecars(self.place)
        if self.place.is_file():
            return [self.place]
        return [
            file for part in _PARTS for ending in (".bin", ".txt") if (file := self.place / (part + ending)).is_file()
        ]


def find_export(folder: Path) -> Export | None:
    """The cameras that lie in the folder, COLMAP's before others, which have no points."""
    for name in _MODELS:
        place = folder / name
        if all(any((place / (part + e)).is_file() for e in (".bin", ".txt")) for part in ("cameras", "images")):
            return Export("COLMAP", place)
    for file in sorted(folder.glob("*.xml")):
        with file.open("rb") as opened:
            if b"<document" in opened.read(2000):
                return Export("Metashape", file)
    file = folder / "transforms.json"
    if file.is_file():
        return Export("nerfstudio", file)
    return next((Export("RealityScan", folder / name) for name in _PLACES if sidecars(folder / name)), None)


def read_export(export: Export, pictures: Sequence[Path], working: Sequence[Working]) -> Motion:
    """The cameras of the `working` pictures, made of the files `pictures`, which are called as they are.

    Pictures that the export does not know are left out. Raises DataError where it cannot be read, where its cameras are
    of other sizes than the pictures, and where it knows fewer than three of them.
    """
    try:
        found = _READERS[export.program](export.place)
    except (KeyError, TypeError, ValueError) as error:
        what = f"{export.program}'s cameras cannot be read ({type(error).__name__}: {error})"
        raise DataError(what, where=str(export.place), fix="export them again, or set cameras: find") from error
    own, places = _by_name(found.poses), {picture.name: picture for picture in pictures}
    poses: dict[str, np.ndarray] = {}
    lenses: dict[tuple[int, int, float], Behind] = {}
    camera: dict[str, int] = {}
    for one in working:
        name = own.get(one.name) or own.get(Path(one.name).stem.lower())
        if name is None:
            continue
        lens = found.lenses[name]
        quarter = _quarters(places[one.name], lens, export) + one.quarter
        key = (id(lens), quarter % 4, one.scale)
        behind = lenses.setdefault(key, Behind(lens, quarter, 1 / one.scale))
        poses[one.name], camera[one.name] = found.poses[name] @ turn(quarter), list(lenses).index(key)
        if (behind.width, behind.height) != one.size:
            raise _other_size(places[one.name], lens, export)
    if len(poses) < 3:
        raise DataError(
            f"{export.program}'s cameras are of {len(found.poses)} pictures, of which {len(poses)} lie in the folder",
            where=str(export.place), expected=f"cameras of {some([one.name for one in working])}",
            fix="export the cameras of these pictures, or set cameras: find to look for them in the pictures",
        )  # fmt: skip
    return Motion(
        camera_to_world=poses, camera=camera, lenses=list(lenses.values()), points=found.points, colours=found.colours,
        tracks=found.tracks, left_out=tuple(one.name for one in working if one.name not in poses), error=found.error,
        focal_known=True, how=f"{export.program}'s", matching="",
    )  # fmt: skip


def _by_name(poses: Mapping[str, np.ndarray]) -> dict[str, str]:
    """{a picture's name, or its stem in small letters: what the export calls it}."""
    names: dict[str, str] = {}
    for name in poses:
        last = PurePosixPath(name.replace("\\", "/")).name
        for key in (last, PurePosixPath(last).stem.lower(), last.lower()):
            names.setdefault(key, name)
    return names


def _quarters(picture: Path, lens: AnyLens, export: Export) -> int:
    """Quarter turns to the left from the pixels that the lens is of to the upright picture."""
    header, size = read_header(picture), (lens.width, lens.height)
    if size == header.size and header.orientation in _QUARTERS:
        return _QUARTERS[header.orientation]
    if header.orientation >= 5 and size == header.size[::-1]:
        return 0
    raise _other_size(picture, lens, export)


def _other_size(picture: Path, lens: AnyLens, export: Export) -> DataError:
    wide, high = read_header(picture).size
    return DataError(
        f"the picture is {wide} x {high}, its camera in {export.program}'s export {lens.width} x {lens.height}",
        where=str(picture), expected="the pictures that the cameras were found for",
        fix="export the cameras of these pictures, or set cameras: find",
    )  # fmt: skip


def _read_colmap(place: Path) -> Found:
    colmap = import_pycolmap()
    try:
        model = colmap.Reconstruction(str(place))
    except (ValueError, RuntimeError, OSError) as error:
        raise DataError(f"COLMAP's model cannot be read ({error})", where=str(place)) from error
    names = frozenset(image.name for image in model.images.values())
    motion = motion_of(Mapped(model, names, "", 0, 0), (), "")
    lenses = {name: motion.lenses[number] for name, number in motion.camera.items()}
    return Found(motion.camera_to_world, lenses, motion.points, motion.colours, motion.tracks, motion.error)


def _read_nerfstudio(file: Path) -> Found:
    poses, lenses = {}, {}
    known: dict[Lens, Lens] = {}
    for shot in read_frames(file.parent, file, "false"):
        lens = shot.lens
        if lens is None:
            size = shot.size or read_header(shot.image).size
            k = shot.intrinsics if shot.intrinsics is not None else intrinsics_from_fov(shot.angle_x, *size)
            lens = Lens(*size, (k[0, 0], k[1, 1]), (k[0, 2], k[1, 2]))
        poses[shot.image.name], lenses[shot.image.name] = shot.camera_to_world, known.setdefault(lens, lens)
    cloud = _nerfstudio_cloud(file)
    if cloud is None:
        return Found(poses, lenses, *no_points())
    points = read_points(cloud)  # of which it is not said how many pictures see them
    return Found(poses, lenses, points, np.full_like(points, 0.5), np.full(len(points), SEEN_BY))


def _nerfstudio_cloud(file: Path) -> Path | None:
    """The sparse points that transforms.json names, where they are there."""
    content = read_json(file)
    named = content.get("ply_file_path") if isinstance(content, dict) else None
    cloud = file.parent / str(named)
    return cloud if named and cloud.is_file() else None


_READERS: dict[str, Callable[[Path], Found]] = {
    "COLMAP": _read_colmap, "nerfstudio": _read_nerfstudio, "Metashape": read_metashape, "RealityScan": read_sidecars,
}  # fmt: skip
