"""One factor per view and channel, for photographs whose exposure wanders.

In display space a change of exposure is close to a factor too. The factors are fitted in closed form and divided by
their mean over the views, so that together they cannot brighten the texture.
"""

from __future__ import annotations

import torch

from exmesh_graph.stage1.render import Surface, draw
from exmesh_graph.stage1.targets import Targets

RATE = 0.3
LIMITS = (0.5, 2.0)


def fit_gain(
    image: torch.Tensor, target: torch.Tensor, mask: torch.Tensor, before: torch.Tensor, rate: float = RATE
) -> torch.Tensor:
    """The least-squares factor [3] from `image` to `target` [H, W, 3] inside `mask` [H, W], approached by `rate`.

    Stays at `before` where the image is black.
    """
    weight = mask[..., None]
    power = (weight * image.square()).sum(dim=(0, 1))
    fitted = (weight * image * target).sum(dim=(0, 1)) / power.clamp(min=1e-12)
    fitted = torch.where(power > 1e-6, fitted, before).clamp(*LIMITS)
    return torch.lerp(before, fitted, rate)


@torch.no_grad()
def initial_gains(surface: Surface, targets: Targets) -> torch.Tensor:
    """Factors [N, 3] of all views for the surface as it is."""
    gains = torch.ones((len(targets), 3), device=targets.images.device)
    for i in range(len(targets)):
        picture = draw(surface, targets.intrinsics[i], targets.world_to_camera[i], targets.height, targets.width)
        gains[i] = fit_gain(picture.colour, targets.images[i], targets.alpha[i], gains[i], rate=1.0)
    return gains
