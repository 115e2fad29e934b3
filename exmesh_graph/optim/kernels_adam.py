"""Adam's step in one pass over values, gradient and moments, for a CPU. Import through `adam`: its plain form.

Vectors in which gradient and moments are all zero are left: their step is zero. In a texture that is every texel that
no view has shown since the moments began.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.gpu.simd import PRELUDE

wp.set_module_options({"enable_backward": False})

BLOCK = wp.constant(6144)
"""Values that one item steps: whole vectors, and whole rows of up to four values."""

_SNIPPET = (
    PRELUDE
    + """
    const long begin = (long)block * block_size;
    const long end = begin + block_size < count ? begin + block_size : count;
    const vf zero = 0.f, one = 1.f;
    vf apart = 0.f;                                               // not a number once a gradient is not finite
    for (long i = begin; i < end; i += LANES) {
        const int n = end - i < LANES ? (int)(end - i) : LANES;
        vf x = 0.f, g = 0.f, m = 0.f, v = 0.f;
        if (n == LANES) {
            g = LOAD(gradient.data + i); m = LOAD(first_moment.data + i); v = LOAD(second_moment.data + i);
        } else {
            for (int k = 0; k < n; ++k) {
                g[k] = gradient.data[i + k]; m[k] = first_moment.data[i + k]; v[k] = second_moment.data[i + k];
            }
        }
        apart += g - g;
        if (!__builtin_reduce_or((g != zero) | (m != zero) | (v != zero))) continue;
        if (n == LANES) x = LOAD(values.data + i);
        else for (int k = 0; k < n; ++k) x[k] = values.data[i + k];
        // operation by operation as torch rounds them in the plain form
        m = __builtin_elementwise_fma((vf)from_gradient, g - m, m);
        v = __builtin_elementwise_fma(from_square * g, g, v * b2);
        const vf scale = torch_rounding ? __builtin_elementwise_sqrt(v) / bias : __builtin_elementwise_sqrt(v / bias);
        x = x + length * m / (scale + epsilon);
        if (bounded) {
            x = x > one ? one : (x < zero ? zero : x);            // a value that is not a number stays one
            const vf size = __builtin_elementwise_abs(g);
            if (__builtin_reduce_or(size > threshold)) {
                int mark = (int)i / row, column = (int)i - mark * row;
                float sizes[LANES];
                STORE(sizes, size);
                for (int k = 0; k < n; ++k) {
                    touched.data[mark] |= sizes[k] > threshold;
                    if (++column == row) { column = 0; ++mark; }
                }
            }
        }
        if (n == LANES) {
            STORE(values.data + i, x); STORE(first_moment.data + i, m); STORE(second_moment.data + i, v);
        } else {
            for (int k = 0; k < n; ++k) {
                values.data[i + k] = x[k]; first_moment.data[i + k] = m[k]; second_moment.data[i + k] = v[k];
            }
        }
    }
    faults.data[block] = __builtin_reduce_or(apart != zero);
"""
)


@wp.func_native(_SNIPPET)
def _step(
    block: int,
    block_size: int,
    count: int,
    from_gradient: float,
    b2: float,
    from_square: float,
    bias: float,
    torch_rounding: int,
    epsilon: float,
    length: float,
    bounded: int,
    row: int,
    threshold: float,
    values: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
    first_moment: wp.array(dtype=float),
    second_moment: wp.array(dtype=float),
    touched: wp.array(dtype=wp.bool),
    faults: wp.array(dtype=wp.uint8),
): ...


@wp.kernel
def adam_blocks(
    first: int,
    count: int,
    from_gradient: float,
    b2: float,
    from_square: float,
    bias: float,
    torch_rounding: int,
    epsilon: float,
    length: float,
    bounded: int,
    row: int,
    threshold: float,
    values: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
    first_moment: wp.array(dtype=float),
    second_moment: wp.array(dtype=float),
    touched: wp.array(dtype=wp.bool),
    faults: wp.array(dtype=wp.uint8),
):
    """Block `first + tid`: m += (1 - b1)(g - m), v = b2 v + (1 - b2) g^2, x += length m / (s + epsilon).

    s is sqrt(v / bias), or with `torch_rounding` sqrt(v) / bias. Where `bounded`, x is held in [0, 1] and rows of `row`
    values with a |g| above the threshold are marked. `faults` is 1 where a g is not finite.
    """
    _step(
        first + wp.tid(), BLOCK, count, from_gradient, b2, from_square, bias, torch_rounding, epsilon, length, bounded,
        row, threshold, values, gradient, first_moment, second_moment, touched, faults,
    )  # fmt: skip
