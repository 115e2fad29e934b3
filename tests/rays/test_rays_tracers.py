"""Embree against all pairs in float64; watertightness; invariance to scale and position."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from benchmarks.brute_rays import BruteTracer
from exmesh_graph.errors import GeometryError
from exmesh_graph.rays import MISS, make_ray_tracer, offset_origins

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
CUBE_FACES = np.array(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ],
    np.int32,
)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), exponent=st.integers(-3, 3), shift=st.sampled_from([0.0, 10.0]))
@example(seed=45074556, exponent=0, shift=10.0)  # drew one face twice
def test_embree_agrees_with_all_pairs(seed, exponent, shift):
    rng = np.random.default_rng(seed)
    scale = 10.0**exponent
    vertices = (rng.normal(size=(40, 3)) + shift) * scale
    faces = rng.permuted(np.tile(np.arange(40), (30, 1)), axis=1)[:, :3].astype(np.int32)
    faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]  # of two alike either may be named
    origins = (rng.normal(size=(300, 3)) * 2 + shift) * scale
    directions = rng.normal(size=(300, 3))
    fast, slow = (
        tracer.closest_hit(origins, directions)
        for tracer in (make_ray_tracer(vertices, faces), BruteTracer(vertices, faces))
    )
    same = fast.face == slow.face
    assert same.mean() > 0.99  # rays within float32 of an edge may differ
    both = same & (fast.face != MISS)
    np.testing.assert_allclose(fast.bary[both], slow.bary[both], atol=2e-3)
    np.testing.assert_allclose(fast.t[both], slow.t[both], rtol=5e-3, atol=1e-5 * scale)
    np.testing.assert_array_equal(np.isinf(fast.t), fast.face == MISS)


def test_t_is_in_units_of_the_directions_length_and_limits_hold():
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2]], np.int32)
    origins, directions = np.array([[0.0, 0, 4]]), np.array([[0.0, 0, -2]])
    for tracer in (make_ray_tracer(vertices, faces), BruteTracer(vertices, faces)):
        hits = tracer.closest_hit(origins, directions)
        assert hits.t[0] == pytest.approx(2, rel=1e-5)
        np.testing.assert_allclose(hits.bary[0] @ vertices, [0, 0, 0], atol=1e-6)
        assert tracer.any_hit(origins, directions, 2.1)[0]
        assert not tracer.any_hit(origins, directions, 1.9)[0]
        assert tracer.closest_hit(origins, directions, 1.9).face[0] == MISS


def test_no_ray_leaves_a_closed_box():
    tracer = make_ray_tracer(CUBE, CUBE_FACES)
    rng = np.random.default_rng(0)
    through_edges = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z])
    along_edges = CUBE[CUBE_FACES[:, 0]] * rng.uniform(0, 1, (12, 1)) + CUBE[CUBE_FACES[:, 1]] * 0
    directions = np.concatenate([rng.normal(size=(200_000, 3)), through_edges, along_edges + 1e-9])
    origins = np.zeros_like(directions)
    assert tracer.any_hit(origins, directions).all()


@pytest.mark.parametrize(("scale", "shift"), [(1, 0), (1e-3, 0), (1e3, 0), (1, 100)])
def test_offset_origins_do_not_meet_their_own_surface(scale, shift):
    rng = np.random.default_rng(1)
    vertices = (CUBE * scale + shift).astype(np.float32)
    tracer = make_ray_tracer(vertices, CUBE_FACES)
    # rays from the top face (y = +1) into its open half space: none may be blocked; from just inside: all are
    corner = rng.uniform(-0.99, 0.99, (5000, 2))
    points = np.stack([corner[:, 0], np.ones(5000), corner[:, 1]], 1).astype(np.float32) * scale + shift
    points = points.astype(np.float32).astype(np.float64)
    up = np.tile([0.0, 1, 0], (5000, 1))
    directions = rng.normal(size=(5000, 3))
    directions[:, 1] = np.abs(directions[:, 1]) + 0.02
    assert not tracer.any_hit(offset_origins(points, up, tracer.radius), directions).any()
    assert tracer.any_hit(offset_origins(points, -up, tracer.radius), directions).all()


def test_many_rays_over_threads_equal_one_thread():
    from exmesh_graph.rays.embree import EmbreeTracer

    rng = np.random.default_rng(2)
    origins, directions = rng.normal(size=(300_000, 3)) * 2, rng.normal(size=(300_000, 3))
    one, two = (EmbreeTracer(CUBE, CUBE_FACES, threads=n).closest_hit(origins, directions) for n in (1, 3))
    for a, b in ((one.face, two.face), (one.t, two.t), (one.bary, two.bary)):
        np.testing.assert_array_equal(a, b)


def test_bad_meshes_are_refused():
    with pytest.raises(GeometryError, match="empty"):
        make_ray_tracer(CUBE, CUBE_FACES[:0])
    broken = CUBE.copy()
    broken[3, 1] = np.nan
    with pytest.raises(GeometryError, match="vertex 3"):
        make_ray_tracer(broken, CUBE_FACES)


def test_faces_that_cast_nothing_are_passed_and_the_others_keep_their_numbers():
    from exmesh_graph.rays.embree import EmbreeTracer

    rng = np.random.default_rng(5)
    sheet = np.array([[-9, 3, -9], [9, 3, -9], [0, 3, 9]], float)
    both, faces = np.concatenate([sheet, CUBE]), np.concatenate([[[0, 1, 2]], CUBE_FACES + 3])
    casts = np.arange(len(faces)) > 0
    tracer, alone = make_ray_tracer(both, faces, casts=casts), EmbreeTracer(CUBE, CUBE_FACES)
    origins = rng.normal(size=(2000, 3)) + np.array([0, 6, 0])
    directions = 1.5 * rng.normal(size=(2000, 3)) - origins
    found, expected = (one.closest_hit(origins, directions) for one in (tracer, alone))
    assert 0.2 < (expected.face != MISS).mean() < 0.95
    np.testing.assert_array_equal(found.face, np.where(expected.face == MISS, MISS, expected.face + 1))
    assert tracer.radius == alone.radius
    assert (make_ray_tracer(both, faces).closest_hit(origins, directions).face == 0).mean() > 0.5
    assert not make_ray_tracer(both, faces, casts=np.zeros(len(faces), bool)).any_hit(origins, directions).any()
