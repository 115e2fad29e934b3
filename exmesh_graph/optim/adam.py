"""Adam (Kingma and Ba 2015) as the solvers use it.

torch.optim.Adam does the same as the plain form; constructing it imports torch's compiler (over a second on a laptop),
as long as forty steps of a fit. The moments are plain tensors, so that they travel with a state. Large float32
tensors on a CPU with a second moment for each value take one pass over memory (`kernels_adam`); the rest, and the
reference, is plain torch.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import torch

from exmesh_graph.gpu.cores import scratch, split
from exmesh_graph.gpu.warp_runtime import warp

EPSILON = 1e-15
"""Far below any gradient of a mean over an image; it only keeps 0 / 0 from happening."""

FIRST, SECOND = 0.9, 0.99
"""Decay of the moments, unless told otherwise."""


class Bounds(NamedTuple):
    """What a step of colours does besides: hold them in [0, 1], and mark rows whose gradient is above a threshold.

    touched    bool [...] for values [..., C], set where any |gradient| of a row is above `threshold`
    """

    touched: torch.Tensor
    threshold: float


@torch.no_grad()
def adam_step(
    values: torch.Tensor,
    gradient: torch.Tensor,
    first: torch.Tensor,
    second: torch.Tensor,
    step: int,
    rate: float,
    *,
    betas: tuple[float, float] = (FIRST, SECOND),
    epsilon: float = EPSILON,
    uniform: bool = False,
    torch_rounding: bool = False,
    bounds: Bounds | None = None,
    check: bool = False,
) -> bool:
    """Move `values` one step of bias-corrected Adam, and update both moments: in place.

    values, gradient, first   of one shape
    second    of that shape; or [V] for values [V, C]: the mean of a row's |g|^2. Sharing it over x, y, z makes the step
              of a vertex turn with the object, and points it along the gradient.
    step      counts from 1
    rate      length of a step under a steady gradient, in units of the values
    epsilon   the gradient below which steps shorten
    uniform   every row is divided by the largest of the second moments (AdamUniform of "Large Steps")
    torch_rounding  sqrt(v) / sqrt(1 - b2^t), as torch.optim.Adam rounds it, in place of sqrt(v / (1 - b2^t))
    bounds    see `Bounds`
    check     whether to look at the gradient: returns False if a value of it is not finite (the step is taken), else
              True
    """
    tensors = (values, gradient, first, second)
    if second.ndim == values.ndim and not uniform and values.numel() >= _MANY and all(_plain(t) for t in tensors):
        return _fused(*tensors, step, rate, betas, epsilon, torch_rounding, bounds)
    b1, b2 = betas
    if bounds is not None:
        bounds.touched.logical_or_((gradient.abs() > bounds.threshold).any(dim=-1))
    first.lerp_(gradient, 1 - b1)
    if second.ndim < values.ndim:
        second.lerp_(gradient.square().sum(1), 1 - b2)
    else:
        second.mul_(b2).addcmul_(gradient, gradient, value=1 - b2)
    known = second.amax().expand_as(second) if uniform and len(second) else second
    if torch_rounding:
        scale = (known.sqrt() / (1 - b2**step) ** 0.5).add_(epsilon)
    else:
        scale = (known / (1 - b2**step)).sqrt_().add_(epsilon)
    scale = scale[:, None] if second.ndim < values.ndim else scale
    values.addcdiv_(first, scale, value=-rate / (1 - b1**step))
    if bounds is not None:
        values.clamp_(0, 1)
    return not check or bool(torch.isfinite(gradient.sum()))


def _plain(tensor: torch.Tensor) -> bool:
    kind = (tensor.device.type, tensor.dtype, tensor.layout)
    return kind == ("cpu", torch.float32, torch.strided) and tensor.is_contiguous()


def _fused(
    values: torch.Tensor,
    gradient: torch.Tensor,
    first: torch.Tensor,
    second: torch.Tensor,
    step: int,
    rate: float,
    betas: tuple[float, float],
    epsilon: float,
    torch_rounding: bool,
    bounds: Bounds | None,
) -> bool:
    k, count = _kernels(), values.numel()
    b1, b2 = betas
    bias = 1 - b2**step
    bias = bias**0.5 if torch_rounding else bias
    touched, threshold = bounds if bounds is not None else (_NOTHING, 0.0)
    row = values.shape[-1] if bounds is not None else 1
    blocks = -(-count // int(k.BLOCK))
    faults = scratch("adam faults", blocks, torch.uint8)[:blocks]
    split(
        k.adam_blocks, blocks, count, 1 - b1, b2, 1 - b2, bias, int(torch_rounding), epsilon,
        -rate / (1 - b1**step), int(bounds is not None), row, threshold, values.detach(), gradient, first, second,
        touched, faults, grain=16,
    )  # fmt: skip
    return not bool(faults.any())


@cache
def _kernels() -> Any:
    """Imported after Warp has been set up."""
    warp()
    from exmesh_graph.optim import kernels_adam

    return kernels_adam


_MANY = 1 << 14
"""Values from which on one pass over memory is faster than torch's operations in turn."""
_NOTHING = torch.zeros(1, dtype=torch.bool)


class Adam:
    """`adam_step` over leaf tensors, each with its own learning rate."""

    def __init__(
        self,
        parameters: list[torch.Tensor],
        rates: list[float],
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        self.parameters, self.rates, self.betas, self.eps = parameters, rates, betas, eps
        self.first = [torch.zeros_like(p) for p in parameters]
        self.second = [torch.zeros_like(p) for p in parameters]
        self.steps = 0

    def state(self) -> dict[str, Any]:
        """Parameters and moments (the tensors themselves), and the number of steps."""
        return {"parameters": self.parameters, "first": self.first, "second": self.second, "steps": self.steps}

    @torch.no_grad()
    def restore(self, kept: Mapping[str, Any]) -> None:
        """Take over the values of `state`."""
        for name in ("parameters", "first", "second"):
            for tensor, value in zip(getattr(self, name), kept[name], strict=True):
                tensor.copy_(value)
        self.steps = kept["steps"]

    @torch.no_grad()
    def forget(self) -> None:
        """Begin anew where the parameters are, with the moments of none of the steps before."""
        for moment in (*self.first, *self.second):
            moment.zero_()
        self.steps = 0

    def step(self, scale: float = 1.0) -> None:
        """One update with all rates multiplied by `scale`; consumes the gradients."""
        self.steps += 1
        for parameter, rate, m, v in zip(self.parameters, self.rates, self.first, self.second, strict=True):
            if parameter.grad is not None:
                gradient, parameter.grad = parameter.grad, None
                adam_step(
                    parameter, gradient, m, v, self.steps, scale * rate, betas=self.betas, epsilon=self.eps,
                    torch_rounding=True,
                )  # fmt: skip
