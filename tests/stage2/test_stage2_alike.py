"""Roughness drawn together where no highlight tells it (stage2.alike, stage2.together)."""

import numpy as np
import pytest
import torch

from exmesh_graph.stage2.alike import Alike
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.maps import Material
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.together import STEP, drawn_together, told

SHORT = DecompositionSettings(
    environment_height=16, iterations=40, material_rate=0.2, environment_rate=0.4, ssim_weight=0.0, corrections=1
)


def _texels(within, seed=0, count=6000):
    """Two colours of roughness 0.3 and 0.6, spread by `within`; half of the texels are hardly told."""
    rng = np.random.default_rng(seed)
    second = rng.random(count) < 0.4
    color = np.where(second[:, None], [0.6, 0.5, 0.4], [0.05, 0.1, 0.3]) * np.exp(0.05 * rng.normal(size=(count, 3)))
    true = np.where(second, 0.6, 0.3) + within * rng.normal(size=count)
    variance = np.where(rng.random(count) < 0.5, 0.02**2, 0.3**2)
    return true, true + np.sqrt(variance) * rng.normal(size=count), variance, color


@pytest.mark.parametrize("within", [0.0, 0.03, 0.15])
def test_what_is_hardly_told_takes_the_value_of_its_colour(within):
    true, fitted, variance, color = _texels(within)
    found, spread = drawn_together(fitted, variance, color)
    assert spread == pytest.approx(within, abs=0.02)
    loose = variance > 0.01
    best = within if within else 0.0  # no estimate can beat the spread itself
    assert np.sqrt(np.mean((found - true)[loose] ** 2)) < best + 0.03
    assert np.sqrt(np.mean((found - true)[~loose] ** 2)) < 0.025


def test_one_material_in_many_colours_keeps_what_its_highlights_tell():
    rng = np.random.default_rng(1)
    true = np.where(np.arange(4000) % 2 == 0, 0.2, 0.8)  # a pattern that no colour shows
    fitted = true + 0.02 * rng.normal(size=4000)
    found, spread = drawn_together(fitted, np.full(4000, 0.02**2), rng.random((4000, 3)))
    assert spread > 0.2
    assert np.abs(found - fitted).max() < 0.02


def test_metal_is_no_dielectric_of_its_colour():
    true, fitted, variance, color = _texels(0.0)
    gray = np.full_like(color, 0.5)
    metal = (true > 0.45).astype(float)[:, None]
    apart, _ = drawn_together(fitted, variance, np.concatenate([gray, metal], axis=1))
    assert np.sqrt(np.mean((apart - true) ** 2)) < 0.03
    mixed, _ = drawn_together(fitted, variance, gray)
    assert np.sqrt(np.mean((mixed - true)[variance > 0.01] ** 2)) > 0.1


def test_evidence_is_the_squared_slope_of_the_pictures(carrier, train_views, transport):
    model = Decomposition(carrier, train_views, transport, SHORT.replaced(texture_size=32), "cpu")
    model.start()
    evidence, residual = told(model)
    assert residual > 0
    # by autograd: d log(1 + L) / d r of every pixel, squared, by its texels' weights
    expected = torch.zeros(len(evidence), dtype=torch.float64)
    prepared = model.prepare(1.0, 0)
    for buffer in model.buffers:
        with torch.no_grad():
            read = model.maps.read(model.maps.values(), buffer.texel, buffer.texel_weight)
        table = read.table.clone().requires_grad_()
        radiance = model.light.radiance(buffer, Material(table, False), prepared.light)
        square = torch.zeros(len(table))
        for channel in range(3):
            (slope,) = torch.autograd.grad(torch.log1p(radiance[:, channel]).sum(), table, retain_graph=True)
            square += torch.where(buffer.clipped[:, channel], torch.zeros(()), slope[:, 3]).square()
        expected.index_add_(
            0, buffer.texel.reshape(-1).long(), (buffer.texel_weight * square[:, None]).double().reshape(-1)
        )
    told_well = expected > expected.mean()
    ratio = evidence[told_well] / expected[told_well]
    assert 0.6 < float(ratio.median()) < 1.6, STEP  # finite differences over 0.1 of roughness


@pytest.mark.thorough
def test_a_fit_with_the_prior_ends_with_less_spread_of_roughness(carrier, train_views, transport):
    told_lines = []
    settings = SHORT.replaced(texture_size=32)
    plain, _ = fit(carrier, train_views, transport, settings)
    drawn, _ = fit(carrier, train_views, transport, settings, prior=Alike(doubt=10), log=told_lines.append)
    assert any("drawn together" in line for line in told_lines)
    np.testing.assert_allclose(drawn.base_color[drawn.seen], plain.base_color[plain.seen], atol=1e-6)
    assert drawn.roughness[drawn.seen].std() < 0.9 * plain.roughness[plain.seen].std()
