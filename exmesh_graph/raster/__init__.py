"""Differentiable rasteriser: visibility, interpolation, texture lookup and silhouette antialiasing.

Torch tensors in and out; the inner loops are Warp kernels, one source for CPU and CUDA. Importing this package
loads torch but not Warp.
"""

from exmesh_graph.raster.camera import pixel_centres, project
from exmesh_graph.raster.rasterize import Fragments, rasterize, rasterize_projected
from exmesh_graph.raster.texture import sample_texture

__all__ = [
    "Fragments",
    "pixel_centres",
    "project",
    "rasterize",
    "rasterize_projected",
    "sample_texture",
]
