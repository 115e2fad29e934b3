"""The metallic-roughness BRDF, in a form that stays finite and keeps its energy at grazing angles.

    f = (1 - m) a / pi + D V F,   V = G / (4 n.l n.v),   alpha = max(r^2, ALPHA_MIN),   F0 = 0.04 (1 - m) + m a

GGX D, height-correlated Smith G, Schlick F. The paper's form (section 5.2) divides by 4 n.l n.v + epsilon; written
through V (Heitz 2014) the cosines cancel against G, so no epsilon is needed and none biases grazing angles.
All functions take torch tensors of any float dtype; vectors are unit [..., 3], scalars [...].
"""

from __future__ import annotations

import math

import torch

#: Width of the narrowest lobe, at roughness 0.019: sin^2 of a float32 half vector is still good to 0.05 % there. Below
#: it roughness has no gradient, so whoever fits it keeps it above (stage2: roughness_min).
ALPHA_MIN = 3.6e-4
DIELECTRIC_F0 = 0.04
COSINE_MIN = 1e-4


def alpha_of(roughness: torch.Tensor) -> torch.Tensor:
    """Width alpha of the microfacet lobe, floored so that a mirror stays integrable in float32."""
    return (roughness * roughness).clamp_min(ALPHA_MIN)


def ggx(sine2_h: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """D(h) [1/sr] = alpha^2 / (pi (alpha^2 cos^2 + sin^2)^2), from sin^2 of the angle between n and h.

    From sin^2 and not from cos^2: 1 - cos^2 loses every digit of a narrow lobe in float32.
    """
    a2 = alpha * alpha
    d = a2 + (1 - a2) * sine2_h
    return a2 / (math.pi * d * d)


def smith_visibility(n_l: torch.Tensor, n_v: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """V = G / (4 n.l n.v) = 1 / (2 (n.l sqrt(a2 + (1-a2) n.v^2) + n.v sqrt(a2 + (1-a2) n.l^2)))."""
    a2 = alpha * alpha
    masked = n_l * (a2 + (1 - a2) * n_v * n_v).sqrt() + n_v * (a2 + (1 - a2) * n_l * n_l).sqrt()
    return 0.5 / masked


def schlick(v_h: torch.Tensor, f0: torch.Tensor) -> torch.Tensor:
    """F = F0 + (1 - F0) (1 - v.h)^5, [..., 3] from v_h [...] and f0 [..., 3]."""
    return f0 + (1 - f0) * ((1 - v_h).clamp(0, 1) ** 5)[..., None]


def base_reflectance(base_color: torch.Tensor, metallic: torch.Tensor | None) -> torch.Tensor:
    """F0 = (1 - m) 0.04 + m a, [..., 3]; a dielectric where `metallic` is None.

    Equation: 16.
    """
    if metallic is None:
        return torch.full_like(base_color, DIELECTRIC_F0)
    m = metallic[..., None]
    return (1 - m) * DIELECTRIC_F0 + m * base_color


def diffuse(base_color: torch.Tensor, metallic: torch.Tensor | None = None) -> torch.Tensor:
    """f_d = (1 - m) a / pi, [..., 3].

    Equation: 14.
    """
    scaled = base_color if metallic is None else base_color * (1 - metallic[..., None])
    return scaled / math.pi


def specular(
    normal: torch.Tensor,
    view: torch.Tensor,
    light: torch.Tensor,
    roughness: torch.Tensor,
    f0: torch.Tensor,
) -> torch.Tensor:
    """f_s = D V F [..., 3]; 0 where view or light lies under (or within 1e-4 of) the horizon.

    Gradients are finite everywhere, also for light = -view, where the half vector does not exist.

    Equation: 15.
    """
    n_l, n_v = (normal * light).sum(-1), (normal * view).sum(-1)
    lit = (n_l > COSINE_MIN) & (n_v > COSINE_MIN)
    half = view + light
    half = half / (half * half).sum(-1, keepdim=True).clamp_min(1e-20).sqrt()
    across = torch.linalg.cross(normal.expand_as(half), half, dim=-1)
    alpha = alpha_of(roughness)
    d = ggx((across * across).sum(-1), alpha)
    one = torch.ones_like(n_l)
    v = smith_visibility(torch.where(lit, n_l, one), torch.where(lit, n_v, one), alpha)
    f = schlick((view * half).sum(-1), f0)
    return torch.where(lit, d * v, torch.zeros_like(d))[..., None] * f


def evaluate(
    normal: torch.Tensor,
    view: torch.Tensor,
    light: torch.Tensor,
    base_color: torch.Tensor,
    roughness: torch.Tensor,
    metallic: torch.Tensor | None = None,
) -> torch.Tensor:
    """The whole BRDF f [..., 3], per steradian; one-sided: 0 at and below the horizon.

    Equation: 13.
    """
    f_s = specular(normal, view, light, roughness, base_reflectance(base_color, metallic))
    lit = ((normal * light).sum(-1) > COSINE_MIN) & ((normal * view).sum(-1) > COSINE_MIN)
    return torch.where(lit[..., None], diffuse(base_color, metallic), torch.zeros_like(f_s)) + f_s
