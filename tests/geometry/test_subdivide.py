"""Uniform subdivision keeps surface, atlas and seams."""

from __future__ import annotations

import numpy as np
import pytest
from topology_meshes import SHAPES, check_topology, unwrapped

from exmesh_graph.geometry.adjacency import components, face_areas
from exmesh_graph.geometry.split import subdivide


@pytest.mark.parametrize("name", SHAPES)
def test_four_times_the_faces_of_the_same_surface(name):
    mesh = unwrapped(name)
    vertices, faces, uvs, uv_faces = mesh
    done = subdivide(*mesh)
    check_topology(mesh, done)
    assert len(done.faces) == 4 * len(faces)
    np.testing.assert_array_equal(done.vertices[: len(vertices)], vertices)
    np.testing.assert_allclose(
        np.bincount(done.face_source, weights=face_areas(done.vertices, done.faces)),
        face_areas(vertices, faces),
        rtol=1e-5,
    )
    assert components(done.uv_faces).max() == components(uv_faces).max()
    # every corner of a small face lies where its parent's affine map puts it
    for corner, parent in ((done.vertices[done.faces], vertices[faces]), (done.uvs[done.uv_faces], uvs[uv_faces])):
        n = len(faces)
        a, b, c = (parent[:, k] for k in range(3))
        np.testing.assert_allclose(corner[:n, 0], a, atol=1e-6)
        np.testing.assert_allclose(corner[n : 2 * n, 1], b, atol=1e-6)
        np.testing.assert_allclose(corner[2 * n : 3 * n, 2], c, atol=1e-6)
        np.testing.assert_allclose(corner[3 * n :].mean(axis=1), (a + b + c) / 3, atol=1e-6)
