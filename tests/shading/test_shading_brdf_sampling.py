"""The BRDF's sampler: chi-square from mirror-like to rough and up to grazing views, furnace, float32."""

import math

import numpy as np
import pytest
import torch
from shading_statistics import chi_square_excess, sphere_cells, sphere_integral

from benchmarks.brdf_reference import pdf_brdf, sample_brdf
from exmesh_graph.shading import brdf
from exmesh_graph.shading.brdf_sampling import basis, specular_share
from exmesh_graph.shading.point_sets import hammersley

NORMAL = torch.nn.functional.normalize(torch.tensor([[0.3, -0.5, 0.8]], dtype=torch.float64), dim=1)


def _point(degrees, roughness, color=0.6, metallic=None, dtype=torch.float64):
    """normal, view, base color, roughness, metallic of one point seen `degrees` off its normal."""
    tangent = basis(NORMAL)[0]
    angle = math.radians(degrees)
    view = NORMAL * math.cos(angle) + tangent * math.sin(angle)
    metal = None if metallic is None else torch.full((1,), metallic, dtype=dtype)
    rough = torch.full((1,), roughness, dtype=dtype)
    return NORMAL.to(dtype), view.to(dtype), torch.full((1, 3), color, dtype=dtype), rough, metal


def _random(count, seed=0):
    return torch.rand(1, count, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.thorough
@pytest.mark.parametrize("degrees", [0, 60, 85, 89])
@pytest.mark.parametrize("roughness", [0.02, 0.1, 0.3, 1.0])
def test_specular_lobe_follows_its_density_chi_square(roughness, degrees):
    """A pure metal samples its lobe alone. Cells in half-vector space, stretched with the lobe, resolve any width."""
    point = _point(degrees, roughness, metallic=1.0)
    count, rings, sectors, fine = 100_000, 12, 16, 24
    light, density = sample_brdf(*point, _random(count))
    kept = light[0][density[0] > 0]
    frame = torch.stack([*(a[0] for a in basis(NORMAL)), NORMAL[0]])
    alpha2 = float(brdf.alpha_of(point[3]) ** 2)
    half = torch.nn.functional.normalize(kept + point[1], dim=1) @ frame.T
    sine2 = half[:, 0] ** 2 + half[:, 1] ** 2
    stretched = 1 - (1 - sine2 / (alpha2 + (1 - alpha2) * sine2)).clamp_min(0).sqrt()
    sector = (torch.atan2(half[:, 1], half[:, 0]) / (2 * math.pi)) % 1
    cell = (stretched * rings).long().clamp(max=rings - 1) * sectors + (sector * sectors).long().clamp(max=sectors - 1)
    observed = torch.bincount(cell, minlength=rings * sectors).double()

    grids = ((torch.arange(n * fine).double() + 0.5) / (n * fine) for n in (rings, sectors))
    w, t = torch.meshgrid(*grids, indexing="ij")
    s = 1 - (1 - w) ** 2  # in w and not in s, whose integrand has a pole at the rim (1 / cos(theta_h))
    sine2 = alpha2 * s / (1 - s + alpha2 * s)
    sine, cosine = sine2.sqrt(), (1 - sine2).sqrt()
    half = torch.stack([sine * (2 * math.pi * t).cos(), sine * (2 * math.pi * t).sin(), cosine], -1)
    half = half.reshape(-1, 3) @ frame
    v_h = (half * point[1]).sum(-1)
    mirrored = 2 * v_h[:, None] * half - point[1]
    found = pdf_brdf(point[0], point[1], mirrored[None], *point[2:])[0]
    # (s, t) has density D cos(theta_h) over half vectors, and light 1 / (4 v.h) of that
    uniform = (brdf.ggx(sine2, torch.tensor(alpha2**0.5)) * cosine / (2 * (1 - w))).reshape(-1)
    measure = 4 * v_h.clamp_min(0) / uniform
    expected = (found * measure).reshape(rings, fine, sectors, fine).mean(dim=(1, 3)).reshape(-1) / (rings * sectors)
    assert chi_square_excess(observed, expected * count) < 5
    assert float(observed.sum()) == pytest.approx(float(expected.sum()) * count, rel=3e-3)


@pytest.mark.parametrize(("roughness", "degrees", "metallic"), [(0.35, 20, None), (0.5, 75, 0.4), (1.0, 89, None)])
def test_mixture_follows_its_density_chi_square(roughness, degrees, metallic):
    point = _point(degrees, roughness, metallic=metallic)
    count = 200_000
    light, density = sample_brdf(*point, _random(count, 1))
    expected = sphere_integral(lambda d: pdf_brdf(*point[:2], d[None], *point[2:])[0]) * count
    observed = sphere_cells(light[0][density[0] > 0])
    assert chi_square_excess(observed, expected) < 5
    assert float(observed.sum()) == pytest.approx(float(expected.sum()), rel=5e-3)
    # the lobe's tilted share of directions under the horizon is all that a mixture may lose
    assert float(expected.sum()) / count > 0.6


@pytest.mark.parametrize("degrees", [0, 60, 85, 89.9])
@pytest.mark.parametrize("roughness", [0.02, 0.08, 0.3, 0.6, 1.0])
def test_white_furnace_of_the_sampler(roughness, degrees):
    """A white metal under a white sky returns at most all light; smooth ones return all of it; no estimate is wild."""
    point = _point(degrees, roughness, color=1.0, metallic=1.0)
    light, density = sample_brdf(*point, hammersley(4096).double()[None])
    cosine = (light * NORMAL).sum(-1).clamp_min(0)
    value = brdf.specular(NORMAL[:, None], point[1][:, None], light, point[3][:, None], torch.ones(1, 1, 3).double())[
        ..., 0
    ]
    estimate = torch.where(density > 0, value * cosine / density.clamp_min(1e-30), torch.zeros_like(value))
    assert float(estimate.max()) <= 1 + 1e-6  # G / G1 never exceeds 1
    assert 0.3 < float(estimate.mean()) <= 1
    if roughness <= 0.08 and degrees <= 60:
        assert float(estimate.mean()) > 0.99


@pytest.mark.thorough
@pytest.mark.parametrize("degrees", [10, 80])
@pytest.mark.parametrize("roughness", [0.25, 0.5, 1.0])
def test_estimate_equals_quadrature_of_the_whole_brdf(roughness, degrees):
    point = _point(degrees, roughness, color=0.8, metallic=0.3)
    light, density = sample_brdf(*point, hammersley(1 << 15).double()[None])
    normal, view, color, rough, metal = (x[:, None] for x in point)
    value = brdf.evaluate(normal, view, light, color, rough, metal)[0, :, 0]
    cosine = (light[0] * NORMAL).sum(-1).clamp_min(0)
    found = torch.where(density[0] > 0, value * cosine / density[0].clamp_min(1e-30), torch.zeros_like(value)).mean()
    # the same integral by the other strategy alone: cosine samples, many
    u = hammersley(1 << 19).double()
    tangent, bitangent = basis(NORMAL)
    radius, phi = u[:, 1:].sqrt(), 2 * math.pi * u[:, :1]
    even = radius * phi.cos() * tangent + radius * phi.sin() * bitangent + (1 - u[:, 1:]).sqrt() * NORMAL
    other = brdf.evaluate(normal, view, even[None], color, rough, metal)[0, :, 0].mean() * math.pi
    assert float(found) == pytest.approx(float(other), rel=0.01)


@pytest.mark.parametrize("degrees", [0, 60, 89, 89.99])
@pytest.mark.parametrize("roughness", [0.02, 0.1, 0.5])
def test_float32_samples_weigh_as_float64_ones(roughness, degrees):
    means = []
    for dtype in (torch.float32, torch.float64):
        point = _point(degrees, roughness, color=0.5, metallic=0.5, dtype=dtype)
        light, density = sample_brdf(*point, hammersley(1 << 14).to(dtype)[None])
        assert light.dtype == density.dtype == dtype
        assert bool(torch.isfinite(light).all() and torch.isfinite(density).all())
        normal, view, color, rough, metal = (x[:, None] for x in point)
        value = brdf.evaluate(normal, view, light, color, rough, metal)[0, :, 0]
        cosine = (light[0] * NORMAL.to(dtype)).sum(-1).clamp_min(0)
        weighted = torch.where(density[0] > 0, value * cosine / density[0].clamp_min(1e-30), torch.zeros_like(value))
        means.append(float(weighted.mean()))
    assert means[0] == pytest.approx(means[1], rel=2e-3)


def test_share_of_the_specular_lobe():
    normal = view = torch.tensor([[0.0, 0, 1]]).expand(4, 3)
    color = torch.tensor([[0.9] * 3, [0.0] * 3, [0.5] * 3, [0.5] * 3])
    metal = torch.tensor([0.0, 0.0, 1.0, 0.999])
    share = specular_share(normal, view, color, metal)
    np.testing.assert_allclose(share.numpy(), [0.1, 0.9, 1.0, 0.9], atol=1e-6)
    torch.testing.assert_close(specular_share(normal[:2], view[:2], color[:2], None), share[:2])
