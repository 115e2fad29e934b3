"""Noise, loss and gradient: a sphere of one albedo under known light, fitted from eight samples a point."""

import math

import pytest
import torch
from monte_carlo_scenes import on_mesh, tracer_of

from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.shading import envmap
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo import Material, draw_light, independent_gradient, make_pool, shade
from exmesh_graph.torch_setup import torch_threads

TRUTH = torch.tensor([0.6, 0.4, 0.25])


def hilly_sky(height=16):
    """A sky whose radiance varies by 40: eight samples of it are noisy."""
    d = torch.from_numpy(envmap.texel_directions(height, 2 * height)).float()
    return (
        (0.3 + 12 * torch.exp(8 * (d @ torch.tensor([0.36, 0.48, 0.8]) - 1)))[..., None].expand(-1, -1, 3).contiguous()
    )


def irradiance(points, sky):
    """Exact: a convex body is never in its own shade."""
    height, width = 64, 128
    d = torch.from_numpy(envmap.texel_directions(height, width)).reshape(-1, 3)
    weight = torch.from_numpy(envmap.solid_angles(height, width)).repeat_interleave(width)
    radiance = envmap.lookup(sky.double(), d) * weight[:, None]
    return ((points.normal.double() @ d.T).clamp_min(0) @ radiance).float()


def fit(loss, gradient, sampler, steps=100, count=500):
    """The albedo found by Adam on `loss`, its mean over the last third of the steps (the noise of single steps out)."""
    mesh = icosphere(2)
    points, _, _ = on_mesh(*mesh, count)
    sky, tracer = hilly_sky(), tracer_of(mesh)
    target = TRUTH / math.pi * irradiance(points, sky)
    density = EnvSampler(sky if sampler == "environment" else torch.ones_like(sky))
    log_albedo = torch.full((3,), math.log(0.5), requires_grad=True)
    optimiser = torch.optim.Adam([log_albedo], lr=0.05)
    found = []

    def estimate(seed, base):
        material = Material(base.expand(count, 3))
        drawn = draw_light(points, material, make_pool(density, "environment", 8, seed, blocks=512), tracer)
        return shade(drawn, points.normal, points.view, material, sky)

    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = 0.05 * 0.1 ** (step / steps)
        base = log_albedo.exp()
        if gradient == "independent":
            image = independent_gradient(estimate, 2 * step, 2 * step + 1, base)
        else:
            image = estimate(2 * step, base)
        optimiser.zero_grad()
        loss(image, target).backward()
        optimiser.step()
        found.append(log_albedo.detach().exp())
    return float((torch.stack(found[-steps // 3 :]).mean(0) / TRUTH - 1).abs().max())


def l1(image, target):
    return (image - target).abs().mean()


def log_l1(image, target):
    return (torch.log1p(image) - torch.log1p(target)).abs().mean()


def squared(image, target):
    return ((image - target) ** 2).mean()


@pytest.fixture(autouse=True)
def _one_thread():
    with torch_threads(1):  # small tensors
        yield


@pytest.mark.parametrize("loss", [l1, log_l1])
def test_own_seed_for_the_gradient_leaves_less_than_one_percent_of_bias(loss):
    """Eight samples, environment sampling, as the paper; the truth is analytic."""
    assert fit(loss, "independent", "environment") < 0.01
    assert fit(loss, "same", "environment") > 0.02


def test_squared_loss_keeps_the_albedo_under_any_noise():
    """Samples spread uniformly are so noisy that the shared seed loses a quarter of the albedo."""
    assert fit(squared, "independent", "uniform", count=1500) < 0.05
    assert fit(squared, "same", "uniform") > 0.15


def test_gradient_is_that_of_the_second_seed():
    x = torch.tensor([2.0, 3.0], requires_grad=True)
    y = torch.tensor(5.0)
    scale = {1: 10.0, 2: 0.5}
    value = independent_gradient(lambda seed, a, b: scale[seed] * a * b, 1, 2, x, y)
    torch.testing.assert_close(value, torch.tensor([100.0, 150.0]))
    (value * torch.tensor([1.0, 2.0])).sum().backward()
    torch.testing.assert_close(x.grad, torch.tensor([2.5, 5.0]))


def test_equal_seeds_are_refused():
    with pytest.raises(ValueError, match="both 3"):
        independent_gradient(lambda seed, a: a, 3, 3, torch.ones(1, requires_grad=True))


def test_inputs_without_influence_get_no_gradient():
    used, idle = torch.ones(2, requires_grad=True), torch.ones(2, requires_grad=True)
    independent_gradient(lambda seed, a, b: a * seed, 1, 2, used, idle).sum().backward()
    assert idle.grad is None
    torch.testing.assert_close(used.grad, torch.full((2,), 2.0))
