"""PSNR and SSIM on pictures whose figures are known, and on the usual mistakes."""

import numpy as np
import pytest

from exmesh_graph.errors import NumericsError
from exmesh_graph.evaluate.metrics.image import display, psnr, ssim, ssim_map
from exmesh_graph.io.color import linear_to_srgb


@pytest.fixture
def picture():
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(0, 6, 40), np.linspace(0, 5, 32))
    smooth = np.stack([0.5 + 0.4 * np.sin(x), 0.3 + 0.2 * np.cos(y + x), 0.2 + 0.1 * np.sin(2 * y)], axis=-1)
    return smooth + 0.02 * rng.random(smooth.shape)


def test_psnr_of_a_known_error(picture):
    assert psnr(picture + 0.1, picture) == pytest.approx(20)
    assert psnr(picture + 0.01, picture) == pytest.approx(40)
    assert psnr(picture, picture) == 100


def test_masked_psnr_counts_the_mask_alone(picture):
    wrong = picture.copy()
    wrong[:16] += 0.1
    mask = np.zeros(picture.shape[:2], bool)
    mask[:16] = True
    assert psnr(wrong, picture, mask) == pytest.approx(20)
    assert psnr(wrong, picture) == pytest.approx(20 + 10 * np.log10(2))
    assert psnr(wrong, picture, ~mask) == 100


def test_mistakes_change_the_figures(picture):
    for mistake in (picture[..., ::-1], linear_to_srgb(picture), picture[:, ::-1], np.roll(picture, 1, axis=1)):
        assert psnr(mistake, picture) < 35
        assert ssim(mistake, picture) < 0.97


def test_nothing_to_compare(picture):
    with pytest.raises(NumericsError, match="mask is empty"):
        psnr(picture, picture, np.zeros(picture.shape[:2], bool))
    with pytest.raises(NumericsError, match="shapes"):
        psnr(picture, picture[1:])
    with pytest.raises(NumericsError, match="NaN"):
        psnr(picture * np.nan, picture)
    with pytest.raises(NumericsError, match="smaller than the window"):
        ssim(picture[:8, :8], picture[:8, :8])


def test_ssim_of_equal_and_constant_pictures(picture):
    assert ssim(picture, picture) == pytest.approx(1)
    a, b = np.full((20, 20, 3), 0.5), np.full((20, 20, 3), 0.25)
    # Without variance only the luminance term is left.
    assert ssim(a, b) == pytest.approx((2 * 0.5 * 0.25 + 1e-4) / (0.25 + 0.0625 + 1e-4))


def test_ssim_equals_scikit_image(picture):
    from skimage.metrics import structural_similarity

    noisy = np.clip(picture + 0.05 * np.random.default_rng(1).normal(size=picture.shape), 0, 1)
    expected = structural_similarity(
        noisy, picture, data_range=1, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    assert ssim(noisy, picture) == pytest.approx(expected, abs=1e-9)


def test_ssim_by_the_definition_at_one_pixel(picture):
    other = np.clip(picture * 0.9 + 0.03, 0, 1)
    g = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    w = np.outer(g, g) / g.sum() ** 2
    x, y = (p[10 - 5 : 10 + 6, 20 - 5 : 20 + 6, 1] for p in (picture, other))
    mx, my = (w * x).sum(), (w * y).sum()
    vx, vy, cov = (w * x * x).sum() - mx**2, (w * y * y).sum() - my**2, (w * x * y).sum() - mx * my
    expected = (2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
    assert ssim_map(picture, other)[10, 20, 1] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("box", [(0, 3, 0, 40), (10, 12, 20, 21), (29, 32, 35, 40), (4, 28, 6, 33)])
def test_ssim_where_only_a_part_differs(picture, box):
    """Windows that do not differ are not computed: what is, is as by scikit-image over the whole pictures."""
    from skimage.metrics import structural_similarity

    top, bottom, left, right = box
    other = picture.copy()
    other[top:bottom, left:right] *= 0.8
    _, expected = structural_similarity(
        other, picture, data_range=1, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        full=True,
    )  # fmt: skip
    assert ssim_map(other, picture) == pytest.approx(expected, abs=1e-9)
    assert ssim_map(other[..., 0], picture[..., 0]) == pytest.approx(expected[..., 0], abs=1e-9)


def test_masked_ssim(picture):
    wrong = picture.copy()
    wrong[:, :12] = 0
    mask = np.zeros(picture.shape[:2], bool)
    mask[:, 20:] = True
    assert ssim(wrong, picture, mask) == pytest.approx(1)
    assert ssim(wrong, picture) < 0.9


def test_display_is_srgb_over_black():
    rgb, alpha = np.array([[0.1, 0.2, 3.0]]), np.array([0.5])
    assert display(rgb, alpha)[0] == pytest.approx(np.array([*linear_to_srgb(np.array([0.2, 0.4])), 1]) * 0.5)
    assert display(np.zeros((1, 3)), np.zeros(1)).tolist() == [[0, 0, 0]]
