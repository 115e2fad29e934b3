"""Specular light without noise: the split sum over a stack of prefiltered environments.

    L_s(x, v) ~ [A(n.v, r) F0 + B(n.v, r)] * sum_k w_r(R . w_k) E(w_k) / sum_k w_r(R . w_k),   R = 2 (n.v) n - v

(Karis 2013.) w_r is the GGX lobe seen head-on. The lobe depends on the angle only, so on the lat-long grid the filter
is circulant in longitude: a real matrix per longitudinal frequency, applied between two FFTs. It is exact on its grid,
linear in the texels and cheap enough to run in every step. What the split sum leaves out (the lobe's stretch at
grazing angles, occlusion, reflections of the mesh itself) `stage2.correction` measures with rays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.brdf import ALPHA_MIN
from exmesh_graph.shading.products import mix_frequencies

#: Roughness of the prefiltered levels; between them radiance is interpolated linearly.
LEVELS = (0.0, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0)


class PrefilteredStack:
    """The fixed linear operator from a map [H, W, 3] to its levels, and their lookup.

    Level l keeps the largest H / 2^k that still has about `_TEXELS_PER_LOBE` rows in its lobe's width.
    """

    def __init__(self, height: int, width: int, device: torch.device | str = "cpu") -> None:
        self.knots = torch.tensor(LEVELS, device=device)
        self.shape = (height, width)
        self.factors = [_pooling(r, height, width) for r in LEVELS]
        sizes = [(height // f, width // f) for f in self.factors]
        self.heights = torch.tensor([s[0] for s in sizes], device=device)
        self.widths = torch.tensor([s[1] for s in sizes], device=device)
        counts = [h * w for h, w in sizes]
        self.starts = torch.tensor(np.concatenate([[0], np.cumsum(counts[:-1])]), device=device)
        self.groups = [_Group.of(factor, self.factors, sizes, device) for factor in dict.fromkeys(self.factors)]

    def build(self, environment: torch.Tensor) -> torch.Tensor:
        """All levels of `environment` [H, W, 3], flattened and stacked: [sum of level sizes, 3]."""
        return _Build.apply(environment, self.groups)

    def locate(self, u: torch.Tensor, v: torch.Tensor, roughness: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Rows of `build`'s result and their weights for N lookups: int64 [N, 8], float [N, 8].

        u, v [N]: image coordinates (envmap.uv_of) of the reflected direction; differentiable in roughness [N].
        """
        lower, t = self.between(roughness)
        index, weight = [], []
        for level, share in ((lower, 1 - t), (lower + 1, t)):
            i, w = _bilinear_in(self.heights[level], self.widths[level], u, v)
            index.append(i + self.starts[level][:, None])
            weight.append(w * share[:, None])
        return torch.cat(index, dim=1), torch.cat(weight, dim=1)

    def between(self, roughness: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The sharper of the two levels that each roughness [N] lies between, int64 [N], and the other's share [N]."""
        upper = torch.searchsorted(self.knots, roughness.detach().contiguous()).clamp(1, len(LEVELS) - 1)
        low, high = self.knots[upper - 1], self.knots[upper]
        return upper - 1, ((roughness - low) / (high - low)).clamp(0, 1)


@dataclass(frozen=True)
class _Group:
    """The levels of one pooling factor, which share its map and its Fourier transform.

    sharp   whether the map itself is the first of them
    weight  float32 [h, factor, 1, 1, 1], share of each row of texels in its block's mean
    kernel  [w / 2 + 1, levels x h, h], the lobes' matrices between rows, one per longitudinal frequency
    """

    factor: int
    sharp: bool
    weight: torch.Tensor
    kernel: torch.Tensor

    @cached_property
    def adjoint(self) -> torch.Tensor:
        """`kernel` with its rows and columns exchanged."""
        return self.kernel.transpose(1, 2).contiguous()

    @classmethod
    def of(cls, factor: int, factors: list[int], sizes: list[tuple[int, int]], device: torch.device | str) -> _Group:
        mine = [k for k, own in enumerate(factors) if own == factor]
        height, width = sizes[mine[0]]
        angle = envmap.solid_angles(height * factor, width * factor).reshape(height, factor)
        weight = torch.from_numpy((angle / (angle.sum(axis=1, keepdims=True) * factor)).astype(np.float32))
        lobes = [_lobe_spectrum(LEVELS[k], height, width) for k in mine if LEVELS[k] > 0]
        kernel = np.concatenate([np.zeros((width // 2 + 1, 0, height), np.float32), *lobes], axis=1)
        sharp = any(LEVELS[k] == 0 for k in mine)
        return cls(
            factor, sharp, weight.reshape(height, factor, 1, 1, 1).to(device), torch.from_numpy(kernel).to(device)
        )

    def pool(self, environment: torch.Tensor) -> torch.Tensor:
        """Mean [h, w, 3] of blocks of factor x factor texels, by solid angle."""
        if self.factor == 1:
            return environment
        rows, factor = self.weight.shape[:2]
        # a product, then slices: torch's sum over two axes of such blocks takes ten times as long
        weight = self.weight.to(environment.dtype).view(rows, 1, factor)
        blocks = (weight @ environment.reshape(rows, factor, -1)).view(rows, -1, factor, 3)
        total = blocks[:, :, 0]
        for k in range(1, factor):
            total = total + blocks[:, :, k]
        return total

    def spread(self, gradient: torch.Tensor) -> torch.Tensor:
        """The adjoint of `pool`."""
        if self.factor == 1:
            return gradient
        rows, factor = self.weight.shape[:2]
        wide = gradient.reshape(rows, -1, 1, 3).expand(-1, -1, factor, -1).reshape(rows, 1, -1)
        return (wide * self.weight.to(gradient.dtype).view(rows, factor, 1)).view(rows * factor, -1, 3)


class _Build(torch.autograd.Function):
    """All levels of a map. A lobe is even in longitude, so its adjoint differs in the matrices between rows alone."""

    @staticmethod
    def forward(ctx, environment, groups):  # type: ignore[no-untyped-def]
        ctx.groups, levels = groups, []
        for group in groups:
            pooled = group.pool(environment)
            levels += [pooled] if group.sharp else []
            levels.append(convolve(pooled, group.kernel, group.adjoint))
        return torch.cat([level.reshape(-1, 3) for level in levels])

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        total, start = None, 0
        for group in ctx.groups:
            height, width = len(group.weight), 2 * (len(group.kernel) - 1)
            rows = [height * group.sharp, group.kernel.shape[1]]
            own = gradient[start : start + sum(rows) * width].reshape(-1, width, 3)
            start += sum(rows) * width
            pooled = convolve(own[rows[0] :], group.adjoint, group.kernel)
            part = group.spread(pooled + own[: rows[0]] if group.sharp else pooled)
            total = part if total is None else total + part
        return total, None


_TEXELS_PER_LOBE = 5.0
#: Rounds of scaling the lobe's rows and columns; a sun in the polar row is then kept to 1e-4.
_BALANCING = 30


def _pooling(roughness: float, height: int, width: int) -> int:
    """How far a level of this roughness may be coarsened: a power of two that divides the map."""
    rows = _TEXELS_PER_LOBE / max(roughness * roughness, ALPHA_MIN)
    factor = 1
    while height // (factor * 2) >= max(rows, 16) and height % (factor * 2) == 0 and width % (factor * 2) == 0:
        factor *= 2
    return factor


def _lobe_spectrum(roughness: float, height: int, width: int) -> np.ndarray:
    """The normalised lobe as matrices between rows, one per longitudinal frequency: float32 [W/2 + 1, H, H].

    Scaled on both sides alike, k_ij = s_i lobe_ij s_j, until every row sums to 1 over its solid angles. The lobe being
    symmetric, so are the columns: a uniform sky stays as it is, and no texel's light gains or loses by the grid
    (rows alone made a sun in the polar row 2.4 % too bright).
    """
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    longitude = 2 * np.pi * np.arange(width) / width
    sine, cosine = np.sin(latitude), np.cos(latitude)
    cos_angle = sine[:, None, None] * sine[None, :, None] + cosine[:, None, None] * cosine[None, :, None] * np.cos(
        longitude
    )
    a2 = max(roughness * roughness, ALPHA_MIN) ** 2
    # head-on: the half vector stands at half the angle between axis and light
    sine2_half = np.clip(0.5 * (1 - cos_angle), 0, 1)
    lobe = np.clip(cos_angle, 0, None) * a2 / (a2 + (1 - a2) * sine2_half) ** 2
    angle = envmap.solid_angles(height, width)
    between = lobe.sum(axis=2) * angle
    scale = 1 / np.sqrt(between.sum(axis=1))
    for _ in range(_BALANCING):
        scale = np.sqrt(scale / (between @ scale))
    lobe *= scale[:, None, None] * (angle * scale)[None, :, None]
    lobe /= lobe.sum(axis=(1, 2), keepdims=True)
    # even in longitude, hence a real spectrum
    return np.ascontiguousarray(np.fft.rfft(lobe, axis=2).real.transpose(2, 0, 1)).astype(np.float32)


def convolve(rows: torch.Tensor, kernel: torch.Tensor, adjoint: torch.Tensor) -> torch.Tensor:
    """`rows` [R, W, 3] through a matrix per longitudinal frequency, `kernel` [W / 2 + 1, S, R]: [S, W, 3].

    `adjoint` is the kernel with S and R exchanged, which a CPU reads in float32 (`mix_frequencies`).
    """
    if kernel.shape[1] == 0 or len(rows) == 0:
        return rows.new_zeros(kernel.shape[1], rows.shape[1], 3)
    spectrum = torch.fft.rfft(rows, dim=1)
    if rows.device.type == "cpu" and rows.dtype == adjoint.dtype == torch.float32 and len(rows) <= 1024:
        return torch.fft.irfft(mix_frequencies(spectrum, adjoint), n=rows.shape[1], dim=1)
    parts = torch.view_as_real(spectrum).permute(1, 0, 2, 3).reshape(len(kernel), len(rows), 6)
    filtered = torch.bmm(kernel.to(rows.dtype), parts).reshape(len(kernel), -1, 3, 2)
    return torch.fft.irfft(torch.view_as_complex(filtered).permute(1, 0, 2), n=rows.shape[1], dim=1)


def _bilinear_in(
    height: torch.Tensor, width: torch.Tensor, u: torch.Tensor, v: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """`envmap.bilinear` for lookups that each have a map size of their own."""
    x = u * width - 0.5
    y = torch.minimum((v * height - 0.5).clamp_min(0), height - 1.0)
    x0 = x.floor()
    y0 = torch.minimum(y.floor(), (height - 2.0).clamp_min(0))
    fx, fy = x - x0, y - y0
    left = x0.long() % width
    right = (left + 1) % width
    top = y0.long() * width
    bottom = torch.minimum(y0.long() + 1, height - 1) * width
    index = torch.stack([top + left, top + right, bottom + left, bottom + right], dim=-1)
    weight = torch.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], dim=-1)
    return index, weight


_TABLE = 64


@cache
def reflectance_table(samples: int = 24, device: torch.device | str = "cpu") -> torch.Tensor:
    """A and B of the split sum on a grid of (n.v, r), float32 [64, 64, 2]; samples^2 half vectors each.
    Computed once in a process: not to be written to.

    A F0 + B is the directional albedo of D V F: the integral of f_s n.l over the upper hemisphere.
    """
    grid = (np.arange(_TABLE) + 0.5) / _TABLE
    n_v, roughness = (axis[..., None] for axis in np.meshgrid(grid, grid, indexing="ij"))
    a2 = np.maximum(roughness * roughness, ALPHA_MIN) ** 2
    s, t = ((axis.reshape(-1) + 0.5) / samples for axis in np.meshgrid(*[np.arange(samples)] * 2, indexing="ij"))
    cos2 = (1 - s) / (1 + (a2 - 1) * s)
    n_h, sine = np.sqrt(cos2), np.sqrt(1 - cos2)
    v_h = np.sqrt(1 - n_v * n_v) * sine * np.cos(2 * np.pi * t) + n_v * n_h
    n_l = 2 * v_h * n_h - n_v
    lit = (n_l > 0) & (v_h > 0)
    n_l = np.where(lit, n_l, 1)
    visibility = 0.5 / (n_l * np.sqrt(a2 + (1 - a2) * n_v * n_v) + n_v * np.sqrt(a2 + (1 - a2) * n_l * n_l))
    weight = np.where(lit, 4 * visibility * n_l * v_h / n_h, 0)
    fresnel = (1 - np.clip(v_h, 0, 1)) ** 5
    table = np.stack([(weight * (1 - fresnel)).mean(-1), (weight * fresnel).mean(-1)], axis=-1)
    return torch.from_numpy(table.astype(np.float32)).to(device)


def directional_albedo(
    table: torch.Tensor, n_v: torch.Tensor, roughness: torch.Tensor, f0: torch.Tensor | float
) -> torch.Tensor:
    """A(n.v, r) F0 + B(n.v, r), bilinear in `reflectance_table`; [N] for a number F0, else [N, 3]."""
    x = (n_v * _TABLE - 0.5).clamp(0, _TABLE - 1.001)
    y = (roughness * _TABLE - 0.5).clamp(0, _TABLE - 1.001)
    x0, y0 = x.detach().floor(), y.detach().floor()
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    row, column = x0.long(), y0.long()
    near = table[row, column] * (1 - fy) + table[row, column + 1] * fy
    far = table[row + 1, column] * (1 - fy) + table[row + 1, column + 1] * fy
    a, b = (near * (1 - fx) + far * fx).unbind(-1)
    if isinstance(f0, torch.Tensor) and f0.dim() > a.dim():
        a, b = a[..., None], b[..., None]
    return a * f0 + b


@cache
def _mean_table() -> torch.Tensor:
    """A and B of `reflectance_table` averaged over all directions of view, cosine-weighted: float32 [2, 64]."""
    n_v = (np.arange(_TABLE) + 0.5) / _TABLE
    weight = torch.from_numpy((n_v / n_v.sum()).astype(np.float32))
    return (reflectance_table() * weight[:, None, None]).sum(0).T.contiguous()


def mean_albedo(roughness: torch.Tensor, f0: torch.Tensor) -> torch.Tensor:
    """A(r) F0 + B(r) [N, 3]: the part of even light that the lobes of N points send back, to all sides together.

    roughness [N], f0 [N, 3]; differentiable in both.
    """
    columns = _mean_table().to(roughness)
    y = (roughness * _TABLE - 0.5).clamp(0, _TABLE - 1.001)
    row = y.detach().long()
    share = y - row  # a column after the other: rows of two by an index take half as long again
    a, b = (torch.lerp(column.take(row), column.take(row + 1), share)[:, None] for column in columns)
    return a * f0 + b


def scattered(base_color: torch.Tensor, roughness: torch.Tensor, metallic: torch.Tensor | None = None) -> torch.Tensor:
    """f [N, 3] of a surface that light meets on its way to another: all it sends, to all sides alike.

    base_color [N, 3], roughness [N], metallic [N] or None. The coat of a dielectric sends 0.03 to 0.08 of the light on,
    a tenth of what a surface of middling colour does and more; a metal has no other light to send.
    """
    lobes = mean_albedo(roughness, brdf.base_reflectance(base_color, metallic))
    return brdf.diffuse(base_color, metallic) + lobes / math.pi


def mean_visibility(
    transfer_visible: torch.Tensor, directions: torch.Tensor, reflected: torch.Tensor, roughness: float
) -> torch.Tensor:
    """Share of the lobe around `reflected` [N, 3] that sees the sky, [N]: the average over all K rays of a point,
    weighted by the lobe, from their visibility [N, K]."""
    alpha = resolved_alpha(roughness, len(directions))
    cosine = reflected @ directions.T
    sine2_half = (0.5 * (1 - cosine)).clamp(0, 1)
    weight = cosine.clamp_min(0) / (alpha**2 + (1 - alpha**2) * sine2_half) ** 2
    return (weight * transfer_visible).sum(1) / weight.sum(1)


def resolved_alpha(roughness: float, directions: int) -> float:
    """The width of the lobe of `roughness`, or the least that K = `directions` rays of a point resolve."""
    return max(roughness * roughness, math.sqrt(4 * math.pi / directions) / 4)
