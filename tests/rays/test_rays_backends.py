"""The tracers against each other, against closed boxes and over scales; rays as tensors."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from test_rays_tracers import CUBE, CUBE_FACES

from benchmarks.brute_rays import BruteTracer
from exmesh_graph.errors import MissingLibraryError
from exmesh_graph.rays import MISS, make_ray_tracer, offset_origins, tensors
from exmesh_graph.rays.embree import EmbreeTracer
from exmesh_graph.rays.warp_bvh import WarpTracer

CUDA = pytest.param(
    "cuda",
    marks=[pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device")],
)
DEVICES = ["cpu", CUDA]


def _soup(seed, shift=0.0, scale=1.0):
    rng = np.random.default_rng(seed)
    vertices = (rng.normal(size=(40, 3)) + shift) * scale
    faces = rng.permuted(np.tile(np.arange(40), (30, 1)), axis=1)[:, :3].astype(np.int32)
    faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]  # of two equal faces either may win
    origins = (rng.normal(size=(4000, 3)) * 2 + shift) * scale
    return vertices, faces, origins, rng.normal(size=(4000, 3)) * rng.uniform(0.1, 10, (4000, 1))


def _sphere(rings):
    lat, lon = np.meshgrid(
        np.linspace(-np.pi / 2, np.pi / 2, rings + 1),
        np.linspace(-np.pi, np.pi, 2 * rings, endpoint=False),
        indexing="ij",
    )
    points = np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    k = (j + 1) % (2 * rings)
    a, b, c, d = (row * 2 * rings + column for row, column in ((i, j), (i, k), (i + 1, k), (i + 1, j)))
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    corners = points[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return points, faces[area > 1e-9].astype(np.int32)


@pytest.mark.parametrize("device", DEVICES)
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**31), exponent=st.integers(-3, 3), shift=st.sampled_from([0.0, 10.0]))
def test_warp_agrees_with_embree(device, seed, exponent, shift):
    vertices, faces, origins, directions = _soup(seed, shift, 10.0**exponent)
    fast, other = make_ray_tracer(vertices, faces), WarpTracer(vertices, faces, device)
    assert other.radius == pytest.approx(fast.radius)
    first, second = (tracer.closest_hit(origins, directions) for tracer in (fast, other))
    same = first.face == second.face
    assert (~same).sum() <= 2  # of 4000: rays within float32 of an edge
    both = same & (first.face != MISS)
    # rays along a face's plane tell neither well
    assert (np.abs(first.bary[both] - second.bary[both]).max(axis=1) < 1e-3).mean() > 0.99
    assert (np.abs(first.t[both] / second.t[both] - 1) < 1e-3).mean() > 0.99
    assert np.isinf(second.t[second.face == MISS]).all()
    limit = np.where(np.isfinite(first.t), first.t, 1.0) * np.random.default_rng(seed).uniform(0.3, 3, 4000)
    blocked = [tracer.any_hit(origins, directions, limit) for tracer in (fast, other)]
    assert (blocked[0] != blocked[1]).sum() <= 2
    assert 0 < blocked[0].sum() < len(limit)


@pytest.mark.parametrize("device", DEVICES)
def test_a_smooth_scene_agrees_to_more_than_9999_in_10000(device):
    vertices, faces = _sphere(24)
    vertices = vertices * (1 + 0.15 * np.sin(9 * vertices[:, :1]) * np.sin(7 * vertices[:, 1:2]))
    rng = np.random.default_rng(0)
    face = rng.integers(0, len(faces), 50_000)
    corners = vertices[faces[face]]
    points = (corners * rng.dirichlet([1, 1, 1], 50_000)[..., None]).sum(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    directions = rng.normal(size=points.shape)
    directions *= np.sign((directions * normal).sum(axis=1, keepdims=True))
    tracers = make_ray_tracer(vertices, faces), WarpTracer(vertices, faces, device)
    origins = offset_origins(points, normal, tracers[0].radius)
    blocked = [tracer.any_hit(origins, directions) for tracer in tracers]
    assert 0.02 < blocked[0].mean() < 0.5
    assert (blocked[0] == blocked[1]).mean() > 0.9999


def box_rays(count, seed=0):
    """Directions from the inside of CUBE: random ones, and ones through its edges, vertices and face diagonals."""
    rng = np.random.default_rng(seed)
    a, b = CUBE[rng.integers(0, 8, count // 2)], CUBE[rng.integers(0, 8, count // 2)]
    towards = a + (b - a) * rng.integers(0, 65, (count // 2, 1)) / 64
    return np.concatenate([rng.normal(size=(count - count // 2, 3)), towards]) + 0.0


@pytest.mark.parametrize(("tracer", "count"), [(EmbreeTracer, 400_000), (WarpTracer, 100_000)])
@pytest.mark.parametrize("centre", [(0, 0, 0), (0.3, -0.2, 0.71)])
def test_no_ray_leaves_a_closed_box_from_inside(tracer, count, centre):
    built = WarpTracer(CUBE, CUBE_FACES, "cpu") if tracer is WarpTracer else tracer(CUBE, CUBE_FACES)
    targets = box_rays(count)
    directions = targets - np.asarray(centre) * (np.arange(count) >= count - count // 2)[:, None]
    kept = np.abs(directions).sum(axis=1) > 1e-6
    origins = np.broadcast_to(np.asarray(centre, float), directions.shape)
    assert built.any_hit(origins[kept], directions[kept]).all()


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1e3, 0.0), (1.0, 1e3), (1e3, 1e3)])
def test_visibility_does_not_depend_on_scale_and_position(scale, shift):
    """The same rays from the surface of a soup: 1 in 10 000 may fall to the other side of an edge by rounding."""
    vertices, faces, _, directions = _soup(4)
    rng = np.random.default_rng(5)
    face = rng.integers(0, len(faces), 20_000)
    weights = rng.dirichlet([1, 1, 1], 20_000)
    directions = rng.normal(size=(20_000, 3))

    def visible(vertices):
        corners = vertices[faces[face]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        normal *= np.sign((normal * directions).sum(axis=1, keepdims=True))
        tracer = make_ray_tracer(vertices, faces)
        points = (corners * weights[..., None]).sum(axis=1)
        return tracer.any_hit(offset_origins(points, normal, tracer.radius), directions)

    found, expected = visible(vertices * scale + shift), visible(vertices)
    assert 0.1 < expected.mean() < 0.9
    assert (found != expected).mean() <= 1e-4


@pytest.mark.parametrize("device", DEVICES)
def test_tensors_trace_as_arrays_do(device):
    vertices, faces, origins, directions = _soup(6)
    o, d = (torch.from_numpy(x).to(device).requires_grad_() for x in (origins, directions))
    limit = torch.full((len(o),), 2.5, device=device)
    plain = make_ray_tracer(vertices, faces)
    expected = plain.closest_hit(origins, directions, 2.5)
    for tracer in (plain, WarpTracer(vertices, faces, device)):
        for far in (2.5, limit):
            found = tensors.closest_hit(tracer, o, d, far)
            assert {x.device.type for x in (found.face, found.t, found.bary)} == {device}
            assert (found.face.cpu().numpy() == expected.face).mean() > 0.999
            blocked = tensors.any_hit(tracer, o, d, far)
            assert blocked.dtype == torch.bool
            assert (blocked.cpu().numpy() == (expected.face != MISS)).mean() > 0.999
    assert len(tensors.any_hit(plain, o[:0], d[:0])) == 0
    assert len(tensors.closest_hit(WarpTracer(vertices, faces, device), o[:0], d[:0]).face) == 0


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_offsets_follow_radius_and_the_points_own_precision(dtype):
    rng = np.random.default_rng(0)
    points, normals = (rng.normal(size=(2, 50, 3)) * 30).astype(dtype).astype(np.float64)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    expected = offset_origins(points.astype(dtype), normals, 3.0)
    assert expected.dtype == np.float64
    found = offset_origins(torch.from_numpy(points.astype(dtype)), torch.from_numpy(normals), 3.0)
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-15)
    lift = np.linalg.norm(expected - points, axis=1)
    np.testing.assert_allclose(lift, 3.0 * 2e-5 + 8 * np.finfo(dtype).eps * np.abs(points).max(axis=1), rtol=1e-8)


def test_directions_of_any_length_and_mixed_limits():
    """Lengths from 1e-4 to 1e4 in one call: t counts in each ray's own length."""
    vertices, faces, origins, directions = _soup(7)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    length = 10 ** np.random.default_rng(1).uniform(-4, 4, len(unit))
    for tracer in (make_ray_tracer(vertices, faces), WarpTracer(vertices, faces, "cpu")):
        plain, scaled = tracer.closest_hit(origins, unit), tracer.closest_hit(origins, unit * length[:, None])
        assert (plain.face == scaled.face).mean() > 0.999
        hit = (plain.face == scaled.face) & (plain.face != MISS)
        np.testing.assert_allclose(scaled.t[hit] * length[hit], plain.t[hit], rtol=1e-3)
        just_short = tracer.any_hit(origins[hit], unit[hit] * length[hit, None], scaled.t[hit] * 0.99)
        just_past = tracer.any_hit(origins[hit], unit[hit] * length[hit, None], scaled.t[hit] * 1.01)
        assert just_short.mean() < 0.01
        assert just_past.mean() > 0.99


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a CUDA device")
def test_cuda_tracer_without_a_device_says_so():
    with pytest.raises(MissingLibraryError, match="CUDA"):
        make_ray_tracer(CUBE, CUBE_FACES, "cuda")


def test_brute_force_is_the_measure_of_both_on_slivers_and_duplicates():
    """Zero-area, duplicated and needle-thin faces neither block wrongly nor crash a tracer."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0], [0, 1e-7, 0.5], [0, 0, 0.5], [1, 0, 0.5]])
    faces = np.array([[0, 1, 2], [0, 1, 2], [3, 3, 4], [3, 4, 5]], np.int32)
    rng = np.random.default_rng(0)
    origins, directions = np.tile([0.0, 0, 2], (3000, 1)), rng.normal(size=(3000, 3))
    expected = BruteTracer(vertices, faces).any_hit(origins, directions)
    assert 0.02 < expected.mean() < 0.9
    for tracer in (make_ray_tracer(vertices, faces), WarpTracer(vertices, faces, "cpu")):
        assert (tracer.any_hit(origins, directions) != expected).sum() <= 1
