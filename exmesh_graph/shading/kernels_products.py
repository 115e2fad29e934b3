"""Products of the transport's operators with three colours, for a CPU. Import through `products`: its plain form."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.gpu.simd import PRELUDE

wp.set_module_options({"enable_backward": False})

BLOCK = wp.constant(1024)
"""Points of an item: their sums stay in the cache while the directions stream by."""

_FORWARD = (
    PRELUDE
    + r"""
    const long begin = (long)block * size, end = begin + size < points ? begin + size : points;
    const int n = (int)(end - begin), whole = n / LANES * LANES;
    float sum[3][1024];
    for (int c = 0; c < 3; ++c) for (int p = 0; p < n; ++p) sum[c][p] = 0.f;
    for (int k = 0; k < lights; ++k) {
        const float* t = transfer.data + (long)k * points + begin;
        const float r = radiance.data[3 * k], g = radiance.data[3 * k + 1], b = radiance.data[3 * k + 2];
        for (int p = 0; p < whole; p += LANES) {
            __builtin_prefetch(t + points + p);  // the next direction: another page, which no processor foresees
            const vf v = LOAD(t + p);
            STORE(sum[0] + p, LOAD(sum[0] + p) + v * r);
            STORE(sum[1] + p, LOAD(sum[1] + p) + v * g);
            STORE(sum[2] + p, LOAD(sum[2] + p) + v * b);
        }
        for (int p = whole; p < n; ++p) { sum[0][p] += t[p] * r; sum[1][p] += t[p] * g; sum[2][p] += t[p] * b; }
    }
    for (int p = 0; p < n; ++p) for (int c = 0; c < 3; ++c) out.data[3 * (begin + p) + c] = sum[c][p];
"""
)

_BACK = (
    PRELUDE
    + r"""
    const long begin = (long)block * size, end = begin + size < points ? begin + size : points;
    const int n = (int)(end - begin), whole = n / LANES * LANES;
    float by[3][1024];
    for (int p = 0; p < n; ++p) for (int c = 0; c < 3; ++c) by[c][p] = gradient.data[3 * (begin + p) + c];
    for (int k = 0; k < lights; ++k) {
        const float* t = transfer.data + (long)k * points + begin;
        vf s[3] = {0.f, 0.f, 0.f};
        for (int p = 0; p < whole; p += LANES) {
            __builtin_prefetch(t + points + p);  // the next direction: another page, which no processor foresees
            const vf v = LOAD(t + p);
            for (int c = 0; c < 3; ++c) s[c] += v * LOAD(by[c] + p);
        }
        for (int c = 0; c < 3; ++c) {
            double all = 0.0;
            for (int j = 0; j < LANES; ++j) all += s[c][j];
            for (int p = whole; p < n; ++p) all += t[p] * by[c][p];
            sums.data[((long)block * lights + k) * 3 + c] = all;
        }
    }
"""
)

_SPARSE = r"""
    typedef float v4 __attribute__((ext_vector_type(4), aligned(4)));
    const int begin = block * size, end = begin + size < rows ? begin + size : rows;
    for (int r = begin; r < end; ++r) {
        v4 sum = 0.f;
        for (int i = start.data[r]; i < start.data[r + 1]; ++i)
            sum += weight.data[i] * *(const v4*)(values.data + 4 * (long)column.data[i]);
        for (int c = 0; c < 3; ++c) out.data[3 * (long)r + c] = sum[c];
    }
"""


_MIX = (
    PRELUDE
    + r"""
    // of a frequency's numbers, red real and imaginary to blue: 2 * frequencies floats from colour to colour
    const long colour = 2L * frequencies;
    float x[6 * 1024];
    for (int r = 0; r < rows; ++r)
        for (int k = 0; k < 6; ++k) x[6 * r + k] = spectrum.data[(3L * r + k / 2) * colour + 2 * f + k % 2];
    const float* m = matrices.data + (long)f * rows * results;
    auto put = [&](int s, int k, float value) { out.data[(3L * s + k / 2) * colour + 2 * f + k % 2] = value; };
    int s = 0;
    for (; s + 2 * LANES <= results; s += 2 * LANES) {
        vf sum[2][6];
        for (int k = 0; k < 6; ++k) sum[0][k] = sum[1][k] = 0.f;
        for (int r = 0; r < rows; ++r) {
            const vf a = LOAD(m + (long)r * results + s), b = LOAD(m + (long)r * results + s + LANES);
            for (int k = 0; k < 6; ++k) {
                sum[0][k] += a * x[6 * r + k];
                sum[1][k] += b * x[6 * r + k];
            }
        }
        for (int k = 0; k < 6; ++k)
            for (int j = 0; j < LANES; ++j) {
                put(s + j, k, sum[0][k][j]);
                put(s + LANES + j, k, sum[1][k][j]);
            }
    }
    for (; s < results; ++s)
        for (int k = 0; k < 6; ++k) {
            float sum = 0.f;
            for (int r = 0; r < rows; ++r) sum += m[(long)r * results + s] * x[6 * r + k];
            put(s, k, sum);
        }
"""
)


@wp.func_native(_FORWARD)
def _direct(
    block: int,
    size: int,
    points: int,
    lights: int,
    transfer: wp.array(dtype=float),
    radiance: wp.array(dtype=float),
    out: wp.array(dtype=float),
): ...


@wp.kernel
def direct(
    first: int,
    points: int,
    lights: int,
    transfer: wp.array(dtype=float),
    radiance: wp.array(dtype=float),
    out: wp.array(dtype=float),
):
    """T L [P, 3]; `transfer` is T transposed."""
    _direct(first + wp.tid(), BLOCK, points, lights, transfer, radiance, out)


@wp.func_native(_BACK)
def _direct_adjoint(
    block: int,
    size: int,
    points: int,
    lights: int,
    transfer: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
    sums: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def direct_adjoint(
    first: int,
    points: int,
    lights: int,
    transfer: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
    sums: wp.array(dtype=wp.float64),
):
    """The share of each block of points in T^T g, [blocks, K, 3]."""
    _direct_adjoint(first + wp.tid(), BLOCK, points, lights, transfer, gradient, sums)


@wp.func_native(_SPARSE)
def _sparse(
    block: int,
    size: int,
    rows: int,
    start: wp.array(dtype=int),
    column: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    values: wp.array(dtype=float),
    out: wp.array(dtype=float),
): ...


@wp.kernel
def sparse(
    first: int,
    rows: int,
    start: wp.array(dtype=int),
    column: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    values: wp.array(dtype=float),
    out: wp.array(dtype=float),
):
    """M x [R, 3] of a matrix in rows; `values` are x in rows of four floats."""
    _sparse(first + wp.tid(), BLOCK, rows, start, column, weight, values, out)


@wp.func_native(_MIX)
def _mix_frequencies(
    f: int,
    frequencies: int,
    rows: int,
    results: int,
    spectrum: wp.array(dtype=float),
    matrices: wp.array(dtype=float),
    out: wp.array(dtype=float),
): ...


@wp.kernel
def mix_frequencies(
    first: int,
    frequencies: int,
    rows: int,
    results: int,
    spectrum: wp.array(dtype=float),
    matrices: wp.array(dtype=float),
    out: wp.array(dtype=float),
):
    """One frequency of each row of three colours, [R, 3, F, 2], through its matrix [R, S]: [S, 3, F, 2]."""
    _mix_frequencies(first + wp.tid(), frequencies, rows, results, spectrum, matrices, out)
