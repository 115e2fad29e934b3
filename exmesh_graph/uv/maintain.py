"""Keeping an atlas valid while the mesh under it changes (paper section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import components, face_areas, signed_areas_2d
from exmesh_graph.uv.raster import coverage_counts, dilate, rasterize_atlas
from exmesh_graph.uv.transfer import COVER


@dataclass(frozen=True)
class AtlasReport:
    """Figures on an atlas.

    charts     UV islands
    welded     UV coordinates shared by corners of different vertices: islands grown together by mistake
    flipped    faces with area in space whose UV area is negative or zero
    overlap    part of the covered texel centres that lie in more than one face
    covered    part of the texture under charts
    stretch    95th over 5th percentile of texel size per face, area weighted
    """

    charts: int
    welded: int
    flipped: int
    overlap: float
    covered: float
    stretch: float


def check_atlas(
    vertices: np.ndarray, faces: np.ndarray, uvs: np.ndarray, uv_faces: np.ndarray, texture_size: int
) -> AtlasReport:
    """Measure an atlas. Raises GeometryError when it cannot be used at all: bad indices, bad coordinates."""
    if uv_faces.shape != faces.shape:
        raise GeometryError(f"{len(faces)} faces but {len(uv_faces)} UV faces", expected="one UV face per face")
    if len(uv_faces) and (uv_faces.min() < 0 or uv_faces.max() >= len(uvs)):
        bad = int(((uv_faces < 0) | (uv_faces >= len(uvs))).sum())
        raise GeometryError(f"{bad} face corners name no UV coordinate", expected=f"indices in [0, {len(uvs)})")
    used = uvs[uv_faces.reshape(-1)]
    if not np.isfinite(used).all() or used.min(initial=0.0) < 0.0 or used.max(initial=0.0) > 1.0:
        raise GeometryError("UV coordinates outside [0, 1] or not finite", expected="an atlas in the unit square")
    owner = np.zeros(len(uvs), np.int64)
    owner[uv_faces.reshape(-1)] = faces.reshape(-1)
    strays = owner[uv_faces] != faces
    uv_area = signed_areas_2d(uvs, uv_faces)
    area = face_areas(vertices, faces)
    real = area > 1e-6 * max(float(area.mean()), 1e-300)
    texels = np.abs(uv_area) * texture_size**2
    layers = coverage_counts(uvs, uv_faces, texture_size)
    covered = layers > 0
    return AtlasReport(
        charts=int(components(uv_faces).max(initial=-1)) + 1,
        welded=len(set(zip(uv_faces[strays].tolist(), faces[strays].tolist(), strict=True))),
        flipped=int((real & (uv_area <= 0)).sum()),
        overlap=float((layers > 1).sum() / max(int(covered.sum()), 1)),
        covered=float(covered.mean()),
        stretch=_spread(np.sqrt(area[real] / np.maximum(texels[real], 1e-300)), area[real]),
    )


def refill(texture: np.ndarray, uvs: np.ndarray, uv_faces: np.ndarray, radius: float | None) -> np.ndarray:
    """Dilate a texture [R, R, C] from the texels that lookups inside charts can read into the space between charts."""
    face_id, _ = rasterize_atlas(uvs, uv_faces, texture.shape[:2], margin=COVER)
    return dilate(texture, face_id >= 0, radius)


def _spread(values: np.ndarray, weights: np.ndarray) -> float:
    if len(values) == 0:
        return 1.0
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order]) / weights.sum()
    low, high = values[order][np.minimum(np.searchsorted(share, [0.05, 0.95]), len(values) - 1)]
    return float(high / low)
