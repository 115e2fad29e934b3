"""What a step does for each vertex or face, for a CPU. Import through `runtime.vertex_kernels`.

Plain forms: `regularise.smoothness`, `normals.normal_variation`, `facing.behind`, `refine.move`.
Every item writes what it alone owns; sums belong to an item.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False})

CHUNK = wp.constant(1024)
"""Vertices or faces that one item is for."""

_RANGE = """
    const int begin = chunk * each, end = begin + each < count ? begin + each : count;
"""

_UMBRELLA = (
    """
    typedef float v4 __attribute__((ext_vector_type(4), aligned(4)));
"""
    + _RANGE
    + """
    auto at = [&](int j) {                                        // the last row has nothing behind it to read
        const float* p = x.data + 3 * (long)j;
        return j < count - 1 ? *(const v4*)p : (v4){p[0], p[1], p[2], 0.f};
    };
    double total = 0.0;
    for (int v = begin; v < end; ++v) {
        const int first = starts.data[v], last = starts.data[v + 1];
        v4 sum = 0.f;
        for (int n = first; n < last; ++n) {
            const int j = neighbours.data[n];
            sum += transposed ? at(j) * inverse.data[j] : at(j);
        }
        if (!transposed) sum *= inverse.data[v];
        if (last > first) sum = (sum - at(v)) * factor;           // a vertex without edges stands for itself
        float* to = out.data + 3 * (long)v;
        to[0] = sum.x; to[1] = sum.y; to[2] = sum.z;
        total += sum.x * sum.x + sum.y * sum.y + sum.z * sum.z;
    }
    totals.data[chunk] = total;
"""
)

_STEP = (
    _RANGE
    + """
    double total = 0.0;
    for (int v = begin; v < end; ++v) {
        const float* g = gradient.data + 3 * (long)v;
        const float norm = __builtin_sqrtf(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
        total += norm;
        mean.data[v] += to_mean * (norm - mean.data[v]);
        const float own = per_area.data[v], h[3] = {g[0] * own, g[1] * own, g[2] * own};
        const float square = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
        const float second = second_moment.data[v] + from_square * (square - second_moment.data[v]);
        second_moment.data[v] = second;
        const float step = length / (__builtin_sqrtf(second / bias) + epsilon);
        for (int c = 0; c < 3; ++c) {
            float* m = first_moment.data + 3 * (long)v + c;
            *m += from_gradient * (h[c] - *m);
            values.data[3 * (long)v + c] += step * *m;
        }
    }
    totals.data[chunk] = total;
"""
)

_TURNED = (
    _RANGE
    + """
    int found = 0;
    for (int f = begin; f < end; ++f) {
        if (!shown.data[f]) continue;
        double p[3][3];
        for (int k = 0; k < 3; ++k)
            for (int c = 0; c < 3; ++c) p[k][c] = points.data[3 * (long)faces.data[3 * (long)f + k] + c];
        const double* a = p[0]; const double* b = p[1]; const double* d = p[2];
        found += (a[1] * b[2] - a[2] * b[1]) * d[0] + (a[2] * b[0] - a[0] * b[2]) * d[1]
            + (a[0] * b[1] - a[1] * b[0]) * d[2] > 0.0;
    }
    totals.data[chunk] = found;
"""
)

_BEND = (
    _RANGE
    + """
    typedef float v3[3];
    auto cross = [](const float* a, const float* b, float* to) {
        to[0] = a[1] * b[2] - a[2] * b[1]; to[1] = a[2] * b[0] - a[0] * b[2]; to[2] = a[0] * b[1] - a[1] * b[0];
    };
    auto dot = [](const float* a, const float* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; };
    double total = 0.0;
    for (int e = begin; e < end; ++e) {
        float* to = pushes.data + 12 * (long)e;
        for (int c = 0; c < 12; ++c) to[c] = 0.f;
        const int* at = corners.data + 4 * (long)e;
        const float* p[4];
        for (int k = 0; k < 4; ++k) p[k] = points.data + 3 * (long)at[k];
        v3 along, left, right, n[2];
        for (int c = 0; c < 3; ++c) {
            along[c] = p[1][c] - p[0][c]; left[c] = p[2][c] - p[0][c]; right[c] = p[3][c] - p[0][c];
        }
        cross(along, left, n[0]);
        cross(right, along, n[1]);
        const float size[2] = {__builtin_sqrtf(dot(n[0], n[0])), __builtin_sqrtf(dot(n[1], n[1]))};
        if (!(size[0] > least && size[1] > least)) continue;
        for (int k = 0; k < 2; ++k) for (int c = 0; c < 3; ++c) n[k][c] /= size[k];
        const v3 off = {n[0][0] - n[1][0], n[0][1] - n[1][1], n[0][2] - n[1][2]};
        const float bend = __builtin_sqrtf(dot(off, off) + width * width), own = weights.data[e];
        total += own * (dot(off, off) / (bend + width));              // bend - width, without its cancellation
        v3 g[2], pushed;
        for (int k = 0; k < 2; ++k) {                                 // what is across the normal, per its length
            const float factor = (k ? -own : own) / bend, inside = dot(n[k], off);
            for (int c = 0; c < 3; ++c) g[k][c] = factor * (off[c] - n[k][c] * inside) / size[k];
        }
        cross(left, g[0], pushed);
        for (int c = 0; c < 3; ++c) to[3 + c] += pushed[c];
        cross(g[1], right, pushed);
        for (int c = 0; c < 3; ++c) to[3 + c] += pushed[c];
        cross(g[0], along, to + 6);
        cross(along, g[1], to + 9);
        for (int c = 0; c < 3; ++c) to[c] = -(to[3 + c] + to[6 + c] + to[9 + c]);
    }
    totals.data[chunk] = total;
"""
)

_GATHER = (
    _RANGE
    + """
    for (int v = begin; v < end; ++v) {
        float x = 0.f, y = 0.f, z = 0.f;
        for (int n = starts.data[v]; n < starts.data[v + 1]; ++n) {
            const float* from = pushes.data + 3 * (long)rows.data[n];
            x += from[0]; y += from[1]; z += from[2];
        }
        float* to = out.data + 3 * (long)v;
        to[0] = x; to[1] = y; to[2] = z;
    }
"""
)


@wp.func_native(_UMBRELLA)
def _umbrella(
    chunk: int,
    each: int,
    count: int,
    transposed: int,
    factor: float,
    starts: wp.array(dtype=wp.int32),
    neighbours: wp.array(dtype=wp.int32),
    inverse: wp.array(dtype=float),
    x: wp.array(dtype=float),
    out: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def umbrella(
    first: int,
    count: int,
    transposed: int,
    factor: float,
    starts: wp.array(dtype=wp.int32),
    neighbours: wp.array(dtype=wp.int32),
    inverse: wp.array(dtype=float),
    x: wp.array(dtype=float),
    out: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
):
    """Chunk `first + tid`: factor (mean of v's neighbours - v) of rows x [V, 3], or the transposed operator's rows.

    The vertices next to v are neighbours[starts[v]:starts[v + 1]], and `inverse` is one over their number. `totals` is
    the chunk's sum of squares.
    """
    _umbrella(first + wp.tid(), CHUNK, count, transposed, factor, starts, neighbours, inverse, x, out, totals)


@wp.func_native(_STEP)
def _step(
    chunk: int,
    each: int,
    count: int,
    to_mean: float,
    from_gradient: float,
    from_square: float,
    bias: float,
    epsilon: float,
    length: float,
    gradient: wp.array(dtype=float),
    per_area: wp.array(dtype=float),
    mean: wp.array(dtype=float),
    first_moment: wp.array(dtype=float),
    second_moment: wp.array(dtype=float),
    values: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def step_vertices(
    first: int,
    count: int,
    to_mean: float,
    from_gradient: float,
    from_square: float,
    bias: float,
    epsilon: float,
    length: float,
    gradient: wp.array(dtype=float),
    per_area: wp.array(dtype=float),
    mean: wp.array(dtype=float),
    first_moment: wp.array(dtype=float),
    second_moment: wp.array(dtype=float),
    values: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
):
    """Chunk `first + tid`: the running mean of |g|, then Adam of g per unit of area with one second moment a vertex.

    x += length m / (sqrt(v / bias) + epsilon). `totals` is the chunk's sum of |g|, which is not finite if a g is not.
    """
    _step(
        first + wp.tid(), CHUNK, count, to_mean, from_gradient, from_square, bias, epsilon, length, gradient, per_area,
        mean, first_moment, second_moment, values, totals,
    )  # fmt: skip


@wp.func_native(_TURNED)
def _turned(
    chunk: int,
    each: int,
    count: int,
    points: wp.array(dtype=float),
    faces: wp.array(dtype=wp.int32),
    shown: wp.array(dtype=wp.uint8),
    totals: wp.array(dtype=wp.int32),
): ...


@wp.kernel
def count_turned(
    first: int,
    count: int,
    points: wp.array(dtype=float),
    faces: wp.array(dtype=wp.int32),
    shown: wp.array(dtype=wp.uint8),
    totals: wp.array(dtype=wp.int32),
):
    """Chunk `first + tid`: how many of its faces that are shown are seen from behind, by homogeneous pixel places."""
    _turned(first + wp.tid(), CHUNK, count, points, faces, shown, totals)


@wp.func_native(_BEND)
def _bend(
    chunk: int,
    each: int,
    count: int,
    width: float,
    least: float,
    corners: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=float),
    points: wp.array(dtype=float),
    pushes: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def bend_edges(
    first: int,
    count: int,
    width: float,
    least: float,
    corners: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=float),
    points: wp.array(dtype=float),
    pushes: wp.array(dtype=float),
    totals: wp.array(dtype=wp.float64),
):
    """Chunk `first + tid`: edges of two faces by their corners [E, 4], first the ends.

    `totals` is the chunk's sum of weight (sqrt(|n - n'|^2 + width^2) - width), `pushes` [E, 4, 3] its gradient. Faces
    whose doubled area is not above `least` count nothing.
    """
    _bend(first + wp.tid(), CHUNK, count, width, least, corners, weights, points, pushes, totals)


@wp.func_native(_GATHER)
def _gather(
    chunk: int,
    each: int,
    count: int,
    starts: wp.array(dtype=wp.int32),
    rows: wp.array(dtype=wp.int32),
    pushes: wp.array(dtype=float),
    out: wp.array(dtype=float),
): ...


@wp.kernel
def gather_corners(
    first: int,
    count: int,
    starts: wp.array(dtype=wp.int32),
    rows: wp.array(dtype=wp.int32),
    pushes: wp.array(dtype=float),
    out: wp.array(dtype=float),
):
    """Chunk `first + tid`: of each vertex v the sum of the rows rows[starts[v]:starts[v + 1]] of `pushes`, in their
    order."""
    _gather(first + wp.tid(), CHUNK, count, starts, rows, pushes, out)
