"""Differentiable rasteriser: visibility, interpolation, texture lookup and silhouette antialiasing.

Torch tensors in and out; the inner loops are Warp kernels, one source for CPU and CUDA. Importing this package
loads torch but not Warp.
"""

from exmesh_graph.raster.camera import pixel_centres, project
from exmesh_graph.raster.interpolate import barycentrics, interpolate, shade, uv_footprint
from exmesh_graph.raster.paint import Painter
from exmesh_graph.raster.rasterize import Fragments, rasterize, rasterize_projected
from exmesh_graph.raster.shown import shown_faces, shown_vertices
from exmesh_graph.raster.silhouette import EdgeTable, Silhouette, antialias, edge_table, find_silhouette
from exmesh_graph.raster.texture import mip_level, mip_pyramid, sample_mipmap, sample_texture

__all__ = [
    "EdgeTable",
    "Fragments",
    "Painter",
    "Silhouette",
    "antialias",
    "barycentrics",
    "edge_table",
    "find_silhouette",
    "interpolate",
    "mip_level",
    "mip_pyramid",
    "pixel_centres",
    "project",
    "rasterize",
    "rasterize_projected",
    "sample_mipmap",
    "sample_texture",
    "shade",
    "shown_faces",
    "shown_vertices",
    "uv_footprint",
]
