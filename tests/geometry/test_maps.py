"""Vertex attributes follow topology operations."""

from __future__ import annotations

import numpy as np
import pytest

from exmesh_graph.geometry.merge import merge
from exmesh_graph.geometry.settings import MergeSettings, SplitSettings
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.geometry.split import split, subdivide
from exmesh_graph.geometry.topology import Step, VertexMap


def test_kept_first_then_interpolated():
    step = Step(np.array([2, 0]), np.array([0, 1]), np.array([1, 2]), np.array([0.25, 0.5]))
    values = np.array([[0.0, 10.0], [4.0, 20.0], [8.0, 40.0]], np.float32)
    assert step.carry(values).tolist() == [[8, 40], [0, 10], [1, 12.5], [6, 30]]
    assert step.carry(values, new="zero")[2:].tolist() == [[0, 0], [0, 0]]
    assert step.carry(values[:, 0]).tolist() == [8, 0, 1, 6]
    assert step.carry(values).dtype == np.float32


def test_an_empty_map_changes_nothing():
    values = np.arange(5.0)
    np.testing.assert_array_equal(VertexMap().carry(values), values)


@pytest.mark.parametrize("operation", ["split", "merge", "subdivide"])
def test_positions_carried_as_an_attribute_are_the_new_positions(operation):
    vertices, faces = icosphere(2)
    uvs, rng = np.zeros((len(vertices), 2), np.float32), np.random.default_rng(0)
    uvs[:] = vertices[:, :2] * 0.5 + 0.5
    if operation == "split":
        choice = SplitSettings(position="random")
        done = split(vertices, faces, uvs, faces, rng.random(len(vertices)), 1500, choice)
        assert len(done.map.steps) > 1
    elif operation == "merge":
        choice = MergeSettings(min_faces=4, area_quantile=0.9, min_cosine=0.0)
        done = merge(vertices, faces, uvs, faces, rng.integers(0, 2, len(faces)), choice)
        assert done.count > 0
    else:
        done = subdivide(vertices, faces, uvs, faces)
    np.testing.assert_allclose(done.map.carry(vertices), done.vertices, atol=1e-6)
    linear = vertices.astype(np.float64) @ [1.0, -2.0, 3.0]
    np.testing.assert_allclose(done.map.carry(linear), done.vertices.astype(np.float64) @ [1.0, -2.0, 3.0], atol=1e-5)


def test_interpolated_second_moments_bound_the_first_step_and_zero_ones_do_not():
    b1, b2, steps, gradient = 0.9, 0.999, 2000, 0.01
    vertices, faces = icosphere(1)
    uvs = np.zeros((len(vertices), 2), np.float32)
    m, v = np.full(len(vertices), gradient), np.full(len(vertices), gradient**2)
    done = subdivide(vertices, faces, uvs, faces)

    def first_step(new):
        """Adam's update in learning rates for the same gradient as before."""
        m1 = b1 * done.map.carry(m, new) + (1 - b1) * gradient
        v1 = b2 * done.map.carry(v, new) + (1 - b2) * gradient**2
        return np.abs(m1 / (1 - b1**steps) / np.sqrt(v1 / (1 - b2**steps)))[len(vertices) :]

    assert first_step("interpolate").max() == pytest.approx(1.0, abs=0.1)
    assert first_step("zero").min() > 2.5
