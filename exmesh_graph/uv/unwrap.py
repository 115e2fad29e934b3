"""A UV atlas: valid for every face, never mirrored, packed to exactly the texture that will be used.

Charts are nearly flat discs of our own (`layout`), or xatlas's. xatlas's packing is not used: it exceeds a wished
resolution by up to 30 %, so that the padding shrinks when the atlas is scaled back, and leaves half of it empty.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_areas, require_mesh, signed_areas_2d
from exmesh_graph.geometry.pixels import FINENESS, pixel_width
from exmesh_graph.types import Stage1State
from exmesh_graph.uv.cut import Sheets, cut_open, defects
from exmesh_graph.uv.layout import lay_out
from exmesh_graph.uv.mend import adopt, mend
from exmesh_graph.uv.pack import NoRoomError, pack
from exmesh_graph.uv.settings import AtlasSettings, DiscSettings, XatlasSettings
from exmesh_graph.uv.transfer import transfer_texture

_COVERED = 0.6  # of an atlas by its charts: 0.54 to 0.73 on smooth surfaces of the scenes for choosing
_FULL = 0.75  # of an atlas by its charts and what they keep free around them
_LARGEST = 8192


def unwrap(
    vertices: np.ndarray,
    faces: np.ndarray,
    texture_size: int = 1024,
    settings: AtlasSettings | None = None,
    *,
    warn: Callable[[str], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Cut the mesh into charts, flatten them, pack them into one square atlas.

    vertices      float [V, 3]; faces int [F, 3]
    texture_size  R, texels on a side: one texel has the same size on all charts, isotropic
    settings      DiscSettings (default) or XatlasSettings say whose charts
    warn          is told of cuts, and where xatlas was not done in time

    Returns uvs float32 [T, 2] in [0, 1], origin lower left, and uv_faces int32 [F, 3], the corner map Phi. UV area is
    positive for every face with area; two corners share a UV index only if they are the same vertex in the same chart.
    Deterministic. Raises GeometryError for an empty, non-finite or non-manifold mesh, DataError
    for arrays of another shape or type.
    """
    settings = settings or DiscSettings()
    return _packed(_charts(vertices, faces, settings, warn), texture_size, settings.padding)


def unwrap_at(
    vertices: np.ndarray,
    faces: np.ndarray,
    texel: float,
    settings: AtlasSettings | None = None,
    *,
    warn: Callable[[str], None] | None = None,
) -> tuple[np.ndarray, np.ndarray, int]:
    """(uvs, uv_faces) as `unwrap`, and the side of an atlas whose texels span about `texel`, in world units.

    A multiple of 64, 64 to 8192. Many small charts spend most of an atlas on the space between them: it is packed again
    for the side that this one tells, at most twice that of charts which cover `_COVERED` of it. Where they do not fit
    at all the side is doubled until they do. Raises as `unwrap`, NoRoomError where 8192 texels are too few.
    """
    settings = settings or DiscSettings()
    charts = _charts(vertices, faces, settings, warn)
    wanted = float(face_areas(vertices, faces).sum()) / texel**2  # texels of charts
    side = _side(wanted / _COVERED)
    while (packed := _packed_if(charts, side, settings.padding)) is None:
        side *= 2
    uvs, uv_faces = packed
    there = max(float(np.abs(signed_areas_2d(uvs, uv_faces)).sum()) * side**2, 1.0)
    # the space around charts grows with their outlines, as the root of their area
    between = max(_FULL * side**2 - there, 0.0) * math.sqrt(wanted / there)
    larger = min(_side((wanted + between) / _FULL), 2 * side, _LARGEST)
    if larger > side:
        uvs, uv_faces = _packed(charts, larger, settings.padding)
    return uvs, uv_faces, max(larger, side)


def shown_texel(vertices: np.ndarray, intrinsics: np.ndarray, world_to_camera: np.ndarray) -> float:
    """Width in world units of a texel as fine as N views show the surface: `FINENESS` pixels at the object's middle."""
    return FINENESS * pixel_width(intrinsics, world_to_camera, np.asarray(vertices, np.float64).mean(axis=0))


def regenerate(
    state: Stage1State,
    texture_size: int,
    settings: AtlasSettings | None = None,
    *,
    texel: float | None = None,
    warn: Callable[[str], None] | None = None,
) -> Stage1State:
    """The state under a new atlas, its texture and texture moments resampled to `texture_size` texels on a side.

    texel  in place of `texture_size`, see `unwrap_at`
    A texel's gradient grows with the surface it stands for, so the moments are scaled by the ratio of texel areas.
    """
    mesh = state.vertices, state.faces
    if texel is None:
        uvs, uv_faces = unwrap(*mesh, texture_size, settings, warn=warn)
    else:
        uvs, uv_faces, texture_size = unwrap_at(*mesh, texel, settings, warn=warn)
    atlas = (state.uvs, state.uv_faces, uvs, uv_faces, texture_size)
    colour, _ = transfer_texture({"texture": state.texture}, *atlas, bounds=(0.0, 1.0))
    moments, _ = transfer_texture({"m": state.texture_m, "v": state.texture_v}, *atlas, sharpen=0)
    old_area = float(np.abs(signed_areas_2d(state.uvs, state.uv_faces)).sum()) * state.texture.shape[0] ** 2
    new_area = float(np.abs(signed_areas_2d(uvs, uv_faces)).sum()) * texture_size**2
    growth = np.float32(old_area / max(new_area, 1e-300))  # of the surface under one texel
    first, second = moments["m"] * growth, moments["v"] * growth**2
    return replace(state, uvs=uvs, uv_faces=uv_faces, texture=colour["texture"], texture_m=first, texture_v=second)


class _Charts(NamedTuple):
    """Flat charts of a mesh, not yet packed."""

    points: np.ndarray
    faces: np.ndarray
    sheets: Sheets
    flat: np.ndarray
    corners: np.ndarray
    orphans: np.ndarray


def _charts(
    vertices: np.ndarray, faces: np.ndarray, settings: AtlasSettings, warn: Callable[[str], None] | None
) -> _Charts:
    require_mesh(vertices, faces, "unwrap")
    points = _scaled(vertices, faces)
    sheets = cut_open(points, faces, settings.cut_nonmanifold)
    if settings.cut_nonmanifold and warn is not None and (wrong := defects(faces)):
        warn(f"the mesh is not manifold and was cut open for its atlas: {wrong}")
    own = sheets.faces
    space = points[sheets.vertex]
    uncharted = np.zeros(len(own), bool)
    charts: tuple[np.ndarray, np.ndarray, np.ndarray] | str = ""
    if isinstance(settings, XatlasSettings):
        from exmesh_graph.uv.xatlas_charts import xatlas_charts

        charts = xatlas_charts(space, own, settings)
        if isinstance(charts, str) and warn is not None:
            warn(f"{charts}: the charts are the built-in ones instead")
    if isinstance(charts, str):
        bend = settings.bend if isinstance(settings, DiscSettings) else DiscSettings().bend
        flat, corners = lay_out(space, own, bend)
    else:
        flat, corners, uncharted = charts
    return _Charts(points, faces, sheets, *mend(space, own, flat, corners, uncharted))


def _packed(charts: _Charts, texture_size: int, padding: int) -> tuple[np.ndarray, np.ndarray]:
    points, faces, sheets, flat, corners, orphans = charts
    uvs = pack(flat, corners[~orphans], texture_size, padding)
    whole = np.zeros((len(faces), 3), np.int64)
    whole[sheets.kept] = corners
    missing = np.ones(len(faces), bool)
    missing[sheets.kept] = orphans
    twins = sheets.twin >= 0
    uvs, whole = adopt(points, faces, uvs, whole, missing & ~twins)
    whole = _repeat(faces, whole, sheets.twin)
    used, index = np.unique(whole, return_inverse=True)
    return np.clip(uvs[used], 0.0, 1.0).astype(np.float32), index.reshape(whole.shape).astype(np.int32)


def _packed_if(charts: _Charts, side: int, padding: int) -> tuple[np.ndarray, np.ndarray] | None:
    """None where there is no room and a larger side may have it."""
    try:
        return _packed(charts, side, padding)
    except NoRoomError:
        if 2 * side > _LARGEST:
            raise
        return None


def _side(texels: float) -> int:
    return int(np.clip(64 * round(math.sqrt(texels) / 64), 64, _LARGEST))


def _scaled(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Vertices moved and scaled to a mean face area of 1."""
    if len(faces) == 0:
        raise GeometryError("the mesh has no faces", expected="at least one triangle")
    if not np.isfinite(vertices).all():
        bad = int((~np.isfinite(vertices)).any(axis=1).sum())
        raise GeometryError(f"{bad} vertices are not finite", expected="finite positions")
    area = face_areas(vertices, faces).sum()
    if area <= 0:
        raise GeometryError("the mesh has no area", expected="triangles with area", fix="clean the mesh (init.clean)")
    used = vertices[np.unique(faces)].astype(np.float64)
    centre = 0.5 * (used.min(axis=0) + used.max(axis=0))
    scaled = (vertices.astype(np.float64) - centre) * np.sqrt(len(faces) / area)
    return np.round(scaled, 3)  # so that ties between charts are not broken by the rounding of the scene's scale


def _repeat(faces: np.ndarray, corners: np.ndarray, twin: np.ndarray) -> np.ndarray:
    """A face that repeats another one shows the same texels."""
    repeats = np.flatnonzero(twin >= 0)
    if len(repeats) == 0:
        return corners
    corners = corners.copy()
    for f in repeats.tolist():
        other = list(faces[twin[f]])
        corners[f] = [corners[twin[f], other.index(v)] for v in faces[f]]
    return corners
