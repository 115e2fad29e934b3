"""Meshes, cameras and pictures that the rasteriser's tests and benchmarks share."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch

from exmesh_graph.raster import (
    antialias,
    barycentrics,
    edge_table,
    find_silhouette,
    interpolate,
    project,
    rasterize_projected,
)


def icosphere(level: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Unit sphere of 20 * 4^level faces: (float64 [V, 3], int64 [F, 3]), counter-clockwise from outside."""
    t = (1 + 5**0.5) / 2
    corners = [(-1, t, 0), (1, t, 0), (-1, -t, 0), (1, -t, 0)]
    corners += [(z, x, y) for x, y, z in corners] + [(y, z, x) for x, y, z in corners]
    v = torch.tensor(corners, dtype=torch.float64)
    # faces: all triples of mutually neighbouring corners, turned outwards
    edge = torch.cdist(v, v).round(decimals=6)
    near = edge == edge[edge > 0].min()
    f = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    f = torch.tensor(f)
    a, b, c = v[f].unbind(1)
    inward = (torch.linalg.cross(b - a, c - a) * a).sum(1) < 0
    f[inward] = f[inward][:, [0, 2, 1]]
    v = torch.nn.functional.normalize(v, dim=1)
    for _ in range(level):
        ends = torch.cat([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]).sort(dim=1).values
        unique, where = torch.unique(ends, dim=0, return_inverse=True)
        ab, bc, ca = (where + len(v)).view(3, -1)
        v = torch.cat([v, torch.nn.functional.normalize(v[unique].mean(1), dim=1)])
        a, b, c = f.unbind(1)
        f = torch.cat([torch.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    return v, f


def camera(
    width: int,
    height: int,
    *,
    distance: float = 3.7,
    turn: float = 0.0,
    focal: float | None = None,
    shift: tuple[float, float] = (0.0, 0.0),
) -> tuple[torch.Tensor, torch.Tensor]:
    """(intrinsics, world_to_camera), float64, looking at the origin; `shift` moves the principal point."""
    focal = focal or 1.37 * max(width, height)
    intrinsics = torch.tensor(
        [[focal, 0, width / 2 + shift[0]], [0, focal * 1.03, height / 2 + shift[1]], [0, 0, 1]],
        dtype=torch.float64,
    )
    c, s = math.cos(turn), math.sin(turn)
    pose = torch.tensor([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, distance], [0, 0, 0, 1]], dtype=torch.float64)
    return intrinsics, pose


def soup(count: int, size: float, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """`count` unconnected random triangles around the origin, float32."""
    g = torch.Generator().manual_seed(seed)
    centres = torch.rand(count, 1, 3, generator=g) * 2 - 1
    v = (centres + size * torch.randn(count, 3, 3, generator=g)).reshape(-1, 3)
    return v, torch.arange(3 * count).reshape(count, 3)


def smooth_field(points: torch.Tensor, seed: int, waves: int = 3) -> torch.Tensor:
    """A smooth random vector field [V, 3] over points [V, 3], of magnitude about 1."""
    g = torch.Generator().manual_seed(seed)
    direction = torch.randn(waves, 3, generator=g, dtype=torch.float64) * 1.5
    phase = torch.rand(waves, generator=g, dtype=torch.float64) * 2 * math.pi
    amplitude = torch.randn(waves, 3, generator=g, dtype=torch.float64) / waves**0.5
    return torch.sin(points.double() @ direction.T + phase) @ amplitude


def smooth_image(height: int, width: int, channels: int, seed: int) -> torch.Tensor:
    """A smooth random image [H, W, C], float64."""
    g = torch.Generator().manual_seed(seed)
    coarse = torch.randn(1, channels, 5, 5, generator=g, dtype=torch.float64)
    fine = torch.nn.functional.interpolate(coarse, (height, width), mode="bicubic", align_corners=True)
    return fine[0].permute(1, 2, 0).contiguous()


def disc(rings: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Unit disc in z = 0: ring k holds 6 k vertices; 6 rings^2 faces of about the same area."""
    points, start = [(0.0, 0.0)], [0]
    for k in range(1, rings + 1):
        start.append(len(points))
        points += [
            (k / rings * math.cos(math.pi * i / (3 * k)), k / rings * math.sin(math.pi * i / (3 * k)))
            for i in range(6 * k)
        ]
    faces = []
    for k in range(1, rings + 1):
        inner, outer = max(6 * (k - 1), 1), 6 * k
        i = j = 0
        while i < (inner if k > 1 else 0) or j < outer:
            a = start[k - 1] + i % inner
            b = start[k] + j % outer
            if j < outer and (k == 1 or (j + 1) * inner <= (i + 1) * outer or i >= inner):
                faces.append([a, b, start[k] + (j + 1) % outer])
                j += 1
            else:
                faces.append([a, b, start[k - 1] + (i + 1) % inner])
                i += 1
    xy = torch.tensor(points, dtype=torch.float64)
    return torch.cat([xy, torch.zeros(len(xy), 1, dtype=torch.float64)], dim=1), torch.tensor(faces)


def random_bodies(seed: int, level: int, count: int = 3) -> tuple[torch.Tensor, ...]:
    """Bumpy bodies that hide parts of each other and do not touch: vertices, faces, vertex colours, owner [V]."""
    g = torch.Generator().manual_seed(seed)
    unit, faces = icosphere(level)
    bodies = []
    for k in range(count):
        radius = torch.rand(1, generator=g, dtype=torch.float64) * 0.25 + 0.25
        centre = torch.rand(3, generator=g, dtype=torch.float64) * 1.2 - 0.6
        centre[2] = 0.08 * centre[2] + (k - 1) * 1.25
        bodies.append(unit * radius * (1 + 0.15 * smooth_field(unit, seed * 10 + k)[:, :1].clamp(-1, 1)) + centre)
    vertices = torch.cat(bodies)
    owner = torch.arange(count).repeat_interleave(len(unit))
    base = torch.rand(count, 3, generator=g, dtype=torch.float64)
    colours = 0.7 * base[owner] + 0.15 * (1 + smooth_field(vertices, seed + 900).clamp(-1, 1))
    return vertices, torch.cat([faces + k * len(unit) for k in range(count)]), colours, owner


def random_layers(seed: int, count: int = 5) -> tuple[torch.Tensor, ...]:
    """Single tilted triangles in slabs one behind the other: as `random_bodies`, with open borders only."""
    g = torch.Generator().manual_seed(seed)
    angle = torch.rand(count, 1, generator=g, dtype=torch.float64) * 2 * math.pi
    angle = angle + torch.tensor([0.0, 2.1, 4.2]) + 0.3 * torch.rand(count, 3, generator=g, dtype=torch.float64)
    centre = torch.rand(count, 1, 3, generator=g, dtype=torch.float64) * 0.9 - 0.45
    corners = torch.stack([angle.cos(), angle.sin(), torch.zeros_like(angle)], dim=-1) * 0.5 + centre
    corners[..., 2] = (torch.rand(count, 3, generator=g, dtype=torch.float64) - 0.5) * 0.3
    corners[..., 2] += torch.linspace(-1, 1, count, dtype=torch.float64)[:, None]
    colours = torch.rand(3 * count, 3, generator=g, dtype=torch.float64)
    return corners.reshape(-1, 3), torch.arange(3 * count).view(-1, 3), colours, torch.arange(3 * count) // 3


def cube_with_a_chart_per_face() -> tuple[torch.Tensor, ...]:
    """A cube of welded vertices whose six sides are charts of their own, and a colour that is linear in position.

    The atlas holds that colour at each side's own place, so the picture has no seams although every edge is one.
    """
    corner = torch.cartesian_prod(*[torch.tensor([-0.7, 0.7], dtype=torch.float64)] * 3)
    slope = torch.tensor([[0.25, 0.1, -0.1], [-0.1, 0.2, 0.15], [0.1, -0.15, 0.3]], dtype=torch.float64)
    faces, uvs, texture = [], [], torch.zeros(96, 64, 3, dtype=torch.float64)
    for axis in range(3):
        for side, sign in enumerate((-0.7, 0.7)):
            across, up = [a for a in range(3) if a != axis]
            quad = [
                int(((corner[:, axis] == sign) & (corner[:, across] == a) & (corner[:, up] == b)).nonzero())
                for a, b in ((-0.7, -0.7), (0.7, -0.7), (0.7, 0.7), (-0.7, 0.7))
            ]
            faces += [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
            # a chart of 24 x 24 texels in a cell of 32 x 32
            left, top = 32 * side, 32 * axis
            place = torch.tensor([[4, 28], [28, 28], [28, 4], [4, 4]], dtype=torch.float64) + torch.tensor([left, top])
            uv = torch.stack([place[:, 0] / 64, 1 - place[:, 1] / 96], dim=1)
            uvs += [uv[[0, 1, 2]], uv[[0, 2, 3]]]
            i, j = torch.meshgrid(torch.arange(32) + 0.5, torch.arange(32) + 0.5, indexing="ij")
            point = torch.zeros(32, 32, 3, dtype=torch.float64)
            point[..., axis] = sign
            point[..., across], point[..., up] = -0.7 + 1.4 * (j - 4) / 24, -0.7 + 1.4 * (28 - i) / 24
            texture[top : top + 32, left : left + 32] = 0.5 + point @ slope
    faces = torch.tensor(faces)
    return corner, faces, torch.cat(uvs), torch.arange(36).view(-1, 3), texture, 0.5 + corner @ slope


def coverage(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    intrinsics: torch.Tensor,
    pose: torch.Tensor,
    height: int,
    width: int,
    colours: torch.Tensor | None = None,
) -> torch.Tensor:
    """Antialiased [H, W, 1 + C]: coverage, and vertex colours interpolated."""
    projected = project(vertices, intrinsics, pose)
    fragments = rasterize_projected(projected, faces, height, width)
    layers = [(fragments.face_id >= 0).to(vertices.dtype)[..., None]]
    if colours is not None:
        flat = fragments.face_id.view(-1)
        pixels = torch.nonzero(flat >= 0)[:, 0]
        bary = barycentrics(projected, faces, flat[pixels], pixels, width)
        values = interpolate(colours, faces, flat[pixels], bary)
        image = values.new_zeros((height * width, colours.shape[1])).index_copy(0, pixels, values)
        layers.append(image.view(height, width, -1))
    silhouette = find_silhouette(projected, edge_table(faces), fragments)
    return antialias(torch.cat(layers, dim=-1), projected, silhouette)


def at_scale(intrinsics: torch.Tensor, scale: int) -> torch.Tensor:
    return torch.diag(torch.tensor([scale, scale, 1.0], dtype=torch.float64)) @ intrinsics


def derivatives(
    draw: Callable[[torch.Tensor, int], torch.Tensor],
    vertices: torch.Tensor,
    owner: torch.Tensor,
    seed: int,
    size: int,
    fine: int = 2,
    step: float = 0.004,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Directional derivatives [4, 2] of smoothly weighted coverage and colour: analytic, and numeric.

    `draw(vertices, scale)` gives the picture [scale size, scale size, 1 + C]. Directions are smooth displacements plus
    a motion of each part by itself; numeric are central differences of the picture with fine^2 samples a pixel.
    """
    analytic, numeric = [], []
    parts = torch.nn.functional.one_hot(owner, 5)[:, :3].double() * 3
    start = vertices.clone().requires_grad_()
    image = draw(start, 1)
    for s in range(4):
        field = smooth_field(vertices, s) + smooth_field(parts, s + 50)
        weight = smooth_image(size, size, image.shape[-1], seed + s + 100)
        with torch.no_grad():
            moved = (draw(vertices + step * field, fine) - draw(vertices - step * field, fine)) / (2 * step)
            moved = moved.view(size, fine, size, fine, -1).mean((1, 3))
        for channels in (slice(0, 1), slice(1, None)):
            loss = (image * weight)[..., channels].sum()
            (gradient,) = torch.autograd.grad(loss, start, retain_graph=True)
            analytic.append((gradient * field).sum())
            numeric.append((moved * weight)[..., channels].sum())
    return torch.stack(analytic).view(-1, 2), torch.stack(numeric).view(-1, 2)
