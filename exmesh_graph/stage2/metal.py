"""Metal by colour: what some texels of a colour show to be metal, the others are as well.

Metal that mirrors nothing sharp looks much like paint of its colour, and each texel decides alone: of a sheet of steel
a part ends as metal, the rest as gray paint, and the light makes up for it with more contrast and more colour than the
sky has. But paint hardly ever ends as metal by mistake. So a share of metal among texels of like colour, far below one
half, tells what all of them are; what is none after all, the pictures bring back. Dark texels tell nothing: a coat
mirrors 0.04 of the light, as a black metal would, and no bare metal is black.
"""

from __future__ import annotations

import torch

from exmesh_graph.stage2.init import logit
from exmesh_graph.stage2.maps import MaterialMaps
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.together import like_mean

#: When texels agree, as a share of the fit's steps: light and colours are found, and can still follow. For how long
#: base colour and roughness then wait: paint that was taken for metal comes back before its roughness hides that.
WHEN, WAIT = 0.5, 0.1
#: What a texel that joins the metals starts again from; 1 less it, what a dark one does.
JOINED = 0.9
#: Mean of a base colour's channels from which metals are bare, and below which there is none.
BRIGHT, BLACK = 0.2, 0.15
#: Cells of like colour, of the logarithm of base colour.
CELL = 0.3


def agrees(settings: DecompositionSettings) -> bool:
    """Whether texels agree at all."""
    return settings.metallic and settings.metal_share > 0


def agreeing(settings: DecompositionSettings, step: int) -> bool:
    """Whether texels agree before this step."""
    return agrees(settings) and step == round(WHEN * settings.iterations)


def metal_alone(settings: DecompositionSettings, step: int) -> bool:
    """Whether of the maps metallic alone moves in this step."""
    since = step - round(WHEN * settings.iterations)
    return agrees(settings) and 0 <= since < WAIT * settings.iterations


@torch.no_grad()
def agree_on_metal(maps: MaterialMaps, seen: torch.Tensor, share: float) -> int:
    """Raise metallic where more than `share` of what is alike is metal, lower it where base colour is black.

    seen  float [T], how much pixels tell of each texel (`gbuffer.Evidence.weight`)
    Returns how many texels changed sides of one half.
    """
    values = maps.values().double().cpu().numpy()
    color, metallic = values[:, :3], values[:, 4]
    mean = like_mean(color, metallic, seen.double().cpu().numpy(), CELL)
    level = color.mean(axis=1)
    joined = torch.from_numpy((mean > share) & (level > BRIGHT)).to(seen.device)
    black = torch.from_numpy(level < BLACK).to(seen.device)
    column = maps.parameter[:, 4]
    end = float(logit(torch.tensor(JOINED)))
    moved = torch.where(joined, column.clamp_min(end), torch.where(black, column.clamp_max(-end), column))
    changed = int(((moved > 0) != (column > 0)).sum())
    maps.parameter[:, 4] = moved
    return changed
