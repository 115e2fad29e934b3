"""Local edits of an asset's maps: a region of texels is set, scaled or painted over; all others keep their bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from exmesh_graph.edit.settings import Channel, Operation
from exmesh_graph.errors import DataError
from exmesh_graph.types import Asset
from exmesh_graph.uv.surface import TexelSurface
from exmesh_graph.uv.transfer import sample_bilinear


def ball_region(
    surface: TexelSurface, center: Sequence[float] | np.ndarray, radius: float, feather: float = 0.0
) -> np.ndarray:
    """Weights float32 [R, R] of texels within `radius` of `center`; they fall to 0 over the outer `feather` share."""
    distance = np.linalg.norm(surface.position - np.asarray(center, np.float32), axis=-1)
    if feather <= 0:
        return (distance <= radius).astype(np.float32)
    return np.clip((radius - distance) / (feather * radius), 0, 1).astype(np.float32)


def mask_region(mask: np.ndarray, size: int) -> np.ndarray:
    """Weights float32 [size, size] of a UV-space picture [h, w] in [0, 1] (row 0 is v = 1), bilinear."""
    if mask.shape == (size, size):
        return mask.astype(np.float32)
    v, u = np.meshgrid(*2 * [(np.arange(size) + 0.5) / size], indexing="ij")
    return _sample(mask[..., None].astype(np.float32), u, v)[..., 0]


def decal(
    surface: TexelSurface,
    picture: np.ndarray,
    center: Sequence[float] | np.ndarray,
    radius: float,
    upright: Sequence[float] = (0, 1, 0),
) -> np.ndarray:
    """A picture [h, w, 4] laid onto the surface around `center`: [R, R, 4] per texel, 0 where it does not reach.

    It is projected along the mean normal of the ball of `radius` around `center`, its longer side 2 radius long, its
    top towards `upright`; surfaces that face away, or lie outside the ball, get none of it.
    """
    inside = ball_region(surface, center, radius) > 0
    if not inside.any():
        return np.zeros((*inside.shape, picture.shape[-1]), np.float32)
    axis = surface.normal[inside].mean(axis=0)
    axis /= max(float(np.linalg.norm(axis)), 1e-12)
    up = np.asarray(upright, float) - np.dot(upright, axis) * axis
    if np.linalg.norm(up) < 1e-3:  # looking along `upright`: any direction across will do
        up = np.cross(axis, (1.0, 0.0, 0.0))
    up /= np.linalg.norm(up)
    offset = surface.position - np.asarray(center, np.float32)
    height, width = picture.shape[:2]
    longest = max(height, width)
    u = 0.5 + 0.5 * offset @ np.cross(up, axis) / radius * longest / width
    v = 0.5 - 0.5 * offset @ up / radius * longest / height
    reached = inside & (surface.normal @ axis > 0) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
    return np.where(reached[..., None], _sample(picture.astype(np.float32), u.clip(0, 1), v.clip(0, 1)), np.float32(0))


def edited(asset: Asset, channel: Channel, weight: np.ndarray, operation: Operation, value: np.ndarray) -> Asset:
    """`asset` with one map changed where `weight` [R, R] > 0: old + weight (new - old), clipped to [0, 1].

    value   set: the new value; scale: the factor (both [C] or [1]); paint: new values [R, R, C], linear
    A metallic map that is not there starts at 0. Texels of weight 0 keep their bytes.
    """
    old = getattr(asset, channel)
    if old is None:
        old = np.zeros_like(asset.roughness)
    layers = old if old.ndim == 3 else old[..., None]
    value = np.asarray(value, np.float32)
    if operation != "paint" and value.shape not in ((1,), (layers.shape[-1],)):
        raise DataError(
            f"{value.size} values for {channel}", expected=f"1 or {layers.shape[-1]} number(s)", fix="correct `value`"
        )
    new = layers * value if operation == "scale" else np.broadcast_to(value, layers.shape)
    mixed = np.clip(layers + weight[..., None] * (new - layers), 0, 1).astype(np.float32)
    result = np.where(weight[..., None] > 0, mixed, layers)
    return replace(asset, **{channel: np.ascontiguousarray(result.reshape(old.shape))})


def _sample(image: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Bilinear, clamped, at image coordinates [...] u right and v down in [0, 1]."""
    uv = np.stack([u.reshape(-1), 1 - v.reshape(-1)], axis=-1)
    return sample_bilinear(image, uv).reshape(*u.shape, image.shape[-1]).astype(np.float32)
