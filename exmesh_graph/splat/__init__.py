"""Planar Gaussians: a differentiable rasteriser (Warp kernels, one source for CPU and CUDA) and what is fitted with it.

Importing this package loads torch but not Warp.
"""

from exmesh_graph.splat.gaussians import SH_DEGREE, Gaussians, rotation_matrices
from exmesh_graph.splat.render import Drawn, Render, render

__all__ = ["SH_DEGREE", "Drawn", "Gaussians", "Render", "render", "rotation_matrices"]
