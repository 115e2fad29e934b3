"""Warp kernels of traced lobes. CPU only: each calls a native snippet. Import through `stage2.light.fused_lobes`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.stage2.light.native_lobes import LIGHT_RAYS, MAKE_RAYS, VISIBLE_SHARE

wp.set_module_options({"enable_backward": False})


@wp.func_native(MAKE_RAYS)
def _make_rays(
    item: int,
    groups: int,
    count: int,
    samples: int,
    grid: wp.array(dtype=float),
    shift: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    view: wp.array(dtype=float),
    flat: wp.array(dtype=float),
    roughness: wp.array(dtype=float),
    direction: wp.array(dtype=float),
    reach: wp.array(dtype=float),
    rays: wp.array(dtype=float),
): ...


@wp.kernel
def make_rays(
    first: int,
    groups: int,
    count: int,
    samples: int,
    grid: wp.array(dtype=float),
    shift: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    view: wp.array(dtype=float),
    flat: wp.array(dtype=float),
    roughness: wp.array(dtype=float),
    direction: wp.array(dtype=float),
    reach: wp.array(dtype=float),
    rays: wp.array(dtype=float),
):
    """Rays of the GGX lobe by its visible normals (shading.brdf_sampling.sample_specular); `reach` is 0 for useless
    ones and infinite for others."""
    _make_rays(
        first + wp.tid(), groups, count, samples, grid, shift, normal, view, flat, roughness, direction, reach, rays
    )


@wp.func_native(LIGHT_RAYS)
def _light_rays(
    item: int,
    groups: int,
    count: int,
    samples: int,
    texel: float,
    rays: wp.array(dtype=float),
    slot: wp.array(dtype=int),
    f0: wp.array(dtype=float),
    sent: wp.array(dtype=float),
    extra: wp.array(dtype=wp.bool),
    texels: wp.array(dtype=float),
    levels: wp.array(dtype=int),
    result: wp.array(dtype=float),
): ...


@wp.kernel
def light_rays(
    first: int,
    groups: int,
    count: int,
    samples: int,
    texel: float,
    rays: wp.array(dtype=float),
    slot: wp.array(dtype=int),
    f0: wp.array(dtype=float),
    sent: wp.array(dtype=float),
    extra: wp.array(dtype=wp.bool),
    texels: wp.array(dtype=float),
    levels: wp.array(dtype=int),
    result: wp.array(dtype=float),
):
    """Radiance [N, 3] of traced lobes; `texel` is half the log2 of a texel's solid angle in the finest level."""
    _light_rays(first + wp.tid(), groups, count, samples, texel, rays, slot, f0, sent, extra, texels, levels, result)


@wp.func_native(VISIBLE_SHARE)
def _visible_share(
    item: int,
    grain: int,
    count: int,
    lights: int,
    alpha: float,
    directions: wp.array(dtype=float),
    visible: wp.array(dtype=wp.uint8),
    point: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    reflected: wp.array(dtype=float),
    result: wp.array(dtype=float),
): ...


@wp.kernel
def visible_share(
    first: int,
    grain: int,
    count: int,
    lights: int,
    alpha: float,
    directions: wp.array(dtype=float),
    visible: wp.array(dtype=wp.uint8),
    point: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    reflected: wp.array(dtype=float),
    result: wp.array(dtype=float),
):
    """Visibility [N] interpolated between three lattice points, averaged over a lobe; `directions` [3, K]."""
    _visible_share(first + wp.tid(), grain, count, lights, alpha, directions, visible, point, weight, reflected, result)
