"""One Adam for all solvers, bit by bit against the plain formulas of each."""

import pytest
import torch

from exmesh_graph.optim import EPSILON, Adam, adam_step
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
