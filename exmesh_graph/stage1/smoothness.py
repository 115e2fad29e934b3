"""The smoothness terms that Stage I can be given (see `regularise`), with their parameters. Loads no torch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from exmesh_graph.params import Params, param

if TYPE_CHECKING:
    import torch

    from exmesh_graph.stage1.regularise import PreparedSmoothness


_LEAST = 0.25
"""Share of the weight on long edges: what they take away is bounded by what was measured (docs/stage1_trials.md)."""


class Laplacian(Params):
    """The paper's L_s times `weight`; a `regularise.Smoothness`."""

    weight: float = param(0.3, ge=0, doc="Weight of L_s, per square of `units`; 0: no smoothness.")
    units: Literal["edges", "world"] = param(
        "edges", doc="What distances are measured in: mean edge lengths, or units of the normalised world (the paper)."
    )

    def prepare(self, vertices: torch.Tensor, edges: torch.Tensor, pixels: float) -> PreparedSmoothness | None:
        from exmesh_graph.stage1.regularise import mean_edge, weighted

        square = mean_edge(vertices, edges) ** 2 if self.units == "world" else 1.0
        return weighted("laplacian", self.weight * square, vertices, edges)


class Bilaplacian(Params):
    """Its square, which does not shrink round shapes, times `weight`; a `regularise.Smoothness`."""

    weight: float = param(0.3, ge=0, doc="Weight of L_s in its scale-free form; 0: no smoothness.")
    edge: float = param(
        0.0,
        ge=0,
        unit="pixels",
        doc="Edge that the weight suits: where edges span more pixels, it falls with their square, to a quarter at "
        "most; 0: any edge.",
    )

    def prepare(self, vertices: torch.Tensor, edges: torch.Tensor, pixels: float) -> PreparedSmoothness | None:
        from exmesh_graph.stage1.regularise import weighted

        return weighted("bilaplacian", self.weight * self.share(pixels), vertices, edges)

    def share(self, pixels: float) -> float:
        """Of the weight, where the mean edge spans so many pixels: as many times more of them tell where it lies."""
        if self.edge == 0 or pixels <= self.edge:
            return 1.0
        return max(_LEAST, (self.edge / pixels) ** 2)
