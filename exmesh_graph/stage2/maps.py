"""The optimised material maps: one table of the texels that pixels or light read, and what pixels read from it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.moving import turned
from exmesh_graph.stage2.init import NARROW_MARGIN, logit, resize_texture
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.surface import slopes_of
from exmesh_graph.types import Asset

#: How far past 1 the sigmoid of roughness reaches, as a share of its span. A sigmoid that ends at 1 would need an
#: infinite parameter for a matt surface (docs/stage2_trials.md).
PAST_ONE = 0.02

#: Where metallic starts that the start does not give. Nearer to 0 its sigmoid is flat: metal is found late or never;
#: from 0.5 much that is no metal stays half of one (docs/stage2_trials.md).
START_METALLIC = 0.2

#: What base colour is raised by before its logarithm is taken: in what is nearly black, steps say little.
LOG_FLOOR = 0.02

#: Slope of the normal map per unit of its parameter, so that one learning rate serves all maps.
SLOPE = 0.1


@dataclass(frozen=True)
class Material:
    """What N points read from the maps: `table` [N, C], one column per channel."""

    table: torch.Tensor
    has_metallic: bool
    has_normal: bool = False

    @property
    def base_color(self) -> torch.Tensor:
        """[N, 3], linear."""
        return self.table[:, :3]

    @property
    def roughness(self) -> torch.Tensor:
        """[N]."""
        return self.table[:, 3]

    @property
    def metallic(self) -> torch.Tensor | None:
        """[N]; None: a dielectric."""
        return self.table[:, 4] if self.has_metallic else None

    @property
    def slopes(self) -> torch.Tensor | None:
        """[N, 2], of the normal map (stage2.surface); None: the smooth normals."""
        return self.table[:, -2:] if self.has_normal else None

    def varied(self, settings: DecompositionSettings) -> torch.Tensor:
        """What the materials' total variation is taken of, [N, C].

        Of a base colour's logarithm (`variation: log`) it is the same for bright and dark paint, and a common factor of
        base colour and light leaves it as it is.

        Equation: 23.
        """
        color = self.base_color
        if settings.variation == "log":
            color = (color + LOG_FLOOR).log()
        return torch.cat([color, settings.gloss_weight * self.table[:, 3:]], dim=1)


@dataclass(frozen=True)
class Footprint:
    """Where N points read: rows int32 [N, 4] of a table of texels, weight [N, 4], and order int32 [N], the points by
    ascending first row.

    The rows are two pairs of texels side by side, the upper pair's first: where one side of the table's square is
    longer than a texel, each second row of a pair is the one after the first.
    """

    rows: torch.Tensor
    weight: torch.Tensor
    order: torch.Tensor

    @classmethod
    def of(cls, rows: torch.Tensor, weight: torch.Tensor) -> Footprint:
        rows = rows.to(torch.int32).contiguous()
        return cls(rows, weight.contiguous(), torch.argsort(rows[:, 0], stable=True).to(torch.int32))


class MaterialMaps:
    """The free parameters of T texels and the maps they stand for.

    texels     int64 [T], ascending: flat positions in the size x size maps; all others stay out of the fit
    spare      memory [T, C] of a gradient that is no longer wanted, for the next one (None: none)
    extreme    address, version and largest |value| of a gradient that was just computed, where known (fused.maps)
    parameter  [T, C] leaf; columns: base colour 3, roughness, (metallic), each the logit of its map; (the normal map's
               two slopes over `SLOPE`)
    """

    def __init__(self, start: Asset, texels: torch.Tensor, size: int, settings: DecompositionSettings) -> None:
        self.texels, self.size, self.settings = texels, size, settings
        device = texels.device

        def texels_of(image: np.ndarray) -> torch.Tensor:
            resized = resize_texture(image.reshape(*image.shape[:2], -1), size)
            return resized.reshape(size * size, -1)[texels.cpu()].to(device)

        columns = [logit(texels_of(start.base_color), NARROW_MARGIN), self.of_roughness(texels_of(start.roughness))]
        if settings.metallic:
            if start.metallic is None:
                columns.append(logit(texels_of(np.full((1, 1), START_METALLIC, np.float32))))
            else:
                columns.append(logit(texels_of(start.metallic), NARROW_MARGIN))
        if settings.normal_map:
            flat = np.zeros((1, 1, 2), np.float32)
            columns.append(texels_of(flat if start.normal is None else slopes_of(start.normal)) / SLOPE)
        self.parameter = torch.cat(columns, dim=1).requires_grad_()
        self.spare: torch.Tensor | None = None
        self.extreme: tuple[int, int, float] | None = None

    @torch.no_grad()
    def polish(self, most: float) -> None:
        """Make every texel as smooth as a roughness of `most` at least."""
        self.parameter[:, 3].clamp_(max=float(self.of_roughness(torch.tensor(most))))

    def values(self) -> torch.Tensor:
        """Base colour, roughness (metallic, slopes) of the texels, [T, 4 to 7]; differentiable in `parameter`."""
        count = 5 if self.settings.metallic else 4
        values = torch.sigmoid(self.parameter[:, :count])
        low = self.settings.roughness_min
        raw = low + (1 - low) * (1 + PAST_ONE) * values[:, 3:4]
        roughness = raw - (raw - 1).clamp_min(0).detach()  # cut at 1; the gradient passes, so that it can come back
        slopes = SLOPE * self.parameter[:, count:]
        return torch.cat([values[:, :3], roughness, values[:, 4:], slopes], dim=1)

    def of_roughness(self, roughness: torch.Tensor) -> torch.Tensor:
        """The parameter whose value is `roughness`."""
        low = self.settings.roughness_min
        return logit((roughness - low) / ((1 - low) * (1 + PAST_ONE)), NARROW_MARGIN)

    def undecided(self) -> torch.Tensor:
        """Mean of m (1 - m) over the texels' metallic m, a scalar: 0 where each is metal or none."""
        metallic = torch.sigmoid(self.parameter[:, 4])
        return (metallic * (1 - metallic)).mean()

    def read(self, values: torch.Tensor, index: torch.Tensor, weight: torch.Tensor) -> Material:
        """The material at N points from `values` and the points' texel rows int64 [N, 4] and weights [N, 4].

        Equation: 10.
        """
        return self.material(gather_rows(values, index, weight))

    def material(self, table: torch.Tensor) -> Material:
        """The material that `table` [N, C], read from the maps, holds."""
        return Material(table, self.settings.metallic, self.settings.normal_map)

    def rows(self, flat: torch.Tensor) -> torch.Tensor:
        """Rows int32 of the table of flat texel positions. Raises ValueError for one that is not among `texels`: what
        reads the rows does not look where they lead."""
        rows = self._row_of[flat]
        if rows.numel() and int(rows.min()) < 0:
            raise ValueError(f"texel {int(flat[rows < 0][0])} of maps of side {self.size} is not part of the fit")
        return rows

    @cached_property
    def _row_of(self) -> torch.Tensor:
        """int32 [size * size]; what is not among `texels` has no row."""
        rows = torch.full((self.size**2,), -1, dtype=torch.int32, device=self.texels.device)
        rows[self.texels] = torch.arange(len(self.texels), dtype=torch.int32, device=rows.device)
        return rows


@dataclass(frozen=True)
class Appearance:
    """Maps and environment as one step of a fit has them: what a light model computes from.

    values       [T, C], MaterialMaps.values()
    environment  [H, W, 3], radiance
    strength     lambda_ind of eq. 20
    turns        how each view turns the environment (shading.moving.light_turns); None: it stands still
    """

    maps: MaterialMaps
    values: torch.Tensor
    environment: torch.Tensor
    strength: float = 1.0
    step: int = 0
    turns: np.ndarray | None = None

    def seen_by(self, number: int) -> Appearance:
        """The same with the environment as it stands in the world when view `number` is taken."""
        if self.turns is None:
            return self
        return replace(self, environment=turned(self.environment, self.turns[number]), turns=None)
