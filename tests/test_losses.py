"""Losses and colour curves: values against independent formulas, gradients in float64, hard inputs."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph import losses
from exmesh_graph.gpu.cores import cores
from exmesh_graph.losses.dssim import _separable


def images(height=20, width=24, channels=3, seed=0, dtype=torch.float64):
    g = torch.Generator().manual_seed(seed)
    return (torch.rand(height, width, channels, generator=g, dtype=dtype) for _ in range(2))


def test_ssim_equals_scikit_image_inside_the_border():
    from skimage.metrics import structural_similarity

    a, b = images(40, 50)
    b = 0.7 * a + 0.3 * b
    # scikit-image leaves out the border of 5 pixels: compare on the interior by cutting ours there as well
    _, full = structural_similarity(
        a.numpy(), b.numpy(), channel_axis=2, data_range=1.0, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    inner = np.s_[10:-10, 10:-10]
    gradient_free = losses.ssim(a, b)
    assert 0 < float(gradient_free) < 1
    # a patch whose windows all lie inside: pad it with itself, so that only interior windows differ
    x = a.clone()
    x[inner] = b[inner]
    _, changed = structural_similarity(
        x.numpy(), b.numpy(), channel_axis=2, data_range=1.0, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    # the mean over all pixels changes by what scikit-image says, border windows being the same in both
    assert float(losses.ssim(x, b) - losses.ssim(a, b)) == pytest.approx((changed - full).mean(), rel=1e-3)


def test_ssim_of_equal_images_is_one_with_no_gradient():
    a, _ = images()
    a.requires_grad_()
    value = losses.ssim(a, a.detach())
    (gradient,) = torch.autograd.grad(value, a)
    assert float(value.detach()) == pytest.approx(1.0, abs=1e-12)
    assert float(gradient.abs().max()) < 1e-12


@pytest.mark.parametrize("level", [0.0, 1e-4, 0.5, 1.0])
def test_ssim_of_flat_images_in_float32(level):
    a = torch.full((30, 30, 3), level, requires_grad=True)
    value = losses.ssim(a, torch.full((30, 30, 3), level))
    (gradient,) = torch.autograd.grad(value, a)
    assert float(value.detach()) == pytest.approx(1.0, abs=1e-4)
    assert bool(torch.isfinite(gradient).all())
    assert float(gradient.abs().max()) < 1e-3


@pytest.mark.thorough
def test_ssim_gradient_and_cached_target():
    a, b = images(13, 12)
    a.requires_grad_()
    assert torch.autograd.gradcheck(lambda x: losses.d_ssim(x, b), a)
    assert torch.equal(losses.ssim(a, losses.ssim_target(b)), losses.ssim(a, b))


@settings(max_examples=25, deadline=None)
@given(
    st.integers(1, 150), st.integers(1, 40), st.integers(1, 4), st.sampled_from([None, "weights", "bool"]),
    st.integers(0, 10**6),
)  # fmt: skip
def test_the_fused_kernel_is_ssim(height, width, channels, kind, seed):
    """float32 on a CPU against torch's convolutions in float64, at sizes that no vector or strip divides."""
    g = torch.Generator().manual_seed(seed)
    target = torch.rand(height, width, channels, generator=g)
    image = (target + 0.2 * torch.randn(height, width, channels, generator=g)).clamp(0, 1)
    weights = {None: None, "weights": torch.rand(height, width, generator=g)}
    mask = weights.get(kind, torch.rand(height, width, generator=g) > 0.5)
    mine, gradient = value_and_gradient(image, target, mask)
    exact, want = value_and_gradient(image.double(), target.double(), mask)
    assert mine == pytest.approx(exact, abs=1e-5)
    assert torch.allclose(gradient.double(), want, atol=1e-5 * float(want.abs().max()) + 1e-12)


def test_the_fused_moments_are_those_of_the_target():
    image, _ = images(150, 37)
    exact, mine = losses.ssim_target(image), losses.ssim_target(image.float())
    assert torch.allclose(mine.mean.double(), exact.mean, atol=1e-6)
    assert torch.allclose(mine.variance.double(), exact.variance, atol=1e-6)
    assert bool((losses.ssim_target(torch.ones(20, 21, 3)).variance >= 0).all())


@pytest.mark.parametrize("level", [0.0, 1e-4, 0.5, 1.0])
def test_the_fused_kernel_on_flat_and_extreme_images(level):
    """Flat targets leave SSIM's denominators at their constants: there the difference of squares counts most."""
    target = torch.full((70, 33, 3), level)
    image = target.clone()
    image[20:40, 5:9] = (level + 0.4) % 1
    mine, gradient = value_and_gradient(image, target)
    exact, want = value_and_gradient(image.double(), target.double())
    assert mine == pytest.approx(exact, abs=1e-4)
    # the variance of flat ground is a difference of numbers up to 1: 2e-7 of 9e-4
    assert torch.allclose(gradient.double(), want, atol=2e-3 * float(want.abs().max()))


def test_the_fused_kernel_gives_the_same_bytes_on_any_number_of_cores():
    a, b = images(300, 41, dtype=torch.float32)
    alone = value_and_gradient(a, b)
    for count in (2, 3):
        with cores(count):
            shared = value_and_gradient(a, b)
        assert shared[0] == alone[0]
        assert torch.equal(shared[1], alone[1])


def value_and_gradient(image, target, mask=None):
    x = image.clone().requires_grad_()
    value = losses.ssim(x, target, mask)
    gradient = torch.autograd.grad(value, x)[0] if value.requires_grad else torch.zeros_like(x)
    return value.item(), gradient


def test_ssim_refuses_half_precision():
    a, b = images(dtype=torch.float32)
    with pytest.raises(ValueError, match="float32"):
        losses.ssim(a.half(), b.half())


@pytest.mark.thorough
def test_masked_mean_and_its_gradient():
    a, b = images(30, 26)
    mask = torch.rand(30, 26, generator=torch.Generator().manual_seed(4)) > 0.6
    # the map itself, one window at a time
    one = torch.zeros(30, 26, dtype=torch.bool)
    windows = []
    for i, j in torch.nonzero(mask).tolist():
        one[i, j] = True
        windows.append(float(losses.ssim(a, b, one)))
        one[i, j] = False
    assert float(losses.ssim(a, b, mask)) == pytest.approx(np.mean(windows), rel=1e-12)
    assert float(losses.ssim(a, b, torch.ones(30, 26))) == pytest.approx(float(losses.ssim(a, b)), rel=1e-12)
    x = a[:9, :8].clone().requires_grad_()
    weight = torch.rand(9, 8, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: losses.d_ssim(x, b[:9, :8], weight), x)


def test_masked_mean_ignores_what_no_window_of_the_mask_sees():
    a, b = images(40, 40)
    mask = torch.zeros(40, 40, dtype=torch.bool)
    mask[15:25, 15:25] = True
    wild = a.clone()
    wild[:9], wild[:, 31:] = float("nan"), 1e30
    box = losses.mask_box(mask)
    x = box.crop(wild).clone().requires_grad_()
    value = losses.d_ssim(x, box.crop(b), box.crop(mask))
    (gradient,) = torch.autograd.grad(value, x)
    assert float(value) == pytest.approx(float(losses.d_ssim(a, b, mask)), rel=1e-9)
    assert bool(torch.isfinite(gradient).all())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_empty_mask_is_no_loss(dtype):
    a, b = images(dtype=dtype)
    a.requires_grad_()
    assert float(losses.d_ssim(a, b, torch.zeros(20, 24, dtype=torch.bool))) == 0
    assert float(losses.ssim(a, b, torch.zeros(20, 24))) == 1


def test_masked_box_weighted_by_its_share_equals_the_whole():
    a, b = images(60, 70)
    mask = torch.zeros(60, 70, dtype=torch.bool)
    mask[20:41, 25:52] = True
    a, b = a * mask[..., None], b * mask[..., None]
    box = losses.mask_box(mask)
    assert box == losses.Box(15, 46, 20, 57)
    boxed = losses.d_ssim(box.crop(a), box.crop(b)) * box.area / mask.numel()
    assert float(boxed) == pytest.approx(float(losses.d_ssim(a, b)), rel=1e-9)
    assert losses.mask_box(torch.zeros(6, 7, dtype=torch.bool)) == losses.Box(0, 6, 0, 7)


def test_l1_and_log_l1_by_hand():
    a = torch.tensor([[[0.0], [1.0]], [[3.0], [3.0]]])
    b = torch.zeros_like(a)
    assert float(losses.l1(a, b)) == pytest.approx(7 / 4)
    assert float(losses.log_l1(a, b)) == pytest.approx((np.log(2) + 2 * np.log(4)) / 4)


def test_silhouette_losses_at_zero_and_one():
    alpha = torch.tensor([[0.0, 1.0, 0.5, 1.1]], requires_grad=True)
    mask = torch.tensor([[0.0, 1.0, 1.0, 0.0]])
    value = losses.silhouette_bce(alpha, mask)
    (gradient,) = torch.autograd.grad(value, alpha)
    assert bool(torch.isfinite(gradient).all())
    expected = -(2 * np.log(1 - 1e-3) + np.log(0.5) + np.log(1e-3)) / 4
    assert float(value.detach()) == pytest.approx(expected, rel=1e-4)
    assert float(losses.l1(alpha, mask).detach()) == pytest.approx(1.6 / 4)


def test_pearson_depth_ignores_scale_and_shift():
    g = torch.Generator().manual_seed(1)
    depth = torch.rand(9, 9, generator=g, dtype=torch.float64) + 2
    mask = torch.rand(9, 9, generator=g) > 0.3
    assert float(losses.pearson_depth(depth, 0.2 * depth - 7, mask)) == pytest.approx(0, abs=1e-9)
    assert float(losses.pearson_depth(depth, -depth, mask)) == pytest.approx(2, abs=1e-9)
    other = torch.rand(9, 9, generator=g, dtype=torch.float64)
    expected = 1 - np.corrcoef(depth[mask].numpy(), other[mask].numpy())[0, 1]
    assert float(losses.pearson_depth(depth, other, mask)) == pytest.approx(expected)
    depth.requires_grad_()
    assert torch.autograd.gradcheck(lambda d: losses.pearson_depth(d, other, mask), depth)


@pytest.mark.parametrize("pixels", [0, 2, 81])
def test_pearson_depth_where_it_is_not_defined(pixels):
    depth = torch.full((9, 9), 3.3, requires_grad=True)
    mask = torch.arange(81).view(9, 9) < pixels
    value = losses.pearson_depth(depth, torch.rand(9, 9), mask)
    assert float(value) == 0


def test_srgb_curves_are_inverse_and_smooth_at_zero():
    x = torch.linspace(0, 1, 1001, dtype=torch.float64, requires_grad=True)
    encoded = losses.linear_to_srgb(x)
    assert torch.allclose(losses.srgb_to_linear(encoded), x, atol=1e-7)
    for curve in (losses.linear_to_srgb, losses.srgb_to_linear):
        y = torch.tensor([-0.1, 0.0, 1e-12, 0.0031308, 0.04045, 1.0, 3.0], requires_grad=True)
        (gradient,) = torch.autograd.grad(curve(y).sum(), y)
        assert bool(torch.isfinite(gradient).all())
        assert bool((gradient > 0).all())
    assert losses.linear_to_srgb(torch.tensor([0.0, 0.18, 1.0])).tolist() == pytest.approx(
        [0.0, 0.46135613, 1.0], abs=1e-6
    )


def test_display_over_black():
    rgb = torch.tensor([[0.09, 0.5, 0.0], [0.3, 2.0, 1.0], [0.0, 0.0, 0.0]])
    alpha = torch.tensor([0.5, 1.0, 0.0])
    got = losses.display(rgb, alpha)
    want = losses.linear_to_srgb(torch.tensor([0.18, 1.0, 0.0])) * 0.5
    assert torch.allclose(got[0], want)
    assert got[1, 1:].tolist() == pytest.approx([1.0, 1.0])
    assert got[2].tolist() == [0, 0, 0]


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 14), st.integers(1, 14), st.integers(0, 10**6))
def test_blur_is_its_own_adjoint_at_any_size(height, width, seed):
    g = torch.Generator().manual_seed(seed)
    a, b = (torch.randn(1, 2, height, width, generator=g, dtype=torch.float64) for _ in range(2))
    left = (_separable(a) * b).sum()
    right = (a * _separable(b)).sum()
    assert float(left) == pytest.approx(float(right), rel=1e-9, abs=1e-12)
