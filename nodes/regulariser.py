"""Smoothness of Stage I: what `stage1.refine` takes as its `smoothness` (L_s of the paper's loss)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from exmesh_graph.graph import Component, component
from exmesh_graph.stage1 import large_steps, smoothness

if TYPE_CHECKING:
    import torch

    from exmesh_graph.raster import EdgeTable
    from exmesh_graph.stage1.regularise import PreparedSmoothness


class Smoothness(Component):
    """Base of what keeps the surface smooth; an `exmesh_graph.stage1.regularise.Smoothness`."""

    def prepare(self, vertices: torch.Tensor, table: EdgeTable, pixels: float) -> PreparedSmoothness | None:
        """Of the start's vertices [V, 3] and edges, of which the mean one spans `pixels` of the photographs; None where
        there is nothing to do."""
        raise NotImplementedError


@component("regulariser.laplacian", version="1", libraries=("torch", "warp-lang"))
class Laplacian(smoothness.Laplacian, Smoothness):
    """The paper's Laplacian, divided by the squared mean edge length."""


@component("regulariser.bilaplacian", version="1", libraries=("torch", "warp-lang"))
class Bilaplacian(smoothness.Bilaplacian, Smoothness):
    """The Laplacian's square, which does not shrink round shapes; the default."""


@component("regulariser.large_steps", version="1", libraries=("torch", "scipy", "warp-lang"))
class LargeSteps(large_steps.LargeSteps, Smoothness):
    """Preconditioned steps (Nicolet et al. 2021): smooth motions are fast, noise is damped, no term in the loss."""
