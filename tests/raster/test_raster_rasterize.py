"""Visibility against the brute-force reference, on random and on hard scenes."""

import subprocess
import sys

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.stability.scenes import camera, icosphere, soup
from exmesh_graph.raster import project, rasterize, rasterize_projected, shown_vertices
from tests.raster.raster_reference import rasterize_reference


def agree(vertices, faces, intrinsics, pose, height, width, **options) -> torch.Tensor:
    """Assert equality with the float64 reference, except where a centre lies on an edge or depths tie."""
    got = rasterize(vertices, faces, intrinsics, pose, height, width, **options)
    want = rasterize_reference(vertices.double(), faces, intrinsics, pose, height, width, **options)
    same = got.face_id == want.face_id
    close_edge = (got.bary.min(-1).values < 1e-3) | (want.bary.min(-1).values < 1e-3)
    tie = (got.depth - want.depth).abs() < 1e-5 * want.depth
    assert bool((same | close_edge | tie).all())
    assert same.double().mean() > 0.995
    seen = same & (want.face_id >= 0)
    assert torch.allclose(got.depth[seen].double(), want.depth[seen], rtol=1e-4, atol=1e-5)
    error = (got.bary[seen] - want.bary[seen]).abs()
    assert error.numel() == 0 or float(error.quantile(0.99)) < 1e-3
    return got.face_id


@pytest.mark.parametrize("size", [(40, 56), (64, 17), (1, 90)])
@pytest.mark.parametrize("triangle", [0.05, 0.5, 3.0])
def test_random_triangles_with_an_off_centre_camera(size, triangle):
    height, width = size
    vertices, faces = soup(60, triangle, seed=height)
    intrinsics, pose = camera(width, height, turn=0.4, shift=(7.3, -4.1))
    agree(vertices, faces, intrinsics, pose, height, width)


@pytest.mark.parametrize("cull", [False, True])
def test_back_faces_are_kept_unless_culled(cull):
    vertices, faces = soup(40, 0.4, seed=3)
    intrinsics, pose = camera(32, 32)
    agree(vertices, faces, intrinsics, pose, 32, 32, cull_back=cull)


def test_culling_keeps_the_outside_of_a_closed_surface():
    vertices, faces = icosphere(2)
    intrinsics, pose = camera(48, 48)
    both = rasterize(vertices, faces, intrinsics, pose, 48, 48)
    outside = rasterize(vertices, faces, intrinsics, pose, 48, 48, cull_back=True)
    assert torch.equal(both.face_id, outside.face_id)
    inside = rasterize(vertices, faces[:, [0, 2, 1]], intrinsics, pose, 48, 48, cull_back=True)
    assert bool((inside.depth >= both.depth).all())
    assert bool((inside.depth > both.depth).any())


def test_a_camera_inside_the_object_sees_it_everywhere():
    vertices, faces = icosphere(2)
    intrinsics, pose = camera(40, 30, distance=0.3, focal=20.0)
    assert bool((agree(vertices.float(), faces, intrinsics, pose, 30, 40) >= 0).all())


@pytest.mark.parametrize("near", [1e-3, 0.5, 3.4])
def test_the_near_plane_cuts_faces_exactly(near):
    """A long floor that runs from behind the camera to far away, and a soup that the plane crosses."""
    floor = torch.tensor([[-3.0, 0.5, -9], [3, 0.5, -9], [0, 0.5, 60]])
    vertices, faces = soup(40, 1.0, seed=9)
    vertices = torch.cat([floor, vertices])
    faces = torch.cat([torch.tensor([[0, 1, 2]]), faces + 3])
    intrinsics, pose = camera(36, 36, focal=30.0)
    got = agree(vertices, faces, intrinsics, pose, 36, 36, near=near)
    depth = rasterize(vertices, faces, intrinsics, pose, 36, 36, near=near).depth
    assert bool((depth[got >= 0] > near).all())


def test_one_triangle_over_the_whole_screen():
    vertices = torch.tensor([[-900.0, -900, 5], [900, -900, 5], [0, 1800, 5]])
    intrinsics, pose = camera(64, 48)
    got = rasterize(vertices, torch.tensor([[0, 1, 2]]), intrinsics, pose, 48, 64)
    assert bool((got.face_id == 0).all())
    assert torch.allclose(got.depth, torch.full_like(got.depth, 8.7), rtol=1e-4)


def test_slivers_and_degenerate_faces():
    g = torch.Generator().manual_seed(1)
    base = torch.rand(30, 3, generator=g) * 2 - 1
    along = torch.randn(30, 3, generator=g)
    vertices = torch.cat([base, base + along, base + 0.5 * along + 1e-3 * torch.randn(30, 3, generator=g)])
    slivers = torch.arange(90).reshape(3, 30).T.contiguous()
    points = torch.stack([torch.arange(30)] * 3, dim=1)
    lines = torch.stack([torch.arange(30), torch.arange(30) + 30, torch.arange(30)], dim=1)
    faces = torch.cat([slivers, points, lines])
    intrinsics, pose = camera(128, 128)
    got = rasterize(vertices, faces, intrinsics, pose, 128, 128)
    assert int(got.face_id.max()) < 30
    assert bool(torch.isfinite(got.bary).all())
    agree(vertices, slivers, intrinsics, pose, 128, 128)


def test_shared_edges_leave_no_hole_and_ties_go_to_the_lowest_face():
    """A fan of thin triangles through pixel centres covers its square; two copies give the first one's faces."""
    n = 61
    angle = torch.linspace(0, 2 * torch.pi, n)[:-1]
    ring = torch.stack([2 * angle.cos(), 2 * angle.sin(), torch.zeros(n - 1)], dim=1)
    vertices = torch.cat([torch.zeros(1, 3), ring])
    i = torch.arange(n - 1)
    fan = torch.stack([torch.zeros_like(i), 1 + i, 1 + (i + 1) % (n - 1)], dim=1)
    intrinsics, pose = camera(64, 64)
    got = rasterize(vertices, torch.cat([fan, fan]), intrinsics, pose, 64, 64)
    assert bool((got.face_id >= 0).all())
    assert int(got.face_id.max()) < n - 1


@pytest.mark.parametrize(("faces", "size"), [(0, (8, 8)), (5, (0, 8)), (5, (8, 0))])
def test_nothing_to_draw(faces, size):
    vertices, f = soup(5, 0.5, seed=0)
    intrinsics, pose = camera(8, 8)
    got = rasterize(vertices, f[:faces], intrinsics, pose, *size)
    assert got.face_id.shape == size
    assert got.bary.shape == (*size, 3)
    assert bool((got.face_id == -1).all())


def test_a_vertex_that_is_not_finite_hides_only_its_faces():
    vertices, faces = soup(20, 0.5, seed=5)
    intrinsics, pose = camera(32, 32)
    broken = vertices.clone()
    broken[0] = torch.nan
    broken[4] = torch.inf
    got = rasterize(broken, faces, intrinsics, pose, 32, 32)
    want = rasterize(vertices, faces[2:], intrinsics, pose, 32, 32)
    assert torch.equal(got.face_id, torch.where(want.face_id >= 0, want.face_id + 2, -1).int())


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1e-3, 1.0, 1e3]))
def test_scaling_the_scene_changes_no_face(seed, scale):
    vertices, faces = soup(15, 0.6, seed)
    intrinsics, pose = camera(24, 24)
    one = rasterize(vertices, faces, intrinsics, pose, 24, 24, near=1e-3)
    pose = pose.clone()
    pose[:3, 3] *= scale
    other = rasterize(vertices * scale, faces, intrinsics, pose, 24, 24, near=1e-3 * scale)
    assert (one.face_id == other.face_id).double().mean() > 0.99


def test_same_bytes_on_repeat():
    vertices, faces = soup(300, 0.3, seed=2)
    intrinsics, pose = camera(64, 64)
    first, second = (rasterize(vertices, faces, intrinsics, pose, 64, 64) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert torch.equal(a, b)


def test_projection_is_differentiable_and_keeps_the_principal_point():
    vertices = torch.randn(7, 3, dtype=torch.float64, requires_grad=True)
    intrinsics, pose = camera(64, 48, shift=(5.0, -3.0), turn=1.0)
    assert torch.autograd.gradcheck(lambda v: project(v, intrinsics, pose), vertices)
    x, y, z = project(torch.zeros(1, 3, dtype=torch.float64), intrinsics, pose)[0]
    assert (float(x / z), float(y / z)) == pytest.approx((37.0, 21.0))


@pytest.mark.thorough
def test_nothing_is_printed_and_warp_is_not_loaded_early():
    code = (
        "import sys, exmesh_graph.raster as r, torch\n"
        "assert 'warp' not in sys.modules\n"
        "k = torch.tensor([[9., 0, 4], [0, 9, 4], [0, 0, 1]])\n"
        "f = r.rasterize(torch.rand(3, 3) + 1, torch.tensor([[0, 1, 2]]), k, torch.eye(4), 8, 8)\n"
        "r.sample_texture(torch.rand(4, 4, 3), torch.rand(5, 2))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""
    assert done.stderr == ""


@pytest.mark.parametrize("large_face", [None, 0])
def test_without_barycentrics_the_rest_is_the_same(large_face):
    vertices, faces = soup(300, 0.4, seed=3)
    k, pose = camera(64, 48)
    places = project(vertices, k, pose)
    drawn = rasterize_projected(places, faces, 48, 64, large_face=large_face)
    less = rasterize_projected(places, faces, 48, 64, bary=False, large_face=large_face)
    assert torch.equal(drawn.face_id, less.face_id)
    assert torch.equal(drawn.depth, less.depth)
    assert less.bary.numel() == 0
    both = rasterize_projected(torch.stack([places, places]), faces, 48, 64, bary=False, large_face=large_face)
    assert torch.equal(both.face_id, torch.stack([drawn.face_id, drawn.face_id]))


def test_the_vertices_of_faces_that_are_shown():
    vertices, faces = soup(300, 0.4, seed=3)
    k, pose = camera(64, 48)
    face_id = rasterize(vertices, faces, k, pose, 48, 64).face_id
    faces = faces.long()
    expected = torch.zeros(len(vertices) + 1, dtype=torch.bool)  # one vertex more, of no face
    for face in set(face_id[face_id >= 0].tolist()):
        expected[faces[face]] = True
    assert 0 < expected.sum() < len(expected)
    assert torch.equal(shown_vertices(face_id, faces, len(expected)), expected)
    assert not shown_vertices(torch.full((2, 2), -1), faces, 5).any()
