"""The smoothness terms that Stage I can be given (see `regularise`), with their parameters. Loads no torch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from exmesh_graph.params import Params, param

if TYPE_CHECKING:
    import torch

    from exmesh_graph.raster import EdgeTable
    from exmesh_graph.stage1.regularise import PreparedSmoothness


_LEAST = 0.25
"""Share of the weight on long edges: what they take away is bounded by what was measured (docs/stage1_trials.md)."""


class Laplacian(Params):
    """The paper's L_s times `weight`; a `regularise.Smoothness`."""

    weight: float = param(0.3, ge=0, doc="Weight of L_s, per square of `units`; 0: no smoothness.")
    units: Literal["edges", "world"] = param(
        "edges", doc="What distances are measured in: mean edge lengths, or units of the normalised world (the paper)."
    )

    def prepare(self, vertices: torch.Tensor, table: EdgeTable, pixels: float) -> PreparedSmoothness | None:
        from exmesh_graph.stage1.regularise import mean_edge, weighted

        square = mean_edge(vertices, table.edges) ** 2 if self.units == "world" else 1.0
        return weighted("laplacian", self.weight * square, vertices, table.edges)


class Bilaplacian(Params):
    """Its square, which does not shrink round shapes, times `weight`, and how much normals vary, times `normals`; a
    `regularise.Smoothness`."""

    weight: float = param(0.3, ge=0, doc="Weight of L_s in its scale-free form; 0: none.")
    edge: float = param(
        0.0,
        ge=0,
        unit="pixels",
        doc="Edge that the weight suits: where edges span more pixels, it falls with their square, to a quarter at "
        "most; 0: any edge.",
    )
    normals: float = param(
        0.0, ge=0, doc="Weight of how much normals vary beside it: walls come out flat, creases stay. 0: none."
    )
    normals_width: float = param(
        0.02,
        gt=0,
        unit="rad",
        doc="Bends between two faces below this cost by their square, so that round stays round.",
    )

    def prepare(self, vertices: torch.Tensor, table: EdgeTable, pixels: float) -> PreparedSmoothness | None:
        from exmesh_graph.stage1.normals import beside, normal_variation
        from exmesh_graph.stage1.regularise import mean_edge, weighted

        smooth = weighted("bilaplacian", self.weight * self.share(pixels), vertices, table.edges)
        if self.normals == 0:
            return smooth
        pixel = mean_edge(vertices, table.edges) / pixels
        return beside(smooth, self.normals, normal_variation(vertices, table, pixel, self.normals_width))

    def share(self, pixels: float) -> float:
        """Of the weight, where the mean edge spans so many pixels: as many times more of them tell where it lies."""
        if self.edge == 0 or pixels <= self.edge:
            return 1.0
        return max(_LEAST, (self.edge / pixels) ** 2)
