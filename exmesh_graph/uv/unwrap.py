"""A UV atlas: valid for every face, never mirrored, packed to exactly the texture that will be used.

Charts are nearly flat discs of our own (`layout`), or xatlas's. xatlas's packing is not used: it exceeds a wished
resolution by up to 30 %, so that the padding shrinks when the atlas is scaled back, and leaves half of it empty.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_areas
from exmesh_graph.uv.cut import cut_open, defects
from exmesh_graph.uv.layout import lay_out
from exmesh_graph.uv.mend import adopt, mend
from exmesh_graph.uv.pack import pack


def unwrap(
    vertices: np.ndarray,
    faces: np.ndarray,
    texture_size: int = 1024,
    *,
    padding: int = 4,
    bend: float = 0.45,
    cut_nonmanifold: bool = False,
    method: Literal["discs", "xatlas"] = "discs",
    max_cost: float = 2.0,
    max_iterations: int = 1,
    max_seconds: float = 120.0,
    warn: Callable[[str], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Cut the mesh into charts, flatten them, pack them into one square atlas.

    vertices          float [V, 3]; faces int [F, 3]
    texture_size      R, texels on a side: one texel has the same size on all charts, isotropic
    padding           texels kept free between charts
    bend              "discs": bound of 1 - |mean normal|^2 in a chart; more gives fewer and more stretched charts
    cut_nonmanifold   chart a mesh whose edges have more than two faces by cutting it there; else such a mesh is refused
    max_cost          "xatlas": the larger, the fewer and the more stretched charts
    max_iterations    "xatlas": rounds of chart growing
    max_seconds       "xatlas": when it is not done by then, "discs" takes its place and `warn` is told

    Returns uvs float32 [T, 2] in [0, 1], origin lower left, and uv_faces int32 [F, 3], the corner map Phi. UV area is
    positive for every face with area; two corners share a UV index only if they are the same vertex in the same chart.
    Deterministic. Raises GeometryError for an empty, non-finite or non-manifold mesh.
    """
    points = _scaled(vertices, faces)
    sheets = cut_open(points, faces, cut_nonmanifold)
    if cut_nonmanifold and warn is not None and (wrong := defects(faces)):
        warn(f"the mesh is not manifold and was cut open for its atlas: {wrong}")
    own = sheets.faces
    space = points[sheets.vertex]
    uncharted = np.zeros(len(own), bool)
    found: tuple[np.ndarray, np.ndarray, np.ndarray] | str = ""
    if method == "xatlas":
        from exmesh_graph.uv.xatlas_charts import xatlas_charts

        found = xatlas_charts(space, own, max_cost, max_iterations, max_seconds)
        if isinstance(found, str) and warn is not None:
            warn(f"{found}: the charts are the built-in ones instead")
    if isinstance(found, str):
        flat, corners = lay_out(space, own, bend)
    else:
        flat, corners, uncharted = found
    flat, corners, orphans = mend(space, own, flat, corners, uncharted)
    uvs = pack(flat, corners[~orphans], texture_size, padding)

    whole = np.zeros((len(faces), 3), np.int64)
    whole[sheets.kept] = corners
    missing = np.ones(len(faces), bool)
    missing[sheets.kept] = orphans
    twins = sheets.twin >= 0
    uvs, whole = adopt(points, faces, uvs, whole, missing & ~twins)
    whole = _repeat(faces, whole, sheets.twin)
    return _compact(uvs, whole)


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


def _compact(uvs: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used, index = np.unique(corners, return_inverse=True)
    return np.clip(uvs[used], 0.0, 1.0).astype(np.float32), index.reshape(corners.shape).astype(np.int32)
