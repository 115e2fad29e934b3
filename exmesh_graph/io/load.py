"""From lists of photographs to `Views`: the part of loading that all data sets share, with its checks."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import check_camera, intrinsics_from_fov, nearest_rotation, scale_intrinsics
from exmesh_graph.io.images import Photo, picture_size, read_mask, read_photo
from exmesh_graph.io.key import keyed
from exmesh_graph.io.normalise import cameras_to_normalised
from exmesh_graph.io.picture_files import Files
from exmesh_graph.io.reduce import downscale_area
from exmesh_graph.io.shots import Shot
from exmesh_graph.io.undistort import resampled
from exmesh_graph.resources import usable_cores
from exmesh_graph.types import Frame, Views
from exmesh_graph.types.pictures import Pictures, too_large

_SILHOUETTE_SIDE = 400
_PIXEL_BYTES = 64
"""Of a picture that is being read, for each of its pixels at full size: codes, floats, a mask, sums in float64."""
_READING_BYTES = 4 << 30
"""What pictures may take while they are read: more of them are read at once where they are small."""


@dataclass(frozen=True)
class Loaded:
    """Pictures and cameras of one split, still in the data set's world; images and alpha as in Views.

    silhouettes  float32 [N, h, w] and their intrinsics: the full-size masks, reduced to about 400 pixels whatever
                 `downscale` is, so that the normalised world does not depend on it
    """

    names: tuple[str, ...]
    images: np.ndarray | Pictures
    alpha: np.ndarray | Pictures
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

    A set that is too large for memory (`types.pictures`) goes into files, picture by picture.
    Training views may lack masks that others have: alpha is 1 all over them. Raises DataError, naming file or view,
    for: no views, doubled names, missing, undecodable or empty pictures, a mask or picture of another size, a test view
    without the mask that others have, and cameras that are singular or not rigid.
    """
    if not shots:
        raise DataError(f"there are no {split} views", expected="at least one", fix="check the data set's camera file")
    width, height = _size(shots[0])
    width, height = width // downscale, height // downscale
    files = Files.of(len(shots), height, width) if too_large(len(shots), height, width) else None
    many = max(1, _READING_BYTES // max(1, _PIXEL_BYTES * width * height * downscale**2))
    with ThreadPoolExecutor(min(usable_cores(), many)) as pool:
        read = _in_turn(pool, [(number, shot, downscale, files) for number, shot in enumerate(shots)], many)
        pictures = list(_alike(shots, read, split))
    full_intrinsics = np.stack([picture.intrinsics for picture in pictures])
    reduction = _reduction(pictures[0].size)
    return Loaded(
        names=tuple(shot.name for shot in shots),
        images=np.stack([picture.rgb for picture in pictures]) if files is None else files.images.stack(),
        alpha=np.stack([picture.alpha for picture in pictures]) if files is None else files.alpha.stack(),
        intrinsics=scale_intrinsics(full_intrinsics, downscale),
        camera_to_world=np.stack([picture.pose for picture in pictures]),
        has_masks=any(picture.masked for picture in pictures),
        clipped=any(picture.clipped for picture in pictures),
        digests=tuple(picture.digest for picture in pictures),
        silhouettes=np.stack([picture.silhouette for picture in pictures]),
        silhouette_intrinsics=scale_intrinsics(full_intrinsics, reduction),
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


def _size(shot: Shot) -> tuple[int, int]:
    """(width, height) that reading will give, (0, 0) where there is nothing to read: reading says so."""
    if not shot.image.is_file():
        return 0, 0
    return picture_size(shot.image) if shot.places is None else (shot.places.shape[1], shot.places.shape[0])


def _in_turn(
    pool: ThreadPoolExecutor, calls: Iterable[tuple[int, Shot, int, Files | None]], ahead: int
) -> Iterator[_Picture]:
    """`_picture` of each call, in order; at most `ahead` are under way or done and not yet taken."""
    waiting: deque[Future[_Picture]] = deque()
    try:
        for call in calls:
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
            waiting.append(pool.submit(_picture, *call))
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


class _Picture(NamedTuple):
    """What is kept of one shot: the picture at its working size, and what was measured at its full size.

    Of a picture that went into a file rgb and alpha are empty.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    silhouette: np.ndarray
    size: tuple[int, int]
    has_alpha: bool
    masked: bool
    clipped: bool
    digest: str
    intrinsics: np.ndarray
    pose: np.ndarray


def _picture(number: int, shot: Shot, downscale: int, files: Files | None) -> _Picture:
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
    reduction = _reduction(photo.size)
    whole = photo.alpha[: height // reduction * reduction, : width // reduction * reduction]
    rgb, alpha = (downscale_area(part, downscale, shot.image) for part in (photo.rgb, photo.alpha))
    if files is not None:
        files.put(number, rgb, alpha, photo.codes if downscale == 1 else None)
        rgb = alpha = np.empty(0, np.float32)
    return _Picture(
        rgb=rgb,
        alpha=alpha,
        silhouette=downscale_area(whole, reduction),
        size=photo.size,
        has_alpha=photo.has_alpha,
        masked=bool(photo.has_alpha and (photo.alpha < 1).any()),
        clipped=photo.clipped,
        digest=photo.digest(),
        intrinsics=k,
        pose=pose,
    )


def _reduction(size: tuple[int, int]) -> int:
    return max(1, round(max(size) / _SILHOUETTE_SIDE))


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
        codes = None if photo.has_alpha else photo.codes
        photo = Photo(np.ascontiguousarray(rgb), mask, True, photo.clipped, codes)
    elif shot.ground is not None and not photo.has_alpha and photo.codes is not None:
        photo = keyed(photo, shot.ground)
    if not (photo.alpha >= 0.5).any():
        raise DataError(
            "the mask is empty: no pixel has alpha >= 0.5", where=str(shot.mask or shot.image),
            expected="a silhouette of the object", fix="leave this view out, or mend its mask",
        )  # fmt: skip
    return photo if shot.places is None else resampled(photo, shot.places)


def _alike(shots: Sequence[Shot], pictures: Iterable[_Picture], split: str) -> Iterator[_Picture]:
    """The pictures as they come; DataError for one whose name or size does not go with those before."""
    seen: dict[str, Path] = {}
    first: _Picture | None = None
    for shot, photo in zip(shots, pictures, strict=True):
        first = first or photo
        if shot.name in seen:
            raise DataError(
                f"two views are called {shot.name!r}", where=str(shot.image), fix=f"rename one; see {seen[shot.name]}"
            )
        seen[shot.name] = shot.image
        if photo.size != first.size:
            raise DataError(
                f"the image is {photo.size[0]} x {photo.size[1]}, the first one {first.size[0]} x {first.size[1]}",
                where=str(shot.image),
                expected=f"all images of the size of {shots[0].image.name}",
                fix="resize or crop all images (and their cameras) alike before loading",
            )
        if split != "training" and photo.has_alpha != first.has_alpha:
            lacks, has = (shots[0], shot) if photo.has_alpha else (shot, shots[0])
            raise DataError(
                "the image has no alpha channel or mask, but others have", where=str(lacks.image),
                expected=f"a mask as {has.image.name} has", fix="add the missing mask: scores need it",
            )  # fmt: skip
        yield photo


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
