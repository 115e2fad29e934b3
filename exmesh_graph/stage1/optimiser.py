"""Adam in the two forms Stage I uses; the moments are plain tensors, so that they travel with the state."""

from __future__ import annotations

import torch

VERTEX_BETAS = (0.9, 0.99)
TEXTURE_BETAS = (0.9, 0.99)
EPSILON = 1e-15
"""Far below any gradient of a mean over an image; it only keeps 0 / 0 from happening."""


@torch.no_grad()
def vertex_step(
    vertices: torch.Tensor,
    gradient: torch.Tensor,
    first: torch.Tensor,
    second: torch.Tensor,
    step: int,
    rate: float,
    betas: tuple[float, float] = VERTEX_BETAS,
    *,
    uniform: bool = False,
) -> None:
    """Adam on vertices [V, 3] with one second moment per vertex [V], the mean of |g|^2: in place.

    Sharing it over x, y, z makes the step turn with the object, and points it along the gradient. `step` counts from
    1; `rate` is the length of a step under a steady gradient, in world units. `uniform`: every vertex is divided by
    the largest of the second moments (AdamUniform of "Large Steps").
    """
    b1, b2 = betas
    first.lerp_(gradient, 1 - b1)
    second.lerp_(gradient.square().sum(1), 1 - b2)
    known = second.amax().expand_as(second) if uniform and len(second) else second
    scale = (known / (1 - b2**step)).sqrt_().add_(EPSILON)
    vertices.addcdiv_(first, scale[:, None], value=-rate / (1 - b1**step))


@torch.no_grad()
def texture_step(
    texture: torch.Tensor,
    gradient: torch.Tensor,
    first: torch.Tensor,
    second: torch.Tensor,
    step: int,
    rate: float,
    betas: tuple[float, float] = TEXTURE_BETAS,
    epsilon: float = EPSILON,
) -> None:
    """Adam on texels, then projection to [0, 1]: in place. Clamping after the step leaves no dead gradient.

    `epsilon` is the gradient below which steps shorten: a texel that bilinear lookups merely graze would otherwise
    run about at full speed on a trace of a gradient, and stand out as a speck of wrong colour.
    """
    b1, b2 = betas
    first.lerp_(gradient, 1 - b1)
    second.mul_(b2).addcmul_(gradient, gradient, value=1 - b2)
    scale = (second / (1 - b2**step)).sqrt_().add_(epsilon)
    texture.addcdiv_(first, scale, value=-rate / (1 - b1**step)).clamp_(0, 1)


def vertex_areas(vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """A third of the area of the faces around each vertex [V], held above 1e-3 of the mean.

    A vertex's gradient is proportional to the surface it carries. Adam's moments of gradient / area therefore mean
    the same before and after a split, where those of the raw gradient would be stale for 1 / (1 - beta) iterations
    and the steps too short by the factor that areas fell.
    """
    corners = vertices.double()[faces.long()]
    area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1) / 6
    total = area.new_zeros(len(vertices))
    for k in range(3):
        total.index_add_(0, faces[:, k].long(), area)
    floor = 1e-3 * total.mean() + torch.finfo(total.dtype).tiny
    return total.clamp(min=floor).to(vertices.dtype)
