"""What D-SSIM costs on the CPU in the ways it can be written, and what the other losses cost beside it.

    python benchmarks/losses.py [--size 512] [--repeats 9] [--cores 1] [--json losses.json]
    python benchmarks/losses.py --quick

Milliseconds on the clock, the best of several turns that alternate between the rows; compare ratios.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import torch

from exmesh_graph import losses
from exmesh_graph.gpu.torch_setup import sharing
from exmesh_graph.losses.dssim import _separable as _blur


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="128 x 128, three turns")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.size, options.repeats = 128, 3
    with sharing(options.cores):
        rows = measure(options.size, options.repeats)
    best = rows["ours: separable, grouped, own gradient, target cached"]["both"]
    print(f"{options.size} x {options.size} x 3, float32, {options.cores} core(s); milliseconds on the clock")
    print(f"{'':60s}{'forward':>10s}{'with gradient':>15s}{'ratio':>8s}")
    for name, row in rows.items():
        print(f"{name:60s}{row['forward']:10.2f}{row['both']:15.2f}{row['both'] / best:8.1f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def measure(size: int, repeats: int) -> dict[str, dict[str, float]]:
    generator = torch.Generator().manual_seed(0)
    image, target, depth = (torch.rand(size, size, 3, generator=generator) for _ in range(3))
    image.requires_grad_()
    cached = losses.ssim_target(target)
    mask = torch.zeros(size, size, dtype=torch.bool)
    mask[size // 4 : 3 * size // 4, size // 4 : 3 * size // 4] = True
    box = losses.mask_box(mask)
    boxed = losses.ssim_target(box.crop(target).contiguous())
    work: dict[str, Callable[[], torch.Tensor]] = {
        "ours: separable, grouped, own gradient, target cached": lambda: losses.d_ssim(image, cached),
        "ours, cropped to the box of a mask of a quarter": lambda: losses.d_ssim(
            box.crop(image), boxed, box.crop(mask)
        ),
        "ours, target not cached": lambda: losses.d_ssim(image, target),
        "separable, grouped, gradient by autograd": lambda: plain_d_ssim(image, target, _separable),
        "one 11 x 11 window, grouped": lambda: plain_d_ssim(image, target, _square),
        "separable, channels on the batch axis": lambda: plain_d_ssim(image, target, _batched),
        "L1": lambda: losses.l1(image, target),
        "log-L1": lambda: losses.log_l1(image, target),
        "sRGB curve": lambda: losses.linear_to_srgb(image).mean(),
        "Pearson depth": lambda: losses.pearson_depth(image[..., 0], depth[..., 0], mask),
        "silhouette BCE": lambda: losses.silhouette_bce(image[..., 0], mask.float()),
    }
    reference = float(work["separable, grouped, gradient by autograd"]().detach())
    for name in list(work)[2:6]:  # the ways must agree before they are compared
        assert abs(float(work[name]().detach()) - reference) < 1e-5, name
    best = {name: {"forward": float("inf"), "both": float("inf")} for name in work}
    for _ in range(repeats):
        for name, forward in work.items():
            with torch.no_grad():
                best[name]["forward"] = min(best[name]["forward"], _clock(forward))
            best[name]["both"] = min(best[name]["both"], _clock(lambda: torch.autograd.grad(forward(), image)))  # noqa: B023
    return best


def plain_d_ssim(
    image: torch.Tensor, target: torch.Tensor, blur: Callable[[torch.Tensor], torch.Tensor]
) -> torch.Tensor:
    """D-SSIM written out with autograd's gradient, over any way to blur planes [1, C, H, W]."""
    x, y = (a.permute(2, 0, 1)[None] for a in (image, target))
    mean, other = blur(x), blur(y)
    variance = (blur(x * x) - mean * mean).clamp(min=0) + (blur(y * y) - other * other).clamp(min=0)
    covariance = blur(x * y) - mean * other
    c1, c2 = 0.01**2, 0.03**2
    similarity = (2 * mean * other + c1) / (mean * mean + other * other + c1) * (2 * covariance + c2) / (variance + c2)
    return (1 - similarity.mean()) / 2


def _window() -> torch.Tensor:
    offsets = torch.arange(losses.SSIM_WINDOW, dtype=torch.float32) - losses.SSIM_WINDOW // 2
    window = torch.exp(-offsets.square() / (2 * losses.SSIM_SIGMA**2))
    return window / window.sum()


def _separable(planes: torch.Tensor) -> torch.Tensor:
    return _blur(planes)


def _square(planes: torch.Tensor) -> torch.Tensor:
    channels, window = planes.shape[1], _window()
    kernel = (window[:, None] * window[None]).expand(channels, 1, -1, -1)
    return torch.nn.functional.conv2d(planes, kernel, padding=losses.SSIM_WINDOW // 2, groups=channels)


def _batched(planes: torch.Tensor) -> torch.Tensor:
    window, half = _window(), losses.SSIM_WINDOW // 2
    rows = torch.nn.functional.conv2d(planes.transpose(0, 1), window.view(1, 1, 1, -1), padding=(0, half))
    return torch.nn.functional.conv2d(rows, window.view(1, 1, -1, 1), padding=(half, 0)).transpose(0, 1)


def _clock(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return 1000 * (time.perf_counter() - began)


if __name__ == "__main__":
    main()
