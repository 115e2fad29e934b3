"""Stanford-ORB's figures by hand on small pictures, its quirks, and mistakes that must show."""

import numpy as np
import pytest

from benchmarks.meshes import grid
from exmesh_graph.errors import NumericsError
from exmesh_graph.evaluate.metrics.lpips import Lpips
from exmesh_graph.evaluate.metrics.weights import expected_shapes
from exmesh_graph.evaluate.protocols.stanford_orb import (
    albedo_scores,
    depth_error,
    eroded,
    normal_error,
    shape_error,
    view_scores,
)
from exmesh_graph.io.color import linear_to_srgb

FACTORS = np.array([2.0, 3, 4])


@pytest.fixture(scope="module")
def picture():
    rng = np.random.default_rng(1)
    truth = rng.gamma(1.0, 0.3, (40, 48, 3))  # linear, a few values over 1
    mask = np.zeros((40, 48))
    mask[8:32, 10:40] = 1
    return truth, mask


def test_erosion_takes_two_pixels_and_none_at_the_pictures_border():
    mask = np.zeros((12, 12))
    mask[2:9, 4:] = 0.6
    inside = eroded(mask)
    assert inside[4:7, 6:].all()
    assert inside.sum() == 3 * 6


def test_a_factor_per_channel_is_forgiven_under_new_lights_and_not_in_novel_views(picture):
    truth, mask = picture
    relit, novel = (view_scores(truth * FACTORS, truth, mask, relit=flag) for flag in (True, False))
    assert relit["psnr_h"] == relit["psnr_l"] == 100
    assert relit["ssim"] == pytest.approx(1)
    assert novel["psnr_h"] < 15
    swapped = view_scores(truth[..., ::-1] * FACTORS, truth, mask, relit=True)
    assert swapped["psnr_h"] < 25
    assert albedo_scores(truth / FACTORS, np.clip(truth, 0, 1) * 0 + truth, mask)["psnr"] > 99


def test_both_psnrs_equal_the_formula(picture):
    truth, mask = picture
    image = truth * 1.2 + 0.02
    inside = np.zeros((40, 48, 1))
    inside[10:30, 12:38] = 1
    a, b = image * inside, truth * inside
    level = linear_to_srgb(np.clip(b, 0, 1)).mean() / np.clip(b, 0, 1).mean()
    high = -10 * np.log10(((np.clip(a * level, 0, 4) - np.clip(b * level, 0, 4)) ** 2).mean())
    low = -10 * np.log10(((linear_to_srgb(np.clip(a, 0, 1)) - linear_to_srgb(np.clip(b, 0, 1))) ** 2).mean())
    found = view_scores(image, truth, mask, relit=False)
    assert found["psnr_h"] == pytest.approx(high)
    assert found["psnr_l"] == pytest.approx(low)
    assert abs(high - low) > 3  # linear figures taken for encoded ones would show


def test_the_mean_is_over_the_whole_image(picture):
    """Quirk: the same error on the same object scores 6 dB more in a picture of four times the area."""
    truth, mask = picture
    small = view_scores(truth * 1.2, truth, mask, relit=False)["psnr_l"]
    wide = [np.pad(x, ((20, 20), (24, 24)) + ((0, 0),) * (x.ndim - 2)) for x in (truth * 1.2, truth, mask)]
    assert view_scores(*wide, relit=False)["psnr_l"] == pytest.approx(small + 10 * np.log10(4))


def test_no_figure_is_below_that_of_a_gray_silhouette(picture):
    truth, mask = picture
    inside = eroded(mask)[..., None]
    gray = -10 * np.log10(((0.5 * inside - linear_to_srgb(np.clip(truth * inside, 0, 1))) ** 2).mean())
    awful = view_scores(np.where(truth > 0.3, 0.0, 9.0), truth, mask, relit=False)
    assert awful["psnr_l"] == pytest.approx(gray)


def test_the_background_and_the_masks_rim_do_not_count_but_the_inside_does(picture):
    truth, mask = picture
    rim = np.where(eroded(mask)[..., None], truth, 7.0)
    assert view_scores(rim, truth, mask, relit=False)["psnr_h"] == 100
    inner = np.where(mask[..., None] > 0, truth, 7.0)
    assert view_scores(inner, truth, np.ones_like(mask), relit=False)["psnr_h"] < 20  # a mask forgotten


def test_ssim_is_of_a_3_x_3_window_on_encoded_pictures(picture):
    truth, mask = picture
    image = np.clip(truth + 0.05, 0, None)
    inside = eroded(mask)[..., None]
    a, b = (linear_to_srgb(np.clip(x * inside, 0, 1)) for x in (image, truth))
    line = np.exp(-(np.arange(-1, 2) ** 2) / (2 * 1.5**2))
    kernel = np.outer(line, line) / np.outer(line, line).sum()

    def blur(x):
        p = np.pad(x, ((1, 1), (1, 1), (0, 0)), mode="reflect")
        return sum(kernel[i, j] * p[i : i + x.shape[0], j : j + x.shape[1]] for i in range(3) for j in range(3))

    m1, m2 = blur(a), blur(b)
    v1, v2, cov = blur(a * a) - m1**2, blur(b * b) - m2**2, blur(a * b) - m1 * m2
    expected = (2 * m1 * m2 + 1e-4) * (2 * cov + 9e-4) / ((m1**2 + m2**2 + 1e-4) * (v1 + v2 + 9e-4))
    assert view_scores(image, truth, mask, relit=False)["ssim"] == pytest.approx(expected.mean(), abs=1e-9)


def test_lpips_is_fed_pictures_encoded_twice(picture):
    truth, mask = picture
    seen = []

    class Spy(Lpips):
        def __call__(self, image, reference):
            seen.append((image, reference))
            return 0.25

    found = view_scores(truth, truth, mask, relit=False, lpips=Spy({}))
    assert found["lpips"] == 0.25
    inside = eroded(mask)[..., None]
    np.testing.assert_allclose(seen[0][1], linear_to_srgb(linear_to_srgb(np.clip(truth * inside, 0, 1))), atol=1e-12)
    albedo_scores(truth, truth, mask, lpips=Spy({}))
    np.testing.assert_allclose(seen[1][1], linear_to_srgb(np.clip(truth * inside, 0, 1)), atol=1e-12)
    assert len(expected_shapes()) == 13 * 2 + 5


def test_depth_forgives_one_factor_for_the_scene_but_not_one_per_view(picture):
    mask = picture[1]
    depths = [np.random.default_rng(k).uniform(1, 2, mask.shape) for k in range(3)]
    masks = [mask] * 3
    assert depth_error([5 * d for d in depths], depths, masks) == pytest.approx(0, abs=1e-20)
    assert depth_error([d * k for d, k in zip(depths, (1, 2, 3), strict=True)], depths, masks) > 10
    off = depth_error([d + np.where(eroded(mask), 0.1, 5) for d in depths], [d * 0 + 1 for d in depths], masks)
    assert off < 1e3
    # The mean is over the whole image: an offset that no factor takes out.
    ramp = [np.tile(np.linspace(1, 2, mask.shape[1]), (mask.shape[0], 1))]
    inside = eroded(mask)
    a, b = 1.0 * inside, ramp[0] * inside
    scale = (a * b).sum() / (a * a).sum()
    expected = 1e3 * ((scale * a - b) ** 2).mean()
    assert depth_error([np.ones_like(mask)], ramp, [mask]) == pytest.approx(expected)
    assert depth_error([np.zeros_like(mask)], ramp, [mask]) == pytest.approx(expected)  # nothing rendered: depth 1
    with pytest.raises(NumericsError, match="no view"):
        depth_error(ramp, ramp, [mask * 0])


def test_normals_are_compared_by_cosine_and_flips_show(picture):
    mask = picture[1]
    rng = np.random.default_rng(2)
    truth = rng.normal(size=(*mask.shape, 3))
    assert normal_error(truth * 3, truth, mask) == pytest.approx(0, abs=3e-6)
    assert normal_error(-truth, truth, mask) == pytest.approx(2, abs=1e-5)
    assert normal_error(truth * [1, -1, -1], truth, mask) > 0.3  # OpenGL's axes for OpenCV's
    turned = np.stack([np.full(mask.shape, np.sin(0.2)), 0 * mask, np.full(mask.shape, np.cos(0.2))], -1)
    straight = np.broadcast_to([0, 0, 1.0], turned.shape)
    assert normal_error(turned, straight, mask) == pytest.approx(1 - np.cos(0.2), abs=1e-5)
    with pytest.raises(NumericsError, match="empty after erosion"):
        normal_error(truth, truth, mask * 0)


def test_shape_is_twice_a_thousand_times_the_mean_squared_distance():
    plane, faces = grid(40, 40)
    near = shape_error(plane, faces, plane)
    far = shape_error(plane + np.array([0, 0.1, 0]), faces, plane)
    assert near < 0.5  # the sampling's floor
    assert far - near == pytest.approx(2e3 * 0.01, rel=0.01)  # squared: 0.1 un-squared would be 200
    assert shape_error(plane, faces, plane) == near


def test_shapes_that_differ_and_nan_are_refused(picture):
    truth, mask = picture
    with pytest.raises(NumericsError, match="shapes"):
        view_scores(truth[:20], truth, mask, relit=False)
    with pytest.raises(NumericsError, match="NaN"):
        view_scores(truth * np.nan, truth, mask, relit=False)
