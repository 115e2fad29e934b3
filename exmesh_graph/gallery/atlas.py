"""An atlas in colours of stretch: texel size, anisotropy, texture. Needs neither torch nor a rasteriser of views."""

from __future__ import annotations

import numpy as np

from exmesh_graph.gallery.pictures import resize
from exmesh_graph.geometry.adjacency import components, face_areas
from exmesh_graph.types import Carrier
from exmesh_graph.uv.raster import rasterize_atlas

_BACKGROUND = (0.78, 0.78, 0.78)
_SMALL, _EVEN, _LARGE = np.array([0.13, 0.40, 0.67]), np.array([0.97, 0.97, 0.97]), np.array([0.70, 0.09, 0.17])


def atlas_panels(carrier: Carrier, size: int) -> tuple[list[np.ndarray], str]:
    """The atlas [size, size, 3] by texel size, by anisotropy, and as texture; and words that explain them.

    Texel size is sqrt(area in space / area in the atlas) over its median; anisotropy the ratio of the two singular
    values of the map from the atlas to the surface.
    """
    longer, shorter = _singular_values(carrier)
    with np.errstate(divide="ignore", invalid="ignore"):
        texel = np.sqrt(longer * shorter)
        whole = np.isfinite(texel) & (texel > 0)
        texel = texel / (np.median(texel[whole]) if whole.any() else 1.0)
        aspect = np.where(shorter > 0, longer / shorter, np.inf)
    face_id, _ = rasterize_atlas(carrier.uvs, carrier.uv_faces, size)
    chart = np.where(face_id >= 0, components(carrier.uv_faces)[face_id], -1)
    border = np.zeros(chart.shape, bool)
    for axis in (0, 1):
        change = np.diff(chart, axis=axis) != 0
        border |= np.pad(change, [(0, 1) if k == axis else (0, 0) for k in (0, 1)])
    panels = []
    for values in (_diverging(np.log2(np.where(whole, texel, 2.0))), _rising(np.clip(aspect - 1.0, 0.0, 1.0))):
        picture = np.where((face_id >= 0)[..., None], values[face_id], _BACKGROUND)
        picture[border] *= 0.35
        panels.append(picture)
    panels.append(resize(np.asarray(carrier.texture, np.float64), size))
    area = face_areas(carrier.vertices, carrier.faces)
    spread = _quantiles(texel[whole], area[whole])
    skewed = _quantiles(aspect[whole], area[whole])[1]
    words = (
        f"{int(chart.max(initial=-1)) + 1} charts cover {np.mean(face_id >= 0):.0%}. Left: texel size against the "
        f"median, blue half, red twice ({spread[0]:.2f} to {spread[1]:.2f} on nine tenths of the surface). Middle: "
        f"anisotropy, white 1, red 2 or more (95 % below {skewed:.2f}). Right: the texture."
    )
    return panels, words


def _singular_values(carrier: Carrier) -> tuple[np.ndarray, np.ndarray]:
    """(longer, shorter) float64 [F]: how much a unit step in the atlas is stretched in space; 0 without UV area."""
    p = carrier.vertices[carrier.faces].astype(np.float64)
    q = carrier.uvs[carrier.uv_faces].astype(np.float64)
    d, e = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    det = d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]
    safe = np.where(det != 0, det, np.inf)[:, None]
    u = ((p[:, 1] - p[:, 0]) * e[:, 1:] - (p[:, 2] - p[:, 0]) * d[:, 1:]) / safe
    v = ((p[:, 2] - p[:, 0]) * d[:, :1] - (p[:, 1] - p[:, 0]) * e[:, :1]) / safe
    a, b, c = (np.einsum("fi,fi->f", x, y) for x, y in ((u, u), (u, v), (v, v)))
    root = np.sqrt(np.maximum((a - c) ** 2 + 4 * b * b, 0.0))
    return np.sqrt(np.maximum(0.5 * (a + c + root), 0.0)), np.sqrt(np.maximum(0.5 * (a + c - root), 0.0))


def _diverging(octaves: np.ndarray) -> np.ndarray:
    t = np.clip(octaves, -1.0, 1.0)[:, None]
    return _EVEN + np.where(t < 0, -t * (_SMALL - _EVEN), t * (_LARGE - _EVEN))


def _rising(part: np.ndarray) -> np.ndarray:
    return _EVEN + part[:, None] * (_LARGE - _EVEN)


def _quantiles(values: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """The values below which 5 and 95 % of the weight lie."""
    if len(values) == 0:
        return 1.0, 1.0
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order]) / weights.sum()
    low, high = values[order][np.minimum(np.searchsorted(share, [0.05, 0.95]), len(values) - 1)]
    return float(low), float(high)
