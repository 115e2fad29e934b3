"""Metal by colour and place: what some texels show to be metal, those about them are as well.

Metal that mirrors nothing sharp looks much like paint of its colour, and each texel decides alone: of a sheet of steel
a part ends as metal, the rest as gray paint, and the light makes up for it with more contrast and more colour than the
sky has. But paint hardly ever ends as metal by mistake. So a share of metal among texels of like colour, far below one
half, tells what all of them are that have some of it near; what is none after all, the pictures bring back. Dark texels
tell nothing: a coat mirrors 0.04 of the light, as a black metal would, and no bare metal is black. But where a mirror
shows what is dark, or a dent bends it, metal is found as dark paint, whose colour is none of the metal's: so what lies
among metal on all sides is metal too, whatever its colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from exmesh_graph.geometry.adjacency import face_areas
from exmesh_graph.stage2.init import logit
from exmesh_graph.stage2.maps import MaterialMaps
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.together import colour_cells, means_about
from exmesh_graph.types import Carrier
from exmesh_graph.uv.surface import texel_surface

#: When texels agree, as a share of the fit's steps: light and colours are found, and can still follow. For how long
#: base colour and roughness then wait: paint that was taken for metal comes back before its roughness hides that.
WHEN, WAIT = 0.5, 0.1
#: When they are asked again what lies about them, for pictures bring dark spots back.
AGAIN = (0.7, 0.85)
#: What a texel that joins the metals starts again from; 1 less it, what a dark one does.
JOINED = 0.9
#: Mean of a base colour's channels from which metals are bare, and below which there is none.
BRIGHT, BLACK = 0.2, 0.15
#: Cells of like colour, of the logarithm of base colour; and of what is not far away, of the object's size.
CELL, NEAR = 0.3, 0.1
#: The share of metal that there must be near, of that among all.
LEAST = 0.4
#: What lies about a texel, in texels, and the share of metal from which it is one; cells along the object at most.
ABOUT, MOST, FINEST = 3.0, 0.5, 200


@dataclass(frozen=True)
class Places:
    """Where T texels lie: position float64 [T, 3] in the carrier's units; size, half the diagonal of a box around them;
    spacing, from texel to texel."""

    position: np.ndarray
    size: float
    spacing: float

    @classmethod
    def of(cls, carrier: Carrier, maps: MaterialMaps) -> Places:
        surface = texel_surface(carrier, maps.size)
        position = surface.position.reshape(-1, 3)[maps.texels.cpu().numpy()].astype(np.float64)
        area = face_areas(carrier.vertices, carrier.faces).sum()
        size = float(np.linalg.norm(np.ptp(position, axis=0))) / 2
        return cls(position, size, float(np.sqrt(area / len(position))))

    @property
    def near(self) -> np.ndarray:
        """Cells [T, 3] of what is not far away."""
        return self.position / (NEAR * self.size)

    @property
    def about(self) -> np.ndarray:
        """Cells [T, 3] of what lies about a texel."""
        return self.position / max(ABOUT * self.spacing, 2 * self.size / FINEST)


def agrees(settings: DecompositionSettings) -> bool:
    """Whether texels agree at all."""
    return settings.metallic and settings.metal_share > 0


def agreeing(settings: DecompositionSettings, step: int) -> int:
    """Which time texels agree before this step, from 1 on; 0: not before this one."""
    steps = [round(when * settings.iterations) for when in (WHEN, *AGAIN)]
    return steps.index(step) + 1 if agrees(settings) and step in steps else 0


def metal_alone(settings: DecompositionSettings, step: int) -> bool:
    """Whether of the maps metallic alone moves in this step."""
    since = step - round(WHEN * settings.iterations)
    return agrees(settings) and 0 <= since < WAIT * settings.iterations


@torch.no_grad()
def agree_on_metal(
    maps: MaterialMaps, seen: torch.Tensor, share: float, places: Places | None = None, again: bool = False
) -> int:
    """Raise metallic where more than `share` of what is alike is metal, some of it near, or most of what lies about a
    texel; lower it where base colour is black.

    seen    float [T], how much pixels tell of each texel (`gbuffer.Evidence.weight`)
    places  of the texels; None: colour alone decides, as where a few texels are a part of the object
    again   only what lies about a texel counts, and nothing is lowered
    Returns how many texels changed sides of one half.
    """
    values, weight = maps.values().double().cpu().numpy(), seen.double().cpu().numpy()
    color, metallic = values[:, :3], values[:, 4]
    joined = black = np.zeros(len(values), bool)
    if places is not None:
        joined = means_about(places.about, metallic, weight) > MOST
    if not again:
        alike, level = colour_cells(color, CELL), color.mean(axis=1)
        found = (means_about(alike, metallic, weight) > share) & (level > BRIGHT)
        if places is not None:
            near = np.concatenate([alike, places.near], axis=1)
            found &= means_about(near, metallic, weight) > LEAST * share
        black = (level < BLACK) & ~joined
        joined = joined | found
    column, end = maps.parameter[:, 4], float(logit(torch.tensor(JOINED)))
    up, down = (torch.from_numpy(which).to(column.device) for which in (joined, black))
    moved = torch.where(up, column.clamp_min(end), torch.where(down, column.clamp_max(-end), column))
    changed = int(((moved > 0) != (column > 0)).sum())
    maps.parameter[:, 4] = moved
    return changed
