"""The fit on a scene whose materials and light are known."""

import dataclasses
import itertools

import numpy as np
import pytest
import torch

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.losses import d_ssim, log_l1, pair_variation
from exmesh_graph.optim import Adam
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import initial_base_color, neutral_asset, resize_texture
from exmesh_graph.stage2.maps import Material
from exmesh_graph.stage2.objective import image_terms
from exmesh_graph.stage2.pictures import encode_srgb
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.stage2.result import complete_maps
from exmesh_graph.stage2.schedule import learning_rates, lit_first
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings

QUICK = DecompositionSettings(
    environment_height=16,
    iterations=150,
    material_rate=0.05,
    environment_rate=0.2,
    indirect_ramp=20,
    ssim_weight=0.05,
    material_weight=0.003,
    environment_weight=0.003,
    chroma_weight=0.01,
    corrections=2,
    correction_samples=8,
)


def _psnr(a, b):
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


@pytest.fixture(scope="module")
def render(true_asset):
    """render_views with one light transport for all calls on the scene."""
    light = render_transport(true_asset, 2, directions=128, points=2000)
    return lambda asset, *cameras, **options: render_views(asset, *cameras, 40, 40, transport=light, **options)


def _display(rendered, index):
    return np.clip(rendered.images[index], 0, 1) ** (1 / 2.2)


@pytest.fixture(scope="module")
def fitted(carrier, train_views, transport):
    steps = []
    asset, curves = fit(
        carrier, train_views, transport, QUICK, seed=3, progress=lambda i, n, **f: steps.append((i, n, f["psnr"]))
    )
    return asset, curves, steps


@pytest.mark.thorough
def test_materials_light_and_new_views_are_recovered(fitted, render, true_asset, true_render, cameras):
    asset, curves, steps = fitted
    start = dataclasses.replace(
        asset,
        base_color=np.full_like(asset.base_color, 0.5),
        roughness=np.full_like(asset.roughness, 0.5),
        environment=np.ones_like(asset.environment),
    )
    held = [c[8:] for c in cameras]
    before, after = (render(a, *held) for a in (start, asset))
    assert _psnr(_display(after, 0), _display(true_render, 8)) > 28
    assert (
        _psnr(_display(after, 0), _display(true_render, 8)) > _psnr(_display(before, 0), _display(true_render, 8)) + 6
    )
    seen = true_render.alpha > 0.99
    views = render(asset, *cameras)
    scale = np.median(true_render.albedo[seen] / views.albedo[seen], axis=0)
    error = np.abs(views.albedo[seen] * scale - true_render.albedo[seen]).mean()
    gray = np.abs(np.median(true_render.albedo[seen], axis=0) - true_render.albedo[seen]).mean()
    assert error < 0.6 * gray
    relit_truth = render(true_asset, *held, environment=true_asset.environment[:, ::-1].copy())
    scaled = dataclasses.replace(asset, base_color=np.clip(asset.base_color * scale, 0, 1).astype(np.float32))
    relit = render(scaled, *held, environment=true_asset.environment[:, ::-1].copy())
    assert _psnr(_display(relit, 0), _display(relit_truth, 0)) > 25
    assert curves["image"][-1] < 0.3 * curves["image"][0]
    assert steps[-1][:2] == (150, 150)
    assert np.isfinite(asset.environment).all()
    assert (asset.environment >= 0).all()


@pytest.mark.thorough
def test_same_inputs_give_the_same_bytes(fitted, carrier, train_views, transport):
    again, _ = fit(carrier, train_views, transport, QUICK, seed=3)
    for name in ("base_color", "roughness", "environment", "seen"):
        assert getattr(again, name).tobytes() == getattr(fitted[0], name).tobytes()


def test_maps_have_the_asked_size_and_options(carrier, train_views, transport):
    settings = QUICK.replaced(iterations=3, texture_size=96, metallic=True, corrections=0)
    asset, _ = fit(carrier, train_views, transport, settings)
    assert asset.base_color.shape == (96, 96, 3)
    assert asset.roughness.shape == asset.metallic.shape == asset.seen.shape == (96, 96)
    assert asset.environment.shape == (16, 32, 3)
    assert np.median(asset.metallic) < 0.2 < 0.3 < np.median(asset.roughness)  # they start at 0 and 0.5
    assert asset.base_color.dtype == asset.environment.dtype == np.float32
    assert 0.1 < asset.seen.mean() < 1
    direct = dataclasses.replace(transport, bounces=0, gather_start=None, gather_point=None, gather_weight=None)
    fit(carrier, train_views, direct, QUICK.replaced(iterations=2, corrections=0))


def test_errors_name_the_cause(carrier, train_views, transport):
    settings = QUICK.replaced(iterations=20, corrections=0)
    moved = dataclasses.replace(carrier, vertices=carrier.vertices + 0.1)
    with pytest.raises(GeometryError, match="another mesh"):
        fit(moved, train_views, transport, settings)
    empty = dataclasses.replace(train_views, alpha=np.zeros_like(train_views.alpha))
    with pytest.raises(DataError, match="no training pixel"):
        fit(carrier, empty, transport, settings)


def test_after_a_correction_the_model_equals_the_traced_render(carrier, train_views, transport):
    """shade() = diffuse + traced specular at the parameters it was measured with."""
    from exmesh_graph.shading import brdf
    from exmesh_graph.shading.gather import gather_rows

    settings = QUICK.replaced(correction_samples=64)
    model = Decomposition(carrier, train_views, transport, settings, "cpu")
    buffer = model.buffers[0]
    scales = []
    for seed in (0, 1):
        model.measure(1.0, torch.Generator().manual_seed(seed))
        scales.append(buffer.light.specular_scale.clone())
    # a uniform white sky: free points of the ball see all of it, so the factor is 1 there up to grazing angles ...
    surface = buffer.samples(model.geometry)
    upward = (surface.position[:, 1] > 0.1) & (surface.reflected[:, 1] > 0.6) & (buffer.n_v > 0.6)
    assert int(upward.sum()) > 5
    np.testing.assert_allclose(scales[0][upward].numpy(), 1, atol=0.1)
    # ... and two independent measurements agree
    assert float((scales[0] - scales[1]).abs().mean()) < 0.03
    with torch.no_grad():
        lit = model.prepare(1.0, 0)
        shaded, material = model.shade(buffer, lit)
        split = model.light.split_sum(buffer, material, lit.light)
        irradiance = gather_rows(lit.light.irradiance, buffer.light.point, buffer.light.point_weight)
    diffuse = brdf.diffuse(material.base_color) * irradiance
    torch.testing.assert_close(shaded, diffuse + split * buffer.light.specular_scale)


def test_adam_equals_torchs():
    generator = torch.Generator().manual_seed(0)
    start = torch.rand(5, 3, generator=generator)
    ours, theirs = start.clone().requires_grad_(), start.clone().requires_grad_()
    mine, reference = Adam([ours], [0.05]), torch.optim.Adam([theirs], lr=0.05)
    for step in range(12):
        for parameter in (ours, theirs):
            ((parameter - 0.3) ** 2 * (1 + step % 3)).sum().backward()
        mine.step()
        reference.step()
        reference.zero_grad()
        torch.testing.assert_close(ours.detach(), theirs.detach(), rtol=1e-5, atol=1e-6)


def test_clipped_pixels_pull_up_but_not_down():
    target = torch.ones(2, 3)
    clipped = torch.ones(2, 3, dtype=torch.bool)
    weight = torch.ones(2)
    for value, expected in ((3.0, 0.0), (0.5, abs(np.log(1.5) - np.log(2)))):
        predicted = torch.full((2, 3), value, requires_grad=True)
        loss = log_l1(predicted, target, clipped, weight)
        loss.backward()
        assert float(loss.detach()) == pytest.approx(expected, abs=1e-6)
        assert bool((predicted.grad == 0).all()) == (value > 1)


def test_the_variation_of_logarithms_hardly_knows_how_bright_base_colour_is():
    color = torch.rand(200, 3, generator=torch.Generator().manual_seed(0)) * 0.6 + 0.2
    pairs = torch.arange(200).reshape(100, 2)

    def variation(scale: float, of: str) -> float:
        table = torch.cat([scale * color, torch.full((200, 1), 0.5)], dim=1)
        return float(pair_variation(Material(table, False).varied(DecompositionSettings(variation=of)), pairs))

    assert variation(0.5, "linear") == pytest.approx(0.5 * variation(1.0, "linear"))
    assert variation(0.5, "log") == pytest.approx(variation(1.0, "log"), rel=0.1)


def test_pair_variation_and_weights():
    values, pairs = torch.tensor([[0.0, 1.0], [0.5, 1.0], [0.5, 0.0]]), torch.tensor([[0, 1], [1, 2]])
    assert float(pair_variation(values, pairs)) == pytest.approx((0.5 + 0 + 0 + 1) / 4)
    assert float(pair_variation(values, pairs[:0])) == 0
    target = torch.zeros(2, 1).expand(2, 3)
    predicted = torch.tensor([[1.0], [0.0]]).expand(2, 3)
    loss = log_l1(predicted, target, torch.zeros(2, 3, dtype=torch.bool), torch.tensor([1.0, 3.0]))
    assert float(loss) == pytest.approx(np.log(2) / 4)


def test_neutral_start_shows_the_texture():
    texture = np.random.default_rng(0).uniform(0.2, 0.8, (8, 8, 3)).astype(np.float32)
    linear = initial_base_color(texture, 8, "texture").numpy()
    np.testing.assert_allclose(linear, ((texture + 0.055) / 1.055) ** 2.4, rtol=1e-4)
    np.testing.assert_allclose(resize_texture(texture, 4).mean(), texture.mean(), rtol=0.02)
    assert resize_texture(texture, 16).shape == (16, 16, 3)


def test_unseen_texels_come_from_the_surface_around_them(carrier):
    """Two charts: an unseen patch is filled from its neighbours in space; texels off the charts from the nearest."""
    size = 64
    maps = np.zeros((size, size, 1), np.float32)
    maps[:, :40] = 1.0  # the ball's chart
    seen = np.ones((size, size), bool)
    seen[20:30, 10:30] = False
    broken = maps.copy()
    broken[~seen] = 77
    filled = complete_maps(broken, seen, carrier)
    np.testing.assert_allclose(filled[20:30, 10:30], 1, atol=1e-5)
    np.testing.assert_array_equal(filled[seen], maps[seen])
    nothing = complete_maps(maps, np.zeros_like(seen), carrier)
    np.testing.assert_array_equal(nothing, maps)


def test_texels_that_a_footprints_corner_touched_are_filled_from_their_neighbours(carrier, train_views, transport):
    """Adam moves barely touched texels as fast as all others; what they end at must not reach the asset."""
    from exmesh_graph.stage2.result import finished_asset

    model = Decomposition(carrier, train_views, transport, QUICK.replaced(texture_size=64), "cpu")
    weight = torch.zeros(len(model.maps.texels))
    for buffer in model.buffers:
        weight.index_add_(0, buffer.texel.reshape(-1), buffer.texel_weight.reshape(-1))
    faint = (weight > 0) & (weight < 0.02)
    assert int(faint.sum()) > 3
    with torch.no_grad():
        model.maps.parameter.fill_(0)
        model.maps.parameter[faint] = 9
    asset = finished_asset(carrier, model)
    np.testing.assert_allclose(asset.base_color, 0.5, atol=1e-5)
    assert asset.seen.sum() > 0.5 * int((weight > 0).sum())


@pytest.mark.parametrize("source", ["gray", "texture"])
def test_the_starting_light_makes_the_start_as_bright_as_the_photographs(carrier, train_views, transport, source):
    def started(exposure: float) -> Decomposition:
        views = dataclasses.replace(train_views, images=train_views.images * np.float32(exposure), clipped=False)
        model = Decomposition(
            carrier, views, transport, QUICK, "cpu", start=neutral_asset(carrier, StartSettings(base_color=source))
        )
        model.level_light()
        return model

    model, darker = started(1.0), started(0.25)
    with torch.no_grad():
        lit = model.prepare(0.0, 0)
        shown = sum(float((model.shade(b, lit)[0] * b.coverage[:, None]).sum()) for b in model.buffers)
    assert shown == pytest.approx(sum(float((b.target * b.coverage[:, None]).sum()) for b in model.buffers), rel=1e-3)
    level, quarter = (torch.nn.functional.softplus(m.environment.detach()).mean() for m in (model, darker))
    assert float(quarter / level) == pytest.approx(0.25, rel=1e-3)


def test_d_ssim_weighs_against_log_l1_as_in_stage_one(carrier, train_views, transport):
    """Both are sums over the picture by one number: in Stage I its pixels, here those of the object."""
    settings = QUICK.replaced(ssim_weight=1.0)
    model = Decomposition(carrier, train_views, transport, settings, "cpu")
    buffer = model.buffers[0]
    predicted = (buffer.target * 0.7 + 0.05).clamp(0, 1)
    found = float(image_terms(settings, predicted, buffer)["ssim"])
    height, width = train_views.alpha.shape[1:]

    def picture(values):
        return torch.zeros(height * width, 3).index_copy(0, buffer.pixel, encode_srgb(values)).reshape(height, width, 3)

    whole = float(d_ssim(picture(predicted), picture(buffer.target)))  # the mean that Stage I takes
    assert found == pytest.approx(whole * height * width / len(buffer.pixel), rel=0.02)


def test_longer_fits_than_the_rates_suit_take_smaller_ones():
    rates = DecompositionSettings(material_rate=0.3, environment_rate=0.6, factor_rate=0.03, iterations=1600)
    assert learning_rates(rates) == [0.3, 0.6, 0.03]
    assert learning_rates(rates.replaced(rates_for=400)) == pytest.approx([0.15, 0.3, 0.0075])
    assert learning_rates(rates.replaced(rates_for=400, iterations=100)) == [0.3, 0.6, 0.03]


def test_the_first_steps_move_the_light_alone(carrier, train_views, transport):
    """Maps stay as they were until then, and under a light that is kept there are no such steps."""
    start = neutral_asset(carrier, StartSettings(base_color="gray"))
    kept = {}

    def keep(step, state):
        parameters = state["optimiser"]["parameters"]
        kept[step] = [parameter.detach().clone() for parameter in parameters]

    settings = QUICK.replaced(iterations=20, light_first=0.25, corrections=0)
    fit(carrier, train_views, transport, settings, start=start, checkpoint=keep)
    maps, sky, factor = zip(*(kept[step] for step in range(1, 8)), strict=True)
    assert all(
        torch.equal(maps[0], later) and torch.equal(factor[0], f) for later, f in zip(maps[:5], factor[:5], strict=True)
    )
    assert not torch.equal(maps[4], maps[5])
    assert all(not torch.equal(before, after) for before, after in itertools.pairwise(sky))
    assert lit_first(settings) == 5
    assert lit_first(settings.replaced(keep_light=True)) == 0
