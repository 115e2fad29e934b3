"""From light samples to radiance: the sum of eq. 17, differentiable in material, normal and environment.

    L = sum_s w_s E(d_s) f(A, d_s, v) max(n.d_s, 0),     w_s = visible / sum_i n_i p_i, held fixed

The reference is plain torch in any float type; float32 goes through a fused Warp kernel with its adjoint by hand.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.warp_runtime import launch, warp
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.monte_carlo.points import Material
from exmesh_graph.shading.monte_carlo.samples import LightSamples

#: Points of a piece of work.
_GRAIN = 1024


def shade(
    samples: LightSamples,
    normal: torch.Tensor,
    view: torch.Tensor,
    material: Material,
    environment: torch.Tensor,
) -> torch.Tensor:
    """Outgoing radiance [N, 3] of the samples' points under `environment` [H, W, 3].

    normal, view [N, 3] unit. Gradients reach normal, base colour, roughness, metallic and the environment's texels;
    directions, densities and visibility are constants. A material without roughness reflects diffusely only.

    Equation: 17.
    """
    if environment.dtype != torch.float32 or material.base_color.dtype != torch.float32:
        return shade_reference(samples, normal, view, material, environment)
    height, width = environment.shape[:2]
    if samples.pool.pool_samples:
        u, v = envmap.uv_of(samples.pool.direction)
        pool_radiance = gather_rows(environment.reshape(-1, 3), *envmap.bilinear(height, width, u, v))
    else:
        pool_radiance = environment.new_zeros(1, 3)
    zero = normal.new_zeros(len(normal))
    rough, metal = (zero if value is None else value for value in (material.roughness, material.metallic))
    inputs = (normal, material.base_color, rough, metal, pool_radiance, environment)
    return _Shade.apply(*inputs, view, samples, material.roughness is not None)


def shade_reference(
    samples: LightSamples,
    normal: torch.Tensor,
    view: torch.Tensor,
    material: Material,
    environment: torch.Tensor,
) -> torch.Tensor:
    """`shade` in plain torch, for any float type.

    Equation: 17.
    """
    direction = samples.directions().to(environment)
    radiance = envmap.lookup(environment, direction)
    spread = direction.shape[:2]
    n = normal[:, None].expand(*spread, 3)
    base = material.base_color[:, None].expand(*spread, 3)
    metallic = None if material.metallic is None else material.metallic[:, None].expand(spread)
    if material.roughness is None:
        f = brdf.diffuse(base, metallic)
    else:
        roughness = material.roughness[:, None].expand(spread)
        f = brdf.evaluate(n, view[:, None].expand(*spread, 3), direction, base, roughness, metallic)
    cosine = (n * direction).sum(-1).clamp_min(0)
    return (radiance * f * (cosine * samples.weight)[..., None]).sum(1)


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(ctx, normal, base, roughness, metallic, pool_radiance, environment, view, samples, specular):
        inputs = [t.detach().contiguous() for t in (normal, base, roughness, metallic, pool_radiance, environment)]
        view = view.detach().contiguous()
        out = torch.zeros_like(inputs[1])
        if len(out):
            split(_kernels().shade_light, len(out), *_arguments(inputs, view, samples, specular), out, grain=_GRAIN)
        ctx.save_for_backward(*inputs, view)
        ctx.samples, ctx.specular = samples, specular
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        *inputs, view = ctx.saved_tensors
        outputs = [torch.zeros_like(t) for t in inputs]
        if len(grad):
            given = _arguments(inputs, view, ctx.samples, ctx.specular)
            with_environment = int(ctx.needs_input_grad[4] or ctx.needs_input_grad[5])
            adjoint = _kernels().shade_light_adjoint
            launch(adjoint, len(grad), *given, grad.contiguous(), with_environment, *outputs)
        kept = [t if need else None for t, need in zip(outputs, ctx.needs_input_grad, strict=False)]
        return (*kept, None, None, None)


def _arguments(inputs: list[torch.Tensor], view: torch.Tensor, samples: LightSamples, specular: bool) -> list[Any]:
    normal, *material, pool_radiance, environment = inputs
    pool = samples.pool
    own = [t.reshape(-1, t.shape[-1]) for t in (samples.own_direction, samples.own_uv)]
    own = [t if len(t) else environment.new_zeros(1, t.shape[-1]) for t in own]
    light = (pool.direction, pool_radiance, samples.block, *own, samples.weight, environment, *environment.shape[:2])
    return [normal, view, *material, int(specular), *light, pool.pool_samples, pool.own_samples]


@cache
def _kernels() -> Any:
    warp()
    from exmesh_graph.shading.monte_carlo import kernels_shade

    return kernels_shade
