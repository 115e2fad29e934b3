"""Tints of vertices by the direction of view: kernels against plain operations in float64, and the same bytes."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.gpu.cores import cores
from exmesh_graph.optim import adam_step
from exmesh_graph.stage1.appearance.directional import COUNTS, plain_tints
from exmesh_graph.stage1.appearance.tints import fused_tints, step_residual
from exmesh_graph.stage1.vertices import serves


def made(count, harmonics, seed, distance=3.0):
    """Vertices, residual, mean, gradient and a camera [4, 4] that looks from `distance` away."""
    rng = torch.Generator().manual_seed(seed)
    vertices, gradient = (torch.randn(count, 3, generator=rng) for _ in range(2))
    residual, mean = (torch.randn(count, size, generator=rng) for size in (3 * harmonics, harmonics))
    turn = torch.linalg.qr(torch.randn(3, 3, generator=rng, dtype=torch.float64)).Q
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = turn
    pose[:3, 3] = -turn @ (distance * torch.nn.functional.normalize(torch.randn(3, generator=rng).double(), dim=0))
    return vertices, residual, mean, gradient, pose


def eye_of(pose):
    return tuple((-pose[:3, :3].T @ pose[:3, 3]).tolist())


def both(vertices, residual, mean, gradient, pose):
    """(tints, gradients of vertices and residual) by kernels, and in float64 by plain operations."""
    found = []
    for kind in (torch.float32, torch.float64):
        leaves = [t.to(kind).requires_grad_() for t in (vertices, residual)]
        if kind == torch.float32:
            tints = fused_tints(*leaves, mean, eye_of(pose))
        else:
            tints = plain_tints(*leaves, mean.double(), pose)
        found.append([tints, *torch.autograd.grad((tints * gradient.to(kind)).sum(), leaves)])
    return found


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 3000), st.sampled_from(sorted(COUNTS.values())), st.integers(0, 10**6), st.floats(1.5, 50))
def test_tints_and_their_gradients_are_those_of_plain_operations(count, harmonics, seed, distance):
    ours, plain = both(*made(count, harmonics, seed, distance))
    for one, other in zip(ours, plain, strict=True):
        assert torch.allclose(one.double(), other, rtol=2e-4, atol=2e-5 * max(1.0, float(other.abs().max())))


@pytest.mark.parametrize("harmonics", sorted(COUNTS.values()))
def test_a_vertex_beside_the_camera_and_values_of_many_sizes(harmonics):
    vertices, residual, mean, gradient, pose = made(40, harmonics, 7)
    vertices[0] = torch.tensor(eye_of(pose)).float() + torch.tensor([1e-3, 0, 0])
    residual[1], residual[2], mean[3], gradient[4] = 0, 1e4, 0, 1e-6
    ours, plain = both(vertices, residual, mean, gradient, pose)
    for one, other in zip(ours, plain, strict=True):
        assert torch.isfinite(one).all()
        size = other.abs().amax(dim=1, keepdim=True)
        near = torch.arange(len(one)) > 0  # the first one's direction is known to float32's share of its distance
        assert ((one.double() - other).abs() <= 1e-4 * size + 1e-9)[near].all()
    assert torch.allclose(ours[0][0].double(), plain[0][0], rtol=2e-3, atol=2e-3)


def test_at_the_camera_itself_all_is_finite():
    vertices, residual, mean, gradient, pose = made(3, 8, 1)
    pose[:3, 3] = 0
    vertices[1] = 0
    tints, *gradients = both(vertices, residual, mean, gradient, pose)[0]
    assert all(torch.isfinite(one).all() for one in (tints, *gradients))


@pytest.mark.parametrize("count", [1, 1024, 5000])
def test_any_number_of_cores_gives_the_same_bytes(count):
    found = []
    for number in (1, 2, 3):
        with cores(number):
            ours, _ = both(*made(count, 8, 2))
            _, residual, _, gradient, _ = made(count, 8, 2)
            moments = torch.zeros_like(residual), torch.zeros(count)
            pulled = residual.roll(1, 0) * gradient[:, :1]
            step_residual(residual, pulled, moments, 1, 0.1, pull=0.3, epsilon=1e-8)
            found.append([*ours, residual, *moments])
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other, strict=True))


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 2500), st.sampled_from([9, 24]), st.integers(0, 10**6), st.floats(0, 2))
def test_steps_are_adams_by_plain_operations(count, width, seed, pull):
    rng = torch.Generator().manual_seed(seed)
    values = torch.randn(count, width, generator=rng)
    first, second = torch.zeros_like(values), torch.zeros(count)
    exact = [t.double() for t in (values, first, second)]
    for number in range(1, 5):
        gradient = torch.randn(count, width, generator=rng) * 10.0 ** (number - 3)
        assert step_residual(values, gradient, (first, second), number, 0.02, pull=pull, epsilon=1e-6)
        adam_step(exact[0], gradient.double() + pull * exact[0], *exact[1:], number, 0.02, epsilon=1e-6)
    for one, other in zip((values, first, second), exact, strict=True):
        assert torch.allclose(one.double(), other, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_gradient_that_is_not_finite_is_told(bad):
    values, gradient = torch.zeros(3000, 9), torch.ones(3000, 9)
    gradient[2999, 4] = bad
    moments = torch.zeros_like(values), torch.zeros(3000)
    assert not step_residual(values, gradient, moments, 1, 0.1, pull=0.0, epsilon=1e-8)


def test_what_the_kernels_do_not_serve():
    assert serves(torch.zeros(2, 3))
    assert not serves(torch.zeros(2, 3), torch.zeros(2, 3, dtype=torch.float64))
    assert not serves(torch.zeros(3, 2).T)
