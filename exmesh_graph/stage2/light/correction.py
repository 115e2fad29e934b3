"""The factor `c` of the precomputed light, measured by rays: traced / split sum, pixel by pixel.

A pixel's neighbours on the same surface see nearly the same through their lobes. So their rays count with its own, and
in a view of many pixels only those at the crossings of every n-th row and column are measured: between them the factor
is interpolated, as far as the lobes there are alike.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch

from exmesh_graph.shading import brdf
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.light.sparse import Sparse, shared_lobes, spacing
from exmesh_graph.stage2.light.traced import HitRadiance, traced_specular
from exmesh_graph.stage2.maps import Material
from exmesh_graph.stage2.surface import SurfaceSamples

if TYPE_CHECKING:
    from exmesh_graph.stage2.light.precomputed import PrecomputedLight, PreparedTransport

#: Bounds of the factor: where the split sum is nearly black the ratio means nothing.
LARGEST = 4.0


@torch.no_grad()
def measured_specular_scale(
    light: PrecomputedLight,
    buffer: ViewBuffer,
    material: Material,
    prepared: PreparedTransport,
    environment: torch.Tensor,
    sent: HitRadiance,
    generator: torch.Generator,
    crossings: int | None = None,
) -> torch.Tensor:
    """A view's factor [N, 3]; the mesh sends `sent` to where a ray meets it."""
    every = spacing(len(buffer.pixel), crossings)
    surface = light.surface(buffer, material)
    rest = prepared, environment, sent, generator
    if every == 1:
        near = buffer.neighbours.long()
        return _measured(light, buffer, surface, material, near, shared_lobes(surface, material.roughness, near), *rest)
    sparse = Sparse.of(buffer, surface, material.roughness, every)
    some = Material(material.table[sparse.rows], material.has_metallic, material.has_normal)
    surface = surface[sparse.rows]
    return sparse.spread(_measured(light, buffer.at(sparse.rows), surface, some, sparse.near, sparse.share, *rest))


def _measured(
    light: PrecomputedLight,
    buffer: ViewBuffer,
    surface: SurfaceSamples,
    material: Material,
    near: torch.Tensor,
    share: torch.Tensor,
    prepared: PreparedTransport,
    environment: torch.Tensor,
    sent: HitRadiance,
    generator: torch.Generator,
) -> torch.Tensor:
    """The factor of all of a buffer's pixels, by rays of each and of those `near` [N, 4] it as far as they `share`.

    It is the ratio of the sums, and each pixel traces as many as make `correction_samples` together on the mean.
    """
    wanted, counted = light.settings.correction_samples, 1 + float(share.sum(1).mean())
    rays = math.ceil(wanted / counted)
    traced = traced_specular(
        surface,
        light.geometry.face_normals,
        material.roughness,
        brdf.base_reflectance(material.base_color, material.metallic),
        Pyramid(environment),
        light.tracer,
        sent,
        rays,
        torch.rand(len(surface), 2, generator=generator),
        wanted / rays,
    )
    split = light.split_sum(buffer, material, prepared, None if light.frames is None else surface)
    traced, split = (value + (share[..., None] * value[near]).sum(1) for value in (traced, split))
    return (traced / split.clamp_min(1e-6)).clamp(0, LARGEST)
