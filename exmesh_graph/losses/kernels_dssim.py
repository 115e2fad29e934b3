"""SSIM and its gradient in one pass over an image's rows, for a CPU. Import through `dssim`.

Rows stream through two rings of eleven: x, x^2 and x y blurred along the row; blurred down the ring they are the local
moments, which give the similarity and its partial derivatives; those are blurred along the row into the second ring,
and blurred down it they are the gradient. All of it stays in the cache. Colours are interleaved: the taps of a
C-channel image lie C floats apart, so that vectors run over channels and columns alike.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import math

import warp as wp

from exmesh_graph.gpu.simd import PRELUDE, padded

wp.set_module_options({"enable_backward": False})

VALUE, GRADIENT, MOMENTS = 0, 1, 2
"""The modes of the kernel."""
ROWS = wp.constant(64)
"""Rows of an image that one item of the kernel is for; it reads ten more on either side."""
WINDOW, SIGMA = 11, 1.5
_C1, _C2 = 0.01**2, 0.03**2
_HALF = WINDOW // 2
_TAPS = [math.exp(-((k - _HALF) ** 2) / (2 * SIGMA**2)) for k in range(WINDOW)]
_WEIGHTS = [tap / sum(_TAPS) for tap in _TAPS[: _HALF + 1]]
_PLANES = 3
_ROWS_KEPT = 2 * _PLANES * WINDOW + 2 * _PLANES + 4


def scratch_size(height: int, width: int, channels: int) -> int:
    """Floats that the kernel needs besides images."""
    return -(-height // ROWS) * _ROWS_KEPT * _stride(width * channels, channels)


def _stride(count: int, channels: int) -> int:
    return padded(count) + 2 * padded(_HALF * channels)


_SNIPPET = (
    PRELUDE
    + f"""
    constexpr int RING = {WINDOW}, HALF = {_HALF};
    const float C1 = {_C1}f, C2 = {_C2}f;
    const float w0 = {_WEIGHTS[0]}f, w1 = {_WEIGHTS[1]}f, w2 = {_WEIGHTS[2]}f;
    const float w3 = {_WEIGHTS[3]}f, w4 = {_WEIGHTS[4]}f, w5 = {_WEIGHTS[5]}f;
"""
    + """
    const int n = width * channels;                               // floats in a row, and in whole vectors
    const int m = (n + LANES - 1) / LANES * LANES;
    const int pad = (HALF * channels + LANES - 1) / LANES * LANES;
    const long stride = m + 2 * pad;
    const int top = strip * rows;
    const int bottom = top + rows < height ? top + rows : height;

    float* memory = scratch.data + (long)strip * per_strip;
    for (long i = 0; i < 10 * stride; ++i) memory[i] = 0.f;       // margins stay zero: nothing lies beyond the border
    float* moment[3]; float* partial[3]; float* given[4];         // padded rows: x, x^2, x y; partials; y, m_y, v_y, w
    float* next = memory + pad;
    for (int k = 0; k < 3; ++k, next += stride) moment[k] = next;
    for (int k = 0; k < 3; ++k, next += stride) partial[k] = next;
    for (int k = 0; k < 4; ++k, next += stride) given[k] = next;
    float* moments = next - pad;                                  // the two rings, [RING][3][stride]
    float* partials = moments + 3 * RING * stride;

    // eleven symmetric taps: of one row, s floats apart; and down a ring, row i + o of the slots r[0] to r[10]
#define TAPS(at) (w0 * (at(0) + at(10)) + w1 * (at(1) + at(9)) + w2 * (at(2) + at(8)) \\
    + w3 * (at(3) + at(7)) + w4 * (at(4) + at(6)) + w5 * at(5))
#define IN_ROW(k) LOAD(p + i + (k) * channels)
#define IN_RING(k) LOAD(f[k] + i + offset)

    auto slot = [&](float* ring, int row) { return ring + (long)((row + 2 * RING) % RING) * 3 * stride; };
    auto along = [&](float** from, float* to) {                   // three padded rows, blurred into a slot
        for (int k = 0; k < 3; ++k) {
            const float* p = from[k] - HALF * channels;
            for (int i = 0; i < m; i += LANES) STORE(to + k * stride + i, TAPS(IN_ROW));
        }
    };
    auto down = [&](const float** f, long offset, int i) -> vf { return TAPS(IN_RING); };
    auto clear = [&](float* to) { for (long i = 0; i < 3 * stride; ++i) to[i] = 0.f; };
    auto copy = [&](float* to, const float* from, long row) {
        int i = 0;
        for (; i + LANES <= n; i += LANES) STORE(to + i, LOAD(from + row * n + i));
        for (; i < n; ++i) to[i] = from[row * n + i];
    };

    for (int i = 0; i < n; ++i) given[3][i] = 1.f;                // and 0 in the rest of the last vector
    auto write = [&](float* to, long row, int i, vf v) {
        float* at = to + row * n + i;
        if (i + LANES <= n) STORE(at, v);
        else for (int k = 0; i + k < n; ++k) at[k] = v[k];
    };

    double total = 0.0;
    const bool with_gradient = mode == 1;
    const int reach = with_gradient ? 2 * HALF : HALF;
    for (int r = top - reach; r < bottom + reach; ++r) {
        float* ring = slot(moments, r);
        if (r < 0 || r >= height) {
            clear(ring);
        } else {
            copy(moment[0], x.data, r);
            copy(given[0], y.data, r);
            for (int i = 0; i < m; i += LANES) {
                const vf v = LOAD(moment[0] + i);
                STORE(moment[1] + i, v * v);
                STORE(moment[2] + i, v * LOAD(given[0] + i));
            }
            along(moment, ring);
        }

        const int q = r - HALF;                                   // the row whose moments are now complete
        if (q < top - reach + HALF) continue;
        const float* f[RING];
        if (q >= 0 && q < height) {
            for (int k = 0; k < RING; ++k) f[k] = slot(moments, q - HALF + k);
            if (mode == 2) {
                for (int i = 0; i < m; i += LANES) {
                    const vf a = down(f, 0, i), v = down(f, stride, i) - a * a;
                    write(mean.data, q, i, a);
                    write(variance.data, q, i, v > 0.f ? v : 0.f);
                }
                continue;
            }
            copy(given[1], mean.data, q);
            copy(given[2], variance.data, q);
            if (weighted) {
                for (int i = 0; i < n; ++i) given[3][i] = weight.data[(long)q * width + i / channels];
            }
            vf sum = 0.f;
            const vf zero = 0.f;
            for (int i = 0; i < m; i += LANES) {
                const vf a = down(f, 0, i), aa = down(f, stride, i), ab = down(f, 2 * stride, i);
                const vf b = LOAD(given[1] + i), bb = LOAD(given[2] + i), w = LOAD(given[3] + i);
                const vf v = aa - a * a;
                const vf below_l = 1.f / (a * a + b * b + C1);
                const vf below_c = 1.f / ((v > zero ? v : zero) + bb + C2);
                const vf l = (2.f * a * b + C1) * below_l;
                const vf c = (2.f * (ab - a * b) + C2) * below_c;
                const vf by_variance = v > zero ? -l * c * below_c : zero;
                const vf by_covariance = 2.f * l * below_c;
                const vf by_mean = 2.f * c * (b - l * a) * below_l - 2.f * a * by_variance - b * by_covariance;
                STORE(partial[0] + i, w * by_mean);
                STORE(partial[1] + i, w * by_variance);
                STORE(partial[2] + i, w * by_covariance);
                sum += w * l * c;
            }
            if (q >= top && q < bottom) for (int k = 0; k < LANES; ++k) total += sum[k];
            if (with_gradient) along(partial, slot(partials, q));
        } else if (with_gradient) {
            clear(slot(partials, q));
        }

        const int g = q - HALF;                                   // the row whose gradient is now complete
        if (!with_gradient || g < top) continue;
        for (int k = 0; k < RING; ++k) f[k] = slot(partials, g - HALF + k);
        copy(moment[0], x.data, g);
        copy(given[0], y.data, g);
        for (int i = 0; i < m; i += LANES) {
            const vf a = down(f, 0, i), b = down(f, stride, i), d = down(f, 2 * stride, i);
            write(gradient.data, g, i, scale * (a + 2.f * LOAD(moment[0] + i) * b + LOAD(given[0] + i) * d));
        }
    }
    sums.data[strip] = total;
#undef TAPS
#undef IN_ROW
#undef IN_RING
"""
)


@wp.func_native(_SNIPPET)
def _strip(
    strip: int,
    rows: int,
    height: int,
    width: int,
    channels: int,
    per_strip: int,
    mode: int,
    weighted: int,
    scale: float,
    x: wp.array(dtype=float),
    y: wp.array(dtype=float),
    mean: wp.array(dtype=float),
    variance: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    scratch: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
    sums: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def ssim_strips(
    first: int,
    height: int,
    width: int,
    channels: int,
    per_strip: int,
    mode: int,
    weighted: int,
    scale: float,
    x: wp.array(dtype=float),
    y: wp.array(dtype=float),
    mean: wp.array(dtype=float),
    variance: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    scratch: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
    sums: wp.array(dtype=wp.float64),
):
    """Strip `first + tid`: its sum of weighted similarities; and, mode 1, `scale` times the gradient of all sums in its
    rows; mode 2: only the local mean and variance of x, written to `mean` and `variance`."""
    strip = first + wp.tid()
    _strip(
        strip, ROWS, height, width, channels, per_strip, mode, weighted, scale,
        x, y, mean, variance, weight, scratch, gradient, sums,
    )  # fmt: skip
