"""Surface samples: uniform by area, on the surface, the same for the same seed."""

import numpy as np
import pytest

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_areas
from exmesh_graph.geometry.surface import sample_surface

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 3.0]])
FACES = np.array([[0, 1, 2], [0, 1, 3], [1, 1, 2]])


def test_areas():
    assert face_areas(VERTICES, FACES) == pytest.approx([0.5, 1.5, 0])


def test_faces_get_their_share_and_points_lie_on_them():
    points, face, bary = sample_surface(VERTICES, FACES, 1000, seed=3)
    assert np.abs(np.bincount(face, minlength=3) - [250, 750, 0]).max() <= 1
    assert bary.min() >= 0
    assert bary.sum(1) == pytest.approx(1)
    assert points == pytest.approx(np.einsum("pk,pki->pi", bary, VERTICES[FACES[face]]))


def test_uniform_inside_a_triangle():
    _, _, bary = sample_surface(VERTICES[:3], FACES[:1], 40_000, seed=0)
    assert bary.mean(0) == pytest.approx([1 / 3] * 3, abs=0.005)
    # A uniform point lies in the corner triangle bary_0 > 1/2 with probability 1/4.
    assert (bary > 0.5).mean(0) == pytest.approx([0.25] * 3, abs=0.01)


def test_seeds():
    a, b, c = (sample_surface(VERTICES, FACES, 50, seed)[0] for seed in (1, 1, 2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)


def test_no_area():
    with pytest.raises(GeometryError, match="area 0"):
        sample_surface(VERTICES, FACES[2:], 10, seed=0)
    with pytest.raises(GeometryError, match="area 0"):
        sample_surface(VERTICES, FACES[:0], 10, seed=0)
