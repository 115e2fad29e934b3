"""Sampling of the specular lobe by visible normals, and lookups filtered by the samples' density."""

from __future__ import annotations

import math

import torch

from exmesh_graph.shading import envmap
from exmesh_graph.shading.brdf import COSINE_MIN, ggx


def hammersley(count: int, device: torch.device | str = "cpu") -> torch.Tensor:
    """`count` points (i + 0.5) / n, radical inverse of i in base 2: float32 [count, 2] in [0, 1)."""
    i = torch.arange(count, device=device)
    inverse, base, rest = torch.zeros(count, device=device), 0.5, i.clone()
    while int(rest.max()) > 0:
        inverse += base * (rest % 2)
        rest, base = rest // 2, base / 2
    return torch.stack([(i + 0.5) / count, inverse], dim=1)


def basis(normal: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Two unit tangents of unit normals [..., 3], right-handed, continuous but for n.z = 0 (Duff et al. 2017)."""
    x, y, z = normal.unbind(-1)
    sign = torch.where(z >= 0, torch.ones_like(z), -torch.ones_like(z))
    a = -1 / (sign + z)
    b = x * y * a
    first = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], dim=-1)
    second = torch.stack([b, sign + y * y * a, -y], dim=-1)
    return first, second


def sample_specular(
    normal: torch.Tensor, view: torch.Tensor, alpha: torch.Tensor, sample: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Reflect `view` at GGX normals drawn in proportion to what the view sees of them (Dupuy and Benyoub 2023).

    normal, view [N, 3] unit; alpha [N]; sample [N, S, 2] uniform in [0, 1).
    Returns light [N, S, 3], weight [N, S] = f_s n.l / (pdf F) = G / G1(v), pdf [N, S] per steradian of light,
    v_h [N, S]. weight and pdf are 0 where the light lies under the horizon.
    """
    tangent, bitangent = basis(normal)
    local = torch.stack(
        [(view * tangent).sum(-1), (view * bitangent).sum(-1), (view * normal).sum(-1).clamp_min(COSINE_MIN)], -1
    )
    local = (local / local.norm(dim=-1, keepdim=True))[:, None]
    a = alpha[:, None]
    # the hemisphere seen by the stretched view: a cap of the sphere below the view direction
    std = torch.stack([local[..., 0] * a, local[..., 1] * a, local[..., 2]], dim=-1)
    std = std / std.norm(dim=-1, keepdim=True)
    phi = 2 * math.pi * sample[..., 0]
    z = (1 - sample[..., 1]) * (1 + std[..., 2]) - std[..., 2]
    radius = (1 - z * z).clamp_min(0).sqrt()
    half = torch.stack([radius * phi.cos() + std[..., 0], radius * phi.sin() + std[..., 1], z + std[..., 2]], dim=-1)
    half = torch.stack([half[..., 0] * a, half[..., 1] * a, half[..., 2].clamp_min(0)], dim=-1)
    half = half / half.norm(dim=-1, keepdim=True).clamp_min(1e-20)
    v_h = (local * half).sum(-1)
    light = 2 * v_h[..., None] * half - local

    n_v, n_l = local[..., 2], light[..., 2]
    a2 = a * a
    lit = n_l > COSINE_MIN
    n_l = torch.where(lit, n_l, torch.ones_like(n_l))
    smith_v = (1 + a2 * (1 / (n_v * n_v) - 1)).sqrt()  # 1 + 2 Lambda
    smith_l = (1 + a2 * (1 / (n_l * n_l) - 1)).sqrt()
    weight = torch.where(lit, (1 + smith_v) / (smith_v + smith_l), torch.zeros_like(n_l))
    sine2 = half[..., 0] ** 2 + half[..., 1] ** 2
    # pdf(l) = D G1(v) / (4 n.v), G1 = 2 / (1 + smith_v)
    pdf = torch.where(lit, ggx(sine2, a) / (2 * n_v * (1 + smith_v)), torch.zeros_like(n_l))
    world = light[..., :1] * tangent[:, None] + light[..., 1:2] * bitangent[:, None] + light[..., 2:] * normal[:, None]
    return world, weight, pdf, v_h


class Pyramid:
    """Halved copies of a map, for lookups that average over the solid angle a sample stands for."""

    def __init__(self, environment: torch.Tensor) -> None:
        levels = [environment]
        while levels[-1].shape[0] % 2 == 0 and levels[-1].shape[1] % 2 == 0 and levels[-1].shape[0] > 4:
            levels.append(_halve(levels[-1]))
        self.levels = levels
        self.texel = 4 * math.pi / (environment.shape[0] * environment.shape[1])

    def lookup(self, direction: torch.Tensor, solid_angle: torch.Tensor) -> torch.Tensor:
        """Radiance [N, 3] averaged over about `solid_angle` [N] sr around unit directions [N, 3]."""
        level = 0.5 * torch.log2((solid_angle / self.texel).clamp_min(1e-12))
        level = level.clamp(0, len(self.levels) - 1)
        base = level.floor()
        u, v = envmap.uv_of(direction)
        result = torch.zeros_like(direction)
        for number, image in enumerate(self.levels):
            share = torch.where(base == number, 1 - (level - base), torch.zeros_like(level))
            share = torch.where(base == number - 1, level - base, share)
            chosen = torch.nonzero(share > 0)[:, 0]
            if len(chosen) == 0:
                continue
            height, width = image.shape[:2]
            index, weight = envmap.bilinear(height, width, u[chosen], v[chosen])
            values = torch.nn.functional.embedding_bag(
                index, image.reshape(-1, 3), per_sample_weights=weight * share[chosen, None], mode="sum"
            )
            result.index_add_(0, chosen, values)
        return result


def _halve(environment: torch.Tensor) -> torch.Tensor:
    height, width = environment.shape[:2]
    row = torch.as_tensor(envmap.solid_angles(height, width), dtype=environment.dtype, device=environment.device)
    row = row.reshape(height // 2, 2, 1, 1, 1)
    blocks = environment.reshape(height // 2, 2, width // 2, 2, 3)
    return (blocks * row).sum(dim=(1, 3)) / (row.sum(dim=1)[:, 0] * 2)
