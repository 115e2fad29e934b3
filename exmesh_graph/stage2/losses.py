"""Terms of the Stage II objective, eq. 21 to 24, on one view's pixels."""

from __future__ import annotations

import torch


def log_l1(predicted: torch.Tensor, target: torch.Tensor, clipped: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Mean of |log(1 + predicted) - log(1 + target)| over pixels [N, 3], weighted by coverage [N].

    Where the photograph is `clipped` at the top of its range, any prediction above the target is right.

    Equation: 21.
    """
    residual = torch.log1p(predicted) - torch.log1p(target)
    residual = torch.where(clipped, residual.clamp(max=0), residual)
    return (residual.abs().mean(dim=1) * weight).sum() / weight.sum()


def pair_variation(values: torch.Tensor, pairs: torch.Tensor) -> torch.Tensor:
    """TV of a map projected to the screen: mean absolute step [per channel] over neighbouring pixels `pairs` [Q, 2].

    Equation: 23.
    """
    if len(pairs) == 0:
        return values.sum() * 0
    return (values[pairs[:, 0]] - values[pairs[:, 1]]).abs().mean()
