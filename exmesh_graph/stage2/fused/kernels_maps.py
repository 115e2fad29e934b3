"""Warp kernels of the maps: what pixels and lattice points read, and its adjoint. CPU only: native snippets."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.gpu.simd import MATHS

wp.set_module_options({"enable_backward": False})

# A texel's values are min(cap, from + by sigmoid(p)) for a logit p, else by p: base colour over its gain, roughness cut
# at 1. Vectors hold a row of the table, or, with four channels, the two rows of a pair, which lie side by side.
COLUMNS = r"""
    constexpr int AHEAD = 16;  // how many points ahead memory is asked for
    const int C = channels;
    float by[8], from[8], cap[8];
    vi is_logit;
    for (int j = 0; j < 8; ++j) {
        const int c = C == 4 ? j % 4 : j;
        by[j] = c >= C ? 0.f : c < 3 ? 1.f / gain.data[c] : c == 3 ? span : c < logits ? 1.f : slope;
        from[j] = c == 3 ? low : 0.f;
        cap[j] = c == 3 ? 1.f : 3e38f;
        is_logit[j] = c < logits ? -1 : 0;
    }
    const vf factor = LOAD(by), shift = LOAD(from), largest = LOAD(cap);
"""

READ = (
    MATHS
    + COLUMNS
    + r"""
    typedef float v4 __attribute__((ext_vector_type(4), aligned(4)));
    const int begin = piece * grain, end = begin + grain < count ? begin + grain : count;
    auto value = [&](vf p) {
        const vf v = is_logit ? shift + factor * sigmoid(p) : factor * p;
        return v < largest ? v : largest;
    };
    for (int n = begin; n < end; ++n) {
        const int* t = texel.data + 4 * (long)n;
        const float* w = weight.data + 4 * (long)n;
        for (int k = 0; k < 4 && n + AHEAD < end; k += 2)
            __builtin_prefetch(parameter.data + C * (long)t[4 * AHEAD + k]);
        if (C == 4) {
            vf sum = 0.f;
            for (int k = 0; k < 4; k += 2) {
                const float l = w[k], r = w[k + 1];
                sum += value(LOAD(parameter.data + 4 * (long)t[k])) * (vf){l, l, l, l, r, r, r, r};
            }
            *(v4*)(out.data + 4 * (long)n) = sum.lo + sum.hi;
            continue;
        }
        vf sum = 0.f;
        for (int k = 0; k < 4; ++k) {
            float p[8] = {0.f};
            for (int c = 0; c < C; ++c) p[c] = parameter.data[(long)t[k] * C + c];
            sum += w[k] * value(LOAD(p));
        }
        for (int c = 0; c < C; ++c) out.data[(long)n * C + c] = sum[c];
    }
"""
)


@wp.func_native(READ)
def _read(
    piece: int,
    grain: int,
    count: int,
    channels: int,
    logits: int,
    low: float,
    span: float,
    slope: float,
    gain: wp.array(dtype=float),
    parameter: wp.array(dtype=float),
    texel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    out: wp.array(dtype=float),
): ...


@wp.kernel
def read_maps(
    first: int,
    grain: int,
    count: int,
    channels: int,
    logits: int,
    low: float,
    span: float,
    slope: float,
    gain: wp.array(dtype=float),
    parameter: wp.array(dtype=float),
    texel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    out: wp.array(dtype=float),
):
    """sum_k w_k value(parameter[texel_k]) of `count` points, `grain` of them an item."""
    _read(first + wp.tid(), grain, count, channels, logits, low, span, slope, gain, parameter, texel, weight, out)


# Rows [a, b) of the table belong to one item: it adds up what lands there, in the order of the points' lists, and
# nobody else writes there. A footprint's texels lie in two pairs of rows next to each other, whose first rows ascend
# along `order` alike: what reaches into [a, b) is one stretch of the list for the upper pair, one for the lower.
SCATTER = (
    MATHS
    + COLUMNS
    + r"""
    const int a = piece * grain, b = a + grain < rows ? a + grain : rows;
    float* G = out.data;
    for (long i = (long)a * C; i < (long)b * C; ++i) G[i] = 0.f;
    auto add = [&](int count, const int* order, const int* texel, const float* weight, const float* g) {
        for (int pair = 0; pair < 4; pair += 2) {
            auto first_from = [&](int row) {
                int low = 0, high = count;
                while (low < high) {
                    const int middle = (low + high) / 2;
                    if (texel[4 * order[middle] + pair] < row) low = middle + 1; else high = middle;
                }
                return low;
            };
            const int end = first_from(b);
            for (int i = first_from(a - 1); i < end; ++i) {
                const int n = order[i];
                if (i + AHEAD < end) {
                    const long later = order[i + AHEAD];
                    __builtin_prefetch(texel + 4 * later);
                    __builtin_prefetch(weight + 4 * later);
                    __builtin_prefetch(g + C * later);
                }
                for (int k = pair; k < pair + 2; ++k) {
                    const int row = texel[4 * n + k];
                    if (row < a || row >= b) continue;
                    const float w = weight[4 * n + k];
                    for (int c = 0; c < C; ++c) G[(long)row * C + c] += w * g[(long)n * C + c];
                }
            }
        }
    };
    add(count, order.data, texel.data, weight.data, gradient.data);
    add(count2, order2.data, texel2.data, weight2.data, gradient2.data);
    // through the values: s (1 - s) of a logit; the cut of roughness at 1 lets the gradient pass
    const int width = C == 4 ? 8 : C;
    vd to_gain = 0.0;
    vf most = 0.f, apart = 0.f;                                // apart: not a number once a value is not finite
    for (long i = (long)a * C; i < (long)b * C; i += width) {
        const int lanes = (long)b * C - i < width ? 4 : width;
        float p[8] = {0.f}, q[8] = {0.f};
        bool any = false;
        for (int j = 0; j < lanes; ++j) any |= G[i + j] != 0.f;
        if (!any) continue;
        for (int j = 0; j < lanes; ++j) { p[j] = parameter.data[i + j]; q[j] = G[i + j]; }
        const vf s = sigmoid(LOAD(p)), d = LOAD(q) * factor;
        to_gain += __builtin_convertvector(d * s, vd);
        const vf found = is_logit ? d * s * (1.f - s) : d, size = __builtin_elementwise_abs(found);
        most = size > most ? size : most;
        apart += found - found;
        STORE(q, found);
        for (int j = 0; j < lanes; ++j) G[i + j] = q[j];
    }
    extreme.data[piece] = 0.f;
    for (int j = 0; j < 8; ++j)
        extreme.data[piece] = (most[j] > extreme.data[piece] ? most[j] : extreme.data[piece]) + apart[j];
    for (int c = 0; c < 3; ++c)
        gain_gradient.data[3 * piece + c] = -(to_gain[c] + (C == 4 ? to_gain[c + 4] : 0.0)) / gain.data[c];
"""
)


@wp.func_native(SCATTER)
def _scatter(
    piece: int,
    grain: int,
    rows: int,
    channels: int,
    logits: int,
    low: float,
    span: float,
    slope: float,
    gain: wp.array(dtype=float),
    parameter: wp.array(dtype=float),
    count: int,
    order: wp.array(dtype=int),
    texel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
    count2: int,
    order2: wp.array(dtype=int),
    texel2: wp.array(dtype=int),
    weight2: wp.array(dtype=float),
    gradient2: wp.array(dtype=float),
    out: wp.array(dtype=float),
    gain_gradient: wp.array(dtype=wp.float64),
    extreme: wp.array(dtype=float),
): ...


@wp.kernel
def scatter_maps(
    first: int,
    grain: int,
    rows: int,
    channels: int,
    logits: int,
    low: float,
    span: float,
    slope: float,
    gain: wp.array(dtype=float),
    parameter: wp.array(dtype=float),
    count: int,
    order: wp.array(dtype=int),
    texel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
    count2: int,
    order2: wp.array(dtype=int),
    texel2: wp.array(dtype=int),
    weight2: wp.array(dtype=float),
    gradient2: wp.array(dtype=float),
    out: wp.array(dtype=float),
    gain_gradient: wp.array(dtype=wp.float64),
    extreme: wp.array(dtype=float),
):
    """The adjoint of two `read_maps`: gradient of the parameters [T, C], `grain` rows an item; per item that of gain,
    and the largest |value| (not a number where one is not finite)."""
    _scatter(
        first + wp.tid(), grain, rows, channels, logits, low, span, slope, gain, parameter, count, order, texel, weight,
        gradient, count2, order2, texel2, weight2, gradient2, out, gain_gradient, extreme,
    )  # fmt: skip
