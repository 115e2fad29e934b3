"""The picture of a coloured mesh as Stage I sees it: display colour over black and coverage, both antialiased."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.raster import (
    Fragments,
    Painter,
    antialias,
    barycentrics,
    edge_table,
    find_silhouette,
    project,
    rasterize_projected,
)
from exmesh_graph.stage1.appearance.colours import UVTexture
from exmesh_graph.stage1.appearance.model import Surface
from exmesh_graph.stage1.appearance.state import model_of
from exmesh_graph.types import Carrier, Views


class Picture(NamedTuple):
    """colour [H, W, 3], display-referred over black;  alpha [H, W];  projected [V, 3];  fragments;  shown uint8 [F], 1
    where a pixel shows the face, or None where that was not looked at."""

    colour: torch.Tensor
    alpha: torch.Tensor
    projected: torch.Tensor
    fragments: Fragments
    shown: torch.Tensor | None = None


def surface_of(carrier: Carrier, device: torch.device | str = "cpu") -> Surface:
    """The carrier's arrays as tensors (copies: they may be changed in place)."""
    faces = torch.tensor(np.asarray(carrier.faces, np.int32), device=device)
    return Surface(
        vertices=torch.tensor(np.asarray(carrier.vertices, np.float32), device=device),
        faces=faces,
        uvs=torch.tensor(np.asarray(carrier.uvs, np.float32), device=device),
        uv_faces=torch.tensor(np.asarray(carrier.uv_faces, np.int32), device=device),
        appearance=model_of(carrier, device),
        edges=edge_table(faces),
        extent=float(np.linalg.norm(np.ptp(carrier.vertices, axis=0))) if len(carrier.vertices) else 0.0,
    )


def painter_of(surface: Surface, height: int, width: int) -> Painter | None:
    """What draws the surface in one operation (`draw`), made once for a topology; None where only the plain form does.

    That is on other devices than a CPU, for other types than float32, and for colours that are not a texture or one of
    a single row or column.
    """
    values = surface.appearance.values
    if not isinstance(surface.appearance, UVTexture) or values.device.type != "cpu":
        return None
    if (surface.vertices.dtype, values.dtype) != (torch.float32, torch.float32):
        return None
    rows, columns, _ = values.shape
    if min(rows, columns) < 2:
        return None
    return Painter(
        surface.faces, surface.uvs, surface.uv_faces, surface.edges, vertices=len(surface.vertices),
        texels=(rows, columns), height=height, width=width,
    )  # fmt: skip


def draw(
    surface: Surface,
    intrinsics: torch.Tensor,
    world_to_camera: torch.Tensor,
    height: int,
    width: int,
    *,
    uv_gradient: bool = True,
    painter: Painter | None = None,
) -> Picture:
    """One view; differentiable in vertices and the appearance's values.

    uv_gradient  whether colour also moves vertices inside the silhouette, through the place under each pixel
    painter      `painter_of` the surface: the same to rounding, faster; the picture holds until the next one
    """
    projected = project(surface.vertices, intrinsics, world_to_camera)
    seen = surface.vertices if uv_gradient else surface.vertices.detach()
    tints = surface.appearance.tints(seen, world_to_camera)
    if painter is not None:
        values = surface.appearance.values
        colour, alpha, fragments = painter.paint(
            projected, values, tints, extent=surface.extent, uv_gradient=uv_gradient
        )
        return Picture(colour, alpha, projected, fragments, painter.cover.shown)
    fragments = rasterize_projected(projected, surface.faces, height, width)
    if uv_gradient:
        colour = shaded(surface, projected, fragments.face_id, tints)
    else:
        still = surface._replace(vertices=surface.vertices.detach())
        colour = shaded(still, projected.detach(), fragments.face_id, tints)
    covered = (fragments.face_id >= 0).to(colour.dtype)
    silhouette = find_silhouette(projected, surface.edges, fragments, extent=surface.extent)
    blended = antialias(torch.cat([colour, covered[..., None]], dim=-1), projected, silhouette)
    return Picture(blended[..., :3], blended[..., 3], projected, fragments)


def shaded(
    surface: Surface, projected: torch.Tensor, face_id: torch.Tensor, tints: torch.Tensor | None
) -> torch.Tensor:
    """Colour [H, W, 3] at every pixel, with the appearance's `tints` in the view; 0 on the background."""
    colour = surface.appearance.shade(surface, projected, face_id)
    if tints is None:
        return colour
    flat = face_id.reshape(-1)
    pixels = torch.nonzero(flat >= 0)[:, 0]
    face = flat[pixels].long()
    bary = barycentrics(projected, surface.faces, face, pixels, face_id.shape[-1])
    corners = tints.index_select(0, surface.faces.long()[face].reshape(-1)).view(-1, 3, 3)
    return colour.view(-1, 3).index_add(0, pixels, (bary[..., None] * corners).sum(1)).view_as(colour)


def render_carrier(
    carrier: Carrier, views: Views, device: torch.device | str = "cpu", *, blended: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """The carrier's appearance from the cameras of `views`: display colour over black [N, H, W, 3], alpha [N, H, W].

    float32, in [0, 1]; comparable with `losses.display` of the views. Not `blended`: the colour at pixel centres, with
    nothing in it of what stands behind a silhouette.
    """
    surface = surface_of(carrier, device)
    colours = np.zeros((len(views), views.height, views.width, 3), np.float32)
    alphas = np.zeros((len(views), views.height, views.width), np.float32)
    world_to_camera = torch.from_numpy(views.world_to_camera)
    intrinsics = tensor_of(np.asarray(views.intrinsics, np.float64))
    with torch.no_grad():
        for i in range(len(views)):
            picture = draw(surface, intrinsics[i], world_to_camera[i], views.height, views.width)
            colour, alpha = picture.colour, picture.alpha
            if not blended:
                face_id = picture.fragments.face_id
                tints = surface.appearance.tints(surface.vertices, world_to_camera[i])
                colour, alpha = shaded(surface, picture.projected, face_id, tints), (face_id >= 0).float()
            colours[i] = colour.clamp(0, 1).cpu().numpy()
            alphas[i] = alpha.clamp(0, 1).cpu().numpy()
    return colours, alphas
