"""The probe on tiny scenes whose needs are known."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.shading import envmap
from exmesh_graph.shading.suns import find_suns
from exmesh_graph.shading.transport import trace_transport, with_bounces
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.probe import metal, scene, sharp, short
from exmesh_graph.stage2.probe.light import sampling_gain
from exmesh_graph.stage2.probe.scene import decision_rows, probe_scene
from exmesh_graph.stage2.probe.short import ShortFit, sample_views
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings
from exmesh_graph.stage2.start_light import KeyLight
from tests.stage2 import probe_scenes
from tests.stage2.probe_scenes import asset, ball, box, cameras, carrier_of, glazed_ball, photographed, plaster_die

pytestmark = pytest.mark.thorough  # all of them, for what they share costs most

QUICK = DecompositionSettings(
    texture_size=48,
    environment_height=16,
    iterations=120,
    material_rate=0.2,
    environment_rate=0.4,
    ssim_weight=0.0,
    material_weight=0.01,
    environment_weight=0.002,
    indirect_ramp=10,
    corrections=1,
    correction_samples=8,
)


@pytest.fixture(scope="module", autouse=True)
def small():
    """The scenes are a few thousand pixels: fewer steps, surface points and rows of the sky do."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene, "BASE_STEPS", 80)
        patch.setattr(scene, "STEPS", 30)
        patch.setattr(metal, "THOROUGH", (24, 12, 240))
        patch.setattr(metal, "QUICK", (12, 4, 100))
        patch.setattr(scene, "LONG_STEPS", 160)
        patch.setattr(scene, "SKIES", (32,))
        patch.setattr(short, "TRANSPORT", short.TRANSPORT.replaced(points=300))
        patch.setattr(short, "SHORT", short.SHORT.replaced(environment_height=16))
        yield


@pytest.fixture(scope="module")
def matte(small):
    truth = asset(ball())
    return truth, photographed(truth)


@pytest.fixture(scope="module")
def hollow(small):
    truth = asset(box(6))
    return truth, photographed(truth, above=True)


@pytest.fixture(scope="module")
def matte_probe(matte):
    return probe_scene(carrier_of(matte[0]), matte[1])


@pytest.fixture(scope="module")
def hollow_probe(hollow):
    return probe_scene(carrier_of(hollow[0]), hollow[1])


def _value(probed, name):
    return probed.needs.decisions[name].value


def _held_out(truth, views, bounces, test):
    """PSNR (display) of a new view after a fit with so many interreflections."""
    carrier = carrier_of(truth)
    light = trace_transport(carrier.vertices, carrier.faces, 128, 1)
    light = with_bounces(light, bounces) if bounces else light
    made, _ = fit(carrier, views, light, QUICK, start=neutral_asset(carrier, StartSettings(base_color="gray")))
    shown = render_views(
        made, *test[0], probe_scenes.SIZE, probe_scenes.SIZE, transport=render_transport(made, bounces, 128, 800)
    )
    wrong = np.clip(shown.images, 0, 1) ** (1 / 2.2) - np.clip(test[1].images, 0, 1) ** (1 / 2.2)
    return float(-10 * np.log10(np.mean(wrong**2)))


def _new_views(truth, above):
    intrinsics, poses = cameras(5, above=above)
    middle = intrinsics[1:4], poses[1:4]
    light = render_transport(truth, 3, directions=256, points=1500)
    return middle, render_views(truth, *middle, probe_scenes.SIZE, probe_scenes.SIZE, transport=light)


def test_a_convex_object_needs_no_indirect_light_and_loses_nothing(matte, matte_probe):
    assert _value(matte_probe, "bounces") == 0
    test = _new_views(matte[0], above=False)
    assert abs(_held_out(*matte, 0, test) - _held_out(*matte, 1, test)) < 0.05


@pytest.mark.slow
def test_a_hollow_object_keeps_it_and_it_pays(hollow, hollow_probe):
    decision = hollow_probe.needs.decisions["bounces"]
    assert decision.value >= 1
    assert decision.gain > 1
    assert decision.evidence["concavity"] > 0.2
    assert decision.evidence["share_of_light"] > 0.05
    test = _new_views(hollow[0], above=True)
    assert _held_out(*hollow, decision.value, test) > _held_out(*hollow, 0, test) + 0.1


def test_light_that_stands_still_is_left_to_stand(matte_probe, hollow_probe):
    for probed in (matte_probe, hollow_probe):
        decision = probed.needs.decisions["light_moves"]
        assert decision.value is False
        assert {"still", "turntable", "camera"} <= set(decision.evidence)


def test_light_that_turns_with_a_turntable_is_found_to(matte):
    moving = dataclasses.replace(matte[0], light_axis=np.array([0, 1, 0], np.float32))
    needs = probe_scene(carrier_of(moving), photographed(moving), thorough=False).needs
    decision = needs.decisions["light_moves"]
    assert decision.value == "turntable"
    assert decision.gain > 3
    assert decision.evidence["turntable"] < 0.5 * decision.evidence["still"]
    assert needs.decisions["key_light"].value is False


def test_many_colours_move_with_the_light_from_the_first_step(matte_probe):
    decision = matte_probe.needs.decisions["light_first"]
    assert decision.value == 0
    assert set(decision.evidence) == {"image_ratio", "tint_ratio"}


def test_a_probe_that_is_not_thorough_leaves_the_light_out(matte, matte_probe):
    quick = probe_scene(carrier_of(matte[0]), matte[1], thorough=False).needs
    assert "thorough" in quick.decisions["light_first"].reason
    assert quick.decisions["light_first"].value == 0
    assert quick.decisions["metallic"].value is False
    asked_less = ("light_first", "metallic")
    rest = {name: decision for name, decision in matte_probe.needs.decisions.items() if name not in asked_less}
    assert {name: quick.decisions[name] for name in rest} == rest


def test_metal_turns_metallic_on_and_matte_does_not(matte_probe, hollow_probe):
    steel = asset(ball(), metallic=1.0, roughness=0.35)
    found = probe_scene(carrier_of(steel), photographed(steel)).needs.decisions["metallic"]
    assert found.value is True
    assert found.gain > 0.5
    assert _value(matte_probe, "metallic") is False
    assert _value(hollow_probe, "metallic") is False


def test_a_band_of_steel_on_paint_is_found():
    """Of which all held-out pixels together tell little."""
    painted = asset(ball(), metallic=0.0, roughness=0.35)
    band = np.zeros_like(painted.metallic)
    band[26:33] = 1
    color = np.where(band[..., None] > 0, np.float32([0.6, 0.58, 0.55]), painted.base_color)
    truth = dataclasses.replace(painted, metallic=band, base_color=color)
    found = probe_scene(carrier_of(truth), photographed(truth)).needs.decisions["metallic"]
    assert found.value is True, found.reason
    assert found.evidence["share"] < 0.35
    assert found.gain > found.evidence["gain_on_all"]


def test_gloss_that_no_coat_explains_is_not_taken_for_metal():
    """As of rubber under another BRDF: every texel gains by being a quarter of a metal, which none is."""
    tinted = asset(ball(), metallic=0.25, roughness=0.3)
    found = probe_scene(carrier_of(tinted), photographed(tinted), thorough=False).needs.decisions["metallic"]
    assert found.value is False, found.reason


def test_dark_glaze_starts_smooth_and_matte_does_not(matte_probe, hollow_probe):
    """Windows in a dark room, mirrored by a dark ball: from a rough start they are lost in a smooth sky."""
    glaze = glazed_ball()
    found = probe_scene(carrier_of(glaze), photographed(glaze)).needs.decisions["roughness"]
    assert found.value == sharp.SHARP
    assert found.gain > sharp.LEAST
    assert [_value(probe, "roughness") for probe in (matte_probe, hollow_probe)] == [sharp.NEUTRAL] * 2


def test_one_plaster_stays_one_where_light_moves_first():
    """Each wall of a die has one normal, so that its pictures do not part paint from light."""
    truth = plaster_die()
    carrier, views = carrier_of(truth), photographed(truth)
    light = trace_transport(carrier.vertices, carrier.faces, 128, 1)
    start = neutral_asset(carrier, StartSettings(base_color="gray"))
    spread = []
    for share in (0.0, scene.LIGHT_FIRST):
        made, _ = fit(carrier, views, light, QUICK.replaced(light_first=share), start=start)
        color = made.base_color[made.seen]
        spread.append(np.log(color[:, 0] / color[:, 2]).std())
    assert spread[1] < 0.7 * spread[0]


@pytest.mark.slow
def test_noise_and_blank_pictures_do_not_switch_everything_on(matte, hollow):
    rng = np.random.default_rng(5)
    noise = [rng.random(views.images.shape) * views.alpha[..., None] for _, views in (matte, hollow)]
    blank = np.repeat(0.4 * matte[1].alpha[..., None], 3, axis=-1)
    for (truth, views), images in ((matte, noise[0]), (matte, blank), (hollow, noise[1])):
        found = probe_scene(carrier_of(truth), dataclasses.replace(views, images=images.astype(np.float32))).needs
        assert found.decisions["metallic"].value is False
        assert found.decisions["environment_height"].value == 16
        if truth is matte[0]:
            assert found.decisions["bounces"].value == 0
        else:  # the walls do light one another; against noise it counts for little
            assert found.decisions["bounces"].gain < 1


def test_samples_follow_lobes_where_they_are_sharp(matte):
    """A polished dark ball: where its lobes point decides. Rough white chalk: the light does."""
    fits = ShortFit(carrier_of(matte[0]), sample_views(matte[1]), 32)
    with torch.no_grad():
        fits.model.maps.parameter[:, :3] = -3.0
        fits.model.maps.parameter[:, 3] = -4.0
        polished = sampling_gain(fits, "mis", 1)
        fits.model.maps.parameter[:, :4] = 3.0
        fits.model.environment.copy_(
            envmap.parameter_of(torch.from_numpy(envmap.resample(matte[0].environment, 16, 32)))
        )
        chalk = sampling_gain(fits, "mis", 1)
    assert polished.gain > 2 * polished.error > 0
    assert polished.gain > chalk.gain + 1
    assert sampling_gain(fits, "environment", 1).gain == 0


def test_fits_for_metal_go_the_way_of_whole_ones(matte, monkeypatch):
    """Colours gather and the light follows when they do in a fit, texels agree on metal half way: no step is lost."""
    fits = ShortFit(carrier_of(matte[0]), sample_views(matte[1]), 32)
    told = []
    run = ShortFit.run
    monkeypatch.setattr(short.palette, "gather_colors", lambda maps, seen, width: told.append(("gather", width)))
    monkeypatch.setattr(short.metal, "agree_on_metal", lambda maps, seen, share: told.append(("agree", share)))

    def ran(self, steps, rate=1.0, last=1.0, draw=0, light_first=0.0):
        told.append((steps, round(light_first * steps), rate, rate * last))
        return run(self, steps, rate, last, draw, light_first)

    monkeypatch.setattr(ShortFit, "run", ran)
    fits.restarted(short.Part(metal.TOGETHER)).agreeing(50)
    gathered, rates = ("gather", short.WIDTH), [short.LAST_RATE**share for share in (0, 0.5, 0.6, 0.8, 1)]
    assert [row[:2] for row in told] == [
        (25, 0), ("agree", 0.25), (5, 0), gathered, (10, 5), gathered, (10, 5)
    ]  # fmt: skip
    stretches = [row[2:] for row in told if len(row) == 4]
    np.testing.assert_allclose(stretches, list(pairwise(rates)))


def test_fits_under_a_sun_keep_it_apart_whatever_they_model(hollow):
    """Forks of another sky find it anew; with other bounces its light makes as many."""
    sun = KeyLight(np.array([0.48, 0.6, 0.64]), 5.0)
    fits = ShortFit(carrier_of(hollow[0]), sample_views(hollow[1]), 32, key=sun)
    finer = fits.forked(short.Part({"environment_height": 64}))
    bounced = fits.forked(short.Part(bounces=1))
    afresh = bounced.restarted(short.Part(roughness=0.2))
    for fit_, bounces in ((fits, 0), (finer, 0), (bounced, 1), (afresh, 1)):
        light, buffer = fit_.light, fit_.fitted[0]
        assert len(light.suns.suns) == 1
        assert light.suns.operators.bounces == light.operators.bounces == bounces
        assert light.suns.views[buffer.number].max() > 0
        assert find_suns(torch.from_numpy(fit_.sky()), 64)
        assert torch.isfinite(fit_.model.shade(buffer, fit_.model.prepare(1.0, 0))[0]).all()
    walls = [fit_.model.prepare(1.0, 0).light.irradiance.mean() for fit_ in (fits, bounced)]
    assert walls[1] > 1.02 * walls[0]


@pytest.mark.thorough
def test_the_probe_starts_its_fits_with_the_sun_that_it_found(matte, monkeypatch):
    told = []
    made = ShortFit.__init__
    monkeypatch.setattr(ShortFit, "__init__", lambda self, *a, **k: told.append(a[5]) or made(self, *a, **k))
    monkeypatch.setattr(scene, "MOVING_HINT", 0.0)  # no fits under a light that moves
    for gain, taken in ((0.05, True), (0.02, False)):
        found = KeyLight(np.array([0.0, 0.8, 0.6]), 3.0, 0, gain)
        monkeypatch.setattr(scene, "find_key_light", lambda carrier, light, found=found: found)
        needs = probe_scene(carrier_of(matte[0]), matte[1], thorough=False).needs
        assert needs.decisions["key_light"].value is taken
        assert needs.decisions["key_light"].evidence["share_explained"] == gain
        assert len(told) >= 2
        assert all(key is (found if taken else None) for key in told)
        told.clear()


def test_one_view_is_enough_to_answer(matte):
    views = photographed(matte[0], 1)
    found = probe_scene(carrier_of(matte[0]), views).needs
    assert found.geometry["views"] == 2  # its pixels, in two parts
    assert [found.decisions[name].value for name in ("bounces", "metallic")] == [0, False]
    assert found.decisions["metallic"].evidence["share"] < metal.SHARE


def test_equal_scenes_give_equal_bytes(matte, matte_probe, tmp_path):
    again = probe_scene(carrier_of(matte[0]), matte[1])
    for name, probed in (("a", matte_probe), ("b", again)):
        (tmp_path / name).mkdir()
        probed.needs.save(tmp_path / name)
    assert (tmp_path / "a/needs.json").read_bytes() == (tmp_path / "b/needs.json").read_bytes()


def test_every_decision_has_its_numbers_and_a_sentence(hollow_probe):
    rows = decision_rows(hollow_probe)["decisions"]
    assert {row["name"] for row in rows} >= {
        "bounces",
        "key_light",
        "metallic",
        "roughness",
        "light_first",
        "environment_height",
        "texture_size",
    }
    for row in rows:
        assert row["reason"].endswith(".")
        assert row["cost"] >= 1
        assert (
            row["name"] in ("texture_size", "technique", "roughness", "light_first", "key_light", "light_moves")
            or row["seconds_ratio"] > 0
        )
    assert 0 < hollow_probe.needs.geometry["blocked"] < 1


def test_pictures_that_do_not_show_the_mesh(matte):
    with pytest.raises(DataError, match="pixel sees the mesh"):
        probe_scene(carrier_of(matte[0]), dataclasses.replace(matte[1], alpha=np.zeros_like(matte[1].alpha)))
