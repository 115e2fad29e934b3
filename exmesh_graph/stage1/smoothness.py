"""The smoothness terms that Stage I can be given (see `regularise`), with their parameters. Loads no torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from exmesh_graph.params import Params, param

if TYPE_CHECKING:
    import torch

    from exmesh_graph.stage1.regularise import PreparedSmoothness


class Laplacian(Params):
    """The paper's L_s in its scale-free form, times `weight`; a `regularise.Smoothness`."""

    weight: float = param(0.3, ge=0, doc="Weight of L_s in its scale-free form; 0: no smoothness.")

    def prepare(self, vertices: torch.Tensor, edges: torch.Tensor) -> PreparedSmoothness | None:
        from exmesh_graph.stage1.regularise import weighted

        return weighted("laplacian", self.weight, vertices, edges)


class Bilaplacian(Params):
    """Its square, which does not shrink round shapes, times `weight`; a `regularise.Smoothness`."""

    weight: float = param(0.3, ge=0, doc="Weight of L_s in its scale-free form; 0: no smoothness.")

    def prepare(self, vertices: torch.Tensor, edges: torch.Tensor) -> PreparedSmoothness | None:
        from exmesh_graph.stage1.regularise import weighted

        return weighted("bilaplacian", self.weight, vertices, edges)
