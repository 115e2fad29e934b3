"""Priors that a fit of materials can be given, with their parameters. Loads no torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from exmesh_graph.params import Params, param

if TYPE_CHECKING:
    from exmesh_graph.stage2.decomposition import Decomposition


class Alike(Params):
    """Texels of like colour are of like roughness, as far as no highlight tells it; a `stage2.fit.Prior`."""

    doubt: float = param(
        0.1,
        gt=0,
        doc="Variance of fitted roughness over what independent errors of pixels give: TV has taken most away.",
    )

    def settle(self, model: Decomposition) -> str:
        from exmesh_graph.stage2.together import settle_roughness

        return settle_roughness(model, self.doubt)
