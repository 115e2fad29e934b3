"""A plain folder of photographs, with masks if there are any: cameras are found from the pictures themselves.

Pictures lie in the folder, or in its images/ or image/; masks in masks/ or mask/ beside them, as IMG_1.png,
IMG_1.jpg.png (COLMAP) or IMG_1_mask.png for IMG_1.jpg, or in the pictures' own alpha channel.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import rotation_to_y, scene_from_dataset
from exmesh_graph.io.images import picture_size, read_mask, read_photo
from exmesh_graph.io.motion import Motion, find_motion
from exmesh_graph.io.normalise import nearest_point, points_to_normalised, some
from exmesh_graph.io.settings import PhotosOptions
from exmesh_graph.io.shots import Shot, need_folder, relative_names, split
from exmesh_graph.io.undistort import pinhole
from exmesh_graph.types import PointCloud

if TYPE_CHECKING:
    from exmesh_graph.io.scene import Scene

_ENDINGS = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
_OPAQUE = (".jpg", ".jpeg")  # no alpha in these: not worth reading
_FEWEST = 3
_STRAIGHT = 0.05  # pixels
_NEAR, _ROOM = 0.7, 1.05


def list_photos(path: Path, masks: bool = True) -> list[tuple[Path, Path | None]]:
    """(picture, mask file or None) by name, without reading pixels. DataError for fewer than three pictures."""
    folder = need_folder(path)
    place = next((folder / name for name in ("images", "image") if (folder / name).is_dir()), folder)
    pictures = sorted(f for f in place.iterdir() if f.suffix.lower() in _ENDINGS and not f.stem.endswith("_mask"))
    if len(pictures) < _FEWEST:
        raise DataError(
            f"the folder holds {len(pictures)} pictures", where=str(place),
            expected=f"at least {_FEWEST} {', '.join(_ENDINGS)}, better 30 or more", fix="correct `path`",
        )  # fmt: skip
    stems = [f.stem for f in pictures]
    twin = next((f for f in pictures if stems.count(f.stem) > 1), None)
    if twin is not None:
        raise DataError(f"two pictures are called {twin.stem!r}", where=str(place), fix="remove or rename one")
    held = next((folder / name for name in ("masks", "mask") if (folder / name).is_dir()), place)
    return [(picture, _mask(held, picture) if masks else None) for picture in pictures]


def photo_files(path: Path, options: PhotosOptions) -> dict[str, Path]:
    """Every file that `load_photos` reads, by a name that does not depend on where the scene lies."""
    listed = list_photos(path, options.masks)
    return relative_names(path, [file for pair in listed for file in pair if file is not None])


def _mask(folder: Path, picture: Path) -> Path | None:
    names = [f"{picture.stem}_mask.png", f"{picture.name}.png"]
    if folder != picture.parent:
        names.append(f"{picture.stem}.png")
    return next((folder / name for name in names if (folder / name).is_file()), None)


def load_photos(path: Path, options: PhotosOptions, work: Path, seed: int = 0) -> tuple[Scene, PointCloud, Motion]:
    """Find cameras, undo the lens, load and normalise; sparse points in the normalised world.

    work  an empty folder for the database of features

    The world is Y-up by level cameras, by the mean of the cameras' up where these do not tell. Its sphere comes from
    the masks, else from the sparse points around the place that the cameras look at (`object_sphere`).
    Raises DataError for what `list_photos`, `find_motion` and `load_scene` refuse.
    """
    from exmesh_graph.io.scene import load_scene

    listed = list_photos(path, options.masks)
    _check_sizes([picture for picture, _ in listed])
    ignored = _alphas(listed) if options.keep == "object" else {}
    motion = find_motion([picture for picture, _ in listed], ignored, options, work, seed)
    shots = _shots(listed, motion)
    train, test = split(shots, options.holdout, options.first, path)
    poses = np.stack([shot.camera_to_world for shot in shots])
    turn, note = _upright(poses)
    train, test = ([replace(s, camera_to_world=turn @ s.camera_to_world) for s in part] for part in (train, test))
    points = motion.points @ turn[:3, :3].T
    masked = any(mask is not None for _, mask in listed) or any(_has_alpha(picture) for picture, _ in listed)
    sphere = None if masked else object_sphere(points, motion.tracks, turn @ poses)
    scene = load_scene(
        train, test, up="y", downscale=options.downscale, wrong_masks=options.wrong_masks, sphere=sphere,
        checks=options.checks,
    )  # fmt: skip
    if note:
        scene.notes.append(note)
    if motion.left_out:
        scene.notes.append(
            f"no camera that holds was found for {len(motion.left_out)} of {len(listed)} pictures, which are left out: "
            f"{some(motion.left_out)}"
        )
    cloud = PointCloud(points_to_normalised(points, scene.frame).astype(np.float32), motion.colours.astype(np.float32))
    return scene, cloud, motion


def object_sphere(points: np.ndarray, tracks: np.ndarray, camera_to_world: np.ndarray) -> tuple[np.ndarray, float]:
    """(centre [3], radius) of what stands amidst the cameras, without masks.

    Of the sparse points, those nearer than the cameras to the point that the optical axes pass most closely, each
    counted by the pictures that see it: their median, and the distance that holds 98 % of them, and a little.
    """
    origins, axes = camera_to_world[:, :3, 3], camera_to_world[:, :3, 2]
    middle = nearest_point(origins, axes)
    reach = np.median(np.linalg.norm(origins - middle, axis=1))
    near = np.linalg.norm(points - middle, axis=1) < _NEAR * reach
    if near.sum() < 10:
        raise DataError(
            f"{int(near.sum())} sparse points lie where the cameras look, too few to locate the object",
            fix="add masks, or take pictures from more sides",
        )
    many = np.repeat(points[near], tracks[near], axis=0)
    centre = np.median(many, axis=0)
    return centre, float(np.quantile(np.linalg.norm(many - centre, axis=1), 0.98)) * _ROOM


def _check_sizes(pictures: list[Path]) -> None:
    sizes = [picture_size(picture) for picture in pictures]
    common = max(set(sizes), key=sizes.count)
    other = [p.name for p, size in zip(pictures, sizes, strict=True) if size != common]
    if other:
        raise DataError(
            f"{len(other)} pictures have another size than {common[0]} x {common[1]}, which most have: {some(other)}",
            where=str(pictures[0].parent), expected="pictures of one size, none turned",
            fix="resize or turn them, or take them out",
        )  # fmt: skip


def _alphas(listed: list[tuple[Path, Path | None]]) -> dict[str, np.ndarray]:
    alphas = {}
    for picture, mask in listed:
        alpha = read_mask(mask) if mask is not None else read_photo(picture).alpha
        if (alpha < 1).any():
            alphas[picture.name] = alpha
    return alphas


def _has_alpha(picture: Path) -> bool:
    return picture.suffix.lower() not in _OPAQUE and bool((read_photo(picture).alpha < 1).any())


def _shots(listed: list[tuple[Path, Path | None]], motion: Motion) -> list[Shot]:
    width, height = picture_size(listed[0][0])
    pinholes: list[tuple[np.ndarray, np.ndarray | None]] = []
    for lens in motion.lenses:
        k = lens.calibration_matrix()
        grid, places = pinhole(lens.img_from_cam, k, width, height)
        straight = np.abs(grid - k).max() < _STRAIGHT and np.abs(places - _centres(width, height)).max() < _STRAIGHT
        pinholes.append((k, None) if straight else (grid, places))
    shots = []
    for picture, mask in listed:
        if picture.name in motion.camera_to_world:
            k, where = pinholes[motion.camera[picture.name]]
            pose = motion.camera_to_world[picture.name]
            shots.append(Shot(picture.stem, picture, pose, k, mask, (width, height), places=where))
    return shots


def _centres(width: int, height: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def _upright(poses: np.ndarray) -> tuple[np.ndarray, str]:
    """(rotation [4, 4] that makes the world Y-up, a note where it is a guess)."""
    try:
        return scene_from_dataset("auto", poses), ""
    except DataError:
        up = -poses[:, :3, 1].mean(0)
        rotation = np.eye(4)
        rotation[:3, :3] = rotation_to_y(up / max(np.linalg.norm(up), 1e-12))
        return rotation, "the cameras do not tell which way is up: the mean of their own is taken"
