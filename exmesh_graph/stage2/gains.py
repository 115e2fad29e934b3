"""Scalars fitted beside maps and light: the factor that base colour and light share, and one exposure per view.

The common factor: base colour times s under light divided by s looks the same but for what the coat reflects
(F0 = 0.04, whatever the base colour) and for interreflection. Both tell s, but hardly to Adam: every texel of maps and
sky moves by the sign of its own noisy gradient, and the small common part of those gradients is lost. As one number for
all texels it is the sum of them, and settles within some hundred steps (docs/stage2_trials.md).

The exposures, for photographs whose brightness wanders: a view's gain is the factor that brings the rendering to its
photograph. Where the view is visited, the gain's logarithm follows the median over the view's pixels of
log(photograph / rendering), which no highlight moves. Gains enter divided by their median, so that together they cannot
brighten the light and one view's wrong exposure stays its own. They rest for the first part of the fit: before the sky
has its shape, views that look at the bright side would be taken for overexposed ones.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F

from exmesh_graph.shading import envmap
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.init import LUMINANCE

#: What few paints reflect more than; the share of texels whose base colour the factor must leave below it, judged from
#: so many of them; the logarithm within which a channel is held there.
WHITEST, KEPT, JUDGED, HELD = 0.85, 0.95, 2000, 0.01

#: Luminance that base colours have on the whole (their logarithms' mean), and the logarithm by which objects differ: of
#: ten painted scenes for choosing, 0.23 to 0.49. Black plastic and dark glaze lie far below; gloss tells their level.
USUAL, USUAL_SPREAD = 0.33, 0.4

#: Base colour that `fold` brightens no further: the logit of 1 does not exist.
BRIGHTEST = 0.98


class CommonFactor:
    """`parameter` [3]: logarithm of what the light gains and base colour loses, over what texels alone say.
    `least` [3]: what it may not fall below while another channel is held at its bound; -inf where none is.

    Folding is left to a few moments of a fit: what is brighter than 1 by then is cut, and cut again and again by a
    factor that swings to and fro, bright texels would lose their light.
    """

    def __init__(self, device: torch.device | str = "cpu") -> None:
        self.parameter = torch.zeros(3, device=device, requires_grad=True)
        self.least = torch.full((3,), -math.inf, device=device)

    def share(self, values: torch.Tensor, environment: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The maps' `values` [T, C] and the radiance [H, W, 3] with the factor moved from the first to the second."""
        gain = self.parameter.exp()
        return torch.cat([values[:, :3] / gain, values[:, 3:]], dim=1), environment * gain

    def tint(self) -> torch.Tensor:
        """Ones [3] that change as the factor's channels part from their mean: what the sky's colour says to it."""
        part = self.parameter - self.parameter.mean()
        return (part - part.detach()).exp()

    def too_bright(self, maps: torch.Tensor, metallic: torch.Tensor | None = None) -> torch.Tensor:
        """Square of how much brighter than usual base colours, logits `maps` [T, C], are on the whole with this factor,
        in deviations; 0 from `USUAL` down. Differentiable in the factor alone; metal (`metallic` [T], logits) does not
        count.

        Where no highlight tells the level, texels drift up in steps that Adam scales for each by itself; the factor,
        whose gradient is the sum over all pixels, follows a weak pull only where pictures have no say.
        """
        with torch.no_grad():
            logits, paint = _judged(maps, metallic)
            color = torch.sigmoid(logits) @ maps.new_tensor(LUMINANCE)
            level = (paint * color.clamp_min(1e-4).log()).sum() / paint.sum().clamp_min(1e-6)
            painted = paint.mean()
        off = (level - self.parameter.mean() - math.log(USUAL)) / USUAL_SPREAD
        return painted * off.clamp_min(0) ** 2

    @torch.no_grad()
    def bound(self, maps: torch.Tensor, metallic: torch.Tensor | None = None) -> None:
        """Keep base colours, logits `maps` [T, C], and what the factor makes of them at what paint reflects, where
        `metallic` [T] (logits) says metal at 1. From when one channel is held there no other brightens.

        Where no highlight tells the level, base colours grow as far as they may, the light fading. And texels that
        start near 1 under too dim a sky have a valley of their own: ever brighter base colours make up for the missing
        light by interreflection. They grow in all channels alike: with the brightest alone held, the others would
        catch up with it, base colours fade to gray and the light take their hue.
        """
        logits, paint = _judged(maps, metallic)
        past = F.logsigmoid(logits) - math.log(WHITEST) * paint[:, None]
        bound = _quantile(past, KEPT)
        held = self.parameter <= bound + HELD
        began = torch.where(self.least.isinf(), self.parameter, self.least)
        self.least = torch.where(held.any(), began, -math.inf)
        self.parameter.copy_(torch.maximum(self.parameter, torch.where(held, bound, torch.maximum(bound, self.least))))

    @torch.no_grad()
    def fold(self, maps: torch.Tensor, environment: torch.Tensor) -> None:
        """Move the factor into the logits `maps` [T, C] and the sky's parameters [H, W, 3], in place."""
        color = F.logsigmoid(maps[:, :3])
        folded = color - self.parameter
        folded = torch.minimum(folded, color.clamp_min(math.log(BRIGHTEST)))
        maps[:, :3] = torch.where(folded == color, maps[:, :3], folded - torch.log(-torch.expm1(folded)))
        radiance = envmap.radiance_of(environment) * self.parameter.exp()
        positive = radiance > 0  # a parameter so low that its radiance is 0 stays
        least = torch.finfo(radiance.dtype).tiny
        environment.copy_(torch.where(positive, envmap.parameter_of(radiance, least), environment))
        self.least = self.least - self.parameter
        self.parameter.zero_()


def _judged(maps: torch.Tensor, metallic: torch.Tensor | None) -> tuple[torch.Tensor, torch.Tensor]:
    """Base colours' logits [N, 3] of about `JUDGED` texels, evenly taken, and how much of each is paint [N]."""
    stride = max(1, len(maps) // JUDGED)
    logits = maps[::stride, :3]
    return logits, torch.ones_like(logits[:, 0]) if metallic is None else torch.sigmoid(-metallic[::stride])


def _quantile(values: torch.Tensor, share: float) -> torch.Tensor:
    """torch.quantile of each column of `values` [N, C], whose sort takes ten times as long as the largest few."""
    place = share * (len(values) - 1)
    below = int(place)
    largest = values.topk(len(values) - below, dim=0).values
    return torch.lerp(largest[-1], largest[max(len(largest) - 2, 0)], place - below)


#: Share of the measured change that a gain follows at each visit.
RATE = 0.3
#: Share of the fit's steps during which the gains stay at 1.
REST = 0.1
LARGEST = math.log(4.0)
#: Pixels darker than this tell more of noise than of exposure.
DARK = 0.01


class Exposure:
    """Log-gains float32 [N] of N views; `logs` is replaced at each change."""

    def __init__(self, views: int, device: torch.device | str = "cpu") -> None:
        self.logs = torch.zeros(views, device=device)

    def gain(self, number: int) -> torch.Tensor:
        """What to multiply the rendering of a view with."""
        return (self.logs[number] - self.logs.quantile(0.5)).exp()

    @torch.no_grad()
    def follow(self, buffer: ViewBuffer, predicted: torch.Tensor, progress: float) -> None:
        """Move the gain of a view whose rendering, gain included, is `predicted` [N, 3] at this share of the fit."""
        if progress < REST:
            return
        usable = (predicted > DARK) & (buffer.target > DARK) & ~buffer.clipped
        ratio = (buffer.target[usable] / predicted[usable]).log()
        if len(ratio):
            logs = self.logs.clone()
            logs[buffer.number] = (logs[buffer.number] + RATE * ratio.median()).clamp(-LARGEST, LARGEST)
            self.logs = logs
