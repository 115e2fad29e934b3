"""A UV atlas by xatlas: valid for every face, never mirrored, packed to exactly the texture that will be used.

xatlas makes the charts. Its packing is not used: it turns charts by swapping u and v, which mirrors about half of them,
and it exceeds a wished resolution by up to 30 %, so that the padding shrinks when the atlas is scaled back. Faces that
it leaves folded over inside a chart get islands of their own.
"""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import (
    components,
    corner_fans,
    edges_of,
    face_areas,
    has_collapsed_faces,
    signed_areas_2d,
)
from exmesh_graph.uv.pack import pack

_RESOLUTION = 1024  # of xatlas's own packing, which is thrown away: charts do not depend on the texture's size


def unwrap(
    vertices: np.ndarray,
    faces: np.ndarray,
    texture_size: int = 1024,
    *,
    padding: int = 4,
    max_cost: float = 2.0,
    max_iterations: int = 1,
    normal_deviation_weight: float = 2.0,
    cut_nonmanifold: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Cut the mesh into charts, flatten them, pack them into one square atlas.

    vertices          float [V, 3]; faces int [F, 3]
    texture_size      R, texels on a side: one texel has the same size on all charts, isotropic
    padding           texels kept free between charts
    max_cost          xatlas: the larger, the fewer and the more stretched charts
    max_iterations    xatlas: rounds of chart growing
    cut_nonmanifold   chart a mesh whose edges have more than two faces by cutting it there; else such a mesh is refused

    Returns uvs float32 [T, 2] in [0, 1], origin lower left, and uv_faces int32 [F, 3], the corner map Phi. UV area is
    positive for every face with area; two corners share a UV index only if they are the same vertex in the same chart.
    Deterministic. Raises GeometryError for an empty, non-finite or non-manifold mesh.
    """
    import xatlas

    points = _scaled(vertices, faces)
    chart_vertex, chart_faces = _cut(faces, cut_nonmanifold)

    atlas = xatlas.Atlas()
    atlas.add_mesh(points[chart_vertex].astype(np.float32), chart_faces.astype(np.uint32))
    chart_options = xatlas.ChartOptions()
    chart_options.max_cost, chart_options.max_iterations = max_cost, max_iterations
    chart_options.normal_deviation_weight = normal_deviation_weight
    pack_options = xatlas.PackOptions()
    pack_options.rotate_charts, pack_options.resolution = False, _RESOLUTION
    atlas.generate(chart_options, pack_options)
    _, corners, flat = atlas.get_mesh(0)
    corners = corners.astype(np.int64)
    # Back to the units of `points`: xatlas charts keep the area that their faces have in space.
    flat = flat.astype(np.float64) * [atlas.width, atlas.height] / atlas.texels_per_unit
    uncharted = np.asarray(atlas.get_mesh_vertex_assignment(0)[0])[corners].min(axis=1) < 0

    flat, corners, orphans = _mend(points, faces, flat, corners, uncharted)
    uvs = pack(flat, corners[~orphans], texture_size, padding)
    uvs, corners = _adopt(points, faces, uvs, corners, orphans)
    return _compact(uvs, corners)


def _scaled(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Vertices moved and scaled to a mean face area of 1: xatlas compares areas with an absolute 1e-7."""
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
    return (vertices.astype(np.float64) - centre) * np.sqrt(len(faces) / area)


def _cut(faces: np.ndarray, cut_nonmanifold: bool) -> tuple[np.ndarray, np.ndarray]:
    """(vertex of each charting vertex, faces over charting vertices), cut where surfaces meet in no manifold way."""
    edges = edges_of(faces)
    flat = faces.reshape(-1)
    start = flat[edges.halfedges[edges.interior]]
    crowded, opposed = int((edges.count > 2).sum()), int((start[:, 0] == start[:, 1]).sum())
    collapsed = has_collapsed_faces(faces)
    if collapsed or ((crowded or opposed) and not cut_nonmanifold):
        raise GeometryError(
            f"the mesh is not manifold: {crowded} edges with more than two faces, {opposed} edges between faces of "
            f"opposite winding" + (", faces that use a vertex twice" if collapsed else ""),
            expected="an edge-manifold mesh of consistent winding (charts explode and xatlas hangs otherwise)",
            fix="clean the mesh first (init.clean), or set cut_nonmanifold",
        )
    fans, vertex = corner_fans(faces, edges)
    return vertex, fans


def _mend(
    points: np.ndarray, faces: np.ndarray, flat: np.ndarray, corners: np.ndarray, uncharted: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turn mirrored charts over and give every face that is folded over inside its chart an island of its own.

    Returns (flat, corners, orphans): orphans are the faces without area, which no chart can hold.
    """
    chart = components(corners)
    size = signed_areas_2d(flat, corners)
    mirrored = np.bincount(chart, weights=np.where(uncharted, 0.0, size)) < 0
    sign = np.ones(len(flat))
    sign[corners[mirrored[chart]].reshape(-1)] = -1.0
    flat = np.stack([flat[:, 0] * sign, flat[:, 1]], axis=1)

    area = face_areas(points, faces)
    orphans = area <= 1e-7
    folded = np.flatnonzero(((signed_areas_2d(flat, corners) <= 1e-3 * area) | uncharted) & ~orphans)
    a, b, c = (points[faces[folded, k]] for k in range(3))
    along = np.linalg.norm(b - a, axis=1)
    x = np.einsum("ij,ij->i", c - a, b - a) / along
    height = 2.0 * area[folded] / along
    zero = np.zeros(len(folded))
    islands = np.stack([np.stack([zero, zero], 1), np.stack([along, zero], 1), np.stack([x, height], 1)], axis=1)
    corners = corners.copy()
    corners[folded] = len(flat) + np.arange(3 * len(folded)).reshape(-1, 3)
    return np.concatenate([flat, islands.reshape(-1, 2)]), corners, orphans


def _adopt(
    points: np.ndarray, faces: np.ndarray, uvs: np.ndarray, corners: np.ndarray, orphans: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Faces without area take the UVs of the face across their longest edge; their third corner falls on that edge."""
    waiting = list(np.flatnonzero(orphans))
    if not waiting:
        return uvs, corners
    edges, corners = edges_of(faces), corners.copy()
    extra: list[np.ndarray] = []
    ready = ~orphans
    while waiting:
        left = []
        for f in waiting:
            p = points[faces[f]]
            length = np.linalg.norm(np.roll(p, -1, axis=0) - p, axis=1)
            for k in np.argsort(-length, kind="stable"):
                pair = edges.halfedges[edges.face_edges[f, k]]
                other = pair[0] + pair[1] - (3 * f + k)
                if pair[1] < 0 or not ready[other // 3]:
                    continue
                neighbour = faces[other // 3]
                i, j, o = k, (k + 1) % 3, (k + 2) % 3
                ui, uj = (int(corners[other // 3][list(neighbour).index(faces[f, m])]) for m in (i, j))
                along = p[j] - p[i]
                t = np.clip(np.dot(p[o] - p[i], along) / max(float(np.dot(along, along)), 1e-300), 0.0, 1.0)
                corners[f, [i, j, o]] = ui, uj, len(uvs) + len(extra)
                extra.append((1.0 - t) * _at(uvs, extra, ui) + t * _at(uvs, extra, uj))
                ready[f] = True
                break
            else:
                left.append(f)
        if len(left) == len(waiting):
            raise GeometryError(
                f"{len(left)} faces without area touch no face with area", fix="clean the mesh first (init.clean)"
            )
        waiting = left
    return np.concatenate([uvs, np.array(extra)]), corners


def _at(uvs: np.ndarray, extra: list[np.ndarray], index: int) -> np.ndarray:
    return uvs[index] if index < len(uvs) else extra[index - len(uvs)]


def _compact(uvs: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used, index = np.unique(corners, return_inverse=True)
    return np.clip(uvs[used], 0.0, 1.0).astype(np.float32), index.reshape(corners.shape).astype(np.int32)
