"""Pictures on one flat colour, as renderers and shops give them without alpha: what differs from it is the object.

Which colour, the frames of some pictures say: all of them must show it. The ground is what has this colour and is
joined to the frame, and gaps of it with hard borders. Where object and ground share a pixel its part is told by where
its colour lies between the two, so that masks are as soft as those of files and colours hold nothing of the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, find_objects, label, maximum_filter

from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.io.images import Photo, read_photo
from exmesh_graph.io.shots import Ground, Shot, spread

_ASKED = 6
"""Pictures of either split whose frames are looked at."""
_FRAME = 2
_EXACT, _LOOSE = 2.5 / 255, 10 / 255
"""Display values by which the ground may be off, least and (compressed pictures) most."""
_SHARE, _CUT_OFF = 0.9, 0.6
"""Of the frames' pixels that must show the ground: over all pictures, and in one, where the object may be cut off."""
_GAP = 6
"""Pixels of a gap at least."""
_HARD, _HARDER = 30 / 255, 60 / 255
"""Display values by which the second pixel beside a gap differs from the ground, at three of four places; before a
ground as white as can be, where highlights, which fade, look the same."""
_SPECK = 0.001
_SOLID, _NEAR = 2.0, 4.0
"""Pixels from the ground on which the object fills, and within which such a pixel's colour is asked."""
_LEAST = 12 / 255
_THIN = 0.1


def with_ground(train: Sequence[Shot], test: Sequence[Shot]) -> tuple[list[Shot], list[Shot], Ground | None]:
    """The shots as they are to be read, and the flat ground that they stand on; None, and as they came, without one.

    Shots with masks, or with alpha in their files, have no use for it.
    """
    asked = [split[i] for split in (train, test) for i in spread(len(split), _ASKED)]
    if any(shot.mask is not None or not shot.image.is_file() for shot in asked):
        return list(train), list(test), None
    photos = [read_photo(shot.image) for shot in asked]
    ground = flat_ground(photos)
    if ground is None:
        return list(train), list(test), None
    return [replace(shot, ground=ground) for shot in train], [replace(shot, ground=ground) for shot in test], ground


def ground_note(ground: Ground) -> str:
    """What the user is told of it."""
    return (
        f"the pictures have no alpha and stand on one colour ({_said(ground)}): what differs from it was taken for the "
        "object; key: false in the loader keeps them as they are"
    )


def contradicted_note(ground: Ground, covered: float) -> str:
    """What the user is told where the ground was left in, `covered` of the masks being covered by their hull."""
    return (
        f"the pictures have no alpha and stand on one colour ({_said(ground)}), but parts of the object have it "
        f"too, or pictures show nothing else: the hull of masks by colour covers {covered:.0%} of them. The pictures "
        "stay as they are; pictures with alpha, or masks beside them, are better by far"
    )


def _said(ground: Ground) -> str:
    return ", ".join(f"{255 * part:.0f}" for part in ground.colour) + " of 255"


def flat_ground(photos: Sequence[Photo]) -> Ground | None:
    """The one colour of all frames; None where there is none, or alpha, or the pictures are no files of integers."""
    if not photos or any(photo.has_alpha or photo.codes is None for photo in photos):
        return None
    frames = [_frame(_display(photo)) for photo in photos]
    colour = np.median(np.concatenate(frames), axis=0)
    off = [np.abs(frame - colour).max(axis=1) for frame in frames]
    every = np.concatenate(off)
    near = every <= _LOOSE
    if near.mean() < _SHARE or min((one <= _LOOSE).mean() for one in off) < _CUT_OFF or np.median(every) > _EXACT:
        return None
    red, green, blue = colour.tolist()
    return Ground((red, green, blue), float(np.clip(1.5 * np.quantile(every[near], 0.999), _EXACT, _LOOSE)))


def keyed(photo: Photo, ground: Ground) -> Photo:
    """The photo without its ground: linear colour times alpha, alpha, as a picture with alpha is read."""
    shown, colour = _display(photo), np.asarray(ground.colour, np.float32)
    away = np.abs(shown - colour).max(axis=-1)
    empty = _ground(away, ground)
    if empty.all() or not empty.any():
        return replace(photo, alpha=1.0 - empty.astype(np.float32), has_alpha=True, codes=None)
    alpha = _coverage(shown, colour, away, empty)
    own = colour + (shown - colour) / np.maximum(alpha, _THIN)[..., None]
    rgb = srgb_to_linear(np.clip(own, 0, 1)).astype(np.float32) * alpha[..., None]
    return Photo(np.ascontiguousarray(rgb), alpha, True, photo.clipped, None)


def _ground(away: np.ndarray, ground: Ground) -> np.ndarray:
    """bool [H, W]: what shows the ground, by how far pixels are away from its colour."""
    parts, count = label(away <= ground.off)
    size = np.bincount(parts.ravel(), minlength=count + 1)
    empty = np.zeros(count + 1, bool)
    empty[np.unique(_frame(parts[..., None]))] = True
    empty[0] = False
    hard = _HARDER if min(ground.colour) >= 1 - _EXACT else _HARD
    boxes = find_objects(parts)
    for part in np.flatnonzero((size >= _GAP) & ~empty).tolist():
        if part:
            around = tuple(slice(max(0, one.start - 3), one.stop + 3) for one in boxes[part - 1])
            here = parts[around] == part
            beside = binary_dilation(here, iterations=2) & ~binary_dilation(here) & (parts[around] == 0)
            empty[part] = beside.any() and np.quantile(away[around][beside], 0.25) > hard
    bare = empty[parts]
    islands, _ = label(~bare, np.ones((3, 3)))
    area = np.bincount(islands.ravel())
    area[0] = 0
    return bare | (area < _SPECK * area.max())[islands]


def _coverage(shown: np.ndarray, colour: np.ndarray, away: np.ndarray, empty: np.ndarray) -> np.ndarray:
    """float32 [H, W] in 256 steps: the object's part of each pixel."""
    inside = distance_transform_edt(~empty)
    rim = ~empty & (inside < _SOLID)
    solid = inside >= _SOLID
    own = shown.copy()
    if solid.any():
        far, nearest = distance_transform_edt(~solid, return_indices=True)
        own = shown[tuple(nearest)]
    else:
        far = np.full(empty.shape, np.inf)
    lone = rim & (far > _NEAR)  # of parts thinner than that the strongest colour nearby is the object's
    strongest = maximum_filter(away, size=3)
    own[lone] = shown[lone]
    line = own - colour
    long = np.square(line).sum(axis=-1)
    part = ((shown - colour) * line).sum(axis=-1) / np.maximum(long, 1e-12)
    part = np.where(lone, away / np.maximum(strongest, 1e-6), part)
    part = np.where(long < _LEAST**2, 1.0, part)
    alpha = np.where(empty, 0.0, np.where(rim, np.clip(part, 0, 1), 1.0))
    return (np.rint(255 * alpha) / 255).astype(np.float32)


def _display(photo: Photo) -> np.ndarray:
    """float32 [H, W, 3], the display values in a file of integers."""
    assert photo.codes is not None
    return photo.codes[..., :3].astype(np.float32) / np.iinfo(photo.codes.dtype).max


def _frame(picture: np.ndarray) -> np.ndarray:
    """[P, C]: the pixels along the border of [H, W, C]."""
    edge = np.zeros(picture.shape[:2], bool)
    for side in (np.s_[:_FRAME], np.s_[-_FRAME:], np.s_[:, :_FRAME], np.s_[:, -_FRAME:]):
        edge[side] = True
    return picture[edge]
