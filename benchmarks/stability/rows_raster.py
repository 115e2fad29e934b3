"""Rows of visibility and antialiasing."""

from __future__ import annotations

import torch

from benchmarks.stability.table import Reached, row
from exmesh_graph.raster import rasterize
from exmesh_graph.raster.reference import rasterize_reference


@row("raster", "one triangle over the whole screen, corners far outside", "uncovered pixels", high=0)
def whole_screen() -> Reached:
    vertices = torch.tensor([[-900.0, -900, 5], [900, -900, 5], [0, 1800, 5]])
    faces = torch.tensor([[0, 1, 2]])
    intrinsics = torch.tensor([[300.0, 0, 128], [0, 300, 96], [0, 0, 1]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    got = rasterize(vertices, faces, intrinsics, pose, 192, 256)
    want = rasterize_reference(vertices.double(), faces, intrinsics, pose, 192, 256)
    return Reached(float((got.face_id != 0).sum()), float((want.face_id != 0).sum()))
