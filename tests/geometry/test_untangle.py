"""Faces that cut one another: against pymeshlab and a test of all pairs; smoothing apart."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from benchmarks.meshes import grid
from exmesh_graph.evaluate.metrics.mesh import count_self_intersections
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.geometry.untangle import cutting_pairs, untangle


def rough(seed: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = icosphere(2)
    rng = np.random.default_rng(seed)
    return (vertices + noise * rng.normal(size=vertices.shape)).astype(np.float32), faces


def crosses(p, q, triangle) -> bool:
    """Solve for the point of the segment in the triangle's own coordinates."""
    a, b, c = triangle
    system = np.stack([q - p, a - b, a - c], axis=1)
    if abs(np.linalg.det(system)) < 1e-14:
        return False
    t, u, v = np.linalg.solve(system, a - p)
    return 0 < t < 1 and u > 0 and v > 0 and u + v < 1


def every_pair(vertices, faces) -> list[tuple[int, int]]:
    points, found = vertices.astype(np.float64), []
    for f, g in itertools.combinations(range(len(faces)), 2):
        for a, b in ((f, g), (g, f)):
            edges = [(faces[a][k], faces[a][(k + 1) % 3]) for k in range(3)]
            if any(not {i, j} & set(faces[b]) and crosses(points[i], points[j], points[faces[b]]) for i, j in edges):
                found.append((f, g))
                break
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.0, 0.2, 0.4])
def test_pairs_are_those_of_testing_every_pair(noise):
    vertices, faces = icosphere(1)  # 80 faces
    vertices = (vertices + noise * np.random.default_rng(3).normal(size=vertices.shape)).astype(np.float32)
    want = every_pair(vertices, faces.tolist())
    assert [tuple(pair) for pair in cutting_pairs(vertices, faces).tolist()] == want
    assert (len(want) > 2) == (noise > 0)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("seed", range(3))
def test_as_many_faces_cut_others_as_pymeshlab_counts(seed, scale):
    vertices, faces = rough(seed, 0.15)
    found = np.unique(cutting_pairs(scale * vertices, faces))
    assert len(found) == count_self_intersections(vertices, faces) > 10


def test_one_huge_face_cuts_as_a_small_one_does():
    vertices, faces = icosphere(2)
    huge = np.array([[-100, -100, 0.01], [100, -100, 0.01], [0, 200, 0.01]])
    both = np.concatenate([vertices, huge])
    together = np.concatenate([faces, len(vertices) + np.arange(3)[None]])
    pairs = cutting_pairs(both, together)
    assert (pairs[:, 1] == len(faces)).all()
    assert len(pairs) > 10
    assert len(pairs) == count_self_intersections(both, together) - 1


@pytest.mark.parametrize("seed", range(3))
def test_a_rough_ball_comes_apart_and_only_near_its_cuts(seed):
    vertices, faces = icosphere(3)
    rng = np.random.default_rng(seed)
    bad = rng.choice(len(vertices), 12, replace=False)
    vertices = vertices.copy()
    vertices[bad] += (0.4 * rng.normal(size=(12, 3))).astype(np.float32)
    done = untangle(vertices, faces)
    assert done.before > 5
    assert done.after == 0 == count_self_intersections(done.vertices, faces)
    moved = (done.vertices != vertices).any(axis=1)
    assert done.moved == moved.sum() < 0.4 * len(vertices)
    assert np.array_equal(done.vertices, untangle(vertices, faces).vertices)


def test_what_does_not_cut_stays_and_what_cannot_come_apart_is_left():
    vertices, faces = rough(0, 0.02)
    done = untangle(vertices, faces)
    assert (done.before, done.after, done.moved) == (0, 0, 0)
    assert np.array_equal(done.vertices, vertices)
    # two sheets that cross: all their boundaries are fixed, and flat inner vertices stay flat
    flat, sheet = grid(4, 4)
    upright = flat[:, [0, 2, 1]] * np.float32(0.9) + np.float32([0.07, -0.41, 0.43])
    crossed = np.concatenate([flat, upright]), np.concatenate([sheet, sheet + len(flat)])
    done = untangle(*crossed)
    assert done.before == done.after > 0
    assert done.moved == 0
    assert cutting_pairs(flat[:0], sheet[:0]).shape == (0, 2)
