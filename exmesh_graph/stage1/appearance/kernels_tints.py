"""What colour by the direction of view asks of each vertex, for a CPU. Import through `tints.kernels`.

Plain forms: `directional.plain_tints` under autograd, `optim.adam_step`. Every vertex writes what it alone owns; sums
belong to a chunk.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False})

CHUNK = wp.constant(1024)
"""Vertices that one item is for."""

_RANGE = """
    const int begin = chunk * each, end = begin + each < count ? begin + each : count;
"""

_BASIS = """
    // unit direction d from vertex v to the eye, one over the distance, and Y(d) - m; sizes: directional.harmonics
    const float five = 2.2360679775f, twelve = 3.4641016151f;
    float b[8], x, y, z, inverse, distance;
    auto look = [&](int v) {
        const float* p = vertices.data + 3 * (long)v;
        x = eye_x - p[0]; y = eye_y - p[1]; z = eye_z - p[2];
        distance = __builtin_sqrtf(x * x + y * y + z * z);
        inverse = 1.f / (distance > 1e-12f ? distance : 1e-12f);
        x *= inverse; y *= inverse; z *= inverse;
        b[0] = x; b[1] = y; b[2] = z;
        if (harmonics > 3) {
            b[3] = five * x * y; b[4] = five * y * z; b[5] = five * (3.f * z * z - 1.f) / twelve;
            b[6] = five * x * z; b[7] = five * (x * x - y * y) / 2.f;
        }
        const float* m = mean.data + (long)harmonics * v;
        for (int k = 0; k < harmonics; ++k) b[k] -= m[k];
    };
"""

_TINTS = (
    _RANGE
    + _BASIS
    + """
    for (int v = begin; v < end; ++v) {
        look(v);
        const float* r = residual.data + 3 * (long)harmonics * v;
        float sum[3] = {0.f, 0.f, 0.f};
        for (int k = 0; k < harmonics; ++k)
            for (int c = 0; c < 3; ++c) sum[c] += b[k] * r[3 * k + c];
        for (int c = 0; c < 3; ++c) out.data[3 * (long)v + c] = sum[c];
    }
"""
)

_ADJOINT = (
    _RANGE
    + _BASIS
    + """
    for (int v = begin; v < end; ++v) {
        look(v);
        const long row = 3 * (long)harmonics * v;
        const float *r = residual.data + row, *g = gradient.data + 3 * (long)v;
        float h[8];
        for (int k = 0; k < harmonics; ++k) {
            h[k] = 0.f;
            for (int c = 0; c < 3; ++c) {
                by_residual.data[row + 3 * k + c] = b[k] * g[c];
                h[k] += r[3 * k + c] * g[c];
            }
        }
        float dx = h[0], dy = h[1], dz = h[2];
        if (harmonics > 3) {
            dx += five * (h[3] * y + h[6] * z + h[7] * x);
            dy += five * (h[3] * x + h[4] * z - h[7] * y);
            dz += five * (h[4] * y + h[5] * 6.f * z / twelve + h[6] * x);
        }
        // of a direction's length nothing depends; below the least distance it is not held at one
        const float along = distance > 1e-12f ? dx * x + dy * y + dz * z : 0.f;
        float* to = by_vertex.data + 3 * (long)v;
        to[0] = (along * x - dx) * inverse; to[1] = (along * y - dy) * inverse; to[2] = (along * z - dz) * inverse;
    }
"""
)

_STEP = (
    _RANGE
    + """
    double total = 0.0;
    for (int v = begin; v < end; ++v) {
        const long row = (long)width * v;
        const float *g = gradient.data + row;
        float *r = values.data + row, *m = first_moment.data + row, square = 0.f;
        for (int k = 0; k < width; ++k) {
            const float pulled = g[k] + pull * r[k];
            total += pulled;
            square += pulled * pulled;
            m[k] += from_gradient * (pulled - m[k]);
        }
        const float second = second_moment.data[v] + from_square * (square - second_moment.data[v]);
        second_moment.data[v] = second;
        const float step = length / (__builtin_sqrtf(second / bias) + epsilon);
        for (int k = 0; k < width; ++k) r[k] += step * m[k];
    }
    totals.data[chunk] = total;
"""
)


@wp.func_native(_TINTS)
def _tints(
    chunk: int,
    each: int,
    count: int,
    harmonics: int,
    eye_x: float,
    eye_y: float,
    eye_z: float,
    vertices: wp.array(dtype=float),
    residual: wp.array(dtype=float),
    mean: wp.array(dtype=float),
    out: wp.array(dtype=float),
): ...


@wp.kernel
def tint_vertices(
    first: int,
    count: int,
    harmonics: int,
    eye_x: float,
    eye_y: float,
    eye_z: float,
    vertices: wp.array(dtype=float),
    residual: wp.array(dtype=float),
    mean: wp.array(dtype=float),
    out: wp.array(dtype=float),
):
    """Chunk `first + tid`: sum over k of r_k (Y_k(d) - m_k) of each vertex, [V, 3]."""
    _tints(first + wp.tid(), CHUNK, count, harmonics, eye_x, eye_y, eye_z, vertices, residual, mean, out)


@wp.func_native(_ADJOINT)
def _adjoint(
    chunk: int,
    each: int,
    count: int,
    harmonics: int,
    eye_x: float,
    eye_y: float,
    eye_z: float,
    vertices: wp.array(dtype=float),
    residual: wp.array(dtype=float),
    mean: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
    by_vertex: wp.array(dtype=float),
    by_residual: wp.array(dtype=float),
): ...


@wp.kernel
def pull_tints(
    first: int,
    count: int,
    harmonics: int,
    eye_x: float,
    eye_y: float,
    eye_z: float,
    vertices: wp.array(dtype=float),
    residual: wp.array(dtype=float),
    mean: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
    by_vertex: wp.array(dtype=float),
    by_residual: wp.array(dtype=float),
):
    """Chunk `first + tid`: what the gradient [V, 3] of the tints is for vertices [V, 3] and residual [V, 3 K]."""
    _adjoint(
        first + wp.tid(), CHUNK, count, harmonics, eye_x, eye_y, eye_z, vertices, residual, mean, gradient, by_vertex,
        by_residual,
    )  # fmt: skip


@wp.func_native(_STEP)
def _step(
    chunk: int,
    each: int,
    count: int,
    width: int,
    pull: float,
    from_gradient: float,
    from_square: float,
    bias: float,
    epsilon: float,
    length: float,
    gradient: wp.array(dtype=float),
    first_moment: wp.array(dtype=float),
    second_moment: wp.array(dtype=float),
    values: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def step_rows(
    first: int,
    count: int,
    width: int,
    pull: float,
    from_gradient: float,
    from_square: float,
    bias: float,
    epsilon: float,
    length: float,
    gradient: wp.array(dtype=float),
    first_moment: wp.array(dtype=float),
    second_moment: wp.array(dtype=float),
    values: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
):
    """Chunk `first + tid`: Adam of gradient + pull x for rows x of `width` values, one second moment a row.

    x += length m / (sqrt(v / bias) + epsilon). `totals` is the chunk's sum of these gradients, which is not finite if
    one is not.
    """
    _step(
        first + wp.tid(), CHUNK, count, width, pull, from_gradient, from_square, bias, epsilon, length, gradient,
        first_moment, second_moment, values, totals,
    )  # fmt: skip
