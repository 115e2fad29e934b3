"""L1, silhouette and squared error with their gradients in one pass, for a CPU. Import through `runtime.kernels`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.gpu.simd import PRELUDE

wp.set_module_options({"enable_backward": False})

STRIP = wp.constant(32)
"""Rows of an image that one item is for."""

_SNIPPET = (
    PRELUDE
    + """
    const int end = (strip + 1) * rows < height ? (strip + 1) * rows : height;
    const vf zero = 0.f;
    double sums[3] = {};
    // adds |a - b| and (a - b)^2 over n floats; slope sign(a - b) goes to g
    auto compare = [&](const float* a, const float* b, float* g, int n, float slope, double& distance, double* square) {
        vf absolute = 0.f, squared = 0.f;
        const vf up = slope, down = -slope;
        int i = 0;
        for (; i + LANES <= n; i += LANES) {
            const vf d = LOAD(a + i) - LOAD(b + i);
            absolute += __builtin_elementwise_abs(d);
            squared += d * d;
            STORE(g + i, d > zero ? up : (d < zero ? down : zero));
        }
        float rest = 0.f, rest_squared = 0.f;
        for (; i < n; ++i) {
            const float d = a[i] - b[i];
            rest += d < 0.f ? -d : d;
            rest_squared += d * d;
            g[i] = d > 0.f ? slope : (d < 0.f ? -slope : 0.f);
        }
        for (int k = 0; k < LANES; ++k) { rest += absolute[k]; rest_squared += squared[k]; }
        distance += rest;
        if (square) *square += rest_squared;
    };
    for (long row = (long)strip * rows; row < end; ++row) {
        float* to = grad.data + row * 3 * width;
        const long at = row * width;
        compare(colour.data + 3 * at, target.data + 3 * at, to, 3 * width, by_colour, sums[0], sums + 1);
        compare(alpha.data + at, mask.data + at, grad_alpha.data + at, width, by_alpha, sums[2], nullptr);
        if (row >= box_top && row < box_bottom) {
            const int n = 3 * (box_right - box_left);
            const float* from = in_box.data + (row - box_top) * n;
            to += 3 * box_left;
            int i = 0;
            for (; i + LANES <= n; i += LANES) STORE(to + i, LOAD(to + i) + by_box * LOAD(from + i));
            for (; i < n; ++i) to[i] += by_box * from[i];
        }
    }
    for (int k = 0; k < 3; ++k) totals.data[3 * strip + k] = sums[k];
"""
)


@wp.func_native(_SNIPPET)
def _compare(
    strip: int,
    rows: int,
    height: int,
    width: int,
    box_top: int,
    box_bottom: int,
    box_left: int,
    box_right: int,
    by_colour: float,
    by_box: float,
    by_alpha: float,
    colour: wp.array(dtype=float),
    target: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    mask: wp.array(dtype=float),
    in_box: wp.array(dtype=float),
    grad: wp.array(dtype=float),
    grad_alpha: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def compare_strips(
    first: int,
    height: int,
    width: int,
    box_top: int,
    box_bottom: int,
    box_left: int,
    box_right: int,
    by_colour: float,
    by_box: float,
    by_alpha: float,
    colour: wp.array(dtype=float),
    target: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    mask: wp.array(dtype=float),
    in_box: wp.array(dtype=float),
    grad: wp.array(dtype=float),
    grad_alpha: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
):
    """Strip `first + tid`: totals of |colour - target|, its square and |alpha - mask|, and the gradients of
    by_colour |colour - target| + by_alpha |alpha - mask|, plus by_box times what is given `in_box`."""
    _compare(
        first + wp.tid(), STRIP, height, width, box_top, box_bottom, box_left, box_right, by_colour, by_box, by_alpha,
        colour, target, alpha, mask, in_box, grad, grad_alpha, totals,
    )  # fmt: skip
