"""From lists of photographs to `Views`: the part of loading that all data sets share, with its checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import check_camera, intrinsics_from_fov, nearest_rotation, scale_intrinsics
from exmesh_graph.io.images import Photo, read_mask, read_photo
from exmesh_graph.io.normalise import cameras_to_normalised
from exmesh_graph.io.shots import Shot
from exmesh_graph.io.undistort import resampled
from exmesh_graph.types import Frame, Views

_SILHOUETTE_SIDE = 400


@dataclass(frozen=True)
class Loaded:
    """Pictures and cameras of one split, still in the data set's world.

    silhouettes  float32 [N, h, w] and their intrinsics: the full-size masks, reduced to about 400 pixels whatever
                 `downscale` is, so that the normalised world does not depend on it
    """

    names: tuple[str, ...]
    images: np.ndarray
    alpha: np.ndarray
    intrinsics: np.ndarray
    camera_to_world: np.ndarray
    has_masks: bool
    clipped: bool
    digests: tuple[str, ...]
    silhouettes: np.ndarray
    silhouette_intrinsics: np.ndarray
    downscale: int = 1


def load_shots(shots: Sequence[Shot], *, split: str, downscale: int = 1) -> Loaded:
    """Read all pictures of a split; linear, premultiplied, reduced by exact area averaging.

    Training views may lack masks that others have: alpha is 1 all over them. Raises DataError, naming file or view,
    for: no views, doubled names, missing, undecodable or empty pictures, a mask or picture of another size, a test view
    without the mask that others have, and cameras that are singular or not rigid.
    """
    if not shots:
        raise DataError(f"there are no {split} views", expected="at least one", fix="check the data set's camera file")
    photos, full_intrinsics, poses = [], [], []
    for shot in shots:
        photo = _read(shot)
        width, height = photo.size
        if shot.size is not None and shot.size != (width, height):
            raise DataError(
                f"the image is {width} x {height}, the camera file says {shot.size[0]} x {shot.size[1]}",
                where=str(shot.image), fix="use the images the cameras were made for, or correct w and h there",
            )  # fmt: skip
        k = shot.intrinsics if shot.intrinsics is not None else intrinsics_from_fov(shot.angle_x, width, height)
        check_camera(k, shot.camera_to_world, f"{shot.image} (camera of view {shot.name})")
        pose = np.array(shot.camera_to_world, dtype=np.float64)
        pose[:3, :3] = nearest_rotation(pose[:3, :3])
        photos.append(photo)
        full_intrinsics.append(k)
        poses.append(pose)
    _check_alike(shots, photos, split)
    side = max(photos[0].size)
    reduction = max(1, round(side / _SILHOUETTE_SIDE))
    has_masks = any(photo.has_alpha and (photo.alpha < 1).any() for photo in photos)
    return Loaded(
        names=tuple(shot.name for shot in shots),
        images=np.stack([downscale_area(photo.rgb, downscale, shots[0].image) for photo in photos]),
        alpha=np.stack([downscale_area(photo.alpha, downscale, shots[0].image) for photo in photos]),
        intrinsics=scale_intrinsics(np.stack(full_intrinsics), downscale),
        camera_to_world=np.stack(poses),
        has_masks=has_masks,
        clipped=any(photo.clipped for photo in photos),
        digests=tuple(photo.digest() for photo in photos),
        silhouettes=np.stack([_crop_and_reduce(photo.alpha, reduction) for photo in photos]),
        silhouette_intrinsics=scale_intrinsics(np.stack(full_intrinsics), reduction),
        downscale=downscale,
    )


def shifted(loaded: Loaded, offset: float) -> Loaded:
    """With `offset` pixels of the files added to all principal points, in x and y."""
    changed = {}
    for name in ("intrinsics", "silhouette_intrinsics"):
        k = getattr(loaded, name).copy()
        k[:, :2, 2] += (offset / loaded.downscale * k[:, 0, 0] / loaded.intrinsics[:, 0, 0])[:, None]
        changed[name] = k
    return replace(loaded, **changed)


def _crop_and_reduce(alpha: np.ndarray, factor: int) -> np.ndarray:
    height, width = (n // factor * factor for n in alpha.shape)
    return downscale_area(alpha[:height, :width], factor)


def _read(shot: Shot) -> Photo:
    photo = read_photo(shot.image)
    if shot.mask is not None:
        mask = read_mask(shot.mask)
        if mask.shape != photo.alpha.shape:
            raise DataError(
                f"the mask is {mask.shape[1]} x {mask.shape[0]}, its image {photo.size[0]} x {photo.size[1]}",
                where=str(shot.mask), fix=f"make the mask from {shot.image.name} at its full size",
            )  # fmt: skip
        rgb = photo.rgb if photo.has_alpha and not photo.clipped else photo.rgb * mask[..., None]
        photo = Photo(np.ascontiguousarray(rgb), mask, True, photo.clipped)
    if not (photo.alpha >= 0.5).any():
        raise DataError(
            "the mask is empty: no pixel has alpha >= 0.5", where=str(shot.mask or shot.image),
            expected="a silhouette of the object", fix="leave this view out, or mend its mask",
        )  # fmt: skip
    return photo if shot.places is None else resampled(photo, shot.places)


def _check_alike(shots: Sequence[Shot], photos: Sequence[Photo], split: str) -> None:
    seen: dict[str, Path] = {}
    for shot, photo in zip(shots, photos, strict=True):
        if shot.name in seen:
            raise DataError(
                f"two views are called {shot.name!r}", where=str(shot.image), fix=f"rename one; see {seen[shot.name]}"
            )
        seen[shot.name] = shot.image
        if photo.size != photos[0].size:
            raise DataError(
                f"the image is {photo.size[0]} x {photo.size[1]}, the first one "
                f"{photos[0].size[0]} x {photos[0].size[1]}",
                where=str(shot.image),
                expected=f"all images of the size of {shots[0].image.name}",
                fix="resize or crop all images (and their cameras) alike before loading",
            )
        if split != "training" and photo.has_alpha != photos[0].has_alpha:
            lacks, has = (shots[0], shot) if photo.has_alpha else (shot, shots[0])
            raise DataError(
                "the image has no alpha channel or mask, but others have", where=str(lacks.image),
                expected=f"a mask as {has.image.name} has", fix="add the missing mask: scores need it",
            )  # fmt: skip


def downscale_area(image: np.ndarray, factor: int, where: Path | str = "") -> np.ndarray:
    """Exact mean over factor x factor blocks of [H, W] or [H, W, C]; DataError unless factor divides H and W."""
    if factor == 1:
        return image
    height, width = image.shape[:2]
    if height % factor or width % factor:
        fits = [f for f in range(2, 17) if height % f == 0 and width % f == 0]
        raise DataError(
            f"{width} x {height} pixels cannot be reduced by {factor}", where=str(where),
            expected="a factor that divides width and height", fix=f"downscale: one of {fits or [1]}",
        )  # fmt: skip
    blocks = image.reshape(height // factor, factor, width // factor, factor, *image.shape[2:])
    return blocks.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)


def check_no_leak(train: Loaded, test: Loaded) -> None:
    """DataError if a test view is among the training views, by name or by the content of its picture."""
    for names, others, what in (
        (test.names, train.names, "name"),
        (test.digests, train.digests, "content"),
    ):
        shared = [i for i, value in enumerate(names) if value in set(others)]
        if shared:
            i = shared[0]
            twin = train.names[others.index(names[i])]
            raise DataError(
                f"{len(shared)} test views are also training views (same {what}); the first is {test.names[i]}, "
                f"which equals {twin}",
                fix="remove them from one of the two lists: figures on training pictures say nothing",
            )


def to_views(loaded: Loaded, frame: Frame, split: str, *, has_masks: bool) -> Views:
    """The split as `Views` in the normalised world."""
    return Views(
        names=loaded.names,
        images=loaded.images,
        alpha=loaded.alpha,
        intrinsics=loaded.intrinsics,
        camera_to_world=cameras_to_normalised(loaded.camera_to_world, frame),
        split=split,
        has_masks=has_masks,
        clipped=loaded.clipped,
    )
