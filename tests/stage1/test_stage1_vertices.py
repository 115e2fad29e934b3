"""Kernels of vertices and faces against their plain forms in float64."""

import numpy as np
import pytest
import torch

from exmesh_graph.gpu.cores import cores
from exmesh_graph.optim import EPSILON, adam_step
from exmesh_graph.raster import edge_table, project, rasterize_projected
from exmesh_graph.stage1.facing import behind
from exmesh_graph.stage1.regularise import smoother, smoothness
from exmesh_graph.stage1.vertices import any_turned, step
from exmesh_graph.testing import latlong_ball, views


def rough_ball(lonely=2):
    """A closed surface of more vertices than one chunk holds, without symmetry, and vertices of no face."""
    vertices, faces, *_ = latlong_ball(40, 60, 0.6)
    points = np.concatenate([vertices, np.ones((lonely, 3))])
    points = points + 0.01 * np.random.default_rng(0).normal(size=points.shape)
    return torch.from_numpy(points.astype(np.float32)), torch.from_numpy(np.ascontiguousarray(faces, np.int32))


@pytest.mark.parametrize("kind", ["laplacian", "bilaplacian"])
def test_smoothness_and_its_gradient_are_those_in_float64(kind):
    vertices, faces = rough_ball()
    edges = edge_table(faces).edges
    of, exact = smoother(vertices, edges), smoother(vertices.double(), edges)
    assert of.neighbours is not None
    assert exact.neighbours is None
    leaf, plain = vertices.clone().requires_grad_(), vertices.double().requires_grad_()
    want = 0.7 * smoothness(plain, exact, kind)
    found = []
    for count in (1, 2, 3):
        with cores(count):
            got = 0.7 * smoothness(leaf, of, kind)
            found.append((got.detach(), *torch.autograd.grad(got, leaf)))
    assert float(found[0][0]) == pytest.approx(float(want), rel=1e-5)
    (exactly,) = torch.autograd.grad(want, plain)
    assert float((found[0][1] - exactly).norm()) < 1e-5 * float(exactly.norm())
    assert not found[0][1][-2:].any()  # a vertex without edges is not moved
    assert all(torch.equal(a, b) for other in found[1:] for a, b in zip(found[0], other, strict=True))


def test_a_step_is_that_of_the_plain_operations():
    draw = torch.Generator().manual_seed(0)
    count = 3000
    gradient, values, first = (torch.randn(count, 3, generator=draw) for _ in range(3))
    area, second, mean = (torch.rand(count, generator=draw) for _ in range(3))
    exact = [t.double() for t in (values, first, second, mean)]
    norm = gradient.double().norm(dim=1)
    exact[3].lerp_(norm, 0.03)
    adam_step(exact[0], gradient.double() * area.double()[:, None], exact[1], exact[2], 7, 0.1, epsilon=1e-3)
    total = step(values, gradient, area[:, None], mean, (first, second), 7, 0.1, decay=0.97, epsilon=1e-3)
    assert total == pytest.approx(float(norm.sum()), rel=1e-6)
    for got, want in zip((values, first, second, mean), exact, strict=True):
        assert torch.allclose(got.double(), want, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_gradient_that_is_not_finite_is_told(value):
    gradient = torch.zeros(1500, 3)
    gradient[1400, 1] = value
    zeros = torch.zeros(1500, 3)
    moments = (zeros.clone(), torch.zeros(1500))
    total = step(zeros, gradient, torch.ones(1500, 1), torch.zeros(1500), moments, 1, 0.1, decay=0.9, epsilon=EPSILON)
    assert not np.isfinite(total)


@pytest.mark.parametrize("shape", [(40, 3), (1 << 14, 3)])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_adam_tells_it_of_few_values_and_of_many(shape, value):
    values, first, second, gradient = (torch.zeros(shape) for _ in range(4))
    assert adam_step(values, gradient, first, second, 1, 0.1, check=True)
    gradient[shape[0] // 2, 2] = value
    assert not adam_step(values, gradient, first, second, 2, 0.1, check=True)


def test_a_whole_surface_shows_no_back_and_one_turned_face_is_found():
    vertices, faces = rough_ball(lonely=0)
    made = views(count=1, size=48)
    place = [torch.from_numpy(np.array(a[0])) for a in (made.intrinsics, made.world_to_camera)]
    projected = project(vertices, *place)
    seen = rasterize_projected(projected, faces, 48, 48)
    shown = torch.zeros(len(faces), dtype=torch.uint8)
    shown[seen.face_id[seen.face_id >= 0].unique().long()] = 1
    assert not any_turned(projected, faces, shown)
    assert behind(vertices, faces, projected, seen, place[0], shown) is None
    face = int(shown.nonzero()[len(shown.nonzero()) // 2])
    faces[face] = faces[face].flip(0)
    assert any_turned(projected, faces, shown)
    value, plain = (behind(vertices, faces, projected, seen, place[0], given) for given in (shown, None))
    assert float(value) == float(plain) > 0
    shown[face] = 0
    assert not any_turned(projected, faces, shown)
