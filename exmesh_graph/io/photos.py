"""A plain folder of photographs, with masks if there are any: cameras are found from the pictures themselves.

Pictures lie in the folder, or in its images/ or image/; masks in masks/ or mask/ beside them, as IMG_1.png,
IMG_1.jpg.png (COLMAP) or IMG_1_mask.png for IMG_1.jpg, or in the pictures' own alpha channel. Or frames of a video
(`io.video`). They are made alike first (`io.working`): upright, at the working size. Blurred ones and those that repeat
their neighbour go (`io.selection`). What structure from motion sees is what the views are made of.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.exports import Export, find_export, read_export
from exmesh_graph.io.formats import OPAQUE, PICTURES, VIDEOS, need_libraries
from exmesh_graph.io.images import read_mask, read_photo
from exmesh_graph.io.motion import Motion, Through, find_motion, renamed
from exmesh_graph.io.normalise import some
from exmesh_graph.io.placed import Placed
from exmesh_graph.io.selection import choose
from exmesh_graph.io.settings import PhotosOptions
from exmesh_graph.io.shots import need_file, need_folder, relative_names
from exmesh_graph.io.video import extract_frames
from exmesh_graph.io.working import Working, prepare

_FEWEST = 3
_WHY = ("blurred beside the others", "nothing moved between them and a sharper neighbour")


def list_photos(path: Path, masks: bool = True) -> list[tuple[Path, Path | None]]:
    """(picture, mask file or None) by name, without reading pixels. DataError for fewer than three pictures."""
    if path.is_file():
        raise DataError(
            "the file is not a video", where=str(path), expected=f"a folder of pictures, or a file {' '.join(VIDEOS)}",
            fix="give the folder in which it lies",
        )  # fmt: skip
    folder = need_folder(path)
    place = next((folder / name for name in ("images", "image") if (folder / name).is_dir()), folder)
    pictures = sorted(f for f in place.iterdir() if f.suffix.lower() in PICTURES and not f.stem.endswith("_mask"))
    if len(pictures) < _FEWEST:
        film = next((f for f in sorted(place.iterdir()) if f.suffix.lower() in VIDEOS), None)
        raise DataError(
            f"the folder holds {len(pictures)} pictures", where=str(place),
            expected=f"at least {_FEWEST} ({' '.join(PICTURES)}), better 30 or more",
            fix="correct `path`" if film is None else f"for the video in it give the file: path: {film}",
        )  # fmt: skip
    stems = [f.stem for f in pictures]
    twin = next((f for f in pictures if stems.count(f.stem) > 1), None)
    if twin is not None:
        raise DataError(f"two pictures are called {twin.stem!r}", where=str(place), fix="remove or rename one")
    held = next((folder / name for name in ("masks", "mask") if (folder / name).is_dir()), place)
    return [(picture, _mask(held, picture) if masks else None) for picture in pictures]


def is_video(path: Path) -> bool:
    """Whether `path` is a file of one of the video formats."""
    return path.is_file() and path.suffix.lower() in VIDEOS


def photo_files(path: Path, options: PhotosOptions) -> dict[str, Path]:
    """Every file that `place_photos` reads, by a name that does not depend on where the scene lies."""
    if is_video(path):
        return need_file(path) | need_libraries([path])
    listed = list_photos(path, options.masks)
    export = _export(path, options)
    files = relative_names(path, [file for pair in listed for file in pair if file is not None])
    files |= relative_names(path, export.files() if export is not None else [])
    return files | need_libraries([picture for picture, _ in listed])


def _export(path: Path, options: PhotosOptions) -> Export | None:
    """The cameras of another program that are to be used."""
    export = find_export(path) if options.cameras != "find" else None
    if export is None and options.cameras == "file":
        raise DataError(
            "the folder has no cameras of another program", where=str(path),
            expected="sparse/0/ (COLMAP, RealityScan), transforms.json (nerfstudio), cameras.xml (Metashape), "
            "or .xmp files beside the pictures (RealityScan)",
            fix="export them into this folder, or set cameras: find",
        )  # fmt: skip
    return export


def _mask(folder: Path, picture: Path) -> Path | None:
    names = [f"{picture.stem}_mask.png", f"{picture.name}.png"]
    if folder != picture.parent:
        names.append(f"{picture.stem}.png")
    return next((folder / name for name in names if (folder / name).is_file()), None)


def place_photos(
    path: Path, options: PhotosOptions, work: Path, seed: int = 0, tell: Callable[[str], None] = lambda _: None
) -> Placed:
    """Photographs with cameras, by structure from motion or another program's.

    work  an empty folder for pictures as structure from motion sees them, and its database
    tell  is told what is being done

    Raises DataError for what `list_photos`, `extract_frames`, `prepare` and `find_motion` refuse.
    """
    listed, notes = _listed(path, options, work)
    working = prepare(listed, work / "pictures", options.megapixels)
    working, dropped = _kept(working, options, path)
    notes += [
        f"{len(names)} of {len(listed)} pictures are left out, {why} (`{knob}`): {some(names)}"
        for (knob, names), why in zip(dropped.items(), _WHY, strict=True)
        if names
    ]
    export = None if is_video(path) else _export(path, options)
    if export is not None:
        tell(f"cameras are {export.program}'s: {export.place}")
        motion = read_export(export, [picture for picture, _ in listed], working)
        if not len(motion.points):
            notes.append(
                f"{export.program}'s cameras come without points, which begin the depth and say where the object is"
            )
    else:
        motion = _motion(working, options, work, seed, tell)
    alpha = any(_has_alpha(one.image) for one in working)
    return Placed(path, options, working, replace(motion, dropped=dropped), alpha, notes)


def _listed(path: Path, options: PhotosOptions, work: Path) -> tuple[list[tuple[Path, Path | None]], list[str]]:
    """(pictures and masks, notes): those of the folder, or frames that are taken from a video now."""
    if not is_video(path):
        return list_photos(path, options.masks), []
    frames, note = extract_frames(path, options.frames, work / "frames")
    return [(frame, None) for frame in frames], [note] if note else []


def _kept(
    working: list[Working], options: PhotosOptions, path: Path
) -> tuple[list[Working], dict[str, tuple[str, ...]]]:
    """(pictures that stay, names of those that do not by the parameter that says so)."""
    soft, twins = choose([one.image for one in working], options.blurred, options.alike)
    kept = [one for k, one in enumerate(working) if k not in {*soft, *twins}]
    if len(kept) < _FEWEST:
        raise DataError(
            f"of {len(working)} pictures {len(soft)} are blurred and {len(twins)} repeat their neighbour",
            where=str(path), expected=f"{_FEWEST} others", fix="take pictures from more sides, or set `alike: 0`",
        )  # fmt: skip
    return kept, {name: tuple(working[k].name for k in chosen) for name, chosen in
                  (("blurred", soft), ("alike", twins))}  # fmt: skip


def _motion(
    working: list[Working], options: PhotosOptions, work: Path, seed: int, tell: Callable[[str], None]
) -> Motion:
    lenses = {one.lens for one in working}
    if options.focal > 0 and len(lenses) > 1:
        raise DataError(
            f"`focal` is one number, and the pictures are of {len(lenses)} cameras, sizes or focal lengths",
            where=str(working[0].image.parent), expected="focal: 0, which takes what EXIF says or finds it",
            fix="leave `focal` out, or give the pictures of one lens alone",
        )  # fmt: skip
    through = {
        one.image.name: Through(one.lens, options.focal * one.scale if options.focal > 0 else one.focal)
        for one in working
    }
    ignored = _alphas(working) if options.keep == "object" else {}
    motion = find_motion(
        [one.image for one in working], ignored, options.replaced(focal=0.0), work, seed, through, tell
    )  # fmt: skip
    return renamed(motion, {one.image.name: one.name for one in working})


def _alphas(working: list[Working]) -> dict[str, np.ndarray]:
    alphas = {}
    for one in working:
        alpha = read_mask(one.mask) if one.mask is not None else read_photo(one.image).alpha
        if (alpha < 1).any():
            alphas[one.image.name] = alpha
    return alphas


def _has_alpha(picture: Path) -> bool:
    return picture.suffix.lower() not in OPAQUE and bool((read_photo(picture).alpha < 1).any())
