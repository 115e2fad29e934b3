"""Planar Gaussians drawn by the kernels against plain torch, in value and in the gradient of every parameter."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import sph_harm_y

from exmesh_graph.splat.gaussians import Gaussians, harmonics
from exmesh_graph.splat.render import render
from tests.splat.splat_reference import render_reference
from tests.splat.splat_scenes import camera, cloud


def planes(drawing):
    return torch.cat([drawing.colour, drawing.normal, drawing.distance[..., None], drawing.alpha[..., None]], dim=-1)


def compare(gaussians, intrinsics, pose, height, width, seed=0, tol=1e-9, **options):
    """Both ways, in value and gradient against random weights of all planes; returns the drawing and its gradients."""
    tensors = gaussians.map(lambda t: t.detach().clone().requires_grad_())
    other = gaussians.map(lambda t: t.detach().clone().requires_grad_())
    tile = options.pop("tile", None)
    drawing = render(tensors, intrinsics, pose, height, width, tile=tile, **options)
    wanted = render_reference(other, intrinsics, pose, height, width, **options)
    assert torch.allclose(planes(drawing), wanted, rtol=tol, atol=tol), (planes(drawing) - wanted).abs().max()
    weight = torch.randn(wanted.shape, generator=torch.Generator().manual_seed(seed), dtype=wanted.dtype)
    mine = torch.autograd.grad((planes(drawing) * weight).sum(), list(tensors.tensors().values()), allow_unused=True)
    theirs = torch.autograd.grad((wanted * weight).sum(), list(other.tensors().values()), allow_unused=True)
    for name, a, b in zip(tensors.tensors(), mine, theirs, strict=True):
        b = torch.zeros_like(a) if b is None else b
        assert torch.isfinite(a).all(), name
        assert torch.allclose(a, b, rtol=1e-6, atol=tol * max(1.0, float(b.abs().max()))), (name, (a - b).abs().max())
    return drawing, mine


@pytest.mark.thorough
@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(1, 40),
    seed=st.integers(0, 10**6),
    size=st.floats(0.003, 1.5),
    flat=st.floats(1e-3, 1.0),
    opacity=st.floats(-2.0, 4.0),
    degree=st.integers(0, 3),
    turn=st.floats(-3.0, 3.0),
    shift=st.tuples(st.floats(-9, 9), st.floats(-9, 9)),
    skew=st.floats(-3, 3),
    tile=st.sampled_from([1, 4, 7, 32]),
)
def test_agrees_with_plain_torch(count, seed, size, flat, opacity, degree, turn, shift, skew, tile):
    gaussians = cloud(count, seed=seed, size=size, flat=flat, opacity=opacity, degree=degree)
    intrinsics, pose = camera(turn=turn, shift=shift, skew=skew)
    compare(gaussians, intrinsics, pose, 18, 24, tile=tile)


@pytest.mark.parametrize(
    "change",
    [
        {"spread": 4.0, "size": 0.5},  # around and behind the camera, and far outside the picture
        {"size": 40.0},  # each covers the whole picture
        {"opacity": 9.0, "size": 0.6},  # opaque: the cut at 0.99 and early termination
        {"flat": 1e-6},  # discs, edge on for some
        {"size": 0.01},  # well below a pixel: the blur takes nearly all
        {"spread": 0.0},  # all at one place: equal depths keep their order
    ],
    ids=lambda c: ",".join(f"{k}={v}" for k, v in c.items()),
)
def test_hard_sets(change):
    intrinsics, pose = camera(shift=(5.0, -3.0))
    compare(cloud(60, **change), intrinsics, pose, 18, 24, tol=1e-6)


def test_gradients_are_those_of_finite_differences():
    """Against the function itself, not against another derivation; few and soft Gaussians, so that no cut is near."""
    gaussians = cloud(3, size=0.5, opacity=0.3, seed=4)
    intrinsics, pose = camera(8, 6)
    weight = torch.randn(6, 8, 8, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def value(g):
        return float((planes(render(g, intrinsics, pose, 6, 8)) * weight).sum())

    tensors = gaussians.map(lambda t: t.clone().requires_grad_())
    (planes(render(tensors, intrinsics, pose, 6, 8)) * weight).sum().backward()
    g = torch.Generator().manual_seed(2)
    for name, tensor in tensors.tensors().items():
        if name == "sh":
            continue
        step = torch.randn(tensor.shape, generator=g, dtype=torch.float64)
        ends = [Gaussians(**{**gaussians.tensors(), name: getattr(gaussians, name) + h * step}) for h in (1e-6, -1e-6)]
        slope = (value(ends[0]) - value(ends[1])) / 2e-6
        assert slope == pytest.approx(float((tensor.grad * step).sum()), rel=1e-5)


def test_the_basis_is_that_of_spherical_harmonics():
    d = torch.nn.functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)).double(), dim=1)
    theta, phi = np.arccos(d[:, 2].numpy()), np.arctan2(d[:, 1].numpy(), d[:, 0].numpy())
    columns = []
    for degree in range(4):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), theta, phi)
            part = value.imag if order < 0 else value.real
            columns.append(part * (np.sqrt(2) if order else 1))
    assert np.allclose(harmonics(d).numpy(), np.stack(columns, 1), atol=1e-12)


def test_float32_follows_float64():
    gaussians = cloud(300, size=0.1)
    intrinsics, pose = camera(64, 48)
    fine = planes(render(gaussians, intrinsics, pose, 48, 64))
    coarse = planes(render(gaussians.map(lambda t: t.float()), intrinsics, pose, 48, 64))
    assert coarse.dtype == torch.float32
    assert float((fine - coarse).abs().mean()) < 1e-5


def test_tiles_change_no_pixel_and_runs_no_byte():
    gaussians = cloud(500, size=0.1, dtype=torch.float32).map(lambda t: t.requires_grad_())
    intrinsics, pose = camera(70, 50, shift=(11, 3))
    runs = []
    for tile in (32, 32, 5, 512):
        drawing = planes(render(gaussians, intrinsics, pose, 50, 70, tile=tile))
        runs.append((drawing.detach(), torch.autograd.grad(drawing.square().sum(), gaussians.means)[0]))
    assert torch.equal(runs[0][1], runs[1][1])
    for image, gradient in runs[1:]:
        assert torch.equal(image, runs[0][0])
        assert torch.allclose(gradient, runs[0][1], rtol=1e-3, atol=1e-4)


def test_pairs_stay_bounded(monkeypatch):
    """Picture-filling Gaussians get larger tiles instead of a pair for each tile; the picture is the same."""
    gaussians, (intrinsics, pose) = cloud(50, size=20.0), camera(64, 64)
    whole = planes(render(gaussians, intrinsics, pose, 64, 64, tile=2))
    module = render.__globals__
    monkeypatch.setitem(module, "PAIRS", 200)
    listed = []
    pairs = module["_pairs"]
    monkeypatch.setitem(module, "_pairs", lambda *a: listed.append(pairs(*a)) or listed[-1])
    assert torch.equal(planes(render(gaussians, intrinsics, pose, 64, 64, tile=2)), whole)
    assert len(listed[0].of) <= 200


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scale_of_the_scene(scale):
    """Positions, sizes, camera and near plane scaled together: the same picture, distances scaled."""
    gaussians, (intrinsics, pose) = cloud(40), camera()
    one = render(gaussians, intrinsics, pose, 18, 24)
    moved = pose.clone()
    moved[:3, 3] *= scale
    scaled = Gaussians(**{**gaussians.tensors(), "means": gaussians.means * scale,
                          "scales": gaussians.scales + np.log(scale)})  # fmt: skip
    other = render(scaled, intrinsics, moved, 18, 24, near=0.01 * scale)
    assert torch.allclose(one.colour, other.colour)
    assert torch.allclose(one.distance * scale, other.distance)


def test_what_is_not_drawn():
    """Behind the camera, faint, without a rotation, not finite: no picture, no gradient, no crash; none at all, too."""
    gaussians = cloud(6)
    gaussians.means[0] = torch.tensor([0, 0, -50.0])
    gaussians.opacities[1] = -8
    gaussians.rotations[2] = 0
    gaussians.means[3, 0] = torch.nan
    gaussians.scales[4] = 800.0
    gaussians.means[5] = 0
    tensors = gaussians.map(lambda t: t.requires_grad_())
    intrinsics, pose = camera(turn=0.0)
    drawing = render(tensors, intrinsics, pose, 18, 24)
    assert drawing.drawn.seen.tolist() == [False] * 5 + [True]
    planes(drawing).sum().backward()
    for tensor in tensors.tensors().values():
        assert (tensor.grad[:5] == 0).all()
        assert torch.isfinite(tensor.grad[5]).all()
    empty = render(cloud(0), intrinsics, pose, 18, 24)
    assert float(planes(empty).abs().sum()) == 0
    assert render(cloud(3), intrinsics, pose, 0, 24).colour.shape == (0, 24, 3)


def test_what_the_drawing_says_of_gaussians():
    gaussians, (intrinsics, pose) = cloud(50, size=0.3), camera()
    tensors = gaussians.map(lambda t: t.requires_grad_())
    drawing = render(tensors, intrinsics, pose, 18, 24)
    assert float(drawing.drawn.weight.sum()) == pytest.approx(float(drawing.alpha.sum()))
    planes(drawing).square().sum().backward()
    plain, absolute = drawing.drawn.gradient.unbind(1)
    assert (absolute >= plain * (1 - 1e-12)).all()
    assert (absolute[drawing.drawn.seen] > 0).all()
    assert (absolute[~drawing.drawn.seen] == 0).all()


def test_wrong_input_is_refused():
    gaussians, (intrinsics, pose) = cloud(3, degree=1), camera()
    with pytest.raises(ValueError, match="degree 2"):
        render(gaussians, intrinsics, pose, 18, 24, degree=2)
    with pytest.raises(ValueError, match="near"):
        render(gaussians, intrinsics, pose, 18, 24, near=0)
    with pytest.raises(ValueError, match="opacities"):
        render(Gaussians(**{**gaussians.tensors(), "opacities": torch.zeros(2).double()}), intrinsics, pose, 18, 24)
    with pytest.raises(ValueError, match="float32"):
        render(Gaussians(**{**gaussians.tensors(), "sh": gaussians.sh.float()}), intrinsics, pose, 18, 24)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device that torch can use; found none")
def test_cuda_draws_the_same():
    gaussians, (intrinsics, pose) = cloud(2000, size=0.1, dtype=torch.float32), camera(200, 150)
    results = []
    for device in ("cpu", "cuda"):
        tensors = gaussians.map(lambda t, d=device: t.detach().to(d).requires_grad_())
        drawing = planes(render(tensors, intrinsics, pose, 150, 200))
        drawing.square().sum().backward()
        results.append([drawing.detach().cpu(), *(t.grad.cpu() for t in tensors.tensors().values())])
    for a, b in zip(*results, strict=True):
        assert float((a - b).abs().mean()) < 2e-3 * float(a.abs().mean())
