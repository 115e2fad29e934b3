"""Image, silhouette and depth losses, and the sRGB curves. Plain torch: CPU or CUDA, whatever the inputs are on.

Images are [H, W, C] (or [H, W]); every loss is a scalar tensor, a mean over pixels and channels.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch.autograd.function import once_differentiable

SSIM_WINDOW = 11
SSIM_SIGMA = 1.5
_C1, _C2 = 0.01**2, 0.03**2


def l1(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """mean |image - target|."""
    return (image - target).abs().mean()


def log_l1(
    image: torch.Tensor,
    target: torch.Tensor,
    clipped: torch.Tensor | None = None,
    weight: torch.Tensor | None = None,
) -> torch.Tensor:
    """Mean of |log(1 + image) - log(1 + target)| over linear radiance [N, 3], negative taken as 0.

    clipped  bool [N, 3], where the photograph is at the top of its range: any image above it is right
    weight   [N], of the pixels; None: all alike
    """
    residual = torch.log1p(image.clamp(min=0)) - torch.log1p(target.clamp(min=0))
    if clipped is not None:
        residual = torch.where(clipped, residual.clamp(max=0), residual)
    if weight is None:
        return residual.abs().mean()
    return (residual.abs().mean(dim=1) * weight).sum() / weight.sum()


def pair_variation(values: torch.Tensor, pairs: torch.Tensor) -> torch.Tensor:
    """TV of a map projected to the screen: mean absolute step [per channel] over neighbouring pixels `pairs` [Q, 2].

    Equation: 23.
    """
    if len(pairs) == 0:
        return values.sum() * 0
    return (values[pairs[:, 0]] - values[pairs[:, 1]]).abs().mean()


def silhouette_bce(alpha: torch.Tensor, mask: torch.Tensor, epsilon: float = 1e-3) -> torch.Tensor:
    """Binary cross-entropy of coverage, the paper's L_m; `alpha` is held inside [epsilon, 1 - epsilon].

    Antialiased coverage may leave [0, 1] slightly, and at exactly 0 or 1 the logarithm has no gradient.
    """
    alpha = alpha.clamp(epsilon, 1 - epsilon)
    return -(mask * alpha.log() + (1 - mask) * (1 - alpha).log()).mean()


def pearson_depth(depth: torch.Tensor, reference: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """1 - correlation of two depth images over `mask` (paper eq. 9): blind to the reference's scale and shift.

    0, without gradient, where the mask has fewer than 3 pixels or either depth is constant there (to 1e-6 of its
    magnitude): a correlation is then not defined. Both must measure the same thing (camera z, not ray length).

    Equation: 9.
    """
    a, b = depth[mask], reference[mask]
    if a.numel() < 3:
        return depth.new_zeros(())
    a_mean, b_mean = a.mean(), b.mean()
    a, b = a - a_mean, b - b_mean
    a_variance, b_variance = a.square().mean(), b.square().mean()
    floor = 1e-6
    if a_variance <= (floor * a_mean).square() or b_variance <= (floor * b_mean).square():
        return depth.new_zeros(())
    return 1 - (a * b).mean() / (a_variance * b_variance).sqrt()


class SsimTarget(NamedTuple):
    """What SSIM needs of a fixed target, computed once: planes [1, C, H, W], local mean and local variance."""

    planes: torch.Tensor
    mean: torch.Tensor
    variance: torch.Tensor


def ssim_target(target: torch.Tensor) -> SsimTarget:
    """Local statistics of `target` [H, W, C] for repeated use in `ssim` and `d_ssim`."""
    planes = _planes(target.detach())
    mean = _separable(planes)
    return SsimTarget(planes, mean, (_separable(planes * planes) - mean * mean).clamp(min=0))


def ssim(image: torch.Tensor, target: torch.Tensor | SsimTarget, mask: torch.Tensor | None = None) -> torch.Tensor:
    """Mean structural similarity (Wang et al. 2004) of two [H, W, C] images with values in [0, 1].

    `mask` [H, W], bool or weights >= 0, takes the mean over the windows centred there; 1 where it is empty.

    11 x 11 Gaussian window of sigma 1.5, zeros beyond the border, C1 = 0.01^2, C2 = 0.03^2. Local variances are
    held >= 0, so that flat images give 1 with a finite gradient in float32. float16 is refused (ValueError): the
    difference of squares keeps no digits there.
    """
    if image.dtype in (torch.float16, torch.bfloat16):
        raise ValueError(f"ssim needs float32 or float64, got {image.dtype}")
    if not isinstance(target, SsimTarget):
        target = ssim_target(target)
    planes = _planes(image)
    weight = None
    if mask is not None:
        weight = mask.to(planes)
        total = weight.sum()
        if not bool(total > 0):
            return image.new_ones(())
        weight = weight / (total * planes.shape[1])
    return _MeanSsim.apply(planes, target.planes, target.mean, target.variance, weight)


def d_ssim(image: torch.Tensor, target: torch.Tensor | SsimTarget, mask: torch.Tensor | None = None) -> torch.Tensor:
    """(1 - SSIM) / 2, in [0, 1]; `mask` as in `ssim` (0 where it is empty)."""
    return (1 - ssim(image, target, mask)) / 2


class Box(NamedTuple):
    """Rows [top, bottom) and columns [left, right) of an image."""

    top: int
    bottom: int
    left: int
    right: int

    def crop(self, image: torch.Tensor) -> torch.Tensor:
        return image[self.top : self.bottom, self.left : self.right]

    @property
    def area(self) -> int:
        return max(self.bottom - self.top, 0) * max(self.right - self.left, 0)


def mask_box(mask: torch.Tensor, margin: int = SSIM_WINDOW // 2) -> Box:
    """The smallest box around the pixels of bool `mask` [H, W], grown by `margin`; the whole image if none is set.

    Outside it both images are background, where SSIM is 1 and its gradient 0: d_ssim of the crops times the box's
    share of the image is the d_ssim of the whole (up to the windows that reach out of the box).
    """
    height, width = mask.shape
    rows = torch.nonzero(mask.any(dim=1))[:, 0]
    columns = torch.nonzero(mask.any(dim=0))[:, 0]
    if len(rows) == 0:
        return Box(0, height, 0, width)
    return Box(
        max(int(rows[0]) - margin, 0),
        min(int(rows[-1]) + 1 + margin, height),
        max(int(columns[0]) - margin, 0),
        min(int(columns[-1]) + 1 + margin, width),
    )


def linear_to_srgb(linear: torch.Tensor) -> torch.Tensor:
    """IEC 61966-2-1 encoding; negative input stays on the linear segment. No upper clamp.

    The power's argument is held above the switch point, so that the unused branch has no infinite gradient at 0.
    """
    power = 1.055 * linear.clamp(min=0.0031308).pow(1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, power)


def srgb_to_linear(encoded: torch.Tensor) -> torch.Tensor:
    """The inverse of `linear_to_srgb`, likewise with finite gradients everywhere."""
    power = ((encoded.clamp(min=0.04045) + 0.055) / 1.055).pow(2.4)
    return torch.where(encoded <= 0.04045, encoded / 12.92, power)


def display(rgb: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Display image over black: sRGB(clip(rgb / alpha)) * alpha, from linear premultiplied `rgb` [..., 3].

    `alpha` [...]; 0 where nothing is covered.
    """
    covered = alpha > 1e-6
    straight = rgb / torch.where(covered, alpha, 1.0)[..., None]
    encoded = linear_to_srgb(straight.clamp(0, 1)) * alpha[..., None]
    return torch.where(covered[..., None], encoded, 0.0)


def _planes(image: torch.Tensor) -> torch.Tensor:
    return (image if image.dim() == 3 else image[..., None]).permute(2, 0, 1)[None].contiguous()


class _MeanSsim(torch.autograd.Function):
    """sum of w S, S = l c, over planes x, y [1, C, H, W], with the gradient in x in closed form; w None is the mean.

    With m = G x, v = G x^2 - m^2, k = G x y - m m_y (G the blur, its own adjoint) and
    l = (2 m m_y + C1) / (m^2 + m_y^2 + C1),  c = (2 k + C2) / (v + v_y + C2):

        d(w S)/dx = G w a + 2 x G w b + y G w d,   b = dS/dv,  d = dS/dk,  a = dS/dm - 2 m b - m_y d

    Autograd's own way through the same terms takes about twice as long on a CPU.
    """

    @staticmethod
    def forward(ctx, x, y, y_mean, y_variance, weight):
        channels = x.shape[1]
        mean, square, cross = _separable(torch.cat([x, x * x, x * y], dim=1)).split(channels, dim=1)
        mean_square = mean * mean
        variance = square - mean_square
        positive = variance > 0
        covariance = cross - mean * y_mean
        below_l = mean_square + y_mean * y_mean + _C1
        below_c = variance.clamp(min=0) + y_variance + _C2
        luminance = (2 * mean * y_mean + _C1) / below_l
        structure = (2 * covariance + _C2) / below_c
        if ctx.needs_input_grad[0]:
            by_variance = torch.where(positive, -luminance * structure / below_c, 0.0)
            by_covariance = 2 * luminance / below_c
            by_mean = structure * 2 * (y_mean - luminance * mean) / below_l
            by_mean -= 2 * mean * by_variance + y_mean * by_covariance
            partial = torch.cat([by_mean, by_variance, by_covariance], dim=1)
            ctx.save_for_backward(x, y, partial if weight is None else partial * weight)
            ctx.count = x.numel() if weight is None else 1
        similarity = luminance * structure
        return similarity.mean() if weight is None else (similarity * weight).sum()

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        x, y, partial = ctx.saved_tensors
        a, b, d = _separable(partial).split(x.shape[1], dim=1)
        return (a + 2 * x * b + y * d) * (grad / ctx.count), None, None, None, None


def _separable(planes: torch.Tensor) -> torch.Tensor:
    """Separable Gaussian with zero padding, [1, C, H, W] to the same: symmetric, hence its own adjoint."""
    # (1, C, H, W) with groups = C: as (C, 1, H, W) the same convolution is tens of times slower on CPU
    channels = planes.shape[1]
    offsets = torch.arange(SSIM_WINDOW, dtype=planes.dtype, device=planes.device) - SSIM_WINDOW // 2
    window = torch.exp(-offsets.square() / (2 * SSIM_SIGMA**2))
    window = window / window.sum()
    half = SSIM_WINDOW // 2
    row = window.view(1, 1, 1, -1).expand(channels, 1, 1, -1)
    column = window.view(1, 1, -1, 1).expand(channels, 1, -1, 1)
    planes = torch.nn.functional.conv2d(planes, row, padding=(0, half), groups=channels)
    return torch.nn.functional.conv2d(planes, column, padding=(half, 0), groups=channels)
