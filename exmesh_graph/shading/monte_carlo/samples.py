"""Where light is sampled: directions, densities and visibility of an estimate of eq. 17. Nothing here has gradients.

A sample towards w, of any technique, has the weight visible / sum_i n_i p_i(w): the balance heuristic (Veach and Guibas
1995), which with one technique is 1 / (n p). p_i are densities on the sphere; none is floored.

Samples of the environment come from one pool for all points: blocks of N_d points of a scrambled Sobol sequence mapped
to the sphere by `EnvSampler`; each point takes one block at random. An aligned block of 2^m such points is itself
stratified (a (0, m, 2)-net), each of its samples alone has density p, so the estimate is unbiased; radiance and
density are read once per pool entry and not once per sample. Lobe samples are one small net, shifted at random per
point (Cranley and Patterson 1976).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, get_args

import torch

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.rays import RayTracer, offset_origins
from exmesh_graph.rays.tensors import any_hit
from exmesh_graph.shading.brdf_sampling import specular_share
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo.points import Material, Points

Sampler = Literal["environment", "brdf", "mis", "cosine"]

#: Entries of the pool where blocks are long, and the fewest blocks for the points to choose from.
_POOL, LEAST_BLOCKS = 1 << 13, 64

#: Points of a piece of work.
_GRAIN = 1024

#: Working memory of one traced ray on its way through torch and the tracer.
_BYTES_PER_RAY = 200


@dataclass(frozen=True)
class LightPool:
    """Directions drawn from the environment for all points of an estimate.

    direction [P, 3]; pdf [P]; density [H W] and shape (H, W) of the sampler's table, for lobe samples;
    lobe_points [n, 2] in [0, 1): the net of the points' own samples. pool_samples + own_samples = N_d.
    """

    direction: torch.Tensor
    pdf: torch.Tensor
    density: torch.Tensor
    shape: tuple[int, int]
    lobe_points: torch.Tensor
    kind: Sampler
    pool_samples: int
    own_samples: int
    seed: int


@dataclass(frozen=True)
class LightSamples:
    """The samples of N points: of each, block `block` [N] of the pool, then own directions [N, own, 3].

    own_uv [N, own, 2]: where the own directions lie in the environment's image; set where weight > 0
    weight [N, pool_samples + own_samples]: visible / sum_i n_i p_i
    """

    pool: LightPool
    block: torch.Tensor
    own_direction: torch.Tensor
    own_uv: torch.Tensor
    weight: torch.Tensor

    def directions(self) -> torch.Tensor:
        """All directions, [N, samples, 3]."""
        count = self.pool.pool_samples
        index = self.block.long()[:, None] * count + torch.arange(count, device=self.block.device)
        return torch.cat([self.pool.direction[index], self.own_direction], dim=1)


def make_pool(sampler: EnvSampler, kind: Sampler, count: int, seed: int, blocks: int = 1024) -> LightPool:
    """The pool for `count` samples a point: all from the environment, all from the BRDF's lobes ("brdf"), half and
    half ("mis"), or from the cosine lobe ("cosine"). The same seed gives the same samples.

    blocks    the most sets of environment samples that points choose from; fewer where the sets are large
    """
    if kind not in get_args(Sampler):
        raise ValueError(f"sampler {kind!r}; expected one of {', '.join(get_args(Sampler))}")
    if count < 1 or (kind == "mis" and count < 2):
        raise ValueError(f"{count} samples by {kind!r}; expected at least {2 if kind == 'mis' else 1}")
    pool_samples = {"environment": count, "mis": count // 2}.get(kind, 0)
    own_samples = count - pool_samples
    device = sampler.density.device
    blocks = min(blocks, max(LEAST_BLOCKS, _POOL // max(pool_samples, 1)))
    uniform = _sobol(blocks * pool_samples, seed).to(device)
    direction, pdf = sampler.sample(uniform)
    return LightPool(
        direction=direction.to(device, torch.float32).contiguous(),
        pdf=pdf.to(device, torch.float32).contiguous(),
        density=sampler.density.reshape(-1).to(torch.float32).contiguous(),
        shape=sampler.shape,
        lobe_points=_sobol(own_samples, seed + 1).to(device, torch.float32).contiguous(),
        kind=kind,
        pool_samples=pool_samples,
        own_samples=own_samples,
        seed=seed,
    )


@torch.no_grad()
def draw_light(
    points: Points,
    material: Material,
    pool: LightPool,
    tracer: RayTracer,
    memory_mib: float = 64,
    turning: bool = False,
) -> LightSamples:
    """Draw the samples of `points` and trace them, as many rays at a time as fit into `memory_mib`. float32.

    turning    keep environment samples under the horizons of the shading normals, for normals that will turn
    """
    drawn = draw_directions(points.normal, points, material, pool, turning)
    rows = rows_within(memory_mib, drawn.weight.shape[1])
    origins = ray_origins(points, tracer)
    for start in range(0, len(points), rows):
        _occlude(drawn, slice(start, start + rows), origins, tracer)
    return drawn


@torch.no_grad()
def draw_directions(
    normal: torch.Tensor,
    points: Points,
    material: Material,
    pool: LightPool,
    turning: bool = False,
    placed: bool = True,
) -> LightSamples:
    """The samples of `points` around `normal` [N, 3], untraced: weights are 0 only under the horizons of `normal`
    (with `turning` not those of environment samples) and of the surface itself.

    placed    own directions' places in the environment are wanted; without, `own_uv` is not set
    """
    count, device = len(points), points.position.device
    samples = pool.pool_samples + pool.own_samples
    if count * samples >= 2**31:
        raise ValueError(f"{count} points of {samples} samples: kernels count to 2^31 - 1; draw the points in parts")
    normal, flat, view = (v.detach().float().contiguous() for v in (normal, points.flat, points.view))
    roughness = share = torch.zeros(count, device=device)
    if material.roughness is not None and pool.kind in ("brdf", "mis"):
        roughness = material.roughness.detach().float().contiguous()
        share = specular_share(normal, view, material.base_color.detach(), material.metallic).float().contiguous()
    block = torch.empty(count, dtype=torch.int32, device=device)
    own = torch.empty(count * pool.own_samples, 3, device=device)
    own_uv = torch.empty(count * pool.own_samples, 2, device=device)
    weight = torch.empty(count * samples, device=device)
    if count:
        blocks = max(len(pool.direction) // max(pool.pool_samples, 1), 1)
        places = (normal, flat, view, roughness, share)
        source = (pool.direction, pool.pdf, pool.density, *pool.shape, pool.lobe_points)
        counts = (pool.pool_samples, pool.own_samples, blocks, pool.seed & 0x7FFFFFFF, int(turning), int(placed))
        results = [t if len(t) else t.new_empty(1, t.shape[1]) for t in (own, own_uv)]
        split(_kernels().draw_light, count, *places, *source, *counts, block, *results, weight, grain=_GRAIN)
    spread = (count, pool.own_samples)
    return LightSamples(pool, block, own.view(*spread, 3), own_uv.view(*spread, 2), weight.view(count, samples))


def _occlude(drawn: LightSamples, rows: slice, origins: torch.Tensor, tracer: RayTracer) -> None:
    """Set the weights of the rows' blocked samples to 0, in place."""
    pool, weight = drawn.pool, drawn.weight[rows].view(-1)
    chosen = torch.nonzero(weight)[:, 0]
    if len(chosen) == 0:
        return
    own = drawn.own_direction[rows].reshape(-1, 3)
    row = torch.empty(len(chosen), dtype=torch.int32, device=chosen.device)
    direction = torch.empty(len(chosen), 3, device=chosen.device)
    source = (drawn.block[rows], pool.direction, own if len(own) else direction)
    counts = (pool.pool_samples, pool.own_samples)
    split(_kernels().ray_directions, len(chosen), chosen, *source, *counts, row, direction, grain=_GRAIN)
    weight[chosen[any_hit(tracer, origins[rows][row], direction)]] = 0


def rows_within(memory_mib: float, rays: int) -> int:
    """How many points with `rays` rays each can be traced at a time within the memory (at least one)."""
    return max(1, int(memory_mib * 2**20 / (_BYTES_PER_RAY * max(rays, 1))))


def ray_origins(points: Points, tracer: RayTracer) -> torch.Tensor:
    """Where the points' rays start, lifted along their geometric normals: float64 [N, 3]."""
    return offset_origins(points.position.detach(), points.flat.detach(), tracer.radius)


def _sobol(count: int, seed: int) -> torch.Tensor:
    """`count` points (at least one) of a scrambled Sobol sequence in [0, 1)^2, float64."""
    engine = torch.quasirandom.SobolEngine(2, scramble=True, seed=seed & 0x7FFFFFFF)
    return engine.draw(max(count, 1), dtype=torch.float64).clamp_max(1 - 1e-9)


@cache
def _kernels() -> Any:
    warp()
    from exmesh_graph.shading.monte_carlo import kernels_draw

    return kernels_draw
