"""The albedo's scale and material errors, on constructed maps."""

import numpy as np
import pytest

from exmesh_graph.errors import NumericsError
from exmesh_graph.evaluate.metrics.material import albedo_psnr, albedo_scale, roughness_mse
from exmesh_graph.io.color import linear_to_srgb


@pytest.fixture
def maps():
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.1, 0.6, (4, 16, 16, 3))
    alpha = np.zeros((4, 16, 16))
    alpha[:, 3:12, 2:13] = 1
    alpha[:, 12, 2:13] = 0.5
    return truth, alpha


def test_a_wrong_exposure_is_taken_out_channel_by_channel(maps):
    truth, alpha = maps
    factor = np.array([0.5, 0.8, 2.0])
    scale = albedo_scale(truth * factor, truth, alpha)
    assert scale == pytest.approx(1 / factor)
    assert albedo_psnr((truth * factor)[0], truth[0], alpha[0], scale) == 100


def test_the_median_shrugs_off_a_third_of_wrong_pixels(maps):
    truth, alpha = maps
    estimate = truth * 0.5
    estimate[:1] *= 30
    assert albedo_scale(estimate, truth, alpha) == pytest.approx([2, 2, 2])


def test_background_plays_no_part(maps):
    truth, alpha = maps
    estimate = np.where(alpha[..., None] > 0, truth / 3, 17.0)
    scale = albedo_scale(estimate, truth, alpha)
    assert scale == pytest.approx([3, 3, 3])
    assert albedo_psnr(estimate[0], truth[0], alpha[0], scale) == 100


def test_zero_estimates_are_clamped_as_published(maps):
    truth, alpha = maps
    assert albedo_scale(truth * 0, truth, alpha) == pytest.approx(np.median(truth[alpha > 0], axis=0) / 1e-6)


def test_known_error_and_its_variants(maps):
    truth, alpha = maps
    estimate, one = truth + 0.1, np.ones(3)
    assert albedo_psnr(estimate[0], truth[0], np.ones((16, 16)), one) == pytest.approx(20)
    full, masked = (albedo_psnr(estimate[0], truth[0], alpha[0], one, masked=m) for m in (False, True))
    share = (alpha[0] > 0).mean()
    assert full - masked == pytest.approx(-10 * np.log10(share))
    srgb = albedo_psnr(estimate[0], truth[0], np.ones((16, 16)), one, srgb=True)
    expected = ((linear_to_srgb(estimate[0]) - linear_to_srgb(truth[0])) ** 2).mean()
    assert srgb == pytest.approx(-10 * np.log10(expected))


def test_mistakes_change_the_figures(maps):
    truth, alpha = maps
    for mistake in (truth[..., ::-1], linear_to_srgb(truth)):
        scale = albedo_scale(mistake, truth, alpha)
        assert albedo_psnr(mistake[0], truth[0], alpha[0], scale) < 35


def test_roughness(maps):
    _, alpha = maps
    truth = np.full((16, 16), 0.5)
    assert roughness_mse(truth + 0.1, truth, np.ones((16, 16))) == pytest.approx(0.01)
    assert roughness_mse(truth + 0.1, truth, alpha[0]) == pytest.approx(0.01 * (alpha[0] ** 2).mean())
    assert roughness_mse(truth + 0.1, truth, (alpha[0] == 1) * 1.0, masked=True) == pytest.approx(0.01)


def test_nothing_covered_and_nan(maps):
    truth, alpha = maps
    with pytest.raises(NumericsError, match="no test pixel"):
        albedo_scale(truth, truth, alpha * 0)
    with pytest.raises(NumericsError, match="scale is"):
        albedo_scale(truth * np.nan, truth, alpha)
