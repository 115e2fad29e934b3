"""Smoothness of Stage I: what `stage1.refine` takes as its `smoothness` (L_s of the paper's loss)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from exmesh_graph.graph import Component, component, param

if TYPE_CHECKING:
    from exmesh_graph.stage1 import regularise


class Smoothness(Component):
    """Base of what keeps the surface smooth."""

    def made(self) -> regularise.Smoothness:
        """The regulariser that the loop calls."""
        raise NotImplementedError


@component("regulariser.laplacian", version="1", libraries=("torch",))
class Laplacian(Smoothness):
    """The paper's Laplacian, divided by the squared mean edge length."""

    weight: float = param(0.3, ge=0, doc="Weight of L_s in its scale-free form; 0: no smoothness.")

    def made(self) -> regularise.Smoothness:
        from exmesh_graph.stage1.regularise import Laplacian

        return Laplacian(self.weight)


@component("regulariser.bilaplacian", version="1", libraries=("torch",))
class Bilaplacian(Smoothness):
    """The Laplacian's square, which does not shrink round shapes; the default."""

    weight: float = param(0.3, ge=0, doc="Weight of L_s in its scale-free form; 0: no smoothness.")

    def made(self) -> regularise.Smoothness:
        from exmesh_graph.stage1.regularise import Bilaplacian

        return Bilaplacian(self.weight)


@component("regulariser.large_steps", version="1", libraries=("torch", "scipy"))
class LargeSteps(Smoothness):
    """Preconditioned steps (Nicolet et al. 2021): smooth motions are fast, noise is damped, no term in the loss."""

    strength: float = param(19.0, ge=0, doc="lambda of the paper; the filter reaches about its root, in edges.")

    def made(self) -> regularise.Smoothness:
        from exmesh_graph.stage1.large_steps import LargeSteps

        return LargeSteps(self.strength)
