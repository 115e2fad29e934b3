"""Decimation: what must hold of any result, and one round against a sequential pass in plain Python."""

import numpy as np
import pytest

from benchmarks.meshes import is_vertex_manifold
from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry import decimate as module
from exmesh_graph.geometry.adjacency import incident_faces, next_halfedge, signed_areas_2d
from exmesh_graph.geometry.decimate import decimate, vertex_quadrics
from exmesh_graph.geometry.merge import collapse_ends, shape_is_kept
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.geometry.topology import Topology, VertexMap, link_condition
from exmesh_graph.types.edges import edges_of, is_closed, is_edge_manifold
from exmesh_graph.uv.unwrap import unwrap


@pytest.fixture(scope="module")
def sphere():
    """A closed bumpy sphere with an atlas of several charts."""
    vertices, faces = icosphere(3)
    vertices = vertices * (1 + 0.1 * np.sin(5 * vertices[:, :1]) * np.cos(4 * vertices[:, 1:2]))
    vertices = vertices * (1 + 0.01 * np.random.default_rng(0).normal(size=(len(vertices), 1)))  # no two costs alike
    uvs, corners = unwrap(vertices.astype(np.float32), faces, 256)[:2]
    return vertices.astype(np.float32), faces.astype(np.int32), uvs, corners


@pytest.mark.thorough
def test_fewer_faces_same_surface_same_atlas(sphere):
    vertices, faces, uvs, corners = sphere
    result = decimate(*sphere, 500)
    assert 400 <= len(result.faces) <= 500
    assert is_closed(result.faces)
    assert is_edge_manifold(result.faces)
    assert is_vertex_manifold(result.faces)
    kept = {tuple(v) for v in vertices.tolist()}
    assert all(tuple(v) in kept for v in result.vertices.tolist())  # nothing moved
    pairs = {(tuple(vertices[f[k]]), tuple(uvs[c[k]])) for f, c in zip(faces, corners, strict=True) for k in range(3)}
    for face, corner in zip(result.faces, result.uv_faces, strict=True):
        for k in range(3):
            assert (tuple(result.vertices[face[k]]), tuple(result.uvs[corner[k]])) in pairs
    before, after = signed_areas_2d(uvs, corners), signed_areas_2d(result.uvs, result.uv_faces)
    assert (after > 0).all() == (before > 0).all()
    assert np.isclose(after.sum(), before.sum(), rtol=0.03)  # charts lose slivers along straight borders only
    # every vertex of the fine sphere lies near the coarse one
    corner = result.vertices[result.faces].astype(np.float64)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    centre = corner.mean(axis=1)
    nearest = np.linalg.norm(vertices[:, None] - centre[None], axis=-1).argmin(axis=1)
    assert np.abs(((vertices - centre[nearest]) * normal[nearest]).sum(1)).max() < 0.08


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scale_does_not_matter(sphere, scale):
    vertices, faces, uvs, corners = sphere
    one, other = decimate(*sphere, 700), decimate((vertices * np.float32(scale)), faces, uvs, corners, 700)
    assert len(one.faces) == len(other.faces)
    shared = {tuple(v) for v in np.round(one.vertices, 4).tolist()} & {
        tuple(v) for v in np.round(other.vertices / scale, 4).tolist()
    }
    assert len(shared) > 0.95 * len(one.vertices)  # ties of float32 rounding may fall the other way


def test_a_flat_sheet_needs_two_faces_more_or_less():
    n = 9
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    result = decimate(points, faces, points[:, :2], faces, 4)
    assert len(result.faces) <= 12
    assert np.isclose(np.abs(signed_areas_2d(result.vertices[:, :2], result.faces)).sum(), 1)
    np.testing.assert_array_equal([result.vertices.min(0), result.vertices.max(0)], [[0, 0, 0], [1, 1, 0]])


def test_quadrics_measure_squared_distances_to_the_planes_around(sphere):
    vertices, faces = sphere[0].astype(np.float64), sphere[1]
    found = vertex_quadrics(vertices, faces)
    place = np.array([0.3, -0.2, 0.4])
    for v in (0, 17, 200):
        total = 0.0
        for face in faces[(faces == v).any(axis=1)]:
            p, q, r = vertices[face]
            normal = np.cross(q - p, r - p)
            total += np.linalg.norm(normal) / 2 * (np.dot(place - p, normal) / np.linalg.norm(normal)) ** 2
        assert np.isclose(np.append(place, 1) @ found[v] @ np.append(place, 1), total)


@pytest.mark.thorough
def test_one_round_is_the_sequential_pass(sphere):
    vertices, faces, uvs, corners = sphere
    state = Topology(vertices, faces, uvs, corners, VertexMap(), np.arange(len(faces)), 0)
    quadrics = vertex_quadrics(vertices, faces)
    plan = module._plan(state, quadrics, 10**6)
    edges, flat = edges_of(faces), faces.reshape(-1)
    start, around = incident_faces(faces, len(vertices))
    price = {}
    seen_edges = set()
    for h in range(faces.size):
        edge = int(edges.face_edges.reshape(-1)[h])
        if edge in seen_edges:
            continue
        seen_edges.add(edge)
        i, j = int(flat[h]), int(flat[next_halfedge(np.array([h]))[0]])
        both = quadrics[i] + quadrics[j]
        cost = [
            float(np.append(vertices[end].astype(float), 1) @ both @ np.append(vertices[end].astype(float), 1))
            for end in (j, i)
        ]
        one = np.array([h])
        removed, survivor, legal = collapse_ends(
            state, edges, one, module.SETTINGS, prefer=np.array([cost[0] <= cost[1]])
        )
        if legal[0]:
            length = np.linalg.norm(vertices[i].astype(float) - vertices[j].astype(float))
            value = cost[0] if removed[0] == i else cost[1]
            price[h] = (value + module._LENGTH * length**4, int(removed[0]), int(survivor[0]), edge)
    order = sorted(price, key=lambda h: price[h][0])[: max(int(module._ROUND * len(price)), 64)]
    touched, expected = set(), []
    for h in order:
        _, removed, survivor, edge = price[h]
        if not link_condition(faces, edges, np.array([edge]), len(vertices))[0]:
            continue
        if not shape_is_kept(state, np.array([removed]), np.array([survivor]), module.SETTINGS, (start, around))[0]:
            continue
        star = set(np.flatnonzero((faces == removed).any(1) | (faces == survivor).any(1)).tolist())
        if not star & touched:
            touched |= star
            expected.append((removed, survivor))
    assert sorted(expected) == sorted(zip(plan.removed.tolist(), plan.survivor.tolist(), strict=True))


def test_counts_that_do_not_fit_are_refused(sphere):
    with pytest.raises(GeometryError, match="3 wanted"):
        decimate(*sphere, 3)
