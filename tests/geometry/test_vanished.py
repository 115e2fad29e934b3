"""Parts that have shrunk to a point."""

from __future__ import annotations

import numpy as np
import pytest

from exmesh_graph.geometry.merge import merge
from exmesh_graph.geometry.settings import MergeSettings
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.geometry.vanished import vanished
from exmesh_graph.types.edges import is_closed
from exmesh_graph.uv.unwrap import unwrap

TETRAHEDRON = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


def ball_and_speck(size: float) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = icosphere(2)
    corners = 2 + size * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    return np.concatenate([vertices, corners]), np.concatenate([faces, TETRAHEDRON + len(vertices)])


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3])
def test_a_speck_has_vanished_whatever_the_scale(size):
    vertices, faces = ball_and_speck(size)
    for scale in (1e-3, 1, 1e3):
        assert np.flatnonzero(vanished(scale * vertices, faces)).tolist() == [320, 321, 322, 323]


def test_a_small_part_and_a_sliver_of_a_large_one_have_not():
    vertices, faces = ball_and_speck(0.1)
    vertices[faces[7, 1]] = vertices[faces[7, 0]]  # a face without area, of the ball
    assert not vanished(vertices, faces).any()
    assert not vanished(1e-9 * vertices, faces).any()
    assert len(vanished(vertices, faces[:0])) == 0


@pytest.mark.thorough
def test_merging_drops_it_and_carries_what_belongs_to_the_rest():
    vertices, faces = ball_and_speck(1e-8)
    vertices, faces, uvs, uv_faces = (vertices, faces, *unwrap(vertices, faces, 256))
    done = merge(vertices, faces, uvs, uv_faces, None, MergeSettings(degenerate=0, min_faces=4))
    assert len(done.faces) == len(faces) - 4
    assert is_closed(done.faces)
    assert np.array_equal(done.map.carry(vertices), done.vertices)
    assert np.array_equal(done.face_source, np.arange(len(faces) - 4))
    assert len(done.uvs) == len(np.unique(uv_faces[:-4]))
