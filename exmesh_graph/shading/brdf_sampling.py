"""Sampling of the GGX lobe by its visible normals, and the lobe's share of what a point reflects.

Nothing here carries gradients: an estimate f(x) / p(x) is differentiated through f, with x and p held fixed.
"""

from __future__ import annotations

import math

import torch

from exmesh_graph.shading.brdf import COSINE_MIN, base_reflectance, ggx, schlick

#: Bounds of the specular lobe's share where there are two lobes: none may be starved by the guess.
_LEAST, _MOST = 0.1, 0.9


@torch.no_grad()
def specular_share(
    normal: torch.Tensor, view: torch.Tensor, base_color: torch.Tensor, metallic: torch.Tensor | None
) -> torch.Tensor:
    """The probability q [N] of the specular lobe: 1 for a pure metal, else within [0.1, 0.9]."""
    n_v = (normal * view).sum(-1).clamp(0, 1)
    glossy = schlick(n_v, base_reflectance(base_color, metallic)).mean(-1)
    scattered = base_color.mean(-1)
    if metallic is not None:
        scattered = scattered * (1 - metallic)
    share = (glossy / (glossy + scattered).clamp_min(1e-9)).clamp(_LEAST, _MOST)
    return share if metallic is None else torch.where(metallic >= 1, torch.ones_like(share), share)


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
