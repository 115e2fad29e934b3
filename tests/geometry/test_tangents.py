"""Tangent frames: directions of growing u, splits at seams and mirrors, corners without area."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exmesh_graph.geometry.adjacency import angle_weighted_normals
from exmesh_graph.geometry.tangents import corner_tangents

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UVS = SQUARE[:, :2]


@pytest.mark.parametrize("angle", [0, 0.4, 2.0])
@pytest.mark.parametrize("mirrored", [False, True])
def test_tangents_point_where_u_grows(angle, mirrored):
    """On a square: exactly d position / d u, and the bitangent d position / d v, also where the chart is mirrored."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    stretch = np.diag([-0.4 if mirrored else 0.4, 0.4])
    matrix = stretch @ turn  # position -> uv
    tangent, sign = corner_tangents(SQUARE, FACES, UVS @ matrix.T + 0.5, FACES)
    inverse = np.linalg.inv(matrix)
    along_u, along_v = inverse[:, 0], inverse[:, 1]
    np.testing.assert_allclose(
        tangent[..., :2], np.broadcast_to(along_u / np.linalg.norm(along_u), (2, 3, 2)), atol=1e-6
    )
    bitangent = sign[:, None, None] * np.cross([0, 0, 1.0], tangent)
    np.testing.assert_allclose(
        bitangent[..., :2], np.broadcast_to(along_v / np.linalg.norm(along_v), (2, 3, 2)), atol=1e-6
    )
    assert (sign == (-1 if mirrored else 1)).all()


def test_frames_split_at_seams_and_mirrors_and_are_shared_inside():
    mirrored = UVS.copy()
    mirrored[:, 0] = 1 - mirrored[:, 0]
    uvs, uv_faces = np.concatenate([UVS, mirrored]), np.array([[0, 1, 2], [4, 6, 7]])
    tangent, sign = corner_tangents(SQUARE, FACES, uvs, uv_faces)
    np.testing.assert_allclose(tangent[0], np.tile([1, 0, 0], (3, 1)), atol=1e-6)
    np.testing.assert_allclose(tangent[1], np.tile([-1, 0, 0], (3, 1)), atol=1e-6)
    assert sign.tolist() == [1, -1]
    bent = SQUARE + 0.3 * np.outer([0, 1, 0, 0], [0, 0, 1])
    shared, _ = corner_tangents(bent, FACES, UVS, FACES)
    np.testing.assert_allclose(shared[0, 0], shared[1, 0], atol=1e-6)  # one chart: corners at vertex 0 and 2 agree
    np.testing.assert_allclose(shared[0, 2], shared[1, 1], atol=1e-6)


def test_the_same_charts_with_coordinates_listed_per_corner():
    bent = SQUARE + 0.3 * np.outer([0, 1, 0, 0], [0, 0, 1])
    indexed, _ = corner_tangents(bent, FACES, UVS, FACES)
    listed, _ = corner_tangents(bent, FACES, UVS[FACES].reshape(-1, 2), np.arange(6).reshape(2, 3))
    np.testing.assert_array_equal(indexed, listed)


def test_corners_without_area_get_a_frame():
    """A face folded to a line in the atlas takes its neighbours' tangents; where all are, anything orthogonal."""
    folded = UVS.copy()
    folded[3] = 0.5 * (UVS[0] + UVS[2])
    tangent, _ = corner_tangents(SQUARE, FACES, folded, FACES)
    np.testing.assert_allclose(tangent[1, :2], np.tile([1, 0, 0], (2, 1)), atol=1e-6)
    for uvs in (np.zeros((4, 2)), UVS * [1, 0]):
        tangent, _ = corner_tangents(SQUARE, FACES, uvs, FACES)
        np.testing.assert_allclose(np.linalg.norm(tangent, axis=-1), 1, atol=1e-6)
        np.testing.assert_allclose(tangent[..., 2], 0, atol=1e-6)
    points = np.zeros((3, 3))
    tangent, _ = corner_tangents(points, np.array([[0, 1, 2]]), UVS[:3], np.array([[0, 1, 2]]))
    assert np.isfinite(tangent).all()


@given(st.integers(0, 1000), st.sampled_from([1e-3, 1.0, 1e3]))
def test_any_mesh_has_unit_orthogonal_frames(seed, scale):
    rng = np.random.default_rng(seed)
    vertices, uvs = rng.normal(size=(8, 3)) * scale, rng.uniform(size=(9, 2))
    faces, uv_faces = rng.integers(0, 8, (12, 3)), rng.integers(0, 9, (12, 3))
    tangent, sign = corner_tangents(vertices, faces, uvs, uv_faces)
    normals = angle_weighted_normals(vertices, faces)[faces]
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=-1), 1, atol=1e-5)
    assert np.abs((tangent * normals).sum(-1)).max() < 1e-5
    assert set(sign.tolist()) <= {-1.0, 1.0}
