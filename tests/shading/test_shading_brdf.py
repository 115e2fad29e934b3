"""BRDF: energy, reciprocity, gradients, agreement with the written-out formula in float64."""

import math

import numpy as np
import pytest
import torch

from exmesh_graph.shading import brdf
from exmesh_graph.shading.point_sets import fibonacci_sphere


def _frame(angle):
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    view = torch.tensor([math.sin(angle), 0.0, math.cos(angle)], dtype=torch.float64)
    return normal, view


@pytest.mark.thorough
@pytest.mark.parametrize("roughness", [0.08, 0.1, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("n_v", [0.01, 0.3, 1.0])
def test_white_furnace_never_gains_energy(roughness, n_v):
    normal, view = _frame(math.acos(n_v))
    light = torch.from_numpy(_around(view, 250_000, roughness))
    one = torch.ones(3, dtype=torch.float64)
    value = brdf.specular(normal, view, light[0], torch.tensor(roughness).double(), one)[..., 0]
    energy = (value * light[0][:, 2].clamp_min(0) * light[1][:, 0]).sum()
    assert 0.3 < float(energy) <= 1.0 + 5e-3
    if roughness <= 0.1 and n_v == 1.0:
        assert float(energy) > 0.99  # a smooth lobe keeps everything


def _around(view, count, roughness):
    """Quadrature over the hemisphere: half vectors on a (sin^2, phi) grid stretched to the lobe.

    Returns [2, count, 3]: light directions, and their solid-angle weights in the first column.
    """
    alpha2 = max(roughness**2, brdf.ALPHA_MIN) ** 2
    side = int(math.sqrt(count))
    s, t = np.meshgrid((np.arange(side) + 0.5) / side, (np.arange(side) + 0.5) / side, indexing="ij")
    s, phi = s.reshape(-1), 2 * np.pi * t.reshape(-1)
    cos2 = (1 - s) / (1 + (alpha2 - 1) * s)
    cos, sin = np.sqrt(cos2), np.sqrt(1 - cos2)
    half = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], 1)
    density = alpha2 * cos / (np.pi * (cos2 * (alpha2 - 1) + 1) ** 2)
    v = view.numpy()
    v_h = half @ v
    light = 2 * v_h[:, None] * half - v
    weight = np.where(v_h > 0, 4 * v_h / density, 0) / len(s)
    return np.stack([light, np.repeat(weight[:, None], 3, 1)])


def test_formula_of_the_renderings_in_float64():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(2, 500, 3))
    directions[..., 2] = np.abs(directions[..., 2]) + 0.05
    view, light = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    normal = np.tile([0.0, 0, 1], (500, 1))
    color, r, m = rng.uniform(0, 1, (500, 3)), rng.uniform(0.1, 1, 500), rng.uniform(0, 1, 500)
    half = view + light
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    a = np.maximum(r * r, brdf.ALPHA_MIN)
    n_l, n_v, n_h, v_h = light[:, 2], view[:, 2], half[:, 2], (view * half).sum(1)
    d = a**2 / (np.pi * (n_h**2 * (a**2 - 1) + 1) ** 2)
    g = 1 / (1 + _lambda(n_v, a) + _lambda(n_l, a))
    f0 = 0.04 * (1 - m[:, None]) + m[:, None] * color
    f = f0 + (1 - f0) * (1 - v_h[:, None]) ** 5
    expected = (1 - m[:, None]) * color / np.pi + (d * g / (4 * n_l * n_v))[:, None] * f
    tensors = (torch.from_numpy(x) for x in (normal, view, light, color, r, m))
    np.testing.assert_allclose(brdf.evaluate(*tensors).numpy(), expected, rtol=1e-9)


def _lambda(c, a):
    return (np.sqrt(1 + a**2 * (1 / c**2 - 1)) - 1) / 2


def test_reciprocity():
    rng = np.random.default_rng(1)
    directions = torch.from_numpy(rng.normal(size=(2, 300, 3)))
    directions[..., 2] = directions[..., 2].abs() + 1e-2
    view, light = directions / directions.norm(dim=-1, keepdim=True)
    normal = torch.tensor([0.0, 0, 1]).double().expand(300, 3)
    rest = (torch.rand(300, 3).double(), torch.rand(300).double(), torch.rand(300).double())
    torch.testing.assert_close(brdf.evaluate(normal, view, light, *rest), brdf.evaluate(normal, light, view, *rest))


def test_gradients_match_finite_differences():
    generator = torch.Generator().manual_seed(0)
    normal, view, light = torch.randn(3, 6, 3, generator=generator, dtype=torch.float64)
    normal, view, light = (x / x.norm(dim=-1, keepdim=True) for x in (normal, view, light))
    view, light = (x * torch.sign((x * normal).sum(-1, keepdim=True)) for x in (view, light))
    color, r, m = (torch.rand(*s, generator=generator).double() * 0.8 + 0.1 for s in ((6, 3), (6,), (6,)))
    inputs = [x.requires_grad_() for x in (normal, color, r, m)]
    assert torch.autograd.gradcheck(lambda n, c, q, k: brdf.evaluate(n, view, light, c, q, k), inputs)


def test_degenerate_directions_have_finite_values_and_gradients():
    normal = torch.tensor([[0.0, 0, 1]]).expand(5, 3).clone().requires_grad_()
    grazing = math.radians(89.99)
    views = torch.tensor([[0.0, 0, 1], [math.sin(grazing), 0, math.cos(grazing)], [1, 0, 0], [0, 0, -1], [0, 0, 1]])
    lights = torch.tensor([[0.0, 0, -1], [-math.sin(grazing), 0, math.cos(grazing)], [-1, 0, 0], [0, 0, 1], [0, 0, 1]])
    roughness = torch.full((5,), 0.05, requires_grad=True)
    color = torch.full((5, 3), 0.5, requires_grad=True)
    value = brdf.evaluate(normal, views, lights, color, roughness)
    value.sum().backward()
    for tensor in (value, normal.grad, roughness.grad, color.grad):
        assert bool(torch.isfinite(tensor).all())
    assert bool((value[[0, 2, 3]] == 0).all())


def test_narrow_lobe_in_float32_keeps_its_digits():
    """D of the mirror-like floor, half a degree off the peak: 1 - cos^2 would be off by percents in float32."""
    for angle in (1e-4, 1e-3, 5e-3):
        sine2 = torch.tensor(math.sin(angle) ** 2, dtype=torch.float32)
        alpha = torch.tensor(brdf.ALPHA_MIN, dtype=torch.float32)
        exact = brdf.ggx(sine2.double(), alpha.double())
        assert float(brdf.ggx(sine2, alpha)) == pytest.approx(float(exact), rel=1e-5)


def test_fibonacci_directions_integrate_low_orders():
    d = fibonacci_sphere(512)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(d.mean(axis=0), 0, atol=1e-3)
    np.testing.assert_allclose(d.T @ d / len(d), np.eye(3) / 3, atol=2e-3)


@pytest.mark.parametrize("degrees", [0, 60, 85, 89.9, 89.99])
@pytest.mark.parametrize("roughness", [0.02, 0.08, 0.3, 1.0])
def test_float32_equals_float64_over_the_whole_lobe(roughness, degrees):
    """Value and gradients of lights spread over the lobe, both precisions given the same float32 vectors."""
    generator = torch.Generator().manual_seed(0)
    normal = torch.nn.functional.normalize(torch.randn(1, 3, generator=generator, dtype=torch.float64), dim=1)
    tangent = torch.nn.functional.normalize(torch.linalg.cross(normal, torch.tensor([[0.0, 1, 0]]).double()), dim=1)
    bitangent = torch.linalg.cross(normal, tangent)
    angle = math.radians(degrees)
    view = (normal * math.cos(angle) + tangent * math.sin(angle)).float()
    u = torch.rand(3000, 2, generator=generator, dtype=torch.float64)
    slope = roughness**2 * (0.98 * u[:, :1] / (1 - 0.98 * u[:, :1])).sqrt()
    phi = 2 * math.pi * u[:, 1:]
    half = torch.nn.functional.normalize(normal + slope * (phi.cos() * tangent + phi.sin() * bitangent), dim=1)
    light = (2 * (view.double() * half).sum(-1, keepdim=True) * half - view).float()
    light = light[(light.double() * normal).sum(-1) > 1.5e-4]
    normal = normal.float()
    assert len(light) > 500
    found = []
    for dtype in (torch.float32, torch.float64):
        n, r, f0 = (x.to(dtype).requires_grad_() for x in (normal, torch.tensor(roughness), torch.full((3,), 0.3)))
        value = brdf.specular(n, view.to(dtype), light.to(dtype), r, f0)
        found.append([x.detach().double() for x in (value, *torch.autograd.grad(value.sum(), (n, r, f0)))])
    for single, double in zip(*found, strict=True):
        scale = double.abs() if single.shape == found[0][0].shape else double.norm()
        assert float(((single - double).abs() / scale).max()) < 1e-3


def test_gradients_in_every_vector_match_finite_differences_up_to_grazing():
    generator = torch.Generator().manual_seed(1)
    normal, view, light = torch.randn(3, 12, 3, generator=generator, dtype=torch.float64)
    normal = torch.nn.functional.normalize(normal, dim=1)
    view, light = (torch.nn.functional.normalize(x, dim=1) for x in (view, light))
    # the second half at 88 to 89.9 degrees
    lift = torch.cat([torch.full((6, 1), 0.5), torch.linspace(0.002, 0.03, 6)[:, None]]).double()
    view, light = (
        torch.nn.functional.normalize(x - (x * normal).sum(-1, keepdim=True) * normal, dim=1) + lift * normal
        for x in (view, light)
    )
    view, light = (torch.nn.functional.normalize(x, dim=1) for x in (view, light))
    rest = (torch.full((12, 3), 0.4).double(), torch.linspace(0.15, 1, 12).double(), torch.full((12,), 0.3).double())
    inputs = [x.clone().requires_grad_() for x in (normal, view, light, *rest)]
    assert torch.autograd.gradcheck(brdf.evaluate, inputs, eps=1e-7, atol=1e-4, rtol=1e-4)
