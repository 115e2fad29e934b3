"""Base colour times s under light divided by s: the factor is found, and folding it in changes nothing else."""

import numpy as np
import pytest
import torch

from exmesh_graph.shading import envmap
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.gains import BRIGHTEST, KEPT, WHITEST, CommonFactor
from exmesh_graph.stage2.maps import PAST_ONE
from exmesh_graph.stage2.settings import DecompositionSettings

QUICK = DecompositionSettings(
    texture_size=48,
    environment_height=16,
    iterations=160,
    material_rate=0.1,
    environment_rate=0.3,
    factor_rate=0.06,
    ssim_weight=0.0,
    material_weight=0.003,
    environment_weight=0.001,
    chroma_weight=0.0,
    indirect_ramp=10,
    corrections=2,
)


def _random_parameters(dtype=torch.float32):
    generator = torch.Generator().manual_seed(0)
    maps = torch.randn(50, 4, generator=generator, dtype=dtype) * 4
    sky = torch.randn(8, 16, 3, generator=generator, dtype=dtype) * 6
    return maps, sky


@pytest.mark.parametrize("texels", [1, 2, 7, 50, 2000])
@pytest.mark.parametrize("metal", [None, -90.0, 0.0, 90.0])
def test_a_bound_factor_keeps_the_quantile_of_base_colours_at_what_paint_reflects(texels, metal):
    """Metal may reflect all; what is neither is between."""
    generator = torch.Generator().manual_seed(texels)
    maps = torch.randn(texels, 4, generator=generator)
    maps[: texels // 3] = maps[0]  # many alike
    factor = CommonFactor()
    with torch.no_grad():
        factor.parameter.fill_(-9.0)
    factor.bound(maps, None if metal is None else torch.full((texels,), metal))
    most = {None: WHITEST, -90.0: WHITEST, 0.0: WHITEST**0.5, 90.0: 1.0}[metal]
    reached = torch.nn.functional.logsigmoid(maps[:, :3]) - factor.parameter
    torch.testing.assert_close(torch.quantile(reached, KEPT, dim=0).exp(), torch.full((3,), most), rtol=1e-5, atol=0)


def _drifted(steps: torch.Tensor, factor: CommonFactor | None = None) -> torch.Tensor:
    """Base colours [3] after `steps` [S, 3] of the factor, each bound; they begin at 0.8, 0.4 and 0.2."""
    maps = torch.logit(torch.tensor([0.8, 0.4, 0.2, 0.5])).repeat(100, 1)
    factor, sky = factor or CommonFactor(), torch.ones(2, 4, 3)
    for number, step in enumerate(steps):
        with torch.no_grad():
            factor.parameter += step
        factor.bound(maps)
        if number % 100 == 50:
            factor.fold(maps, sky)
    return (torch.sigmoid(maps[0, :3]) / factor.parameter.exp()).detach()


def test_a_level_that_drifts_up_to_the_bound_keeps_the_hue():
    """Where nothing tells the level it rises in all channels; the brightest alone held back, all would end gray."""
    reached = _drifted(torch.full((300, 3), -0.01))
    torch.testing.assert_close(reached / reached[0], torch.tensor([1.0, 0.5, 0.25]), rtol=0.02, atol=0)
    assert float(reached[0]) == pytest.approx(WHITEST, rel=1e-4)


def test_a_channel_that_is_held_darkens_no_other():
    """Red presses on; what green and blue do to and fro leaves them within a step of where they were."""
    generator = torch.Generator().manual_seed(0)
    steps = 0.004 * torch.randn(2000, 3, generator=generator)
    steps[1::2] = -steps[::2]
    steps[:, 0] = -0.01
    reached = _drifted(steps)
    assert float(reached[0]) == pytest.approx(WHITEST, rel=1e-4)
    assert (reached[1:] / torch.tensor([0.4, 0.2]) > 0.98).all(), reached


def test_channels_brighten_below_the_bound_and_once_none_is_held():
    rise = torch.tensor([[0.0, -0.5, 0.0], [0.0, 0.0, -1.0]])
    torch.testing.assert_close(_drifted(rise), torch.tensor([0.8, 0.4 * np.exp(0.5), 0.2 * np.e]).float())
    factor = CommonFactor()
    held = _drifted(torch.tensor([[-0.5, 0.0, 0.0], [0.0, -0.5, 0.0]]), factor)
    torch.testing.assert_close(held, torch.tensor([WHITEST, 0.4, 0.2]))
    let_go = _drifted(torch.tensor([[0.5, 0.0, 0.0], [0.0, -0.5, 0.0]]), factor)
    assert float(let_go[1]) == pytest.approx(0.4 * np.exp(0.5), rel=1e-4)


def test_bright_metal_does_not_darken_the_paint_beside_it():
    maps = torch.full((100, 5), -2.0)
    maps[:40, :3], maps[:40, 4] = 3.0, 9.0
    factor = CommonFactor()
    factor.bound(maps, maps[:, 4])
    assert float(factor.parameter.abs().max()) == 0
    factor.bound(maps)
    assert float(factor.parameter.min()) == pytest.approx(np.log(1 / (1 + np.exp(-3.0)) / WHITEST), rel=1e-4)


def test_folding_scales_colour_and_light_and_leaves_the_rest():
    maps, sky = _random_parameters()
    factor = CommonFactor()
    with torch.no_grad():
        factor.parameter.copy_(torch.tensor([0.3, -0.1, 0.05]))
    color, roughness = torch.sigmoid(maps[:, :3].double()), maps[:, 3].clone()
    values, radiance = factor.share(torch.sigmoid(maps.double()), envmap.radiance_of(sky.double()))
    expected = torch.minimum(values[:, :3], color.clamp_min(BRIGHTEST))
    factor.fold(maps, sky)
    torch.testing.assert_close(torch.sigmoid(maps[:, :3].double()), expected.detach(), rtol=1e-5, atol=1e-7)
    torch.testing.assert_close(envmap.radiance_of(sky.double()), radiance.detach(), rtol=1e-5, atol=1e-9)
    assert torch.equal(maps[:, 3], roughness)
    assert torch.equal(factor.parameter, torch.zeros(3))


@pytest.mark.parametrize("gain", [-0.5, 0.0, 0.5])
def test_folding_extremes_stays_finite(gain):
    maps, sky = torch.full((2, 4), -80.0), torch.tensor([-200.0, -20.0, 500.0]).expand(2, 2, 3).clone()
    maps[1] = 80
    sky[0, 0, 0] = 1e4  # beyond what any radiance is
    factor = CommonFactor()
    with torch.no_grad():
        factor.parameter.fill_(gain)
    factor.fold(maps, sky)
    assert bool(torch.isfinite(maps).all())
    assert bool(torch.isfinite(sky).all())
    assert float(sky[0, 0, 2]) == pytest.approx(500 + envmap.BRIGHT * gain, rel=1e-5)


def test_a_step_with_the_factor_is_a_step_with_it_folded_in(carrier, train_views, transport):
    """Same picture before and after folding (no texel is bright enough to be cut), and the loss falls along it."""
    model = Decomposition(carrier, train_views, transport, QUICK, "cpu")
    model.start()
    with torch.no_grad():
        model.factor.parameter.copy_(torch.tensor([0.2, -0.1, 0.0]))
    before, _ = model.shade(model.buffers[0], model.prepare(1.0, 50))
    sky = model.prepare(1.0, 50).environment
    model.settle_factor()
    after, _ = model.shade(model.buffers[0], model.prepare(1.0, 50))
    torch.testing.assert_close(after, before, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(model.prepare(1.0, 50).environment, sky, rtol=1e-4, atol=1e-6)


def test_the_tint_passes_on_what_eq_24_says_of_the_colour_and_nothing_of_the_level():
    factor = CommonFactor()
    factor.parameter.data = torch.tensor([0.3, -0.1, 0.05], dtype=torch.float64)
    sky = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64) + torch.tensor(
        [1, 0, 0]
    )
    seen = sky * factor.parameter.detach().exp()
    assert torch.equal(factor.tint(), torch.ones(3, dtype=torch.float64))
    (found,) = torch.autograd.grad(envmap.chroma(seen * factor.tint()), factor.parameter)
    assert abs(float(found.sum())) < 1e-12
    step = torch.tensor([1.0, -1.0, 0.0], dtype=torch.float64) * 1e-6  # redder, as bright on the whole
    rise = envmap.chroma(sky * (factor.parameter.detach() + step).exp()) - envmap.chroma(
        sky * (factor.parameter.detach() - step).exp()
    )
    assert float(found[0] - found[1]) == pytest.approx(float(rise / 2e-6), rel=1e-6)


@pytest.mark.slow
def test_the_factor_does_not_undo_what_the_chroma_term_does_to_the_sky(carrier, train_views, transport):
    """Left out of it, it ran away: sky less red, factor redder, and so on (image term 0.045 here in place of 0.027)."""
    slow = QUICK.replaced(
        chroma_weight=5.0,
        factor_rate=0.03,
        iterations=600,
        material_rate=2.5e-3,
        environment_rate=1.5e-2,
        corrections=4,
    )
    warned: list[str] = []
    _, curves = fit(carrier, train_views, transport, slow, seed=3, warn=warned.append)
    assert not warned
    assert np.mean(curves["image"][-10:]) < 0.033


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("wrong", "rate", "low", "high"), [(0.8, 0.06, 1.0, 1.15), (0.8, 0.0, 1.15, 1.3), (1.2, 0.06, 0.85, 1.03)]
)
def test_a_wrong_start_is_brought_back(
    carrier, train_views, transport, true_asset, wrong, rate, low, high, monkeypatch
):
    """From the truth, base colour times `wrong`: the factor brings the sky back, the texels alone do not.

    A fifth too bright, a third of the red texels start near 1: the factor must not run off that way (it did).
    Bounds: a little outside what seeds 3 to 7 give, 1.05 to 1.13 (1.02 to 1.11 where green and blue go on while red is
    held), 1.15 to 1.21 and 0.89 to 1.01 (0.77 to 0.90 where base colours may reach 1).
    """

    def start(model):
        model.light.start(model.maps, envmap.radiance_of(model.environment.detach()), model.buffers)
        texels = model.maps.texels
        truth = [torch.from_numpy(image) for image in (true_asset.base_color * wrong, true_asset.roughness[..., None])]
        color, roughness = (
            torch.nn.functional.interpolate(image.permute(2, 0, 1)[None], (48, 48), mode="bilinear", antialias=True)[0]
            .flatten(1)
            .T[texels]
            for image in truth
        )
        with torch.no_grad():
            model.maps.parameter.copy_(
                torch.logit(torch.cat([color, (roughness - 0.08) / (0.92 * (1 + PAST_ONE))], 1).clamp(0.01, 0.99))
            )
            model.environment.copy_(envmap.parameter_of(torch.from_numpy(true_asset.environment) / wrong))

    monkeypatch.setattr(Decomposition, "start", start)
    asset, _ = fit(carrier, train_views, transport, QUICK.replaced(factor_rate=rate), seed=3)
    found = envmap.mean_radiance(torch.from_numpy(asset.environment))
    ratio = found / envmap.mean_radiance(torch.from_numpy(true_asset.environment))
    assert low < float(ratio.min()), ratio
    assert float(ratio.max()) < high, ratio
