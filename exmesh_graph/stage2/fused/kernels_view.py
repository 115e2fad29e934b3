"""Warp kernels of one view's pixels. CPU only: each calls a native snippet (native_view)."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.stage2.fused.native_view import ADD_PIECES, PULL_BACK, RECORD, SHADE  # noqa: F401

wp.set_module_options({"enable_backward": False})


@wp.func_native(SHADE)
def _shade(
    piece: int,
    grain: int,
    count: int,
    channels: int,
    exposure: float,
    material: wp.array(dtype=float),
    predicted: wp.array(dtype=float),
    record: wp.array(dtype=float),
    point: wp.array(dtype=int),
    point_weight: wp.array(dtype=float),
    suns: int,
    transfer: wp.array(dtype=float),
    env_u: wp.array(dtype=float),
    env_v: wp.array(dtype=float),
    scale: wp.array(dtype=float),
    target: wp.array(dtype=float),
    clipped: wp.array(dtype=wp.bool),
    coverage: wp.array(dtype=float),
    box_pixel: wp.array(dtype=wp.int64),
    levels: wp.array(dtype=int),
    knots: wp.array(dtype=float),
    n_v: wp.array(dtype=float),
    irradiance: wp.array(dtype=float),
    flux: wp.array(dtype=float),
    stack: wp.array(dtype=float),
    table: wp.array(dtype=float),
    neighbours: wp.array(dtype=int),
    gloss: float,
    floor: float,
    image: wp.array(dtype=float),
    sums: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def shade_view(
    first: int,
    grain: int,
    count: int,
    channels: int,
    exposure: float,
    material: wp.array(dtype=float),
    predicted: wp.array(dtype=float),
    record: wp.array(dtype=float),
    point: wp.array(dtype=int),
    point_weight: wp.array(dtype=float),
    suns: int,
    transfer: wp.array(dtype=float),
    env_u: wp.array(dtype=float),
    env_v: wp.array(dtype=float),
    scale: wp.array(dtype=float),
    target: wp.array(dtype=float),
    clipped: wp.array(dtype=wp.bool),
    coverage: wp.array(dtype=float),
    box_pixel: wp.array(dtype=wp.int64),
    levels: wp.array(dtype=int),
    knots: wp.array(dtype=float),
    n_v: wp.array(dtype=float),
    irradiance: wp.array(dtype=float),
    flux: wp.array(dtype=float),
    stack: wp.array(dtype=float),
    table: wp.array(dtype=float),
    neighbours: wp.array(dtype=int),
    gloss: float,
    floor: float,
    image: wp.array(dtype=float),
    sums: wp.array(dtype=wp.float64),
):
    """Radiance of a view's pixels, their display values, and of each item's pixels the sums of log-L1 and steps."""
    _shade(
        first + wp.tid(), grain, count, channels, exposure, material, predicted, record, point,
        point_weight, suns, transfer, env_u, env_v, scale, target, clipped, coverage, box_pixel, levels,
        knots, n_v, irradiance, flux, stack, table, neighbours, gloss, floor, image, sums,
    )  # fmt: skip


@wp.func_native(PULL_BACK)
def _pull_back(
    piece: int,
    grain: int,
    count: int,
    channels: int,
    exposure: float,
    material: wp.array(dtype=float),
    predicted: wp.array(dtype=float),
    record: wp.array(dtype=float),
    point: wp.array(dtype=int),
    point_weight: wp.array(dtype=float),
    suns: int,
    transfer: wp.array(dtype=float),
    env_u: wp.array(dtype=float),
    env_v: wp.array(dtype=float),
    scale: wp.array(dtype=float),
    box_pixel: wp.array(dtype=wp.int64),
    levels: wp.array(dtype=int),
    knots: wp.array(dtype=float),
    image_weight: float,
    ssim_weight: float,
    image_gradient: wp.array(dtype=float),
    variation_weight: float,
    points: int,
    rows: int,
    to_material: wp.array(dtype=float),
    to_irradiance: wp.array(dtype=float),
    to_flux: wp.array(dtype=float),
    to_stack: wp.array(dtype=float),
): ...


@wp.kernel
def pull_back(
    first: int,
    grain: int,
    count: int,
    channels: int,
    exposure: float,
    material: wp.array(dtype=float),
    predicted: wp.array(dtype=float),
    record: wp.array(dtype=float),
    point: wp.array(dtype=int),
    point_weight: wp.array(dtype=float),
    suns: int,
    transfer: wp.array(dtype=float),
    env_u: wp.array(dtype=float),
    env_v: wp.array(dtype=float),
    scale: wp.array(dtype=float),
    box_pixel: wp.array(dtype=wp.int64),
    levels: wp.array(dtype=int),
    knots: wp.array(dtype=float),
    image_weight: float,
    ssim_weight: float,
    image_gradient: wp.array(dtype=float),
    variation_weight: float,
    points: int,
    rows: int,
    to_material: wp.array(dtype=float),
    to_irradiance: wp.array(dtype=float),
    to_flux: wp.array(dtype=float),
    to_stack: wp.array(dtype=float),
):
    """The gradient of the weighted terms in material, irradiance, flux, stack; the last three for each item apart."""
    _pull_back(
        first + wp.tid(), grain, count, channels, exposure, material, predicted, record, point,
        point_weight, suns, transfer, env_u, env_v, scale, box_pixel, levels, knots, image_weight,
        ssim_weight, image_gradient, variation_weight, points, rows, to_material, to_irradiance, to_flux,
        to_stack,
    )  # fmt: skip


@wp.func_native(ADD_PIECES)
def _add_pieces(item: int, grain: int, size: int, pieces: int, values: wp.array(dtype=float)): ...


@wp.kernel
def add_pieces(first: int, grain: int, size: int, pieces: int, values: wp.array(dtype=float)):
    """values[0] += values[1] + ..., of `pieces` arrays of `size` floats (a multiple of 8), in their order."""
    _add_pieces(first + wp.tid(), grain, size, pieces, values)
