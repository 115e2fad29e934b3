"""The factor that base colour and light share, as a parameter of its own per colour channel.

Base colour times s under light divided by s looks the same but for what the coat reflects (F0 = 0.04, whatever the base
colour) and for interreflection. Both tell s, but hardly to Adam: every texel of maps and sky moves by the sign of its
own noisy gradient, and the small common part of those gradients is lost. As one number for all texels it is the
sum of them, and is found in some hundred steps (docs/stage2.md).
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F

#: The share of texels whose base colour the factor must leave below 1, judged from so many of them.
KEPT, JUDGED = 0.95, 2000

#: Base colour that `fold` brightens no further: the logit of 1 does not exist.
BRIGHTEST = 0.98


class CommonFactor:
    """`parameter` [3]: logarithm of what the light gains and base colour loses, over what texels alone say.

    Folding is left to a few moments of a fit: what is brighter than 1 by then is cut, and cut again and again by a
    factor that swings to and fro, bright texels would lose their light.
    """

    def __init__(self, device: torch.device | str = "cpu") -> None:
        self.parameter = torch.zeros(3, device=device, requires_grad=True)

    def share(self, values: torch.Tensor, environment: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The maps' `values` [T, C] and the radiance [H, W, 3] with the factor moved from the first to the second."""
        gain = self.parameter.exp()
        return torch.cat([values[:, :3] / gain, values[:, 3:]], dim=1), environment * gain

    @torch.no_grad()
    def bound(self, maps: torch.Tensor) -> None:
        """Keep the factor from brightening base colours, logits `maps` [T, C], past 1.

        Without it, texels that start near 1 under too dim a sky have a valley of their own: ever brighter base colours
        make up for the missing light by interreflection.
        """
        stride = max(1, len(maps) // JUDGED)
        logits = torch.quantile(maps[::stride, :3], KEPT, dim=0)
        self.parameter.copy_(torch.maximum(self.parameter, F.logsigmoid(logits)))

    @torch.no_grad()
    def fold(self, maps: torch.Tensor, environment: torch.Tensor) -> None:
        """Move the factor into the logits `maps` [T, C] and the softplus parameters [H, W, 3], in place."""
        color = F.logsigmoid(maps[:, :3])
        folded = color - self.parameter
        folded = torch.minimum(folded, color.clamp_min(math.log(BRIGHTEST)))
        maps[:, :3] = torch.where(folded == color, maps[:, :3], folded - torch.log(-torch.expm1(folded)))
        radiance = F.softplus(environment) * self.parameter.exp()
        lit = radiance > 0  # a parameter so low that its radiance is 0 stays
        radiance = torch.where(lit, radiance, torch.ones_like(radiance))
        environment.copy_(torch.where(lit, radiance + torch.log(-torch.expm1(-radiance)), environment))
        self.parameter.zero_()
