"""Texture transfer: the same surface under a new atlas keeps its texture, texel by texel.

Every new texel knows its face and its place in it; the face knows the old UVs; the old texture is read there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.uv.raster import dilate, rasterize_atlas

COVER = 1.5  # texels: a bilinear lookup inside a chart reads texel centres up to sqrt(2) away from it


def transfer_texture(
    textures: Mapping[str, np.ndarray],
    old_uvs: np.ndarray,
    old_uv_faces: np.ndarray,
    new_uvs: np.ndarray,
    new_uv_faces: np.ndarray,
    size: int,
    *,
    sharpen: int = 1,
    smooth: frozenset[str] | set[str] = frozenset(),
    bounds: tuple[float, float] | None = None,
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Resample textures [R, R, C] from an old atlas to a new one of the same faces.

    sharpen  corrections T' += new_from_old(T - old_from_new(T')): a bilinear lookup alone blurs by half a texel
    smooth   names of textures that get no correction (second moments must stay >= 0)
    bounds   clamp of the corrected textures

    Returns ({name: float32 [size, size, C], filled to the last texel}, covered bool [size, size]).
    """
    if old_uv_faces.shape != new_uv_faces.shape:
        raise GeometryError(
            f"the old atlas has {len(old_uv_faces)} faces and the new one {len(new_uv_faces)}",
            expected="two atlases of the same faces",
        )
    old_size = next(iter(textures.values())).shape[0]
    forth, covered = _lookup(new_uvs, new_uv_faces, size, old_uvs, old_uv_faces)
    back, old_covered = _lookup(old_uvs, old_uv_faces, old_size, new_uvs, new_uv_faces)
    moved = {}
    for name, texture in textures.items():
        source = dilate(texture.astype(np.float64), old_covered)
        result = dilate(_apply(forth, covered, source), covered)
        for _ in range(0 if name in smooth else sharpen):
            error = dilate(_residual(source, back, old_covered, result), old_covered)
            result = dilate(result + _apply(forth, covered, error), covered)
            if bounds is not None:
                result = np.clip(result, *bounds)
        moved[name] = result.astype(np.float32)
    return moved, covered


def sample_bilinear(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Read texture [H, W, C] at uv [N, 2]: texel centres at (i + 0.5) / N, row 0 at v = 1, clamped at the rim."""
    height, width = texture.shape[:2]
    x = np.clip(uv[:, 0].astype(np.float64) * width - 0.5, 0.0, width - 1.0)
    y = np.clip((1.0 - uv[:, 1].astype(np.float64)) * height - 0.5, 0.0, height - 1.0)
    j, i = np.minimum(x.astype(np.int64), max(width - 2, 0)), np.minimum(y.astype(np.int64), max(height - 2, 0))
    fx, fy = (x - j)[:, None], (y - i)[:, None]
    j1, i1 = np.minimum(j + 1, width - 1), np.minimum(i + 1, height - 1)
    top = (1.0 - fx) * texture[i, j] + fx * texture[i, j1]
    low = (1.0 - fx) * texture[i1, j] + fx * texture[i1, j1]
    return (1.0 - fy) * top + fy * low


def _lookup(
    to_uvs: np.ndarray, to_faces: np.ndarray, size: int, from_uvs: np.ndarray, from_faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(UV in the `from` atlas of every covered texel of the `to` atlas, covered)."""
    face, bary = rasterize_atlas(to_uvs, to_faces, size, margin=COVER)
    covered = face >= 0
    corners = from_uvs.astype(np.float64)[from_faces[face[covered]]]
    return np.einsum("nk,nkc->nc", bary[covered].astype(np.float64), corners), covered


def _apply(uv: np.ndarray, covered: np.ndarray, texture: np.ndarray) -> np.ndarray:
    out = np.zeros((*covered.shape, texture.shape[2]))
    out[covered] = sample_bilinear(texture, uv)
    return out


def _residual(source: np.ndarray, uv: np.ndarray, covered: np.ndarray, result: np.ndarray) -> np.ndarray:
    out = np.zeros_like(source)
    out[covered] = source[covered] - sample_bilinear(result, uv)
    return out
