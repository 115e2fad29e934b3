"""Losses of pictures, silhouettes and depth, in plain torch."""

from __future__ import annotations

import torch


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
