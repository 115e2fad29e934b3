"""From a lens to a pinhole: which pinhole, and where its pixels lie in the photograph."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from exmesh_graph.io.cameras import reduced_size
from exmesh_graph.io.images import Photo
from exmesh_graph.io.reduce import area_means
from exmesh_graph.io.resample import cubic

_SCALES = (0.5, 2.0)
_APART = 1.1  # pixels between places from which on they would miss what lies between them

Project = Callable[[np.ndarray], np.ndarray]
"""Rays [P, 3] of camera axes to pixels [P, 2] of the photograph."""


def pinhole(
    project: Project, intrinsics: np.ndarray, width: int, height: int, to: tuple[int, int] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(K [3, 3], float32 [h, w, 2] pixels of the photograph) of the widest pinhole all of whose pixels it holds.

    intrinsics  the lens's without distortion, for a photograph of `width` x `height`
    to          (w, h) of the pinhole's picture, its own if not given: a picture of another shape loses what does not
                fit at two sides, one of another size is resampled

    The focal lengths are multiplied by one factor, between 1/2 and 2 beside what `to` asks for; the principal point
    stays where it is, or in the same place from the middle.
    """
    wide, high = (width, height) if to is None else to
    enlarged = max(wide / width, high / height)
    middle = intrinsics[:2, 2] if enlarged == 1 and (wide, high) == (width, height) else (
        np.array([wide, high]) / 2 + enlarged * (intrinsics[:2, 2] - np.array([width, height]) / 2)
    )  # fmt: skip
    x, y = np.meshgrid(np.arange(wide) + 0.5, np.arange(high) + 0.5)
    edge = np.ones((high, wide), bool)
    edge[1:-1, 1:-1] = False
    border = np.stack([x[edge], y[edge]], axis=1)

    def places(pixels: np.ndarray, scale: float) -> np.ndarray:
        focal = scale * enlarged * np.array([intrinsics[0, 0], intrinsics[1, 1]])
        rays = (pixels - middle) / focal
        return project(np.concatenate([rays, np.ones((len(rays), 1))], axis=1))

    def held(scale: float) -> bool:
        at = places(border, scale)
        return bool(((at >= 0) & (at <= [width, height])).all())

    least, most = _SCALES
    for _ in range(40):
        half = (least + most) / 2
        least, most = (least, half) if held(half) else (half, most)
    k = np.array(intrinsics, np.float64)
    k[[0, 1], [0, 1]] *= most * enlarged
    k[:2, 2] = middle
    where = places(np.stack([x.ravel(), y.ravel()], axis=1), most)
    return k, where.reshape(high, wide, 2).astype(np.float32)


def resampled(photo: Photo, places: np.ndarray) -> Photo:
    """The photograph at `places` [H, W, 2], by cubic splines in linear, premultiplied light; where places lie further
    apart than pixels, of means over areas as large."""
    apart = float(np.median(np.linalg.norm(np.diff(places, axis=1), axis=-1))) if places.shape[1] > 1 else 1.0
    factor = apart if apart > _APART else 1.0
    height, width = photo.alpha.shape
    small = np.array(reduced_size((width, height), factor))
    places = (places - np.array([width, height]) / 2) / factor + small / 2
    parts = [photo.rgb, photo.alpha[..., None]] if photo.has_alpha else [photo.rgb]
    if factor != 1:
        parts = [area_means(part[..., c], factor)[..., None] for part in parts for c in range(part.shape[-1])]
    sampled = cubic(np.concatenate(parts, axis=-1), np.moveaxis(places, -1, 0)[::-1] - 0.5)
    alpha = np.clip(sampled[..., 3], 0, 1) if photo.has_alpha else np.ones(places.shape[:2], np.float32)
    top = alpha[..., None] if photo.clipped else np.inf
    return Photo(np.clip(sampled[..., :3], 0, top), alpha, photo.has_alpha, photo.clipped)
