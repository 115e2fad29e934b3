"""Meshes and cameras for the rasteriser's tests."""

import math

import torch


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
