"""Figures on triangles whose shape is known."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.mesh_quality import corner_angles, mesh_quality
from benchmarks.meshes import grid
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.geometry.topology import corner_edge_lengths, degeneracy


def test_degeneracy_of_known_triangles():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [0, 1, 0], [2, 0, 0], [0.5, 1e-5, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 0, 0], [0, 1, 5]])
    got = degeneracy(vertices, faces)
    assert got == pytest.approx([np.sqrt(3) / 4, 0.25, 0.0, 0.0, 0.5e-5], abs=1e-12)
    np.testing.assert_allclose(degeneracy(vertices * 1e-6, faces), got, atol=1e-12)  # eq. 4 has no scale


def test_angles_add_up_to_a_half_turn():
    vertices, faces = icosphere(2)
    vertices = vertices + np.random.default_rng(0).normal(size=vertices.shape) * 0.05
    angles = corner_angles(vertices, faces)
    np.testing.assert_allclose(angles.sum(axis=1), np.pi, atol=1e-9)
    right = corner_angles(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    np.testing.assert_allclose(np.degrees(right), [[90, 45, 45]])
    assert np.isfinite(corner_angles(np.zeros((3, 3)), np.array([[0, 1, 2]]))).all()


def test_corner_edges_start_at_their_corner():
    vertices = np.array([[0, 0, 0], [3, 0, 0], [3, 4, 0]])
    assert corner_edge_lengths(vertices, np.array([[0, 1, 2]])).tolist() == [[3, 4, 5]]


def test_figures_of_a_grid():
    figures = mesh_quality(*grid(4, 4))
    assert figures["vertices"] == 25
    assert figures["faces"] == 32
    assert figures["min_angle_mean"] == pytest.approx(45, abs=1e-4)
    assert figures["degeneracy_p1"] == pytest.approx(0.25)
    assert figures["slivers"] == 0
    assert figures["degree_max"] == 6
    assert mesh_quality(*icosphere(3))["edge_cv"] < 0.1
