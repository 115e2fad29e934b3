"""Sampling of the whole BRDF in plain torch: what the Warp kernels (`kernels_draw`) are compared with.

    p(l) = q p_GGX(l) + (1 - q) max(n.l, 0) / pi,      p_GGX(l) = D(h) G1(v) / (4 n.v)

q is the specular lobe's share of what the point reflects under a uniform sky, guessed from Fresnel at n.v.
"""

from __future__ import annotations

import math

import torch

from exmesh_graph.shading.brdf import COSINE_MIN, alpha_of, ggx
from exmesh_graph.shading.brdf_sampling import basis, sample_specular, specular_share


@torch.no_grad()
def sample_brdf(
    normal: torch.Tensor,
    view: torch.Tensor,
    base_color: torch.Tensor,
    roughness: torch.Tensor,
    metallic: torch.Tensor | None,
    uniform: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Directions to light [N, S, 3] and their densities [N, S] per steradian, S for each of N points.

    normal, view [N, 3] unit, view on the normal's side; base_color [N, 3]; roughness [N]; metallic [N] or None;
    uniform [N, S, 2] in [0, 1). The density is 0 where the direction fell under the horizon: such a sample counts as
    an estimate of 0.
    """
    share = specular_share(normal, view, base_color, metallic)[:, None]
    # the first coordinate chooses the lobe and is then stretched again: stratified points stay stratified in each lobe
    first, second = uniform.unbind(-1)
    glossy = first < share
    first = torch.where(glossy, first / share, (first - share) / (1 - share).clamp_min(1e-9)).clamp(0, 1 - 1e-7)
    inner = torch.stack([first, second], dim=-1)
    reflected = sample_specular(normal, view, alpha_of(roughness), inner)[0]
    light = torch.where(glossy[..., None], reflected, _cosine(normal, inner))
    light = torch.nn.functional.normalize(light, dim=-1)
    return light, pdf_brdf(normal, view, light, base_color, roughness, metallic)


@torch.no_grad()
def pdf_brdf(
    normal: torch.Tensor,
    view: torch.Tensor,
    light: torch.Tensor,
    base_color: torch.Tensor,
    roughness: torch.Tensor,
    metallic: torch.Tensor | None,
) -> torch.Tensor:
    """Density [N, S] per steradian with which `sample_brdf` draws the unit directions `light` [N, S, 3].

    0 under the horizon and within the sliver above it where the BRDF itself is 0 (brdf.COSINE_MIN).
    """
    share = specular_share(normal, view, base_color, metallic)[:, None]
    n_l = (light * normal[:, None]).sum(-1)
    n_v = (view * normal).sum(-1, keepdim=True).clamp_min(COSINE_MIN)
    half = view[:, None] + light
    half = half / (half * half).sum(-1, keepdim=True).clamp_min(1e-20).sqrt()
    across = torch.linalg.cross(normal[:, None].expand_as(half), half, dim=-1)
    alpha = alpha_of(roughness)[:, None]
    smith = (1 + alpha * alpha * (1 / (n_v * n_v) - 1).clamp_min(0)).sqrt()
    glossy = ggx((across * across).sum(-1), alpha) / (2 * n_v * (1 + smith))
    value = share * glossy + (1 - share) * n_l / math.pi
    return torch.where(n_l > COSINE_MIN, value, torch.zeros_like(value))


def _cosine(normal: torch.Tensor, uniform: torch.Tensor) -> torch.Tensor:
    """Directions [N, S, 3] with density max(n.l, 0) / pi: points of the disc, lifted to the hemisphere (Malley)."""
    tangent, bitangent = (axis[:, None] for axis in basis(normal))
    phi = 2 * math.pi * uniform[..., :1]
    radius, height = uniform[..., 1:].sqrt(), (1 - uniform[..., 1:]).sqrt()
    return radius * phi.cos() * tangent + radius * phi.sin() * bitangent + height * normal[:, None]
