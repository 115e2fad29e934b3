"""The fit under Monte Carlo light: the same light as the precomputed one up to noise, and resumable."""

from dataclasses import fields, replace
from importlib import import_module

import numpy as np
import pytest
import torch
from exmesh_nodes import stage2
from exmesh_nodes import transport as light_nodes

from exmesh_graph.gpu.cores import cores
from exmesh_graph.shading import envmap
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo import Material, MonteCarloLight
from exmesh_graph.shading.settings import MonteCarloSettings
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.fused import step as fused
from exmesh_graph.stage2.objective import plain_terms, weighted_terms
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.testing import FakeContext
from exmesh_graph.types.state import load_state, save_state

SETTINGS = DecompositionSettings(
    environment_height=16, iterations=12, material_rate=0.05, environment_rate=0.2, indirect_ramp=5, corrections=2,
    correction_samples=64, metallic=True, texture_size=64,
)  # fmt: skip
#: Few samples: these tests compare bytes, not light.
FEW = MonteCarloSettings(samples=2, secondary_rays=2, secondary_samples=1)


def _model(carrier, views, light, **changes):
    """A model with uneven maps under a sky with a bright side."""
    model = Decomposition(carrier, views, light, SETTINGS.replaced(**changes), "cpu")
    with torch.no_grad():
        texels = model.maps.texels
        u, v = (texels % 64).float() / 64, (texels // 64).float() / 64
        model.maps.parameter[:] = torch.stack([2 * u - 1, 1 - v, 0 * u, 0.3 - u, v - 2], 1)
        direction = torch.from_numpy(envmap.texel_directions(16, 32)).float()
        bright = (direction @ torch.tensor([0.6, 0.6, 0.5])).clamp_min(0)[..., None] ** 4
        model.environment.copy_(envmap.parameter_of(0.4 + 2 * bright * torch.tensor([1.3, 1.0, 0.7])))
    return model


def _found(terms_of, model, step=3):
    """Terms, radiance, and the gradients of their sum."""
    parameters = model.maps.parameter, model.environment, model.factor.parameter
    for parameter in parameters:
        parameter.grad = None
    terms, predicted = terms_of(model, model.buffers[1], step)
    torch.stack(list(terms.values())).sum().backward()
    return terms, predicted, [p.grad.clone() for p in parameters]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("light", "changes"),
    [
        ({}, {}),
        ({"independent_gradient": False}, {"normal_map": True}),
        ({"technique": "mis"}, {"exposure": True, "ssim_weight": 0.0, "material_weight": 0.0}),
        ({"bounces": 0}, {"metallic": False, "log_weight": 0.0}),
        ({"secondary_material": False, "half_resolution": False}, {}),
        ({"kept": 2, "technique": "brdf"}, {"normal_map": True, "gloss_weight": 5.0}),
        ({"secondary_lobes": True, "technique": "cosine"}, {"indirect_weight": 0.0}),
    ],
)
def test_the_fused_step_is_that_of_plain_operations(carrier, train_views, light, changes):
    settings = SETTINGS.replaced(**changes)
    model = Decomposition(carrier, train_views, FEW.replaced(**light), settings, "cpu")
    model.start()
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in (model.maps.parameter, model.environment, model.factor.parameter):
            parameter += (0.5 if parameter.dim() > 1 else 0.1) * torch.randn(parameter.shape, generator=generator)
    model.measure(1.0, torch.Generator().manual_seed(0))
    assert fused.serves(model)
    terms, predicted, gradients = _found(weighted_terms, model)
    known, shown, slopes = _found(plain_terms, model)
    assert terms.keys() == known.keys()
    for name, value in known.items():
        assert float(terms[name].detach()) == pytest.approx(float(value.detach()), rel=2e-5, abs=1e-8), name
    torch.testing.assert_close(predicted, shown, rtol=1e-4, atol=1e-5)
    for found, expected in zip(gradients, slopes, strict=True):
        assert float(expected.norm()) > 0
        assert float((found - expected).norm()) <= 1e-4 * float(expected.norm())


def test_texels_outside_of_the_fit_are_refused(carrier, train_views):
    maps = _model(carrier, train_views, FEW).maps
    assert torch.equal(maps.rows(maps.texels), torch.arange(len(maps.texels), dtype=torch.int32))
    outside = next(n for n in range(64 * 64) if n not in set(maps.texels.tolist()))
    with pytest.raises(ValueError, match=f"texel {outside} of maps of side 64"):
        maps.rows(torch.tensor([int(maps.texels[0]), outside]))


def test_the_same_bytes_for_any_number_of_cores(carrier, train_views, monkeypatch):
    monkeypatch.setattr("exmesh_graph.gpu.cores.HANDING", 1e-12)  # what is small is shared too
    for name in ("samples", "shade"):  # import_module: a function of the package has a module's name
        monkeypatch.setattr(import_module(f"exmesh_graph.shading.monte_carlo.{name}"), "_GRAIN", 32)
    results = []
    for count in (1, 2, 3):
        with cores(count):
            for _ in range(2):  # the first launch of a kernel stays on one thread
                _, predicted, gradients = _found(weighted_terms, _model(carrier, train_views, FEW))
        results.append([predicted, *gradients])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_many_samples_converge_to_the_precomputed_light(carrier, train_views, transport, strength, monkeypatch):
    """Two ways to the same integral: 1024 + 256 x 16 samples, and K directions with measured specular, which here finds
    a black mesh where its rays meet it, as the samples do."""
    many = MonteCarloSettings(
        technique="mis", samples=1024, bounces=1, secondary_rays=256, secondary_samples=16, half_resolution=False,
        secondary_lobes=True,
    )  # fmt: skip
    one, other = (_model(carrier, train_views, light) for light in (many, transport))
    with monkeypatch.context() as black:
        black.setattr(other.light, "lattice_sends", lambda maps, values: torch.zeros(1, 3))
        other.measure(strength, torch.Generator().manual_seed(0))
    with torch.no_grad():
        found, expected = (m.shade(m.buffers[1], m.prepare(strength, 0))[0] for m in (one, other))
    error = (found - expected).abs()
    assert float(error.mean() / expected.mean()) < 0.03
    assert float(error.quantile(0.95) / expected.mean()) < 0.1
    assert float(abs(found.mean() / expected.mean() - 1)) < 0.02


def test_the_bounce_is_there_and_its_choices_change_it(carrier, train_views):
    base = MonteCarloSettings(
        technique="mis", samples=256, bounces=1, secondary_rays=64, secondary_samples=8, half_resolution=False
    )
    shades = {}
    for name, changes in {
        "one": {}, "none": {"bounces": 0}, "half": {"half_resolution": True}, "own": {"secondary_material": False},
    }.items():  # fmt: skip
        model = _model(carrier, train_views, base.replaced(**changes))
        with torch.no_grad():
            shades[name] = model.shade(model.buffers[1], model.prepare(1.0, 0))[0]
    bounce = shades["one"] - shades["none"]
    assert float(bounce.mean() / shades["one"].mean()) > 0.02
    difference = (shades["half"] - shades["one"]).abs().mean()
    assert float(difference / bounce.mean()) < 0.25
    assert float((shades["own"] - shades["one"]).abs().mean() / bounce.mean()) > 0.05


def test_gradients_reach_maps_and_sky(carrier, train_views):
    model = _model(carrier, train_views, MonteCarloSettings())
    model.shade(model.buffers[1], model.prepare(1.0, 0))[0].sum().backward()
    pixels = torch.unique(model.buffers[1].texel)
    gradient = model.maps.parameter.grad
    assert float((gradient[pixels].abs().sum(1) > 0).float().mean()) > 0.9
    elsewhere = torch.ones(len(gradient), dtype=torch.bool)
    elsewhere[pixels] = False
    assert int((gradient[elsewhere, :3].abs().sum(1) > 0).sum()) > 50  # what secondary rays met
    assert float((model.environment.grad.abs().sum(-1) > 0).float().mean()) > 0.5


@pytest.mark.parametrize("kept", [0, 2])
def test_the_gradient_is_that_of_other_samples_than_the_picture(carrier, train_views, kept):
    """The picture is that of one seed for both; the gradient that of the next step's kept rays, or of a seed apart."""
    found = {}
    for own in (True, False):
        model = _model(carrier, train_views, FEW.replaced(independent_gradient=own, kept=kept))
        if kept:
            model.measure(1.0, torch.Generator().manual_seed(0))
        for step in (0, 1):
            radiance = model.shade(model.buffers[1], model.prepare(1.0, step))[0]
            model.maps.parameter.grad = None
            radiance.sum().backward()
            found[own, step] = radiance.detach(), model.maps.parameter.grad.clone()
    torch.testing.assert_close(found[True, 0][0], found[False, 0][0], rtol=0, atol=0)
    assert not torch.allclose(found[True, 0][1], found[False, 0][1], rtol=0.01)
    if kept:  # two slots that take turns
        torch.testing.assert_close(found[True, 0][1], found[False, 1][1])


@pytest.mark.thorough
def test_a_squared_loss_pulls_down_only_where_picture_and_gradient_share_their_samples(carrier, train_views):
    """E[(X - t) dX] for a picture X around its own mean t: the covariance of X and dX, 0 with samples of its own."""
    pulls = {}
    for own in (True, False):
        model = _model(carrier, train_views, MonteCarloSettings(independent_gradient=own, bounces=0))
        buffer = model.buffers[1]
        with torch.no_grad():
            target = torch.stack([model.shade(buffer, model.prepare(0.0, step))[0] for step in range(64)]).mean(0)
        for step in range(100, 132):
            radiance = model.shade(buffer, model.prepare(0.0, step))[0]
            radiance.backward(radiance.detach() - target)
        pulls[own] = float(model.maps.parameter.grad[:, :3].sum())
    assert pulls[False] > 0
    assert abs(pulls[True]) < 0.3 * pulls[False]


@pytest.mark.thorough
@pytest.mark.parametrize("light", [FEW, FEW.replaced(kept=2), FEW.replaced(bounces=0)])
def test_a_cut_off_fit_goes_on_to_the_same_bytes(carrier, train_views, light, tmp_path):
    kept = {}

    def checkpoint(now, state):
        if now == 7:  # corrections, at which kept rays are drawn anew, come at 4 and 8
            save_state(tmp_path, state)
            kept.update(load_state(tmp_path))

    whole, curves = fit(carrier, train_views, light, SETTINGS, seed=3, checkpoint=checkpoint)
    resumed, same = fit(carrier, train_views, light, SETTINGS, seed=3, resumed=(7, kept))
    other, _ = fit(carrier, train_views, light, SETTINGS, seed=4)
    assert same == curves
    for field in fields(whole):
        expected = np.asarray(getattr(whole, field.name)).tobytes()
        assert np.asarray(getattr(resumed, field.name)).tobytes() == expected
    assert other.base_color.tobytes() != whole.base_color.tobytes()


def test_kept_rays_are_traced_once_between_measurements(carrier, train_views, monkeypatch):
    drawn = []
    draw = MonteCarloLight.draw
    monkeypatch.setattr(MonteCarloLight, "draw", lambda self, *a, **k: drawn.append(0) or draw(self, *a, **k))
    model = _model(carrier, train_views, FEW.replaced(kept=2))

    def shades():
        with torch.no_grad():
            return [model.shade(model.buffers[1], model.prepare(1.0, step))[0] for step in range(4)]

    shades()
    assert len(drawn) == 4  # fresh ones before the first measurement
    model.measure(1.0, torch.Generator())
    first = shades()
    assert len(drawn) == 6
    assert not torch.equal(first[0], first[1])
    assert torch.equal(first[0], first[2])
    with torch.no_grad():
        model.environment += 0.5
    brighter = shades()[0] - first[0]
    assert float(brighter.min()) >= 0
    assert float(brighter.median()) > 0  # the rays are old, the light is the current one
    assert len(drawn) == 6
    model.measure(1.0, torch.Generator())
    shades()
    assert len(drawn) == 8


def test_kept_rays_are_drawn_again_for_the_normals_of_the_measurement(carrier, train_views):
    """Whenever they are first asked for, in a resumed fit too, whose normal map has moved on since."""
    settings = SETTINGS.replaced(normal_map=True)
    model, resumed = (
        Decomposition(carrier, train_views, FEW.replaced(kept=1), settings, "cpu", seed=3) for _ in range(2)
    )
    with torch.no_grad():
        model.measure(1.0, torch.Generator())
        buffer = model.buffers[1]
        model.shade(buffer, model.prepare(1.0, 0))  # drawn at the flat map
        for one in (model, resumed):
            one.maps.parameter[:, -2:] = 4.0
        resumed.light.restore(resumed.buffers, model.light.state(model.buffers))
        expected, found = (one.shade(one.buffers[1], one.prepare(1.0, 1))[0] for one in (model, resumed))
    assert torch.equal(found, expected)


@pytest.mark.parametrize("technique", ["environment", "mis"])
def test_kept_rays_light_what_a_turned_normal_newly_faces(carrier, train_views, technique):
    """Normals turn back to the surface's own after the rays were drawn: with `turning` they see what fresh rays see."""
    model = _model(carrier, train_views, MonteCarloSettings(technique=technique, samples=512, bounces=0))
    buffer, light = model.buffers[1], model.light
    points = light.seen(buffer).points(model.maps.read(model.maps.values(), buffer.texel, buffer.texel_weight))
    away = torch.nn.functional.normalize(points.normal - 1.2 * torch.tensor([0.6, 0.6, 0.5]), dim=1)
    with torch.no_grad():
        lit = model.prepare(0.0, 0)
        material = Material(model.maps.read(lit.values, buffer.texel, buffer.texel_weight).base_color)
        before = replace(points, normal=away)
        shaded = {}
        for name, there, turning in (("fresh", points, False), ("kept", before, True), ("lost", before, False)):
            drawn = light.light.draw(there, material, None, EnvSampler(lit.environment), 5, turning=turning)
            shaded[name] = light.light.shade(drawn, points, material, None, lit.environment).mean()
    assert float(shaded["kept"] / shaded["fresh"]) == pytest.approx(1, abs=0.01)
    assert float(shaded["lost"] / shaded["fresh"]) < 0.97


@pytest.mark.thorough
def test_the_component_plugs_into_the_node(carrier, train_views):
    component = light_nodes.MonteCarlo(samples=2, secondary_rays=2, secondary_samples=1)
    assert dict(component) == dict(FEW)
    assert dict(light_nodes.MonteCarlo()) == dict(MonteCarloSettings())
    p = stage2.FitParams(iterations=3, environment_height=16, corrections=1)
    asset, _ = stage2.fit(FakeContext(seed=5), carrier, train_views, component, p=p)
    direct, _ = fit(
        carrier, train_views, FEW, DecompositionSettings(iterations=3, environment_height=16, corrections=1), seed=5
    )
    assert asset.base_color.tobytes() == direct.base_color.tobytes()
