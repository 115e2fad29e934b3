"""One Adam for all solvers, bit by bit against the plain formulas of each."""

import pytest
import torch

from exmesh_graph.gpu.cores import cores
from exmesh_graph.optim import EPSILON, Adam, Bounds, adam_step
from exmesh_graph.splat.optimiser import GaussianAdam
from tests.splat.splat_scenes import cloud


def vertices_by_hand(x, g, m, v, t, rate, uniform=False):
    """One second moment for each vertex, the mean of |g|^2."""
    m.lerp_(g, 1 - 0.9)
    v.lerp_((g * g).sum(1), 1 - 0.99)
    root = ((v.max().expand_as(v) if uniform else v) / (1 - 0.99**t)).sqrt() + EPSILON
    x.addcdiv_(m, root[:, None], value=-rate / (1 - 0.9**t))


def texels_by_hand(x, g, m, v, t, rate):
    m.lerp_(g, 1 - 0.9)
    v.mul_(0.99).addcmul_(g, g, value=1 - 0.99)
    x.addcdiv_(m, (v / (1 - 0.99**t)).sqrt() + EPSILON, value=-rate / (1 - 0.9**t))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("use", ["vertices", "uniform", "texels"])
def test_steps_are_those_of_the_plain_formulas_to_the_bit(use, dtype):
    rng = torch.Generator().manual_seed(0)
    x = torch.randn(50, 3, generator=rng, dtype=dtype)
    moments = torch.zeros(50, 3, dtype=dtype), torch.zeros(*((50, 3) if use == "texels" else (50,)), dtype=dtype)
    ours, theirs = ([t.clone() for t in (x, *moments)] for _ in range(2))
    for t in range(1, 8):
        g = torch.randn(50, 3, generator=rng, dtype=dtype) * 10.0 ** -(t % 4)
        adam_step(ours[0], g, *ours[1:], t, 0.02, uniform=use == "uniform")
        if use == "texels":
            texels_by_hand(theirs[0], g, *theirs[1:], t, 0.02)
        else:
            vertices_by_hand(theirs[0], g, *theirs[1:], t, 0.02, use == "uniform")
    assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))
    assert not torch.equal(ours[0], x)


@pytest.mark.parametrize("torch_rounding", [False, True])
@pytest.mark.parametrize("shape", [(83, 70, 3), (16385,), (4096, 4)])
def test_one_pass_is_the_plain_step_to_the_rounding_of_its_root(shape, torch_rounding):
    """Also in marks and bounds, where nothing was ever seen, where a gradient goes silent or is not finite."""
    rng = torch.Generator().manual_seed(2)
    x = torch.rand(shape, generator=rng)
    states = [[t.clone() for t in (x, torch.zeros(shape), torch.zeros(shape))] for _ in range(2)]
    marks = [torch.zeros(shape[:-1], dtype=torch.bool) for _ in range(2)]
    colours = len(shape) > 1
    for t in range(1, 6):
        g = torch.randn(shape, generator=rng) * 10.0 ** -(t % 3)
        g[: len(g) // 3] = 0
        if t > 2:
            g[: len(g) // 2] = 0
        for (values, m, v), touched, dtype in zip(states, marks, (torch.float32, torch.float64), strict=True):
            moved = [a.to(dtype) for a in (values, m, v)]  # float64 takes the plain form
            bounds = Bounds(touched, 0.05) if colours else None
            adam_step(
                moved[0], g.to(dtype), *moved[1:], t, 0.02, epsilon=1e-6, torch_rounding=torch_rounding, bounds=bounds
            )
            for kept, new in zip((values, m, v), moved, strict=True):
                kept.copy_(new)
    for ours, plain in zip(*states, strict=True):
        assert torch.allclose(ours, plain, rtol=1e-5, atol=1e-7)
    assert torch.equal(*marks)
    assert torch.equal(states[0][0][: shape[0] // 3], x[: shape[0] // 3])
    if colours:
        assert float(states[0][0].min()) >= 0
        assert float(states[0][0].max()) <= 1
        assert bool(marks[0].any())
        assert not bool(marks[0].all())
    broken = states[0][0].clone()
    g[-1] = torch.nan
    adam_step(broken, g, *(m.clone() for m in states[0][1:]), 6, 0.02)
    assert bool(broken[-1].isnan().all())
    assert int(broken.isnan().sum()) == g[-1].numel()


def test_one_pass_has_the_same_bytes_on_any_number_of_cores():
    made = []
    for count in (1, 2, 3, 1):
        rng = torch.Generator().manual_seed(3)
        x, g = torch.rand(97, 501, generator=rng), torch.randn(97, 501, generator=rng)
        m, v = torch.zeros_like(x), torch.zeros_like(x)
        with cores(count):
            adam_step(x, g, m, v, 1, 0.1)
            adam_step(x, g, m, v, 2, 0.1)
        made.append((x, m, v))
    assert all(torch.equal(a, b) for other in made[1:] for a, b in zip(made[0], other, strict=True))


def test_the_class_rounds_as_torch_does():
    rng = torch.Generator().manual_seed(1)
    start = torch.randn(200, generator=rng)
    ours, theirs = (start.clone().requires_grad_() for _ in range(2))
    mine, reference = Adam([ours], [0.05]), torch.optim.Adam([theirs], lr=0.05, foreach=False)
    for _ in range(20):
        g = torch.randn(200, generator=rng)
        ours.grad, theirs.grad = g.clone(), g.clone()
        mine.step()
        reference.step()
        assert ours.grad is None
    assert torch.equal(ours, theirs)


def test_the_gaussians_kernel_is_the_same_adam():
    """It counts steps row by row, and leaves rows alone that the view does not see."""
    made = cloud(6, degree=1, dtype=torch.float64)
    rates = {"means": 1e-2, "scales": 2e-2, "rotations": 3e-2, "opacities": 4e-2, "sh": 5e-2, "sh_rest": 5e-2}
    kernel = GaussianAdam(made.map(lambda t: t.clone()))
    plain = {n: [t.clone(), torch.zeros_like(t), torch.zeros_like(t)] for n, t in made.tensors().items()}
    seen = torch.tensor([True] * 5 + [False])
    for t in range(1, 5):
        rng = torch.Generator().manual_seed(t)
        gradients = {n: torch.randn(x.shape, generator=rng, dtype=x.dtype) for n, x in made.tensors().items()}
        kernel.step(gradients, seen, rates)
        for name, (x, m, v) in plain.items():
            adam_step(x, gradients[name], m, v, t, rates[name], betas=(0.9, 0.999))
    for name, tensor in kernel.gaussians.tensors().items():
        assert torch.allclose(tensor[:5], plain[name][0][:5], rtol=1e-12)
        assert torch.equal(tensor[5], made.tensors()[name][5])
