"""Colours gather about the paints of a surface, and the light explains what was shade."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import logit
from exmesh_graph.stage2.maps import LOG_FLOOR
from exmesh_graph.stage2.palette import WHEN, climb, gather_colors, gathering, light_follows
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.types import Views
from tests.stage2.conftest import SIZE

SETTINGS = DecompositionSettings(
    texture_size=32, environment_height=16, iterations=200, material_rate=0.2, environment_rate=0.1, factor_rate=0.02,
    ssim_weight=0.0, material_weight=0.003, environment_weight=0.001, chroma_weight=0.0, indirect_ramp=10,
    corrections=1, correction_samples=8, palette_width=0.1,
)  # fmt: skip
RED, GRAY = np.array([0.6, 0.2, 0.1]), np.array([0.4, 0.42, 0.45])


def mean_shift(place, weight, width, steps=400):
    """The plain form of `climb`: each place goes to the mean of all, by a Gaussian about it, until it stays."""
    at = place.copy()
    for _ in range(steps):
        near = np.exp(-(np.square(at[:, None] - place[None]).sum(-1)) / (2 * width**2)) * weight
        at = (near[..., None] * place[None]).sum(1) / near.sum(1, keepdims=True)
    return at


@pytest.mark.parametrize("seed", range(4))
def test_places_climb_to_the_modes_of_a_mean_shift(seed):
    rng = np.random.default_rng(seed)
    paints = rng.uniform(-3, 0, (4, 3))
    place = np.concatenate([paint + rng.normal(0, 0.06, (150, 3)) for paint in paints])
    weight = rng.uniform(0.2, 3, len(place))
    expected, found = mean_shift(place, weight, 0.12), climb(place, weight, 0.12)
    assert np.abs(found - expected).max() < 0.3 * 0.12
    assert np.abs(found - expected).mean() < 0.1 * 0.12


def test_places_that_are_one_few_or_far_apart_stay_finite():
    one = np.full((5, 3), -1.0)
    np.testing.assert_allclose(climb(one, np.ones(5), 0.1), one, atol=0.02)
    apart = np.array([[-8.0, -8, -8], [0, 0, 0]])  # a width far below the grid's cells
    np.testing.assert_allclose(climb(apart, np.array([1e-6, 1e6]), 0.001), apart, atol=0.1)
    silent = climb(np.array([[-1.0, -1, -1], [-2, -2, -2]]), np.array([1.0, 0.0]), 0.1)  # what no pixel sees
    assert np.isfinite(silent).all()


def _maps(color, metallic=None):
    columns = 4 if metallic is None else 5
    maps = SimpleNamespace(settings=SETTINGS.replaced(metallic=metallic is not None), size=1)
    maps.parameter = torch.zeros(len(color), columns)
    maps.parameter[:, :3] = logit(torch.from_numpy(color.astype(np.float32)), 1e-3)
    if metallic is not None:
        maps.parameter[:, 4] = logit(torch.from_numpy(metallic.astype(np.float32)))
    maps.values = lambda: torch.sigmoid(maps.parameter)
    return maps


def _shaded(paint, count, rng, dark):
    """`count` texels of a paint, a third of them up to `dark` too dark."""
    shade = np.where(rng.random(count) < 1 / 3, rng.uniform(dark, 1, count), 1)
    return paint * shade[:, None] * np.exp(rng.normal(0, 0.02, (count, 3)))


def test_shade_goes_and_paints_stay_apart():
    """Each texel takes its paint's colour; the logarithm of all of them keeps its mean, and roughness stays."""
    rng = np.random.default_rng(1)
    color = np.concatenate([_shaded(RED, 2000, rng, 0.75), _shaded(GRAY, 1000, rng, 0.75)])
    maps = _maps(color)
    before = maps.values().numpy().copy()
    moved = gather_colors(maps, torch.ones(len(color)), 0.1)
    after = maps.values().numpy()
    assert 0.02 < moved < 0.2
    spread = [np.log(part).std(axis=0).max() for part in (before[:2000, :3], after[:2000, :3], after[2000:, :3])]
    assert spread[0] > 0.08
    assert max(spread[1:]) < 0.01
    level = [np.log(part[:, :3] + LOG_FLOOR).mean(axis=0) for part in (before, after)]
    np.testing.assert_allclose(level[0], level[1], atol=1e-4)
    assert np.array_equal(before[:, 3:], after[:, 3:])


def test_metal_and_paint_of_one_colour_gather_apart():
    """The gray of a metal is no mode of a paint that is a little darker."""
    rng = np.random.default_rng(2)
    metal, paint = np.tile(GRAY, (3000, 1)), np.tile(0.92 * GRAY, (500, 1))
    color = np.concatenate([metal, paint]) * np.exp(rng.normal(0, 0.01, (3500, 3)))
    together, apart = _maps(color), _maps(color, np.repeat([0.97, 0.03], [3000, 500]))
    for maps in (together, apart):
        gather_colors(maps, torch.ones(3500), 0.1)
    ratio = [float((m.values()[3000:, :3].mean(0) / m.values()[:3000, :3].mean(0)).mean()) for m in (together, apart)]
    assert ratio == [pytest.approx(1, abs=0.02), pytest.approx(0.92, abs=0.02)]


def test_metal_gathers_wider_than_paint():
    """Two tones a third apart are two paints, and of a metal one, where it is asked to gather three times as wide."""
    rng = np.random.default_rng(3)
    tones = np.repeat([1.0, 0.74], 2000)[:, None] * GRAY * np.exp(rng.normal(0, 0.02, (4000, 3)))
    metallic = np.repeat([0.97, 0.03], 4000)
    apart = []
    for wider in (1.0, 3.0):
        maps = _maps(np.concatenate([tones, tones]), metallic)
        gather_colors(maps, torch.ones(8000), 0.1, wider)
        logs = np.log(maps.values()[:, :3].numpy()).reshape(2, 2, 2000, 3).mean(axis=(2, 3))
        apart.append(logs[:, 0] - logs[:, 1])
    np.testing.assert_allclose(apart[0], 0.3, atol=0.04)
    np.testing.assert_allclose(apart[1], [0, 0.3], atol=0.04)


def test_texels_that_no_pixel_sees_follow_and_do_not_lead():
    color = np.concatenate([np.tile(RED, (10, 1)), np.tile(1.1 * RED, (1000, 1))])
    maps = _maps(color)
    gather_colors(maps, torch.from_numpy(np.repeat([1.0, 0.0], [10, 1000])), 0.1)
    np.testing.assert_allclose(maps.values()[:, :3].numpy(), np.tile(RED, (1010, 1)), rtol=0.03)
    untouched = _maps(color)
    before = untouched.parameter.clone()
    assert gather_colors(untouched, torch.zeros(1010), 0.1) == 0
    assert torch.equal(untouched.parameter, before)


def test_when_colours_gather_and_the_light_follows():
    """As long as steps are left that bring paint back: the quickstart's 800 have three times, 150 two."""
    ours = SETTINGS.replaced(material_rate=0.3, rates_for=400)
    for iterations, shares in ((4000, 3), (800, 3), (600, 3), (150, 2), (20, 0)):
        settings = ours.replaced(iterations=iterations)
        steps = [step for step in range(iterations) if gathering(settings, step)]
        assert steps == [round(share * iterations) for share in WHEN[:shares]]
        alone = [step for step in range(iterations) if light_follows(settings, step)]
        assert alone == [step + since for step in steps for since in range(iterations // 10)]
    for other in (ours.replaced(palette_width=0), ours.replaced(keep_light=True)):
        assert not any(gathering(other, step) or light_follows(other, step) for step in range(200))


@pytest.mark.parametrize(("metal", "shares"), [({}, WHEN[1:]), ({"metal_share": 0}, WHEN), ({"metallic": False}, WHEN)])
def test_colours_gather_once_texels_have_agreed_on_metal(metal, shares):
    """What is half a metal half way is of no paint."""
    settings = SETTINGS.replaced(**{"metallic": True, "metal_share": 0.25, "iterations": 800} | metal)
    assert [step for step in range(800) if gathering(settings, step)] == [round(800 * share) for share in shares]


@pytest.mark.thorough
def test_a_fit_takes_shade_for_light(true_asset, cameras, carrier, transport):
    """A ball and a floor of one paint each: base colour ends nearer to the truth, at an image term that few steps
    have brought back."""
    intrinsics, poses = cameras
    u = np.broadcast_to((np.arange(64) + 0.5) / 64, (64, 64))
    true = dataclasses.replace(
        true_asset, base_color=np.where((u > 0.64)[..., None], GRAY, RED).astype(np.float32),
        roughness=np.full((64, 64), 0.5, np.float32),
    )  # fmt: skip
    shown = render_views(true, intrinsics, poses, SIZE, SIZE, transport=render_transport(true, 2, 256, 4000))
    views = Views(
        names=tuple(f"v{k}" for k in range(8)), images=shown.images[:8], alpha=shown.alpha[:8],
        intrinsics=intrinsics[:8], camera_to_world=poses[:8], split="train", clipped=False,
    )  # fmt: skip
    wrong, said = {}, []
    for width in (0.0, 0.1):
        asset, curves = fit(carrier, views, transport, SETTINGS.replaced(palette_width=width), seed=1, log=said.append)
        wanted = np.where((np.arange(32) + 0.5 > 0.64 * 32)[None, :, None], GRAY, RED)
        ratio = np.log(asset.base_color / wanted)[asset.seen]
        wrong[width] = (np.abs(ratio - np.median(ratio, axis=0)).mean(), np.mean(curves["image"][-5:]))
    assert len([line for line in said if "gather" in line]) == 2
    assert wrong[0.1][0] < 0.9 * wrong[0.0][0], wrong
    assert wrong[0.1][1] < 1.3 * wrong[0.0][1], wrong
