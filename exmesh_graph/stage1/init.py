"""The start of Stage I: a texture taken from the photographs, and optimiser moments at zero."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
import torch

from exmesh_graph.errors import GeometryError
from exmesh_graph.gpu.cores import share
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.raster import project, rasterize_projected, sample_texture
from exmesh_graph.targets import MEMORY_GIB, Targets, prepare_targets
from exmesh_graph.types import Carrier, Stage1State, Views
from exmesh_graph.uv.raster import rasterize_atlas
from exmesh_graph.uv.transfer import COVER

_CHUNK = 1 << 15
_LARGEST = 512
_GREY = 0.5


def initial_state(
    carrier: Carrier,
    views: Views,
    *,
    texture: Literal["views", "carrier", "grey"] = "views",
    device: torch.device | str = "cpu",
) -> Stage1State:
    """A Stage1State with the carrier's geometry and atlas, zero moments, and a first texture of the carrier's size.

    texture  "views": projected from the photographs (`project_texture`); "carrier": as it came; "grey": 0.5
    """
    size = carrier.texture.shape[0]
    if carrier.texture.ndim != 3 or carrier.texture.shape != (size, size, 3) or size == 0:
        raise GeometryError(
            f"the carrier's texture has shape {tuple(carrier.texture.shape)}",
            where="stage1.init",
            expected="a square [R, R, 3] with R > 0",
        )
    if texture == "views":
        memory_gib = 0.0 if views.in_files else MEMORY_GIB  # each view is visited once
        start = project_texture(carrier, prepare_targets(views, device=device, memory_gib=memory_gib), size)
    elif texture == "grey":
        start = np.full((size, size, 3), _GREY, np.float32)
    else:
        start = np.asarray(carrier.texture, np.float32)
    count = len(carrier.vertices)
    return Stage1State(
        vertices=np.asarray(carrier.vertices, np.float32),
        faces=np.asarray(carrier.faces, np.int32),
        uvs=np.asarray(carrier.uvs, np.float32),
        uv_faces=np.asarray(carrier.uv_faces, np.int32),
        texture=start,
        vertex_m=np.zeros((count, 3), np.float32),
        vertex_v=np.zeros(count, np.float32),
        texture_m=np.zeros((size, size, 3), np.float32),
        texture_v=np.zeros((size, size, 3), np.float32),
        gradient_ema=np.zeros(count, np.float32),
    )


def project_texture(carrier: Carrier, targets: Targets, size: int) -> np.ndarray:
    """Display colour float32 [R, R, 3] of every texel: weighted median over the views that see its surface point.

    A view's weight is the cosine between the surface normal and the direction to the camera, squared; it must show
    the point unoccluded and well inside the mask. The median is per channel: highlights and misaligned views are
    outvoted. Texels that nobody sees are filled from their neighbours (`fill_unseen`). Atlases above 512 texels are
    projected at 512 and enlarged: the start needs no more.
    """
    inner = min(size, _LARGEST)
    device = targets.device
    face_id, bary = rasterize_atlas(carrier.uvs, carrier.uv_faces, inner, margin=COVER)
    texels = np.flatnonzero(face_id.reshape(-1) >= 0)
    faces = tensor_of(np.asarray(carrier.faces, np.int64))
    vertices = tensor_of(np.asarray(carrier.vertices, np.float32))
    owner = torch.from_numpy(face_id.reshape(-1)[texels].astype(np.int64))
    weights = torch.from_numpy(bary.reshape(-1, 3)[texels])
    corners = vertices[faces]
    points = (weights[..., None] * corners[owner]).sum(1).to(device)
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = torch.nn.functional.normalize(normals, dim=1, eps=1e-20)[owner].to(device)

    samples = torch.empty((len(targets), len(texels), 3), device=device)
    confidence = torch.empty((len(targets), len(texels)), device=device)
    parts = [slice(start, start + _CHUNK) for start in range(0, len(texels), _CHUNK)]
    mesh = vertices.to(device), faces.to(device)

    def pictures() -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        for i in range(len(targets)):
            targets.expect((i + 1) % len(targets))
            yield targets.images[i], targets.alpha[i]

    def observe(i: int, picture: tuple[torch.Tensor, torch.Tensor]) -> None:
        camera = targets.intrinsics[i], targets.world_to_camera[i]
        depth = rasterize_projected(project(mesh[0], *camera), mesh[1], targets.height, targets.width, bary=False).depth
        for part in parts:
            samples[i, part], confidence[i, part] = _observe(points[part], normals[part], *camera, *picture, depth)

    def settle(part: slice) -> None:
        index = torch.from_numpy(texels[part]).to(device)
        colours[index] = _weighted_median(samples[:, part], confidence[:, part])
        seen[index] = confidence[:, part].sum(0) > 0

    share(observe, range(len(targets)), pictures())
    colours = torch.full((inner * inner, 3), _GREY, device=device)
    seen = torch.zeros(inner * inner, dtype=torch.bool, device=device)
    share(settle, parts)
    colours = torch.where(seen[:, None], colours, _GREY)
    texture = fill_unseen(colours.view(inner, inner, 3), seen.view(inner, inner))
    if inner != size:
        texture = _resize(texture, size)
    return texture.clamp(0, 1).cpu().numpy()


def fill_unseen(texture: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Replace the texels outside bool `seen` [H, W] by smooth colours from the seen ones around them.

    Pull-push: means of seen texels over ever larger cells, then back down, finest known value first. Later stages
    thus read plausible colours in charts' margins and on parts no view shows. All texels unseen: unchanged.
    """
    if bool(seen.all()) or not bool(seen.any()):
        return texture
    colour = torch.where(seen[..., None], texture, 0.0).permute(2, 0, 1)[None]
    weight = seen.to(texture.dtype)[None, None]
    return torch.where(seen[..., None], texture, _pull_push(colour, weight)[0].permute(1, 2, 0))


def _pull_push(colour: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Colours [1, C, H, W] with every hole filled; `colour` is premultiplied by `weight` [1, 1, H, W] in {0, 1}."""
    from torch.nn.functional import avg_pool2d, interpolate

    height, width = weight.shape[-2:]
    if height == 1 and width == 1:
        return colour
    size = {"kernel_size": 2, "ceil_mode": True, "count_include_pad": False}
    coarse_weight = avg_pool2d(weight, **size)  # type: ignore[arg-type]
    coarse = avg_pool2d(colour, **size) / coarse_weight.clamp(min=1e-12)  # type: ignore[arg-type]
    known = (coarse_weight > 0).to(weight.dtype)
    filled = _pull_push(coarse * known, known)
    finer = interpolate(filled, size=(height, width), mode="bilinear", align_corners=False)
    return torch.where(weight > 0, colour, finer)


def _observe(
    points: torch.Tensor,
    normals: torch.Tensor,
    intrinsics: torch.Tensor,
    world_to_camera: torch.Tensor,
    image: torch.Tensor,
    alpha: torch.Tensor,
    depths: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """What a view, which has the mesh at `depths` [H, W], shows of P points: colours [P, 3] and weights [P], 0 where it
    does not see them.
    """
    height, width = depths.shape
    projected = project(points, intrinsics, world_to_camera)
    z = projected[:, 2].clamp(min=1e-6)
    x, y = projected[:, 0] / z, projected[:, 1] / z
    inside = (projected[:, 2] > 1e-6) & (x >= 0.5) & (x < width - 0.5) & (y >= 0.5) & (y < height - 0.5)
    column, row = (p.clamp(0, n - 1).floor().long() for p, n in ((x, width), (y, height)))
    rotation = world_to_camera.to(points)
    centre = -rotation[:3, :3].T @ rotation[:3, 3]
    towards = torch.nn.functional.normalize(centre - points, dim=1)
    cosine = (towards * normals).sum(1)
    # a slanted surface changes depth within a pixel: allow for that
    pixel = z / intrinsics[0, 0].to(z)
    slack = 1e-3 * z + 1.5 * pixel / cosine.clamp(min=0.1)
    depth = depths[row, column]
    visible = inside & (cosine > 0.15) & (depth > 0) & (z < depth + slack)
    visible &= alpha[row, column] > 0.99
    uv = torch.stack([x / width, 1 - y / height], dim=1)
    return sample_texture(image, uv), torch.where(visible, cosine.square(), 0.0)


def _weighted_median(samples: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Per point and channel, the smallest sample at which half of the weight is reached: [P, C] from [N, P, C]."""
    ordered, order = samples.sort(dim=0, stable=True)
    cumulative = weights[..., None].expand_as(samples).gather(0, order).cumsum(0)
    reached = cumulative >= 0.5 * cumulative[-1:]
    first = reached.to(torch.uint8).argmax(dim=0, keepdim=True)
    return ordered.gather(0, first)[0]


def _resize(texture: torch.Tensor, size: int) -> torch.Tensor:
    planes = texture.permute(2, 0, 1)[None]
    larger = torch.nn.functional.interpolate(planes, size=(size, size), mode="bilinear", align_corners=False)
    return larger[0].permute(1, 2, 0).contiguous()
