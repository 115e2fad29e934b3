"""Texture files of an exported asset: dilated, quantised, written and read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.images import read_raw, write_image
from exmesh_graph.types import Asset


def prepare_maps(asset: Asset, *, roughness_floor: float, dilation: int) -> tuple[dict[str, np.ndarray], dict]:
    """The maps as they go to files, and what was done to them.

    Returns ({"base_color" uint8 [R, R, 3] sRGB-encoded, "roughness" uint8 [R, R, 1], "normal" uint8 [R, R, 3]
    or absent, "metallic" uint8 [R, R, 1] or absent}, report). Texels outside charts are filled from the
    nearest chart within `dilation` texels, so that mip levels do not bleed; roughness is raised to the floor.
    """
    from exmesh_graph.uv.dilate import dilate
    from exmesh_graph.uv.raster import rasterize_atlas

    size = asset.base_color.shape[0]
    face_id, _ = rasterize_atlas(asset.uvs, asset.uv_faces, size)
    inside = np.asarray(face_id) >= 0
    # A texel whose centre misses the chart is still fitted where bilinear lookups reach it: keep those values.
    valid = inside | asset.seen

    def fill(texture: np.ndarray) -> np.ndarray:
        return np.asarray(dilate(np.ascontiguousarray(texture, np.float32), valid, dilation))

    raised = (asset.roughness < roughness_floor) & inside
    maps = {
        "base_color": to_bytes(linear_to_srgb(fill(asset.base_color))),
        "roughness": to_bytes(np.maximum(fill(asset.roughness[..., None]), roughness_floor)),
    }
    if asset.metallic is not None:
        maps["metallic"] = to_bytes(fill(asset.metallic[..., None]))
    if asset.normal is not None:
        normal = np.where(valid[..., None], asset.normal, np.array([0, 0, 1], np.float32))
        normal = fill(normal)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        maps["normal"] = to_bytes(normal * 0.5 + 0.5)  # undone by scale 2, bias -1 in the texture reader
    report = {
        "texture_size": int(size),
        "chart_texels": int(inside.sum()),
        "unseen_chart_texels": int((inside & ~asset.seen).sum()),
        "roughness_floor": float(roughness_floor),
        "roughness_texels_raised": int(raised.sum()),
        "dilation_texels": int(dilation),
    }
    return maps, report


def write_map(path: Path, pixels: np.ndarray) -> None:
    """Write uint8 [H, W, C] as PNG and read it back; DataError when the file does not hold exactly these bytes."""
    if pixels.dtype != np.uint8:
        raise DataError(f"a texture map needs uint8, got {pixels.dtype}", where=str(path))
    write_image(path, pixels / 255.0)
    if not np.array_equal(read_raw(path), pixels):
        raise DataError("the texture does not read back as it was written", where=str(path))


def write_environment(path: Path, radiance: np.ndarray) -> float:
    """Write linear [H, W, 3] as half-float EXR; return the largest relative rounding error read back.

    DataError when a value comes back further off than half a unit in the last place (2^-11) of a half float.
    """
    write_image(path, radiance, "half")
    back = read_raw(path).astype(np.float32)
    error = np.abs(back - radiance) / np.maximum(np.abs(radiance), 2.0**-14)  # 2^-14: smallest normal half
    if not np.isfinite(back).all() or error.max() > 2.0**-11 * 1.01:
        raise DataError("the environment does not read back as it was written", where=str(path))
    return float(error.max())


def to_bytes(unit: np.ndarray) -> np.ndarray:
    """[0, 1] to the nearest of 256 code values: at most half a code value of error."""
    return np.floor(np.clip(unit, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
