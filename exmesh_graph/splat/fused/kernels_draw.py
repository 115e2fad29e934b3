"""Warp kernels that draw Gaussians. CPU only: each calls a native snippet."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.splat.fused.native_blend import BLEND, LIST_TILES, SORT, SUM_SLOTS
from exmesh_graph.splat.fused.native_eight import BLOCK
from exmesh_graph.splat.fused.native_project import PROJECT

wp.set_module_options({"enable_backward": False})

GAUSSIANS = wp.constant(BLOCK)
"""Gaussians of an item."""


@wp.func_native(PROJECT)
def _project(
    block: int,
    block_size: int,
    count: int,
    means: wp.array(dtype=float),
    scales: wp.array(dtype=float),
    rotations: wp.array(dtype=float),
    opacities: wp.array(dtype=float),
    sh: wp.array(dtype=float),
    stored: int,
    degree: int,
    coloured: int,
    camera: wp.array(dtype=float),
    height: int,
    width: int,
    near: float,
    tile: int,
    records: wp.array(dtype=float),
    box: wp.array(dtype=int),
    depth: wp.array(dtype=float),
    tiles_of: wp.array(dtype=int),
): ...


@wp.kernel
def project(
    first: int,
    count: int,
    means: wp.array(dtype=float),
    scales: wp.array(dtype=float),
    rotations: wp.array(dtype=float),
    opacities: wp.array(dtype=float),
    sh: wp.array(dtype=float),
    stored: int,
    degree: int,
    coloured: int,
    camera: wp.array(dtype=float),
    height: int,
    width: int,
    near: float,
    tile: int,
    records: wp.array(dtype=float),
    box: wp.array(dtype=int),
    depth: wp.array(dtype=float),
    tiles_of: wp.array(dtype=int),
):
    """Record, pixel box, depth and number of touched tiles of each Gaussian of a block; no tile: not drawn."""
    _project(
        first + wp.tid(),
        GAUSSIANS,
        count,
        means,
        scales,
        rotations,
        opacities,
        sh,
        stored,
        degree,
        coloured,
        camera,
        height,
        width,
        near,
        tile,
        records,
        box,
        depth,
        tiles_of,
    )


@wp.func_native(LIST_TILES)
def _list_tiles(
    block: int,
    block_size: int,
    count: int,
    box: wp.array(dtype=int),
    first_slot: wp.array(dtype=int),
    tile: int,
    across: int,
    tile_of: wp.array(dtype=int),
): ...


@wp.kernel
def list_tiles(
    first: int,
    count: int,
    box: wp.array(dtype=int),
    first_slot: wp.array(dtype=int),
    tile: int,
    across: int,
    tile_of: wp.array(dtype=int),
):
    """The tile of each slot of a block's Gaussians."""
    _list_tiles(first + wp.tid(), GAUSSIANS, count, box, first_slot, tile, across, tile_of)


@wp.func_native(SORT)
def _sort_slots(
    count: int,
    slots: int,
    tiles: int,
    depth: wp.array(dtype=float),
    first_slot: wp.array(dtype=int),
    tile_of: wp.array(dtype=int),
    memory: wp.array(dtype=int),
    start: wp.array(dtype=int),
    entries: wp.array(dtype=int),
): ...


@wp.kernel
def sort_slots(
    count: int,
    slots: int,
    tiles: int,
    depth: wp.array(dtype=float),
    first_slot: wp.array(dtype=int),
    tile_of: wp.array(dtype=int),
    memory: wp.array(dtype=int),
    start: wp.array(dtype=int),
    entries: wp.array(dtype=int),
):
    """(slot, Gaussian) by tile and then by depth; of equal depth by number. One item."""
    _sort_slots(count, slots, tiles, depth, first_slot, tile_of, memory, start, entries)


@wp.func_native(BLEND)
def _blend(
    item: int,
    tiles: int,
    spread: int,
    start: wp.array(dtype=int),
    entries: wp.array(dtype=int),
    records: wp.array(dtype=float),
    box: wp.array(dtype=int),
    tile: int,
    across: int,
    height: int,
    width: int,
    coloured: int,
    colour: wp.array(dtype=float),
    alpha_out: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    distance: wp.array(dtype=float),
    left: wp.array(dtype=float),
    last: wp.array(dtype=int),
    middle: wp.array(dtype=int),
    weights: wp.array(dtype=float),
): ...


@wp.kernel
def blend(
    first: int,
    tiles: int,
    spread: int,
    start: wp.array(dtype=int),
    entries: wp.array(dtype=int),
    records: wp.array(dtype=float),
    box: wp.array(dtype=int),
    tile: int,
    across: int,
    height: int,
    width: int,
    coloured: int,
    colour: wp.array(dtype=float),
    alpha_out: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    distance: wp.array(dtype=float),
    left: wp.array(dtype=float),
    last: wp.array(dtype=int),
    middle: wp.array(dtype=int),
    weights: wp.array(dtype=float),
):
    """A tile's pixels, and of each of its slots the sum of w; `left` and `last` as in kernels_blend."""
    _blend(
        first + wp.tid(),
        tiles,
        spread,
        start,
        entries,
        records,
        box,
        tile,
        across,
        height,
        width,
        coloured,
        colour,
        alpha_out,
        normal,
        distance,
        left,
        last,
        middle,
        weights,
    )


@wp.func_native(SUM_SLOTS)
def _sum_slots(
    block: int,
    block_size: int,
    count: int,
    first_slot: wp.array(dtype=int),
    weights: wp.array(dtype=float),
    scales: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    thickness: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def sum_slots(
    first: int,
    count: int,
    first_slot: wp.array(dtype=int),
    weights: wp.array(dtype=float),
    scales: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    thickness: wp.array(dtype=wp.float64),
):
    """Per Gaussian of a block the sum of its slots' weights; of the block how many are seen, and their thickness."""
    _sum_slots(first + wp.tid(), GAUSSIANS, count, first_slot, weights, scales, weight, thickness)
