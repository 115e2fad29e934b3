"""From any triangle soup to a start mesh: largest parts, manifold, evenly triangulated, within a face budget.

The project's own remesher is the default; pymeshlab (GPL-3, imported here only) and Open3D's quadric decimation are
alternatives. Whatever did the work, the result is measured, and an error is raised where it is not sound.
"""

from __future__ import annotations

import contextlib

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_areas, require_mesh, signed_volume, without_unused
from exmesh_graph.geometry.remesh import nearest_of, remesh
from exmesh_graph.geometry.repair import fill_holes, make_manifold
from exmesh_graph.geometry.settings import CleanSettings
from exmesh_graph.geometry.soundness import flat_area, inspect, require_sound
from exmesh_graph.native import import_open3d, import_pymeshlab

Arrays = tuple[np.ndarray, np.ndarray]
_LOST = 0.01  # share of the surface that a start may lose
_LOOKED = 20000
_RETREATS = 20
_TO_THIN = 2  # passes of the remesher on its way to fewer faces; it has six of its own for the result


def clean_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    settings: CleanSettings | None = None,
    *,
    where: str = "init.clean",
) -> tuple[np.ndarray, np.ndarray]:
    """(vertices float32 [V, 3], faces int32 [F, 3]) with F <= about `settings.faces`.

    Keeps the `components` largest parts by area (0 = all) above `min_area` of the largest; welds equal positions,
    drops duplicate faces, repairs non-manifold edges and vertices, and remeshes: builtin and pymeshlab to edges of the
    length that the budget gives equilateral triangles (l^2 = 4 A / (sqrt 3 F)), open3d by quadric decimation.
    `close_holes` fills holes of at most so many edges first (not open3d). With a `tolerance` the budget doubles, up to
    `max_faces`, until the result keeps 99 % of what it was made of (`lost_parts`).
    Closed input gives closed output, counter-clockwise from outside.
    Raises GeometryError where the result is not edge-manifold, not oriented, or not closed though the input was,
    DataError for arrays of another shape or type.
    """
    settings = settings or CleanSettings()
    require_mesh(vertices, faces, where)
    source = largest_components(*weld(vertices, faces), settings.components, settings.min_area)
    if not settings.tolerance or settings.faces >= settings.max_faces:
        return _cleaned(*source, settings, where)
    radius = float(np.linalg.norm(np.ptp(source[0], axis=0))) / 2
    thinned, budget = source, settings.faces
    if len(source[1]) > 3 * settings.max_faces:  # most of the time goes into the first collapses: take them once
        with contextlib.suppress(GeometryError):
            more = settings.model_copy(update={"faces": 2 * settings.max_faces})
            thinned = _cleaned(*source, more, where, _TO_THIN)
    while budget < settings.max_faces:
        try:
            result = _cleaned(*thinned, settings.model_copy(update={"faces": budget}), where)
        except GeometryError:  # so few faces cannot hold its handles
            budget *= 2
            continue
        if lost_parts(source, result, settings.tolerance * radius) <= _LOST:
            return result
        budget *= 2
    return _cleaned(*thinned, settings.model_copy(update={"faces": settings.max_faces}), where)


def lost_parts(source: Arrays, result: Arrays, distance: float) -> float:
    """Share of the area of `source` that lies farther than `distance` from `result`; meshes are (vertices, faces).

    Judged at the centroids of at most some 20 000 of its faces, taken at even steps.
    """
    vertices, faces = source
    looked = faces[:: max(1, len(faces) // _LOOKED)]
    centres = np.asarray(vertices, np.float64)[looked].mean(1)
    far = np.linalg.norm(nearest_of(*result)(centres) - centres, axis=1) > distance
    area = face_areas(vertices, looked)
    return float(area[far].sum() / max(area.sum(), np.finfo(float).tiny))


def _cleaned(vertices: np.ndarray, faces: np.ndarray, settings: CleanSettings, where: str, passes: int = 6) -> Arrays:
    method, faces_budget, close_holes = settings.method, settings.faces, settings.close_holes
    components, min_area = settings.components, settings.min_area
    closed = inspect(vertices, faces).closed
    if method == "builtin":
        vertices, faces = make_manifold(vertices, faces)
        if close_holes:
            vertices, faces = fill_holes(vertices, faces, close_holes)
        vertices, faces = remesh(vertices, faces, faces_budget, passes)
    elif method == "pymeshlab":
        vertices, faces = _remesh_pymeshlab(vertices, faces, faces_budget, close_holes)
    elif close_holes:
        raise GeometryError(
            "method open3d cannot close holes", where=where, fix="set close_holes: 0, or method: builtin"
        )
    else:
        vertices, faces = _decimate_open3d(vertices, faces, faces_budget)
    if method != "builtin":
        vertices, faces = weld(vertices, faces)
    faces = without_pillows(faces)
    # specks smaller than a face have shrunk to a point
    vertices, faces = largest_components(vertices.astype(np.float32), faces, components, max(min_area, 1e-6))
    if closed:
        faces = outward(vertices, faces)
    else:  # what could not be spread between boundary vertices, which stay
        vertices, faces = without_unused(vertices, faces[face_areas(vertices, faces) > flat_area(vertices)])
    require_sound(vertices, faces, closed=closed, where=where)
    return vertices.astype(np.float32), faces.astype(np.int32)


def _remesh_pymeshlab(
    vertices: np.ndarray, faces: np.ndarray, budget: int, close_holes: int
) -> tuple[np.ndarray, np.ndarray]:
    pymeshlab = import_pymeshlab()
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices.astype(np.float64), faces.astype(np.int32)))
    _repair(meshes)
    if close_holes:
        meshes.meshing_close_holes(maxholesize=close_holes, selfintersection=True)
    source = meshes.current_mesh_id()
    aim = float(budget)
    area = float(face_areas(*_arrays(meshes)).sum())
    for _ in range(3):  # the remesher lands within some ten per cent of the aim; correct the aim, from the source again
        meshes.set_current_mesh(source)
        meshes.generate_copy_of_current_mesh()
        edge = float(np.sqrt(4 * area / (np.sqrt(3) * aim)))
        meshes.meshing_isotropic_explicit_remeshing(
            iterations=8, targetlen=pymeshlab.PureValue(edge), adaptive=False, checksurfdist=False
        )
        count = meshes.current_mesh().face_number()
        if 0.9 * budget <= count <= budget:
            break
        aim *= 0.96 * budget / count
    if meshes.current_mesh().face_number() > budget:
        meshes.meshing_decimation_quadric_edge_collapse(
            targetfacenum=budget, preserveboundary=True, preservenormal=True, preservetopology=True,
            optimalplacement=True, qualitythr=0.5,
        )  # fmt: skip
    _repair(meshes)
    return _arrays(meshes)


def _repair(meshes) -> None:
    meshes.meshing_remove_duplicate_vertices()
    meshes.meshing_remove_duplicate_faces()
    meshes.meshing_remove_null_faces()
    meshes.meshing_repair_non_manifold_edges(method="Remove Faces")
    meshes.meshing_repair_non_manifold_vertices(vertdispratio=0.0)
    meshes.meshing_re_orient_faces_coherently()
    meshes.meshing_remove_unreferenced_vertices()


def _arrays(meshes) -> tuple[np.ndarray, np.ndarray]:
    mesh = meshes.current_mesh()
    return mesh.vertex_matrix().astype(np.float64), mesh.face_matrix().astype(np.int32)


def _decimate_open3d(vertices: np.ndarray, faces: np.ndarray, budget: int) -> tuple[np.ndarray, np.ndarray]:
    o3d = import_open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices.astype(np.float64)), o3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    mesh.remove_non_manifold_edges()
    mesh.orient_triangles()
    if len(mesh.triangles) > budget:
        mesh = mesh.simplify_quadric_decimation(target_number_of_triangles=budget)
    mesh.remove_degenerate_triangles()
    mesh.remove_duplicated_triangles()
    mesh.remove_non_manifold_edges()
    mesh.remove_unreferenced_vertices()
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int32)


def weld(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge vertices at equal float32 positions; drop faces that lose a corner, duplicates and unused vertices."""
    positions, index = np.unique(np.asarray(vertices, np.float32), axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces].astype(np.int32)
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[whole]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return without_unused(positions, faces[np.sort(first)])


def without_pillows(faces: np.ndarray) -> np.ndarray:
    """`faces` without pairs of the same corners that look opposite ways: they enclose nothing, and each of their edges
    has two faces too many where they hang on others."""
    corners = np.sort(faces, axis=1)
    # 0 for an even order of the corners, 1 for an odd one
    turned = ((faces[:, 0] > faces[:, 1]) ^ (faces[:, 1] > faces[:, 2]) ^ (faces[:, 0] > faces[:, 2])).astype(int)
    _, group = np.unique(corners, axis=0, return_inverse=True)
    group = group.reshape(-1)
    ways = np.stack([np.bincount(group[turned == way], minlength=group.max(initial=-1) + 1) for way in (0, 1)])
    return faces[(ways > 0).sum(axis=0)[group] < 2]


def face_components(faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """int [F] label of each face's connected part (parts share vertices)."""
    a, b = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(vertex_count, vertex_count))
    return connected_components(graph, directed=False)[1][faces[:, 0]]


def largest_components(
    vertices: np.ndarray, faces: np.ndarray, count: int, min_area: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Keep the `count` parts of largest area (0 = all) that have at least `min_area` of the largest one's.

    Raises GeometryError for a mesh without faces.
    """
    if len(faces) == 0:
        raise GeometryError("the mesh has no faces left", fix="check the mesh that goes into the clean-up")
    labels = face_components(faces, len(vertices))
    area = np.bincount(labels, face_areas(vertices, faces))
    order = np.argsort(-area, kind="stable")
    kept = order[: count or None]
    kept = kept[area[kept] >= min_area * area[order[0]]]
    return without_unused(vertices, faces[np.isin(labels, kept)].astype(np.int32))


def outward(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Turn every closed part so that it encloses positive volume (counter-clockwise from outside)."""
    labels = face_components(faces, len(vertices))
    turned = faces.copy()
    for label in range(labels.max() + 1):
        part = labels == label
        if signed_volume(vertices, faces[part]) < 0:
            turned[part] = faces[part][:, ::-1]
    return turned


def taubin(vertices: np.ndarray, faces: np.ndarray, steps: int, shrink: float = 0.5, grow: float = -0.53) -> np.ndarray:
    """Taubin's lambda | mu smoothing, `steps` pairs with uniform weights: takes out voxel steps without shrinking.

    Where it would leave a face without area the corners stay where they were.
    """
    if steps == 0:
        return vertices
    a, b = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    ones = np.ones(2 * len(a))
    links = csr_matrix((ones, (np.r_[a, b], np.r_[b, a])), shape=(len(vertices),) * 2)
    links.data[:] = 1  # an edge counts once, however many faces share it
    degree = np.maximum(np.asarray(links.sum(1)), 1)
    x = vertices.astype(np.float64)
    for _ in range(steps):
        for weight in (shrink, grow):
            x = x + weight * (links @ x / degree - x)
    smooth = x.astype(np.float32)
    for _ in range(_RETREATS):
        flat = np.unique(faces[face_areas(smooth, faces) <= flat_area(vertices)])
        moved = flat[(smooth[flat] != vertices[flat]).any(axis=1)]
        if len(moved) == 0:
            break
        smooth[moved] = vertices[moved]
    return smooth
