"""One diffuse bounce off the mesh itself (eq. 18 to 20).

    L_ind(x) = f_d(x) I(x),   I(x) = sum_j w_j max(n_s(x).w_j, 0) L_sec(y_j),   w_j = front-facing hit / (N_b p_b(w_j))
    L_sec(y) = f_d(y) sum_s E(d_s) visible max(n_s(y).d_s, 0) / (N_s p(d_s))

Secondary directions follow the cosine about the geometric normal. Gradients reach f_d(x), f_d(y), both shading normals
and the environment; directions, densities, hits and visibility are constants.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from exmesh_graph.rays import MISS, RayTracer
from exmesh_graph.rays.tensors import closest_hit
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo.points import Material, Points, Query, Surface, mixed
from exmesh_graph.shading.monte_carlo.samples import (
    LEAST_BLOCKS,
    LightPool,
    LightSamples,
    draw_directions,
    draw_light,
    make_pool,
    ray_origins,
    rows_within,
)
from exmesh_graph.shading.monte_carlo.shade import shade, shade_reference


@dataclass(frozen=True)
class SecondaryHits:
    """M valid secondary hits and their light samples.

    row int64 [M], the primary point; direction [M, 3]; weight [M] = 1 / (N_b p_b); face int64 [M], bary [M, 3];
    light, the samples towards the environment
    """

    row: torch.Tensor
    direction: torch.Tensor
    weight: torch.Tensor
    face: torch.Tensor
    bary: torch.Tensor
    light: LightSamples


@torch.no_grad()
def draw_bounce(
    points: Points,
    surface: Surface,
    query: Query,
    tracer: RayTracer,
    sampler: EnvSampler,
    rays: int,
    light_pool: LightPool,
    seed: int,
    memory_mib: float = 64,
) -> SecondaryHits:
    """Send `rays` rays from each point, keep the front-facing hits, and sample their light from `light_pool`."""
    pool = make_pool(sampler, "cosine", rays, seed)
    sent = draw_directions(points.flat, points, Material(torch.zeros_like(points.position)), pool, placed=False)
    origins = ray_origins(points, tracer)
    rows = rows_within(memory_mib, rays)
    hits = [
        _front_hits(sent, slice(start, start + rows), origins, surface, tracer)
        for start in range(0, max(len(points), 1), rows)
    ]
    row, direction, weight, face, bary = (torch.cat(column) for column in zip(*hits, strict=True))
    position = mixed(surface.vertices, surface.faces, face, bary)
    normal, material = query(face, bary)
    there = Points(position, surface.face_normals[face], normal, -direction)
    light = draw_light(there, Material(material.base_color), light_pool, tracer, memory_mib)
    return SecondaryHits(row, direction, weight, face, bary, light)


def _front_hits(
    sent: LightSamples, rows: slice, origins: torch.Tensor, surface: Surface, tracer: RayTracer
) -> tuple[torch.Tensor, ...]:
    """Row, direction, weight, face and barycentrics of the rays of `rows` that meet a face from its front."""
    weight = sent.weight[rows].reshape(-1)
    chosen = torch.nonzero(weight)[:, 0]
    row = torch.div(chosen, sent.weight.shape[1], rounding_mode="floor") + rows.start
    direction = sent.own_direction[rows].reshape(-1, 3)[chosen]
    hits = closest_hit(tracer, origins[row], direction)
    face = hits.face.long()
    front = (face != MISS) & ((surface.face_normals[face.clamp_min(0)] * direction).sum(-1) < 0)
    return row[front], direction[front], weight[chosen][front], face[front], hits.bary[front]


def secondary_radiance(
    hits: SecondaryHits,
    query: Query,
    environment: torch.Tensor,
    stand_in: Material | None = None,
    reference: bool = False,
    lobes: bool = False,
) -> torch.Tensor:
    """L_sec [M, 3]: the light that the hits send back along their rays. Arguments as of `bounce_irradiance`.

    Equation: 18.
    """
    normal, material = query(hits.face, hits.bary)
    if stand_in is not None:
        material = stand_in[hits.row]
    white = Material(torch.ones_like(material.base_color))
    arrived = (shade_reference if reference else shade)(hits.light, normal, -hits.direction, white, environment)
    return (material.sent() if lobes else material.diffuse()) * arrived


def bounce_irradiance(
    hits: SecondaryHits,
    points: Points,
    query: Query,
    environment: torch.Tensor,
    stand_in: Material | None = None,
    reference: bool = False,
    lobes: bool = False,
) -> torch.Tensor:
    """I(x) [N, 3], the indirect light that meets `points`; times f_d(x) it is L_ind.

    stand_in  the primary points' material, used at the hits in place of the query ("no secondary material")
    reference the plain torch sum instead of the fused kernels
    lobes     what the hits' lobes send is added, spread to all sides alike; the paper has diffuse light alone

    Equation: 19.
    """
    radiance = secondary_radiance(hits, query, environment, stand_in, reference, lobes)
    cosine = (points.normal[hits.row] * hits.direction).sum(-1).clamp_min(0)
    carried = radiance * (cosine * hits.weight)[:, None]
    return torch.zeros_like(points.position).to(carried).index_add(0, hits.row, carried)


def secondary_pool(pool: LightPool, sampler: EnvSampler, samples: int, seed: int) -> LightPool:
    """A pool of `samples` environment directions a hit; the same directions as `pool` where it has enough of them."""
    if 1 <= samples <= len(pool.direction) // LEAST_BLOCKS and pool.pool_samples:
        return replace(pool, kind="environment", pool_samples=samples, own_samples=0, seed=seed)
    return make_pool(sampler, "environment", samples, seed)
