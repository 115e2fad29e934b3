"""Samplers, BRDF, environment and losses give on CUDA what they give on the CPU."""

import pytest
import torch

from benchmarks.brdf_reference import sample_brdf
from exmesh_graph import losses
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.point_sets import hammersley
from exmesh_graph.shading.specular import PrefilteredStack

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device"),
]


def _same(work, *inputs):
    """`work` on both devices, its outputs compared."""
    here, there = work(*inputs), work(*(x.cuda() for x in inputs))
    for a, b in zip(here, there, strict=True):
        assert b.is_cuda
        torch.testing.assert_close(b.cpu(), a, rtol=2e-4, atol=1e-5)


def _vectors(count=500):
    normal, view, light = torch.nn.functional.normalize(
        torch.randn(3, count, 3, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    return (
        normal,
        view * torch.sign((view * normal).sum(-1, keepdim=True)),
        light * torch.sign((light * normal).sum(-1, keepdim=True)),
    )


def test_environment_sampling():
    image = torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(0))
    image[3, 4] = 1e4
    _same(lambda e, u: EnvSampler(e).sample(u), image, hammersley(1000))
    _same(lambda e, d: (EnvSampler(e).pdf(d), envmap.lookup(e, d)), image, _vectors()[0])


def test_brdf_and_its_sampling():
    normal, view, light = _vectors()
    color, rough, metal = torch.rand(500, 3), torch.linspace(0.1, 1, 500), torch.linspace(0, 1, 500)
    _same(lambda *x: (brdf.evaluate(*x),), normal, view, light, color, rough, metal)
    inputs = normal, view, color, rough, metal, hammersley(16).expand(500, -1, -1)
    exact = sample_brdf(*(x.double() for x in inputs))
    here, there = sample_brdf(*inputs), [x.cpu() for x in sample_brdf(*(x.cuda() for x in inputs))]
    # the first coordinate is stretched by 1 / share: the last digits of a share grow with it, on either device
    for true, one, other in zip(exact, here, there, strict=True):
        size = true.abs() + 1e-3 * true.abs().mean()
        ours, theirs = ((x - true).abs() / size for x in (one, other))
        assert float(theirs.quantile(0.99)) < 2 * float(ours.quantile(0.99)) + 1e-6
        assert float(theirs.mean()) < 4 * float(ours.mean()) + 1e-6


def test_prefiltered_levels():
    image = torch.rand(32, 64, 3)
    _same(lambda e: (PrefilteredStack(32, 64, e.device).build(e),), image)


def test_losses_and_their_gradients():
    image, target = torch.rand(2, 40, 44, 3)
    mask = torch.rand(40, 44) > 0.5

    def both(x, y, m):
        x = x.detach().requires_grad_()
        value = losses.d_ssim(x, y, m) + losses.log_l1(x, y) + losses.linear_to_srgb(x).mean()
        return value.detach(), torch.autograd.grad(value, x)[0] * x.numel()

    _same(both, image, target, mask)
