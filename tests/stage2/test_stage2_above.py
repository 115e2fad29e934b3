"""Light from above: where what faces up has a paint of its own, no picture tells the paint from the light."""

import dataclasses

import numpy as np
import pytest
import torch
from probe_scenes import TEXELS, asset, carrier_of, die, photographed

from exmesh_graph.shading import envmap
from exmesh_graph.shading.settings import TransportSettings
from exmesh_graph.shading.transport import direct_transport
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.gains import USUAL, USUAL_SPREAD, CommonFactor
from exmesh_graph.stage2.init import LUMINANCE, neutral_asset
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings
from exmesh_graph.stage2.start_light import is_neutral, white_light

LIGHT = TransportSettings(directions=128, points=1500)
SHORT = DecompositionSettings(
    texture_size=TEXELS, environment_height=16, iterations=150, material_rate=0.3, environment_rate=0.6,
    factor_rate=0.03, ssim_weight=0.0, material_weight=0.01, variation="log", environment_weight=0.002,
    chroma_weight=0.0, indirect_ramp=0, corrections=0,
)  # fmt: skip


def roofed_die():
    """A light die with a dark roof under a hazy sky that is brightest above."""
    truth = asset(die(), roughness=0.9)
    d = envmap.texel_directions(16, 32)
    sky = 0.5 * (1 + 0.9 * d[..., 1:2]) * np.array([0.9, 1.0, 1.1])
    sky = sky + 1.5 * np.clip(d @ [0.5, 0.75, 0.43], 0, 1)[..., None] ** 12 * np.array([1.1, 1.0, 0.8])
    color = np.broadcast_to(np.float32([0.6, 0.56, 0.5]), truth.base_color.shape).copy()
    up = np.s_[: color.shape[0] // 2], np.s_[color.shape[1] // 3 : 2 * color.shape[1] // 3]  # its second chart
    color[::-1][up] = [0.15, 0.16, 0.18]
    return dataclasses.replace(truth, base_color=color, environment=sky.astype(np.float32))


@pytest.mark.parametrize("height", [2, 16, 33])
@pytest.mark.parametrize("above", [0.0, 0.4, 0.95])
def test_the_height_of_white_light_is_a_third_of_its_slope_and_no_scale_changes_it(height, above):
    light = torch.from_numpy(white_light(above, height)).double()
    exact = above / 3 if height > 2 else above / 2  # two rows, at 45 degrees
    assert float(envmap.elevation(light)) == pytest.approx(exact, rel=0.01, abs=1e-9)
    assert float(envmap.elevation(7 * light)) == pytest.approx(float(envmap.elevation(light)), abs=1e-12)
    dark = envmap.elevation(torch.zeros(height, 4, 3))
    assert float(dark) == 0


def test_a_lamp_stands_at_the_sine_of_its_elevation():
    light = torch.zeros(32, 64, 3, dtype=torch.float64)
    light[5, 20] = torch.tensor([3.0, 0.5, 0.1], dtype=torch.float64)
    assert float(envmap.elevation(light)) == pytest.approx(np.sin(np.pi * (0.5 - 5.5 / 32)))


def test_only_light_that_stands_lower_than_usual_costs_and_it_is_drawn_up():
    lower = torch.rand(6, 12, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(envmap.too_low, (lower,))
    (gradient,) = torch.autograd.grad(envmap.too_low(lower), lower)
    assert float(gradient[0].max()) < 0 < float(gradient[-1].min())
    high = torch.from_numpy(np.repeat([[[1.0]], [[0.0]]], 4, 1).repeat(3, 2)).requires_grad_()
    assert float(envmap.elevation(high).detach()) > envmap.ABOVE
    assert float(envmap.too_low(high).detach()) == 0
    assert not torch.autograd.grad(envmap.too_low(high), high)[0].any()


def test_white_light_of_any_slope_and_colour_is_neutral_and_no_other_light_is():
    for above in (0.0, 0.5, 0.95):
        assert is_neutral(white_light(above))
        assert is_neutral(3 * white_light(above, 8) * np.float32([1, 0.8, 0.5]))
    overcast = white_light(0.0) * (1 + 2 * envmap.sines(32).numpy().clip(0))[:, None, None]
    turned = np.swapaxes(white_light(0.5, 16)[:, :16], 0, 1).repeat(2, 1)
    coloured = white_light(0.0) + white_light(0.9) * np.float32([0, 0, 1])
    for other in (overcast, turned, coloured, np.random.default_rng(0).uniform(0.5, 1, (8, 16, 3))):
        assert not is_neutral(other)


def test_a_start_under_light_from_above_is_as_bright_as_the_photographs():
    truth = roofed_die()
    views, carrier = photographed(truth, 6), carrier_of(truth)
    light = direct_transport(carrier.vertices, carrier.faces, LIGHT)
    start = neutral_asset(carrier, StartSettings(base_color="gray", above=0.9))
    model = Decomposition(carrier, views, light, SHORT, "cpu", start=start)
    model.start()
    found = envmap.radiance_of(model.environment.detach())
    assert float(envmap.elevation(found)) == pytest.approx(0.3, abs=0.01)
    prepared = model.prepare(0.0, 0)
    shown = torch.cat([model.shade(buffer, prepared)[0] for buffer in model.buffers]).detach()
    assert float(shown.mean()) == pytest.approx(float(torch.cat([b.target for b in model.buffers]).mean()), rel=0.02)


@pytest.mark.thorough
def test_a_dark_roof_stays_darker_where_light_comes_from_above():
    truth = roofed_die()
    views, carrier = photographed(truth), carrier_of(truth)
    light = direct_transport(carrier.vertices, carrier.faces, LIGHT)
    third = TEXELS // 3

    def roof_over_wall(color: np.ndarray) -> float:
        means = [color[TEXELS // 2 + 6 : -6, k * third + 4 : (k + 1) * third - 4].mean() for k in (1, 0)]
        return float(means[0] / means[1])

    def found(above: float, weight: float) -> tuple[float, float]:
        """How much too bright the roof is beside a wall, and the height of the light."""
        start = neutral_asset(carrier, StartSettings(base_color="gray", above=above))
        asset, _ = fit(carrier, views, light, SHORT.replaced(above_weight=weight), start=start)
        too_bright = roof_over_wall(asset.base_color) / roof_over_wall(truth.base_color)
        return too_bright, float(envmap.elevation(torch.from_numpy(asset.environment)))

    (before, low), (now, high) = found(0, 0), found(0.95, 3e-4)
    true = float(envmap.elevation(torch.from_numpy(truth.environment)))
    assert low < high < true
    assert 1 < now < 0.9 * before


def test_only_paint_that_is_brighter_than_usual_pulls_and_it_pulls_at_the_factor_alone():
    generator = torch.Generator().manual_seed(3)
    maps = torch.randn(5000, 5, generator=generator).requires_grad_()
    factor = CommonFactor()
    bright, dark = maps + 2, maps - 4

    def luminance_level(values: torch.Tensor) -> float:
        return float((torch.sigmoid(values.detach()[::2, :3]).double() @ torch.from_numpy(LUMINANCE)).log().mean())

    off = (luminance_level(bright) - np.log(USUAL)) / USUAL_SPREAD
    assert off > 0
    assert float(factor.too_bright(bright).detach()) == pytest.approx(off**2, rel=1e-4)
    to_maps, to_factor = torch.autograd.grad(
        factor.too_bright(bright), [maps, factor.parameter], allow_unused=True, materialize_grads=True
    )
    assert not to_maps.any()
    assert (to_factor < 0).all()  # a step down its gradient darkens paint and brightens light
    torch.testing.assert_close(to_factor, torch.full((3,), float(-2 * off / USUAL_SPREAD / 3)), rtol=1e-3, atol=0)
    assert float(factor.too_bright(dark).detach()) == 0
    with torch.no_grad():
        factor.parameter += off * USUAL_SPREAD + 1e-3  # as much darker
    assert float(factor.too_bright(bright).detach()) == 0


def test_metal_has_no_usual_level():
    maps, factor = torch.full((300, 5), 2.0), CommonFactor()
    paint, metal = torch.full((300,), -12.0), torch.full((300,), 12.0)
    half = torch.cat([paint[:150], metal[150:]])
    whole = float(factor.too_bright(maps).detach())
    assert float(factor.too_bright(maps, paint).detach()) == pytest.approx(whole, rel=1e-4)
    assert float(factor.too_bright(maps, half).detach()) == pytest.approx(whole / 2, rel=1e-4)
    assert float(factor.too_bright(maps, metal).detach()) < 1e-3 * whole
