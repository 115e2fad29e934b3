"""SSIM and D-SSIM with their gradient, of a picture against a fixed target.

On a CPU one fused kernel in float32 (`kernels_dssim`); elsewhere, and in float64, torch's convolutions.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.cores import scratch, split
from exmesh_graph.gpu.warp_runtime import warp

SSIM_WINDOW = 11
SSIM_SIGMA = 1.5
_C1, _C2 = 0.01**2, 0.03**2


class SsimTarget(NamedTuple):
    """What SSIM needs of a fixed target, computed once: image, local mean and local variance, each [H, W, C]."""

    image: torch.Tensor
    mean: torch.Tensor
    variance: torch.Tensor


def ssim_target(target: torch.Tensor) -> SsimTarget:
    """Local statistics of `target` [H, W, C] for repeated use in `ssim` and `d_ssim`."""
    image = _with_channels(target.detach())
    if _fuses(image):
        image = image.contiguous()
        found = SsimTarget(image, torch.empty_like(image), torch.empty_like(image))
        _strips(image, found, None, _kernels().MOMENTS, 1.0, None)
        return found
    planes = _planes(image)
    mean = _separable(planes)
    variance = (_separable(planes * planes) - mean * mean).clamp(min=0)
    return SsimTarget(image, _interleaved(mean), _interleaved(variance))


def ssim(image: torch.Tensor, target: torch.Tensor | SsimTarget, mask: torch.Tensor | None = None) -> torch.Tensor:
    """Mean structural similarity (Wang et al. 2004) of two [H, W, C] images with values in [0, 1].

    `mask` [H, W], bool or weights >= 0, takes the mean over the windows centred there; 1 where it is empty.

    11 x 11 Gaussian window of sigma 1.5, zeros beyond the border, C1 = 0.01^2, C2 = 0.03^2. Local variances are
    held >= 0, so that flat images give 1 with a finite gradient in float32. float16 is refused (ValueError): the
    difference of squares keeps no digits there. The target has no gradient.
    """
    if image.dtype in (torch.float16, torch.bfloat16):
        raise ValueError(f"ssim needs float32 or float64, got {image.dtype}")
    if not isinstance(target, SsimTarget):
        target = ssim_target(target)
    image = _with_channels(image)
    if mask is None:
        return _MeanSsim.apply(image, *target, None)
    weight = mask.to(image)
    total = weight.sum()
    if not bool(total > 0):
        return image.new_ones(())
    return _MeanSsim.apply(image, *target, (weight / (total * image.shape[-1])).contiguous())


def d_ssim(image: torch.Tensor, target: torch.Tensor | SsimTarget, mask: torch.Tensor | None = None) -> torch.Tensor:
    """(1 - SSIM) / 2, in [0, 1]; `mask` as in `ssim` (0 where it is empty)."""
    return (1 - ssim(image, target, mask)) / 2


def ssim_and_gradient(image: torch.Tensor, target: SsimTarget) -> tuple[torch.Tensor, torch.Tensor]:
    """`ssim` of images [H, W, C] and its gradient, for who adds up gradients without autograd."""
    value, gradient = _similarity(image.detach(), target, None, True)
    assert gradient is not None
    return value, gradient


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


class _MeanSsim(torch.autograd.Function):
    """sum of w S, S = l c, over images x, y [H, W, C], with the gradient in x in closed form; w None is the mean.

    With m = G x, v = G x^2 - m^2, k = G x y - m m_y (G the blur, its own adjoint) and
    l = (2 m m_y + C1) / (m^2 + m_y^2 + C1),  c = (2 k + C2) / (v + v_y + C2):

        d(w S)/dx = G w a + 2 x G w b + y G w d,   b = dS/dv,  d = dS/dk,  a = dS/dm - 2 m b - m_y d

    Autograd's own way through the same terms takes about twice as long on a CPU.
    """

    @staticmethod
    def forward(ctx, x, y, y_mean, y_variance, weight):
        value, gradient = _similarity(x, SsimTarget(y, y_mean, y_variance), weight, ctx.needs_input_grad[0])
        if gradient is not None:
            ctx.save_for_backward(gradient)
        return value

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        (gradient,) = ctx.saved_tensors
        return gradient * grad, None, None, None, None


def _fuses(*images: torch.Tensor) -> bool:
    return all(t.device.type == "cpu" and t.dtype == torch.float32 and t.numel() for t in images)


def _similarity(
    x: torch.Tensor, target: SsimTarget, weight: torch.Tensor | None, with_gradient: bool
) -> tuple[torch.Tensor, torch.Tensor | None]:
    """sum of w S and its gradient in x."""
    of = _fused if _fuses(x, *target) else _by_convolution
    return of(x, target, weight, with_gradient)


def _fused(
    x: torch.Tensor, target: SsimTarget, weight: torch.Tensor | None, with_gradient: bool
) -> tuple[torch.Tensor, torch.Tensor | None]:
    scale = 1 / x.numel() if weight is None else 1.0
    gradient = torch.empty_like(x, memory_format=torch.contiguous_format) if with_gradient else None
    kernels = _kernels()
    target = SsimTarget(*(part.contiguous() for part in target))
    mode = kernels.GRADIENT if with_gradient else kernels.VALUE
    sums = _strips(x.detach().contiguous(), target, weight, mode, scale, gradient)
    return (sums.sum() * scale).to(x.dtype), gradient


def _strips(
    x: torch.Tensor, target: SsimTarget, weight: torch.Tensor | None, mode: int, scale: float, out: torch.Tensor | None
) -> torch.Tensor:
    """Sums of the strips [S], float64."""
    kernels = _kernels()
    height, width, channels = x.shape
    strips = -(-height // kernels.ROWS)
    memory = scratch("ssim", kernels.scratch_size(height, width, channels))
    sums = torch.empty(strips, dtype=torch.float64)
    nothing = memory[:1]
    split(
        kernels.ssim_strips, strips, height, width, channels, len(memory) // strips, mode, int(weight is not None),
        scale, x, *target, nothing if weight is None else weight, memory, nothing if out is None else out, sums,
        grain=1,
    )  # fmt: skip
    return sums


def _by_convolution(
    x: torch.Tensor, target: SsimTarget, weight: torch.Tensor | None, with_gradient: bool
) -> tuple[torch.Tensor, torch.Tensor | None]:
    image, channels = _planes(x), x.shape[-1]
    y, y_mean, y_variance = (_planes(part) for part in target)
    mean, square, cross = _separable(torch.cat([image, image * image, image * y], dim=1)).split(channels, dim=1)
    mean_square = mean * mean
    variance = square - mean_square
    covariance = cross - mean * y_mean
    below_l = mean_square + y_mean * y_mean + _C1
    below_c = variance.clamp(min=0) + y_variance + _C2
    luminance = (2 * mean * y_mean + _C1) / below_l
    structure = (2 * covariance + _C2) / below_c
    similarity = luminance * structure
    value = similarity.mean() if weight is None else (similarity * weight).sum()
    if not with_gradient:
        return value, None
    by_variance = torch.where(variance > 0, -luminance * structure / below_c, 0.0)
    by_covariance = 2 * luminance / below_c
    by_mean = structure * 2 * (y_mean - luminance * mean) / below_l
    by_mean -= 2 * mean * by_variance + y_mean * by_covariance
    partial = torch.cat([by_mean, by_variance, by_covariance], dim=1)
    a, b, d = _separable(partial / x.numel() if weight is None else partial * weight).split(channels, dim=1)
    return value, _interleaved(a + 2 * image * b + y * d)


@cache
def _kernels() -> Any:
    """Imported after Warp has been set up."""
    warp()
    from exmesh_graph.losses import kernels_dssim

    return kernels_dssim


def _with_channels(image: torch.Tensor) -> torch.Tensor:
    return image if image.dim() == 3 else image[..., None]


def _planes(image: torch.Tensor) -> torch.Tensor:
    return image.permute(2, 0, 1)[None].contiguous()


def _interleaved(planes: torch.Tensor) -> torch.Tensor:
    return planes[0].permute(1, 2, 0).contiguous()


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
