"""Warp kernels of the terms that Gaussians are fitted by. CPU only: each calls a native snippet."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.splat.fused.native_terms import COMPARE, DEPTH, NORMALS, PULL_BACK, ROWS
from exmesh_graph.splat.fused.native_views import COMPARE_VIEWS, SAMPLES

wp.set_module_options({"enable_backward": False})

ROWS_EACH = wp.constant(ROWS)
"""Rows of a picture that an item is for."""
SAMPLES_EACH = wp.constant(SAMPLES)
"""Compared pixels of an item."""


@wp.func_native(COMPARE)
def _compare(
    band: int,
    rows: int,
    height: int,
    width: int,
    box_top: int,
    box_bottom: int,
    box_left: int,
    box_right: int,
    by_miss: float,
    by_ssim: float,
    by_alpha: float,
    gained: int,
    gain: wp.array(dtype=float),
    colour: wp.array(dtype=float),
    target: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    mask: wp.array(dtype=float),
    in_box: wp.array(dtype=float),
    to_colour: wp.array(dtype=float),
    to_alpha: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def compare(
    first: int,
    height: int,
    width: int,
    box_top: int,
    box_bottom: int,
    box_left: int,
    box_right: int,
    by_miss: float,
    by_ssim: float,
    by_alpha: float,
    gained: int,
    gain: wp.array(dtype=float),
    colour: wp.array(dtype=float),
    target: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    mask: wp.array(dtype=float),
    in_box: wp.array(dtype=float),
    to_colour: wp.array(dtype=float),
    to_alpha: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
):
    """Of each band of rows the sums of |colour - target|, its square, and |alpha - mask|; the terms' gradients.

    `in_box` is the gradient of SSIM inside the box; gradients are of colours before they were multiplied by `gain`.
    """
    _compare(
        first + wp.tid(),
        ROWS_EACH,
        height,
        width,
        box_top,
        box_bottom,
        box_left,
        box_right,
        by_miss,
        by_ssim,
        by_alpha,
        gained,
        gain,
        colour,
        target,
        alpha,
        mask,
        in_box,
        to_colour,
        to_alpha,
        totals,
    )


@wp.func_native(DEPTH)
def _depths(
    band: int,
    rows: int,
    height: int,
    width: int,
    grazing: float,
    lens: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    distance: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    image: wp.array(dtype=float),
    depth: wp.array(dtype=float),
    grey: wp.array(dtype=float),
): ...


@wp.kernel
def depths(
    first: int,
    height: int,
    width: int,
    grazing: float,
    lens: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    distance: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    image: wp.array(dtype=float),
    depth: wp.array(dtype=float),
    grey: wp.array(dtype=float),
):
    """Depth of the blended planes, 0 where there is none, and the mean of a photograph's channels: padded planes."""
    _depths(first + wp.tid(), ROWS_EACH, height, width, grazing, lens, normal, distance, alpha, image, depth, grey)


@wp.func_native(NORMALS)
def _compare_normals(
    band: int,
    rows: int,
    height: int,
    width: int,
    weight: float,
    strongest: float,
    lens: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    depth: wp.array(dtype=float),
    grey: wp.array(dtype=float),
    to_normal: wp.array(dtype=float),
    pulls: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def compare_normals(
    first: int,
    height: int,
    width: int,
    weight: float,
    strongest: float,
    lens: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    depth: wp.array(dtype=float),
    grey: wp.array(dtype=float),
    to_normal: wp.array(dtype=float),
    pulls: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
):
    """Of each band the sum of w |n(depth) alpha - N|_1.

    `to_normal` is set to the gradient in N, `pulls` to those in the depths to the right, to the left, below and above:
    four padded planes.
    """
    _compare_normals(
        first + wp.tid(),
        ROWS_EACH,
        height,
        width,
        weight,
        strongest,
        lens,
        normal,
        alpha,
        depth,
        grey,
        to_normal,
        pulls,
        totals,
    )


@wp.func_native(PULL_BACK)
def _pull_back(
    band: int,
    rows: int,
    height: int,
    width: int,
    lens: wp.array(dtype=float),
    distance: wp.array(dtype=float),
    depth: wp.array(dtype=float),
    pulls: wp.array(dtype=float),
    to_normal: wp.array(dtype=float),
    to_distance: wp.array(dtype=float),
): ...


@wp.kernel
def pull_back(
    first: int,
    height: int,
    width: int,
    lens: wp.array(dtype=float),
    distance: wp.array(dtype=float),
    depth: wp.array(dtype=float),
    pulls: wp.array(dtype=float),
    to_normal: wp.array(dtype=float),
    to_distance: wp.array(dtype=float),
):
    """Each depth's pulls carried to its plane: added to `to_normal`, `to_distance` is set."""
    _pull_back(first + wp.tid(), ROWS_EACH, height, width, lens, distance, depth, pulls, to_normal, to_distance)


@wp.func_native(COMPARE_VIEWS)
def _compare_views(
    item: int,
    samples: int,
    count: int,
    height: int,
    width: int,
    by_geometric: float,
    by_photometric: float,
    pixels: wp.array(dtype=wp.int64),
    relation: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    distance: wp.array(dtype=float),
    depth: wp.array(dtype=float),
    grey: wp.array(dtype=float),
    other_depth: wp.array(dtype=float),
    other_grey: wp.array(dtype=float),
    to_normal: wp.array(dtype=float),
    to_distance: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def compare_views(
    first: int,
    count: int,
    height: int,
    width: int,
    by_geometric: float,
    by_photometric: float,
    pixels: wp.array(dtype=wp.int64),
    relation: wp.array(dtype=float),
    normal: wp.array(dtype=float),
    distance: wp.array(dtype=float),
    depth: wp.array(dtype=float),
    grey: wp.array(dtype=float),
    other_depth: wp.array(dtype=float),
    other_grey: wp.array(dtype=float),
    to_normal: wp.array(dtype=float),
    to_distance: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
):
    """Of each stretch of pixels (none twice) the sums of both terms; gradients are added to those of the pixels."""
    _compare_views(
        first + wp.tid(),
        SAMPLES_EACH,
        count,
        height,
        width,
        by_geometric,
        by_photometric,
        pixels,
        relation,
        normal,
        distance,
        depth,
        grey,
        other_depth,
        other_grey,
        to_normal,
        to_distance,
        totals,
    )
