"""Tangential smoothing that takes the texture along."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from topology_meshes import SHAPES, check_topology, meshes, unwrapped, uv_areas

from benchmarks.mesh_quality import mesh_quality
from benchmarks.meshes import grid
from exmesh_graph.geometry.adjacency import area_vectors
from exmesh_graph.geometry.flip import flip
from exmesh_graph.geometry.relax import relax
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.geometry.split import split
from exmesh_graph.geometry.surface import closest_on_triangles
from exmesh_graph.types.edges import edges_of


def sequential_aims(vertices, faces, strength):
    """{vertex: (where it goes, nearest point of its old faces)}, inner vertices only: smoothing along the tangent plane
    gives an aim; the vertex goes as far from the nearest point of the old faces to the aim as its weight there."""
    p, aims = vertices.astype(np.float64), {}
    edges = edges_of(faces)
    rim = set(edges.vertices[edges.count != 2].reshape(-1).tolist())
    for v in range(len(p)):
        star = [face for face in faces.tolist() if v in face]
        if v in rim or not star:
            continue
        normal = sum(np.cross(p[b] - p[a], p[c] - p[a]) for a, b, c in star)
        normal = normal / np.linalg.norm(normal)
        move = np.mean([p[u] for u in {u for face in star for u in face} - {v}], axis=0) - p[v]
        aim = p[v] + strength * (move - normal * (move @ normal))
        near = closest_on_triangles(np.tile(aim, (len(star), 1)), p[np.array(star)])
        best = ((near - aim) ** 2).sum(axis=1).argmin()
        a, b, c = (p[u] for u in star[best])
        weights = np.linalg.lstsq(np.stack([a, b, c], axis=1), near[best], rcond=None)[0]
        place = near[best]
        aims[v] = (place + weights[star[best].index(v)] * (aim - place), place)
    return aims


def test_one_step_equals_the_sequential_definition():
    rng = np.random.default_rng(1)
    vertices, faces = icosphere(2)
    vertices = (vertices * (1 + 0.02 * rng.normal(size=(len(vertices), 1)))).astype(np.float32)
    uvs = np.stack([np.arctan2(vertices[:, 0], vertices[:, 1]), vertices[:, 2]], axis=1).astype(np.float32)
    got, uv_got, (value,) = relax(vertices, faces, uvs, faces, strength=0.2, max_bend=1.5, colours=[vertices])
    want = sequential_aims(vertices, faces, 0.2)
    moved = (got != vertices).any(axis=1)
    assert moved.mean() > 0.7  # faces that run across the cut of the arctangent are thinner there and stay
    np.testing.assert_allclose(got[moved], [want[v][0] for v in np.flatnonzero(moved)], atol=1e-5)
    # what is painted on the surface stays where it is painted
    np.testing.assert_allclose(value[moved], [want[v][1] for v in np.flatnonzero(moved)], atol=1e-5)
    assert (uv_got != uvs).any(axis=1)[moved].mean() > 0.9


def test_colours_of_a_plane_stay_where_they_are():
    vertices, faces = grid(8, 8)
    rng = np.random.default_rng(4)
    inner = ~np.isin(vertices[:, [0, 2]], (0, 1)).any(axis=1)
    vertices[inner] += (rng.uniform(-0.03, 0.03, (inner.sum(), 3)) * [1, 0, 1]).astype(np.float32)
    uvs = vertices[:, [2, 0]].copy()
    got, uv_got, _ = relax(vertices, faces, uvs, faces, steps=3)
    assert (got != vertices).any(axis=1).sum() == inner.sum()
    np.testing.assert_allclose(uv_got, got[:, [2, 0]], atol=1e-6)
    np.testing.assert_array_equal(got[~inner], vertices[~inner])
    length = [np.linalg.norm(np.diff(x[edges_of(faces).vertices], axis=1)[:, 0], axis=1).std() for x in (vertices, got)]
    assert length[1] < length[0]


def test_a_round_shape_stays_round():
    """Moved along the surface of a ball by a third of an edge, vertices stay much nearer to it than its edges do."""
    vertices, faces = icosphere(2)
    tangent = np.cross(vertices, np.random.default_rng(0).normal(size=vertices.shape))
    vertices = vertices + 0.1 * tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    vertices = (vertices / np.linalg.norm(vertices, axis=1, keepdims=True)).astype(np.float32)
    uvs = np.zeros((len(vertices), 2), np.float32)
    got, *_ = relax(vertices, faces, uvs, faces, max_bend=1.5)
    moved = (got != vertices).any(axis=1)
    off = np.abs(np.linalg.norm(got[moved], axis=1) - 1)
    chord = 1 - np.linalg.norm(vertices[edges_of(faces).vertices].mean(axis=1), axis=1)
    assert moved.mean() > 0.9
    assert off.mean() < 0.4 * chord.mean()


@pytest.mark.thorough
@settings(max_examples=40, deadline=None)
@given(meshes())
def test_nothing_folds_and_seams_and_outlines_stay(mesh):
    vertices, faces, uvs, uv_faces, _ = mesh
    got, uv_got, _ = relax(vertices, faces, uvs, uv_faces, steps=2)
    assert got.dtype == uv_got.dtype == np.float32
    old, new = area_vectors(vertices, faces), area_vectors(got, faces)
    assert (np.einsum("ij,ij->i", old, new) >= -1e-6 * np.abs(old).max() ** 2).all()
    assert ((uv_areas(uvs, uv_faces) <= 0) | (uv_areas(uv_got, uv_faces) > 0)).all()
    pairs = np.unique(np.stack([faces.reshape(-1), uv_faces.reshape(-1)], axis=1), axis=0)
    seam = np.bincount(pairs[:, 0], minlength=len(vertices)) != 1
    edges = edges_of(faces)
    seam[edges.vertices[edges.count != 2].reshape(-1)] = True
    np.testing.assert_array_equal(got[seam], vertices[seam])
    np.testing.assert_array_equal(uv_got[pairs[seam[pairs[:, 0]], 1]], uvs[pairs[seam[pairs[:, 0]], 1]])
    again = relax(vertices, faces, uvs, uv_faces, steps=2)
    assert again[0].tobytes() == got.tobytes()
    done = flip(got, faces, uv_got, uv_faces)
    check_topology((got, faces, uv_got, uv_faces), done)


def test_what_splits_scatter_is_evened_out():
    vertices, faces, uvs, uv_faces = unwrapped("sphere")
    grown = split(vertices, faces, uvs, uv_faces, np.random.default_rng(0).random(len(vertices)), 2000)
    done = flip(grown.vertices, grown.faces, grown.uvs, grown.uv_faces)
    got, *_ = relax(done.vertices, done.faces, done.uvs, done.uv_faces, steps=2)
    before, after = mesh_quality(done.vertices, done.faces), mesh_quality(got, done.faces)
    assert after["edge_cv"] < 0.95 * before["edge_cv"]
    assert after["min_angle_mean"] > before["min_angle_mean"] + 1


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_smoothing_does_not_depend_on_the_scale(name, scale):
    vertices, faces, uvs, uv_faces = unwrapped(name)
    vertices = vertices + np.random.default_rng(6).normal(size=vertices.shape).astype(np.float32) * np.float32(0.02)
    one, uv_one, _ = relax(vertices, faces, uvs, uv_faces)
    other, uv_other, _ = relax(vertices * np.float32(scale), faces, uvs, uv_faces)
    np.testing.assert_allclose(other / scale, one, atol=1e-5)
    np.testing.assert_allclose(uv_other, uv_one, atol=1e-5)
