"""Which views do not fit the surface that all of them made: a wrong camera, a wrong mask, another exposure.

Every view is compared with the rendering of the finished round by robust figures; a view is suspect where one of them
lies far outside those of the other views (median and median absolute deviation) and matters in itself. Exposure needs
no majority: any view that is a quarter of a stop off is named.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch

from exmesh_graph.gpu.cores import share
from exmesh_graph.stage1.appearance.model import Surface
from exmesh_graph.stage1.render import draw
from exmesh_graph.targets import Targets, fit_gain

_FAR = 6.0  # robust standard deviations
_SHIFT = 1.5  # pixels: less may be the surface's own error
_MASK = 0.02  # of the mask's area
_STOPS = 0.25
_COLOUR = 0.02  # display units, root mean square
_DARK = 0.03  # display units: colour that says nothing


class Residuals(NamedTuple):
    """What N views say about a surface, float64 [N] unless noted; NaN where a figure means nothing.

    stops   exposure against the surface's own colours, in powers of two of display values
    colour  root mean square of the colours after that, inside the mask and the surface
    mask    part of the mask's area on which mask and coverage disagree
    bias    coverage less mask, as part of the mask's area: positive where the mask is too small
    shift   [N, 2], pixels (right, down) by which the photograph lies beside the rendering
    light   mean display value of the photograph on the surface
    """

    stops: torch.Tensor
    colour: torch.Tensor
    mask: torch.Tensor
    bias: torch.Tensor
    shift: torch.Tensor
    light: torch.Tensor


@torch.no_grad()
def residuals(surface: Surface, targets: Targets) -> Residuals:
    """The figures of every view of `targets` against `surface`."""
    pictures = ((targets.images[i], targets.alpha[i]) for i in range(len(targets)))
    figures = torch.stack(share(lambda i, seen: _of_view(surface, targets, i, *seen), range(len(targets)), pictures))
    stops, colour, mask, bias, right, down, light = figures.T
    return Residuals(stops, colour, mask, bias, torch.stack([right, down], dim=1), light)


@torch.no_grad()
def _of_view(surface: Surface, targets: Targets, i: int, target: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """float64 [7]: stops, colour, mask, bias, shift, light of view `i`, which took `target` [H, W, 3]."""
    picture = draw(surface, targets.intrinsics[i], targets.world_to_camera[i], targets.height, targets.width)
    cover = picture.alpha
    both = (mask > 0.5) & (cover > 0.5)
    row = torch.full((7,), math.nan, dtype=torch.float64)
    if int(both.sum()) >= 16:
        gain = fit_gain(picture.colour, target, both.to(target), torch.ones(3).to(target), rate=1.0)
        row[0] = float(gain.mean().log2())
        row[1] = float((picture.colour * gain - target)[both].square().mean().sqrt())
        row[6] = float(target[both].mean())
    if bool(targets.masked[i]):
        area = max(float(mask.sum()), 1.0)
        row[2], row[3] = float((cover - mask).abs().sum()) / area, float((cover - mask).sum()) / area
        row[4:6] = phase_shift(cover, mask)
    elif int(both.sum()) >= 16:
        row[4:6] = phase_shift(picture.colour.mean(dim=-1), target.mean(dim=-1), cover)
    return row


def diagnose(surface: Surface, targets: Targets, *, gains: bool = False) -> dict[str, Any]:
    """{"suspects": {view: what looks wrong and what to do}, "dark": views in which the object is almost black, so that
    only the mask shapes it}.

    gains  exposures are fitted, so they may differ
    With fewer than four views there is no majority to judge by: none is suspect.
    """
    figures = residuals(surface, targets)
    dark = [name for name, value in zip(targets.names, figures.light.tolist(), strict=True) if value < _DARK]
    return {"suspects": _suspects(figures, targets, gains) if len(targets) >= 4 else {}, "dark": dark}


def phase_shift(one: torch.Tensor, two: torch.Tensor, weight: torch.Tensor | None = None) -> torch.Tensor:
    """float64 [2], pixels (right, down) by which picture `two` [H, W] lies beside `one`: phase correlation.

    weight  [H, W], where to look (None: everywhere). Whole pixels, refined by a parabola through the peak. NaN for
    pictures without any contrast.
    """
    a, b = one.double(), two.double()
    if weight is not None:
        spread = torch.nn.functional.max_pool2d(weight[None, None].double(), 9, 1, 4)[0, 0]
        a, b = (picture * spread - spread * (picture * spread).sum() / spread.sum() for picture in (a, b))
    height, width = a.shape
    cross = torch.fft.rfft2(b) * torch.fft.rfft2(a).conj()
    strength = cross.abs()
    if float(strength.max()) <= 1e-12:
        return torch.full((2,), math.nan, dtype=torch.float64)
    # full whitening lifts the noise of weak frequencies to the peak's height: the square root keeps some weight
    peak = torch.fft.irfft2(cross / strength.clamp(min=1e-6 * float(strength.max())).sqrt(), s=(height, width))
    at = int(peak.argmax())
    row, column = divmod(at, width)
    peaks = []
    for place, line in ((column, peak[row]), (row, peak[:, column])):
        before, here, after = (float(line[(place + step) % len(line)]) for step in (-1, 0, 1))
        bend = before - 2 * here + after
        fine = place + (0.5 * (before - after) / bend if bend < 0 else 0.0)
        peaks.append((fine + len(line) / 2) % len(line) - len(line) / 2)
    return torch.tensor(peaks, dtype=torch.float64)


def _suspects(figures: Residuals, targets: Targets, gains: bool) -> dict[str, str]:
    size = figures.shift.norm(dim=1)
    stops = figures.stops - figures.stops.nanmedian()
    far_shift, far_mask, far_colour = _far(size, _SHIFT), _far(figures.mask, _MASK), _far(figures.colour, _COLOUR)
    words = {}
    for i, name in enumerate(targets.names):
        focal = float(targets.intrinsics[i, 0, 0])
        if bool(figures.stops[i].isnan()) and bool(size[i].isnan()):
            words[name] = "its camera does not see the object: correct its pose, or leave the view out"
        elif far_shift[i]:
            right, down = figures.shift[i].tolist()
            angle = math.degrees(math.atan(float(size[i]) / focal))
            words[name] = (
                f"the photograph lies {float(size[i]):.1f} pixels beside the rendering ({right:+.1f} right, "
                f"{down:+.1f} down), as if its camera were turned by {angle:.1f} degrees: correct its pose, "
                "or leave the view out, or let the hull bear it (init.visual_hull, wrong_masks: 1)"
            )
        elif far_mask[i]:
            much = "covers more than" if figures.bias[i] < 0 else "leaves out parts of"
            words[name] = (
                f"mask and rendering differ by {float(figures.mask[i]):.0%} of the mask, which {much} the object (or "
                f"its camera is wrong): look at the mask, or leave the view out"
            )
        elif not gains and abs(float(stops[i])) > _STOPS:
            words[name] = (
                f"it is {2.0 ** float(stops[i]):.2f} times as bright as the other views: fit one gain for each view "
                f"(stage1.refine, gains: true), or correct its exposure, unless gloss of the object fills it"
            )
        elif far_colour[i]:
            words[name] = (
                f"its colours differ by {float(figures.colour[i]):.3f}, the others by "
                f"{float(figures.colour.nanmedian()):.3f}, though its outline fits: look for a moved light, "
                "a shadow, a blurred picture"
            )
    return words


def _far(values: torch.Tensor, least: float) -> list[bool]:
    """Which values lie far above the middle of all, and are at least `least` above it. NaN never does."""
    middle = values.nanmedian()
    spread = 1.4826 * float((values - middle).abs().nanmedian())
    return [float(v) > float(middle) + max(_FAR * spread, least) for v in values]
