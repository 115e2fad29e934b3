"""The published albedo rules: each forgives what it says and nothing else."""

import numpy as np
import pytest

from exmesh_graph.evaluate.metrics.image import psnr
from exmesh_graph.evaluate.metrics.material import R3DG_SCALES, SCALE_RULES, albedo_psnr, albedo_scale, albedo_table
from exmesh_graph.io.color import linear_to_srgb, srgb_to_linear

FACTOR = np.array([2.0, 0.5, 1.0])


@pytest.fixture(scope="module")
def maps():
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.1, 0.45, (24, 10, 12, 3))
    alpha = np.zeros((24, 10, 12))
    alpha[:, 2:8, 3:9] = 1
    alpha[:, 2, 3:9] = 0.5
    return truth * (alpha > 0)[..., None], alpha


def test_every_rule_is_said_and_tabled(maps):
    table = albedo_table(maps[0] / FACTOR, *maps, scene="hotdog")
    assert set(table) == {*SCALE_RULES, "r3dg"}
    assert table["r3dg"]["scale"] == list(R3DG_SCALES["hotdog"])
    assert set(albedo_table(*([maps[0]] * 2), maps[1], scene="spot")) == set(SCALE_RULES)
    for row in table.values():
        assert set(row) == {"scale", "linear", "srgb", "linear_masked", "srgb_masked"}
        assert row["linear_masked"] <= row["linear"]  # background is right for everybody


def test_a_scale_per_channel_is_forgiven_and_a_permutation_is_not(maps):
    truth, alpha = maps
    permuted = albedo_table(truth[..., [2, 0, 1]], truth, alpha)
    scaled = albedo_table(truth / FACTOR, truth, alpha)
    for rule in ("median", "mean", "least_squares", "sampled_median"):
        np.testing.assert_allclose(scaled[rule]["scale"], FACTOR, rtol=1e-9)
        assert scaled[rule]["linear"] > 99
        assert permuted[rule]["linear"] < 30
    for rule in ("median_red", "sampled_red"):  # one factor: right for red alone
        np.testing.assert_allclose(scaled[rule]["scale"], 2.0)
        assert scaled[rule]["linear"] < 30
    assert scaled["none"]["linear"] < 25


def test_the_rules_differ_where_a_part_of_the_object_is_wrong(maps):
    truth, alpha = maps
    wrong = truth.copy()
    wrong[:, :4] *= 0.25  # a dark third: it does not move a median
    scales = {rule: albedo_scale(wrong, truth, alpha, rule) for rule in SCALE_RULES}
    np.testing.assert_allclose(scales["median"], 1)
    np.testing.assert_allclose(scales["mean"], 2)  # a third of the ratios is 4
    assert (np.abs(scales["least_squares"] - 1) > 0.02).all()
    assert len({tuple(np.round(scale, 6)) for scale in scales.values()}) >= 3


def test_only_covered_pixels_and_linear_values_fit_the_scale(maps):
    truth, alpha = maps
    ground = np.where((alpha > 0)[..., None], truth / FACTOR, 0.7)
    np.testing.assert_allclose(albedo_scale(ground, truth, alpha), FACTOR)
    assert np.abs(albedo_scale(ground, truth + 0.3, np.ones_like(alpha)) - FACTOR).max() > 0.1  # mask forgotten
    encoded = albedo_scale(linear_to_srgb(truth / FACTOR), linear_to_srgb(truth), alpha)
    assert np.abs(encoded - FACTOR).max() > 0.3  # gamma left in


def test_sampled_rules_look_at_20_views(maps):
    truth, alpha = maps
    wrong = truth.copy()
    left_out = sorted(set(range(24)) - {int((k + 0.5) * 24 / 20) for k in range(20)})
    wrong[left_out] *= 0.01
    np.testing.assert_allclose(albedo_scale(wrong, truth, alpha, "sampled_median"), 1)
    assert albedo_scale(wrong, truth, alpha, "mean")[0] > 2


def test_srgb_and_linear_and_ground_are_other_figures(maps):
    truth, alpha = maps
    off = truth * 1.1
    linear, srgb = (albedo_psnr(off[0], truth[0], alpha[0], np.ones(3), srgb=s) for s in (False, True))
    assert abs(linear - srgb) > 1
    black = psnr(off[0] * alpha[0][..., None], truth[0] * alpha[0][..., None])
    assert linear == pytest.approx(black)
    twice = albedo_psnr(srgb_to_linear(off[0]), truth[0], alpha[0], np.ones(3))
    assert twice < linear - 3


def test_a_scale_fitted_on_the_relit_picture_hides_a_wrong_light(maps):
    """Relit pictures get the albedo's factor; one fitted on themselves would make a wrong light score as right."""
    truth, alpha = maps
    light, wrong_light = np.array([1.0, 1.0, 1.0]), np.array([1.0, 0.7, 0.4])
    estimate = truth / FACTOR
    relit_truth, relit = truth * light, estimate * wrong_light
    scale = albedo_scale(estimate, truth, alpha)
    honest = psnr(relit[0] * scale, relit_truth[0])
    fitted = psnr(relit[0] * albedo_scale(relit, relit_truth, alpha), relit_truth[0])
    assert fitted > 99
    assert honest < 30
