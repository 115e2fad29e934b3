"""Texture files of an exported asset: dilated, quantised, written and read back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.export.settings import MapSettings
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.images import read_raw, write_codes, write_image
from exmesh_graph.types import Asset


def prepare_maps(
    asset: Asset, settings: MapSettings, normal_bits: int = 8
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The maps as they go to files, and what was done to them.

    Returns ({"base_color" uint8 [R, R, 3] sRGB-encoded, "roughness" uint8 [R, R, 1], "normal" uint8 or uint16
    [R, R, 3] or absent, "metallic" uint8 [R, R, 1] or absent}, report). Texels outside charts are filled from the
    nearest chart within `dilation` texels, so that mip levels do not bleed; roughness is raised to the floor.
    """
    from exmesh_graph.uv.raster import coverage_counts, dilation_sources

    height, width = asset.base_color.shape[:2]
    inside = coverage_counts(asset.uvs, asset.uv_faces, (height, width)) > 0
    # A texel whose centre misses the chart is still fitted where bilinear lookups reach it: keep those values.
    valid = inside | asset.seen
    outside, source = dilation_sources(valid, settings.dilation)

    def fill(codes: np.ndarray) -> np.ndarray:
        codes[outside] = codes[source]
        return codes

    maps = {
        "base_color": fill(to_codes(linear_to_srgb(asset.base_color))),
        "roughness": fill(to_codes(np.maximum(asset.roughness[..., None], settings.roughness_floor))),
    }
    if asset.metallic is not None:
        maps["metallic"] = fill(to_codes(asset.metallic[..., None]))
    if asset.normal is not None:
        normal = np.where(valid[..., None], asset.normal, np.array([0, 0, 1], np.float32))
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        # undone by scale 2, bias -1 in the texture reader
        maps["normal"] = fill(to_codes(normal * 0.5 + 0.5, normal_bits))
    raised = (asset.roughness < settings.roughness_floor) & inside
    report = {
        "texture_size": max(height, width),
        "chart_texels": int(inside.sum()),
        "unseen_chart_texels": int((inside & ~asset.seen).sum()),
        "roughness_floor": float(settings.roughness_floor),
        "roughness_texels_raised": int(raised.sum()),
        "dilation_texels": int(settings.dilation),
    }
    return maps, report


def write_map(path: Path, codes: np.ndarray, *, srgb: bool = False) -> None:
    """Write uint8 or uint16 [H, W, C] as PNG and read it back; DataError when the file does not hold these very codes.

    `srgb` is written into the file's header too, for programs that open the picture by itself.
    """
    write_codes(path, codes, color_space="sRGB" if srgb else "")
    if not np.array_equal(read_raw(path), codes):
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


def to_codes(unit: np.ndarray, bits: int = 8) -> np.ndarray:
    """[0, 1] to the nearest of 2^bits code values: at most half a code value of error."""
    top = 2.0**bits - 1
    return np.floor(np.clip(unit, 0.0, 1.0) * np.asarray(unit).dtype.type(top) + 0.5).astype(f"uint{bits}")
