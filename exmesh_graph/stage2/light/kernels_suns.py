"""Warp kernels of rays towards suns. CPU only: each calls a native snippet. Import by `stage2.light.fused_suns`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.stage2.light.native_suns import AIM, REFLECT

wp.set_module_options({"enable_backward": False})


@wp.func_native(AIM)
def _aim(
    item: int,
    groups: int,
    count: int,
    samples: int,
    height: int,
    width: int,
    first: wp.array(dtype=int),
    texel: wp.array(dtype=int),
    cumulated: wp.array(dtype=float),
    grid: wp.array(dtype=float),
    shift: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    flat: wp.array(dtype=float),
    direction: wp.array(dtype=float),
    seen: wp.array(dtype=float),
): ...


@wp.kernel
def aim(
    begin: int,
    groups: int,
    count: int,
    samples: int,
    height: int,
    width: int,
    first: wp.array(dtype=int),
    texel: wp.array(dtype=int),
    cumulated: wp.array(dtype=float),
    grid: wp.array(dtype=float),
    shift: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    flat: wp.array(dtype=float),
    direction: wp.array(dtype=float),
    seen: wp.array(dtype=float),
):
    """Directions towards suns (shading.suns.Suns.directions), and the cosine with the normal, 0 below a horizon.

    Sun k has the texels first[k] to first[k + 1] of `texel`, whose shares `cumulated` sums up.
    """
    _aim(
        begin + wp.tid(), groups, count, samples, height, width, first, texel, cumulated, grid, shift, normal, flat,
        direction, seen,
    )  # fmt: skip


@wp.func_native(REFLECT)
def _reflect(
    item: int,
    groups: int,
    count: int,
    samples: int,
    least: float,
    normal: wp.array(dtype=float),
    view: wp.array(dtype=float),
    direction: wp.array(dtype=float),
    seen: wp.array(dtype=float),
    flux: wp.array(dtype=float),
    diffuse: wp.array(dtype=float),
    roughness: wp.array(dtype=float),
    f0: wp.array(dtype=float),
    result: wp.array(dtype=float),
): ...


@wp.kernel
def reflect(
    first: int,
    groups: int,
    count: int,
    samples: int,
    least: float,
    normal: wp.array(dtype=float),
    view: wp.array(dtype=float),
    direction: wp.array(dtype=float),
    seen: wp.array(dtype=float),
    flux: wp.array(dtype=float),
    diffuse: wp.array(dtype=float),
    roughness: wp.array(dtype=float),
    f0: wp.array(dtype=float),
    result: wp.array(dtype=float),
):
    """Radiance [N, 3] of suns' light by the whole BRDF (shading.brdf), diffuse only where alpha is below `least`."""
    _reflect(
        first + wp.tid(), groups, count, samples, least, normal, view, direction, seen, flux, diffuse, roughness, f0,
        result,
    )  # fmt: skip
