"""Estimates whose gradient is drawn by a seed of its own, for benchmarks of noise in the loss (docs/monte_carlo.md).

A loss that is not linear meets noise twice: its derivative is taken at a noisy image and multiplied by a noisy gradient
of the same samples, so the two correlate and the fit settles beside the truth.
"""

from __future__ import annotations

from collections.abc import Callable

import torch


def independent_gradient(
    estimate: Callable[..., torch.Tensor], seed: int, gradient_seed: int, *inputs: torch.Tensor
) -> torch.Tensor:
    """`estimate(seed, *inputs)`, whose gradient is that of `estimate(gradient_seed, *inputs)`.

    `estimate` must be differentiable in `inputs` alone (nothing else it reads gets a gradient). For a loss l the
    expected gradient is E[l'(X)] E[dX], without the covariance of the two. Raises ValueError for equal seeds.
    """
    if seed == gradient_seed:
        raise ValueError(f"seed and gradient_seed are both {seed}; the gradient's noise must be independent")
    return _IndependentGradient.apply(estimate, seed, gradient_seed, *inputs)


class _IndependentGradient(torch.autograd.Function):
    @staticmethod
    def forward(ctx, estimate, seed, gradient_seed, *inputs):  # type: ignore[no-untyped-def]
        ctx.estimate, ctx.gradient_seed = estimate, gradient_seed
        ctx.save_for_backward(*inputs)
        return estimate(seed, *inputs)

    @staticmethod
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        wanted = ctx.needs_input_grad[3:]
        inputs = [t.detach().requires_grad_(need) for t, need in zip(ctx.saved_tensors, wanted, strict=True)]
        with torch.enable_grad():
            value = ctx.estimate(ctx.gradient_seed, *inputs)
        chosen = [t for t in inputs if t.requires_grad]
        gradients = iter(torch.autograd.grad(value, chosen, gradient, allow_unused=True))
        return (None, None, None, *(next(gradients) if t.requires_grad else None for t in inputs))
