"""Measures and statistics of the probe: closed forms, brute force, and decisions at their edges."""

import dataclasses
import math

import numpy as np
import pytest

from exmesh_graph.shading import envmap
from exmesh_graph.shading.transport import trace_transport
from exmesh_graph.stage2.probe import metal, sharp
from exmesh_graph.stage2.probe.decide import (
    decide_bounces,
    decide_environment,
    decide_light_first,
    decide_part,
    pays,
    required,
    with_noise,
)
from exmesh_graph.stage2.probe.gain import FLOOR, Gain, Work, paired_gain, tiles_of
from exmesh_graph.stage2.probe.geometry import ShapeMeasures, measure_shape, texel_budget
from exmesh_graph.stage2.probe.light import Baked, unnatural
from exmesh_graph.stage2.probe.metal import Comparison, decide_metal
from exmesh_graph.stage2.probe.short import sample_views
from exmesh_graph.types import Views
from tests.stage2 import probe_scenes

CONCAVE = ShapeMeasures(0.4, 0.3, 0.6)
SURE, NOTHING = Gain(1.0, 0.1), Gain(0.0, 0.01)


def _shape(vertices, faces, directions=1024):
    return measure_shape(trace_transport(vertices, faces, directions, 2), vertices, faces)


def test_a_convex_mesh_sees_only_the_sky():
    vertices, faces, _ = probe_scenes.ball(10)
    found = _shape(vertices, faces)
    assert found.concavity == 0
    assert found.occluded == 0
    assert found.blocked < 0.01  # rays below a carrying face's own horizon


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_an_open_box_sees_itself_as_the_form_factors_say(scale):
    """The open side of a cube sees its five walls alone, so 1/5 of what the walls send leaves: reciprocity gives the
    mean form factor of the walls with one another, 4/5."""
    vertices, faces, _ = probe_scenes.box(8)
    found = _shape(vertices * scale, faces)
    assert found.concavity == pytest.approx(0.8, abs=0.01)
    assert found.blocked == pytest.approx(found.concavity, abs=1e-5)
    assert found.occluded > 0.95


def test_pixels_and_texels_on_a_square():
    """A square metre in a full atlas, seen by pixels of 1 cm: 100 texels a side if there are pixels enough."""
    from exmesh_graph.types import Carrier

    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    square = Carrier(corners, faces, corners[:, :2], faces, np.zeros((8, 8, 3), np.float32))
    budget = texel_budget(square, np.full(500, 1e-4), 1e6)
    assert budget.texture_size == 128  # the next multiple of 64
    assert budget.pixel_side == pytest.approx(0.01)
    assert budget.pixels_per_texel == pytest.approx(1e6 / 128**2)
    assert texel_budget(square, np.full(500, 1e-4), 4 * 50**2).texture_size == 64  # too few pixels for finer ones
    assert texel_budget(square, np.full(500, 1e-12), 1e12).texture_size == 8192


def test_gain_and_its_error_against_simulation():
    """The jackknife's error is the spread of the gain over repeated draws of the clusters."""
    rng = np.random.default_rng(0)
    pixels = np.full(48, 100.0)

    def draw():
        before = rng.gamma(2.0, 0.5, 48)
        return before, before * rng.normal(0.8, 0.1, 48)

    found = [paired_gain(*draw(), pixels) for _ in range(300)]
    spread = np.std([g.gain for g in found])
    assert np.mean([g.error for g in found]) == pytest.approx(spread, rel=0.15)
    assert np.mean([g.gain for g in found]) == pytest.approx(-10 * math.log10(0.8), abs=0.05)


def test_gain_counts_pairs_not_levels_and_has_a_floor():
    pixels = np.full(8, 10.0)
    level = np.array([1, 50, 3, 80, 2, 60, 1, 9.0])
    steady = paired_gain(level, level * 0.9, pixels)
    assert steady.error < 0.01  # the same share everywhere, however the clusters differ
    assert steady.gain == pytest.approx(0.4576, abs=1e-3)
    tiny = paired_gain(np.full(8, 1e-9), np.full(8, 1e-12), pixels)
    assert abs(tiny.gain) < 0.01
    assert pytest.approx(1) == FLOOR * 1e5
    assert paired_gain(level[:1], level[:1] / 2, pixels[:1]).error == math.inf
    assert paired_gain(level, level / 2, np.zeros(8)) == Gain(0.0, math.inf)


def test_tiles():
    assert tiles_of(np.array([0, 9, 50, 99]), 10, 10, 2).tolist() == [0, 1, 2, 3]


def test_a_gain_must_exceed_noise_and_cost():
    assert required(1.0) == 0.05
    assert required(2.0) == 0.25
    assert pays(Gain(0.3, 0.1), 1.0)
    assert not pays(Gain(0.3, 0.16), 1.0)
    assert not pays(Gain(0.3, 0.0), 4.0)
    assert not pays(Gain(0.3, math.inf), 1.0)
    assert with_noise(Gain(1.0, 0.3), Gain(-0.4, 9.0)) == Gain(1.0, 0.5)
    assert "within its noise" in decide_part([Gain(0.3, 0.3)], 1.0, "It").reason
    assert "could not be judged" in decide_part([Gain(0.0, math.inf)], 1.0, "It").reason
    assert decide_part([Gain(0.0, math.inf)], 1.0, "It").error is None


def test_a_part_must_pay_under_every_split_and_bring_its_least():
    clear, slight = Gain(1.2, 0.2), Gain(0.11, 0.01)
    assert decide_part([clear, clear], 1.02, "Metal", least=0.3).value is True
    assert decide_part([slight], 1.02, "Metal").value is True  # beyond its noise and its cost
    assert decide_part([slight], 1.02, "Metal", least=0.3).value is False
    for gains in ([clear, slight], [slight, clear], [clear, Gain(0.5, 0.4)]):
        found = decide_part(gains, 1.02, "Metal", least=0.3)
        assert found.value is False
        assert found.gain == min(gain.gain for gain in gains)
        assert found.evidence["gain_of_split_2"] == gains[1].gain
        assert "2 splits" in found.reason


def test_a_start_is_sharp_where_both_splits_end_apart_and_say_so_beyond_doubt():
    clear, slight = sharp.Comparison(Gain(3.0, 0.4), 0.2), sharp.Comparison(Gain(1.2, 0.2), 0.11)
    noisy, less = sharp.Comparison(Gain(2.0, 1.1), 0.2), sharp.Comparison(Gain(0.9, 0.1), 0.2)
    near, none = sharp.Comparison(Gain(3.0, 0.4), 0.09), sharp.Comparison(Gain(0.0, math.inf), 0.0)
    for found, value in (([clear, slight], 0.2), ([clear, noisy], 0.5), ([clear, less], 0.5), ([clear, near], 0.5),
                         ([clear], 0.5), ([none], 0.5)):  # fmt: skip
        decision = sharp.decide_sharp(found)
        assert decision.value == value
        assert decision.gain == min(one.gain.gain for one in found)
        assert decision.evidence["smoother"] == min(one.smoother for one in found)
        assert "roughness 0.2 in place of 0.5" in decision.reason


def test_whole_fits_are_made_only_where_the_quick_look_hints_and_the_first_split_tells(monkeypatch):
    clear, none = sharp.Comparison(Gain(3.0, 0.4), 0.2), sharp.Comparison(Gain(0.4, 0.1), 0.2)
    monkeypatch.setattr(sharp, "compared", lambda neutral, low: low)
    for looks, count in (([none, clear, clear], 1), ([clear, none, clear], 1), ([clear, clear, none], 2)):
        taken = iter(looks)
        found = sharp.find_sharp(lambda t=taken: (None, next(t)), [lambda t=taken: (None, next(t))] * 2)
        assert len(found) == count
        assert sharp.decide_sharp(found).value == sharp.NEUTRAL
    assert sharp.decide_sharp(sharp.find_sharp(lambda: (None, clear), [lambda: (None, clear)] * 2)).value == sharp.SHARP


def test_light_moves_first_where_pictures_are_as_good_and_light_is_more_natural():
    for term, tint, value in ((1.0, 0.6, 0.25), (0.9, 0.5, 0.25), (1.02, 0.5, 0.0), (0.95, 0.98, 0.0)):
        found = decide_light_first((0.01, 0.01 * term), (0.1, 0.1 * tint), 0.25)
        assert found.value == value
        assert found.evidence == pytest.approx({"image_ratio": term, "tint_ratio": tint})


def test_green_from_one_side_is_unnatural_and_a_tint_or_a_warm_sun_is_not():
    up = envmap.texel_directions(32, 64)[..., 1:2]
    side = np.clip(up, 0, 1)
    tinted = np.ones((32, 64, 1)) * [0.4, 1.0, 0.5] * (1 + side)
    assert unnatural(tinted) == pytest.approx(0, abs=1e-6)
    warm = 1 + side * [0.2, 0.0, -0.2]  # red up, blue down: along the curve of black bodies
    green = 1 + side * [0.0, 0.2, 0.0]
    assert unnatural(green) > 10 * unnatural(warm)
    assert unnatural(3 * green) == pytest.approx(unnatural(green))


@pytest.mark.parametrize("count", [3, 6, 16, 40])
def test_the_other_split_keeps_other_pixels_out(count):
    views = _views(count)
    first, second = (sample_views(views, other=other) for other in (False, True))
    if count < 6:
        out = [sample.views.alpha[sample.fitted :] > 0.5 for sample in (first, second)]
        assert not (out[0] & out[1]).any()
    else:
        names = [set(sample.views.names[sample.fitted :]) for sample in (first, second)]
        assert names[0]
        assert len(names[0]) == len(names[1])
        assert not names[0] & names[1]


def test_bounces_are_added_while_they_pay():
    def decided(*gains, held=NOTHING, cost=1.1):
        return decide_bounces([Baked(g, 0.1) for g in gains], [cost] * len(gains), held, CONCAVE)

    assert decided(SURE, SURE, NOTHING).value == 2
    assert decided(SURE, NOTHING, SURE).value == 1
    assert decided(NOTHING, SURE).value == 0
    assert decided(NOTHING, NOTHING, held=SURE).value == 1  # where the photographs themselves tell
    assert decided(SURE, cost=30.0).value == 0
    assert decided(Gain(2.56, 1.38)).value == 1  # it matters much, but only where surfaces see each other
    assert decided(Gain(1.2, 1.38)).value == 0
    assert decide_bounces([], [], NOTHING, ShapeMeasures(0.0, 0.0, 0.0)).value == 0


def test_skies_grow_while_they_pay():
    assert decide_environment([(64, NOTHING, 1.1)], 32).value == 32
    assert decide_environment([(64, SURE, 1.1), (128, NOTHING, 1.1)], 32).value == 64
    found = decide_environment([(64, SURE, 1.1), (128, SURE, 1.1)], 32)
    assert found.value == 128
    assert "128 rows" in found.reason


def test_work_grows_with_everything():
    base = Work(pixels=1e4, texels=1e5, points=1e4, directions=128, entries=1e5)
    for change in ({"channels": 5}, {"bounces": 1}, {"height": 128}, {"pixels": 2e4}):
        assert dataclasses.replace(base, **change).total() > base.total()


def _views(count, height=24, width=32):
    rng = np.random.default_rng(count)
    pose = np.repeat(np.eye(4)[None], count, 0)
    pose[:, 0, 3] = np.arange(count)
    alpha = np.ones((count, height, width), np.float32)
    matrix = np.array([[30.0, 0, width / 2], [0, 30.0, height / 2], [0, 0, 1]])
    images = rng.random((count, height, width, 3), np.float32)
    return Views(tuple(f"{k}" for k in range(count)), images, alpha, np.repeat(matrix[None], count, 0), pose, "train")


def test_some_views_are_fitted_and_others_kept_out():
    views = _views(40)
    found = sample_views(views, 9, 3, view_pixels=24 * 32 // 4)
    assert (found.fitted, len(found.views), found.factor) == (9, 12, 2)
    places = found.views.camera_to_world[:, 0, 3]
    assert len(set(places)) == 12
    assert {0, 39} <= set(places)
    assert np.ptp(places[9:]) > 20  # the held-out ones are spread
    chosen = int(places[4])
    block = views.images[chosen].reshape(12, 2, 16, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(found.views.images[4], block, atol=1e-6)
    np.testing.assert_allclose(found.views.intrinsics[4, 0], [15, 0, 8])
    again = sample_views(views, 9, 3, view_pixels=24 * 32 // 4)
    assert again.views.images.tobytes() == found.views.images.tobytes()


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_views_keep_lone_pixels_out(count):
    found = sample_views(_views(count), view_pixels=10**6)
    assert (found.fitted, len(found.views)) == (count, 2 * count)
    fitted, held = found.views.alpha[:count] > 0, found.views.alpha[count:] > 0
    assert not (fitted & held).any()
    assert (fitted | held).all()
    assert held.mean() == pytest.approx(0.2, abs=0.03)
    assert not (held[:, 1:] & held[:, :-1]).any()
    assert not (held[:, :, 1:] & held[:, :, :-1]).any()


def test_odd_sizes_are_cut_to_whole_blocks():
    found = sample_views(_views(8, 25, 33), view_pixels=25 * 33 // 4)
    assert (found.views.height, found.views.width) == (12, 16)


def _compared(gains, share, seed=0):
    """A comparison of 32 clusters of 100 pixels whose metal gains `gains[1]` dB on its `share`, the rest `gains[0]`."""
    rng = np.random.default_rng(seed)
    pixels = np.full(32, 100.0)
    paint, steel = pixels * (1 - share), pixels * share
    before = [0.01 * rng.uniform(0.8, 1.2, 32) * part for part in (paint, steel)]
    after = [
        values * 10 ** (-gain / 10) * rng.uniform(0.97, 1.03, 32) for values, gain in zip(before, gains, strict=True)
    ]
    whole = np.stack([sum(before), sum(after), pixels])
    return Comparison(share, whole, np.stack([before[1], after[1], steel]), 0.01)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (((0.0, 1.0), 0.08), ((0.0, 1.0), 0.08), True),  # a little metal, of which all pixels together tell little
        (((0.0, -1.0), 0.08), ((0.5, -1.0), 0.08), False),  # paint that is drawn worse as metal
        (((0.5, 0.2), 0.3), ((0.5, 0.2), 0.3), False),  # by less than metal brings
        (((-0.3, 1.0), 0.08), ((-0.3, 1.0), 0.08), False),  # and all the rest is drawn worse
    ],
)
def test_metal_is_judged_where_it_is(first, second, expected):
    found = decide_metal([_compared(*first, seed=1), _compared(*second, seed=2)], 1.05)
    assert found.value is expected, found.reason
    assert found.evidence["share"] == pytest.approx(min(first[1], second[1]))


@pytest.mark.parametrize(("gain", "splits"), [(1.0, 2), (-0.05, 2), (-1.0, 1)])
def test_a_second_split_is_asked_unless_metal_clearly_loses(monkeypatch, gain, splits):
    """What one split leaves open, within its noise, the other may tell."""
    asked = _asked(monkeypatch, together=_noisy(gain), alone=_noisy(gain))
    found = metal.find_metal(lambda other, fitted, held: (other, fitted, held), True, lambda: None)
    fitted, held, steps = metal.THOROUGH
    assert len(found) == splits
    together = [way for way in asked if way[-1] is metal.TOGETHER]
    assert together == [((other, fitted, held), steps, metal.TOGETHER) for other in (False, True)[:splits]]


@pytest.mark.parametrize(
    ("together", "alone", "expected"),
    [
        (0.05, 1.0, (4, 1.0, True)),  # white paint that agreed with steel hid what steel alone brings
        (0.05, -0.1, (4, 0.05, False)),  # neither finds any
        (1.0, -1.0, (2, 1.0, True)),  # found: no more is asked
        (-1.0, 1.0, (1, -1.0, False)),  # clearly none
    ],
)
def test_texels_for_themselves_are_asked_where_together_they_leave_it_open(monkeypatch, together, alone, expected):
    asked = _asked(monkeypatch, _noisy(together), _noisy(alone))
    found = metal.find_metal(lambda *split: split, True, lambda: None)
    decision = decide_metal(found, 1.05)
    assert (len(asked), decision.value) == (expected[0], expected[2])
    assert decision.gain == pytest.approx(expected[1], abs=0.1)


def _noisy(gain):
    """A comparison on whose tiles metal gains or loses, `gain` dB on the mean."""
    noisy = _compared((0.0, gain), 0.2)
    noisy.metal[1] *= np.where(np.arange(32) % 2, 1.15, 0.85)
    return noisy


def _asked(monkeypatch, together, alone):
    """What is asked of splits (start, steps, way), each of which answers as given."""
    asked = []

    class Split:
        def __init__(self, start, steps):
            self.told = start, steps

        def compared(self, way):
            asked.append((*self.told, way))
            return together if way is metal.TOGETHER else alone

    monkeypatch.setattr(metal, "Split", Split)
    return asked


def test_the_reason_says_where_each_texel_decided_for_itself():
    told = "as metal, each texel for itself, 30.0 %"
    found = [_compared((0.5, 1.0), 0.3, seed=k) for k in (1, 2)]
    assert told not in decide_metal(found, 1.05).reason
    assert told in decide_metal([dataclasses.replace(one, alone=True) for one in found], 1.05).reason


def test_one_split_alone_is_no_metal():
    found = decide_metal([_compared((0.5, -0.1), 0.3)], 1.05)
    assert found.value is False
    assert found.gain < 0 < found.evidence["gain_on_all"]


def test_hardly_a_metal_pixel_under_a_split_is_no_metal():
    found = decide_metal([_compared((0.5, 1.0), 0.08), Comparison(0.01, None, None, 0.01)], 1.05)
    assert found.value is False
    assert found.gain is None
    assert found.reason.startswith("1.0 % of the held-out pixels come out as metal, under 2 %")
