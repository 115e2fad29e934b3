"""The variation of normals: value and gradient of both forms, what it costs, and what it does to a wall."""

import numpy as np
import pytest
import torch
from stage1_scenes import ball, fresh_state, photographs
from test_stage1_vertices import rough_ball

from exmesh_graph.gpu.cores import cores
from exmesh_graph.raster import edge_table
from exmesh_graph.stage1.normals import normal_variation
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian


def cube(n):
    """[-1, 1]^3 of 12 n^2 faces: vertices float64 [V, 3], faces int32 [F, 3]."""
    line = np.linspace(-1, 1, n + 1)
    u, v = (a.ravel() for a in np.meshgrid(line, line, indexing="ij"))
    at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    side = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    points, faces = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            grid = np.stack([u, v, np.full_like(u, sign)], 1)
            faces.append((side if sign > 0 else side[:, ::-1]) + sum(map(len, points)))
            points.append(np.roll(grid, axis, axis=1))  # an even permutation of the axes keeps the orientation
    points, place = np.unique(np.round(np.concatenate(points), 9), axis=0, return_inverse=True)
    return points, np.ascontiguousarray(place.ravel()[np.concatenate(faces)], np.int32)


def variation(points, faces, pixel=0.01, width=0.02):
    table = edge_table(torch.from_numpy(faces) if isinstance(faces, np.ndarray) else faces)
    points = torch.from_numpy(points) if isinstance(points, np.ndarray) else points
    return normal_variation(points, table, pixel, width)


def test_kernels_give_value_and_gradient_of_the_plain_form_and_the_same_bytes_on_any_cores():
    vertices, faces = rough_ball()
    of, exact = (variation(v, faces) for v in (vertices, vertices.double()))
    moved = vertices + 0.003 * torch.randn(vertices.shape, generator=torch.Generator().manual_seed(1))
    leaf, plain = moved.clone().requires_grad_(), moved.double().requires_grad_()
    want = 0.7 * exact(plain)
    (exactly,) = torch.autograd.grad(want, plain)
    found = []
    for count in (1, 2, 3):
        with cores(count):
            got = 0.7 * of(leaf)
            found.append((got.detach(), *torch.autograd.grad(got, leaf)))
    assert float(found[0][0]) == pytest.approx(float(want.detach()), rel=1e-5)
    assert float((found[0][1] - exactly).norm()) < 1e-5 * float(exactly.norm())
    assert not found[0][1][-2:].any()  # a vertex without edges is not moved
    assert all(torch.equal(a, b) for other in found[1:] for a, b in zip(found[0], other, strict=True))


@pytest.mark.parametrize("width", [1e-3, 0.02, 0.5])
def test_the_plain_gradient_is_that_of_its_differences(width):
    points, faces = cube(2)
    points = torch.from_numpy(points + 0.1 * np.random.default_rng(0).normal(size=points.shape))
    assert torch.autograd.gradcheck(variation(points, faces[:-5], width=width), points.clone().requires_grad_())


def test_a_cube_costs_its_edges_however_fine_its_faces_are():
    """12 edges of length 2 that turn by 90 degrees, over an area of 24; its walls cost nothing."""
    pixel, width = 0.01, 0.02
    want = pixel / 24 * 24 * (np.sqrt(2 + width**2) - width)
    for n in (1, 4, 9):
        points, faces = cube(n)
        assert float(variation(points, faces)(torch.from_numpy(points))) == pytest.approx(want, rel=1e-12)
        both = variation(points.astype(np.float32), faces)(torch.from_numpy(points.astype(np.float32)))
        assert float(both) == pytest.approx(want, rel=1e-5)


def test_the_whole_moved_or_turned_costs_the_same_and_a_dent_or_bump_costs_more():
    points, faces = cube(8)
    of = variation(points, faces)
    flat = float(of(torch.from_numpy(points)))
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    assert float(of(torch.from_numpy(points @ turn + 3))) == pytest.approx(flat, rel=1e-12)
    middle = np.argmin(np.linalg.norm(points - [0, 0, 1], axis=1))
    for height in (0.05, -0.05):
        other = points.copy()
        other[middle, 2] += height
        assert float(of(torch.from_numpy(other))) > 1.01 * flat


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_needles_and_faces_without_area_count_nothing_and_leave_the_rest_as_it_is(dtype):
    points, faces = cube(4)
    vertices = torch.from_numpy(points).to(dtype)
    of = variation(vertices, faces)
    fallen = vertices.clone()
    fallen[faces[3, 1]] = fallen[faces[3, 0]]  # two corners in one place
    fallen[faces[20, 1]] = fallen[faces[20, 0]] + 1e-12
    leaf = fallen.requires_grad_()
    value = of(leaf)
    (gradient,) = torch.autograd.grad(value, leaf)
    assert torch.isfinite(gradient).all()
    assert float(gradient.abs().max()) < 1  # per pixel of 0.01: nothing is divided by a needle's height
    assert 0 < float(value.detach()) < 2 * float(of(vertices))


def test_nothing_to_bend():
    """One face, none, or faces without an edge in common."""
    apart = np.array([[0, 1, 2], [3, 4, 5]], np.int32)
    for faces in (apart, apart[:1], apart[:0]):
        for dtype in (torch.float32, torch.float64):
            leaf = torch.randn(6, 3, generator=torch.Generator().manual_seed(0)).to(dtype).requires_grad_()
            value = variation(leaf.detach(), faces)(leaf)
            assert float(value.detach()) == 0
            if value.requires_grad:
                assert not torch.autograd.grad(value, leaf)[0].any()


def test_bumps_of_a_wall_go_and_the_creases_stay():
    points, faces = cube(12)
    noise = 0.02 * np.random.default_rng(3).normal(size=len(points))
    inside = np.sort(np.abs(points), axis=1)[:, 1] < 0.99  # not on an edge of the cube
    rough = points + np.where(inside, noise, 0)[:, None] * np.where(np.abs(points) > 0.99, np.sign(points), 0)
    leaf = torch.from_numpy(rough.astype(np.float32)).requires_grad_()
    of = variation(rough.astype(np.float32), faces)
    adam = torch.optim.Adam([leaf], lr=4e-3)
    decay = torch.optim.lr_scheduler.ExponentialLR(adam, 0.99)
    for _ in range(500):
        adam.zero_grad()
        of(leaf).backward()
        adam.step()
        decay.step()
    moved = leaf.detach().numpy()
    assert _unevenness(moved, faces) < 0.4 * _unevenness(rough, faces)
    assert np.abs(moved - points)[~inside].mean() < 0.05  # ... and the box is as large as it was


def _unevenness(points, faces):
    """How far normals are from those of the cube's six walls, rad, on the mean of all faces."""
    one, two, three = (points[faces[:, k]] for k in range(3))
    normal = np.cross(two - one, three - one)
    return np.arccos(np.clip(np.abs(normal).max(axis=1) / np.linalg.norm(normal, axis=1), -1, 1)).mean()


def test_stage_one_takes_it_by_its_weight():
    """Its weight counts in the loss, in pixels of the pictures that are compared."""
    views = photographs(ball(), count=4)
    state = fresh_state(ball())

    def loss(**changes):
        smooth = Bilaplacian(**{"weight": 0.0, **changes})
        settings = RefineSettings(iterations=1, vertex_lr=0.0, texture_lr=0.0)
        return refine(state, views, settings, smoothness=smooth)[1]["loss"][0]

    without, once, twice = (loss(normals=w) for w in (0.0, 1.0, 2.0))
    assert once - without > 1e-3
    assert twice - without == pytest.approx(2 * (once - without), rel=1e-3)
    assert loss(normals=1.0, weight=0.3) - once == pytest.approx(loss(weight=0.3) - without, rel=1e-3)
