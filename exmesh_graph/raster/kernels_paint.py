"""A textured, antialiased picture and its adjoint, for a CPU. Import through `runtime.kernels`; see `paint`.

Everything has one owner, so that the work splits over cores and sums keep their order: forward the pixels of a face
belong to the face; backward a band of the texture's rows belongs to the item that walks the faces whose colours lie
there (one that lies in two bands is walked twice), its face's sum to the band where the face begins, and a vertex's
gradient is gathered from its faces. Equations: kernels.py, kernels_texture.py, silhouette.py.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.gpu.simd import PRELUDE

# the same arithmetic as kernels_cover: a centre that is inside there is inside here, and so is its place in the atlas
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

CHUNK = wp.constant(512)
"""Faces that one item paints."""
BAND = wp.constant(32)
"""Rows of the texture whose gradient one item sums."""

_PLACE = (
    PRELUDE
    + """
    typedef int vi __attribute__((ext_vector_type(LANES), aligned(4)));
    typedef bool vb __attribute__((ext_vector_type(LANES)));
    typedef float v4 __attribute__((ext_vector_type(4), aligned(4)));
    typedef float v2 __attribute__((ext_vector_type(2), aligned(4)));
    const vi lane = {0, 1, 2, 3, 4, 5, 6, 7};
    const float* v[3]; const float* t[3];                         // the face's corners: (x z, y z, z) and (u, v)
    auto corners = [&](int f) {
        for (int k = 0; k < 3; ++k) {
            v[k] = vertices.data + 3 * (long)faces.data[3 * (long)f + k];
            t[k] = uvs.data + 2 * (long)uv_faces.data[3 * (long)f + k];
        }
    };
    // the pixels that show face f, up to LANES at a time: number, flat indices, centres
    int at[LANES]; float px[LANES], py[LANES];
    auto batches = [&](int f, auto&& work) {
        const int* box = boxes.data + 4 * (long)f;
        int n = 0;
        for (int row = box[1]; row <= box[3]; ++row) {
            for (int column = box[0]; column <= box[2]; column += LANES) {
                const int first = row * width + column;           // ids are padded: a vector may reach past the last
                const vi shows = (*(const vi*)(face_id.data + first) == f) & (lane <= box[2] - column);
                unsigned char bits = __builtin_bit_cast(unsigned char, __builtin_convertvector(shows, vb));
                for (; bits; bits &= bits - 1) {
                    const int k = __builtin_ctz(bits);
                    at[n] = first + k; px[n] = (float)(column + k) + 0.5f; py[n] = (float)row + 0.5f;
                    if (++n == LANES) { work(n); n = 0; }
                }
            }
        }
        if (n == 0) return;
        for (int k = n; k < LANES; ++k) { px[k] = px[0]; py[k] = py[0]; }
        work(n);
    };
    // b = u / sum(u), u = x' x y' of the corners' rows x' = x - p_x z and y' = y - p_y z; then the texel and the weight
    // of its right and lower neighbour
    vf x[3], y[3], b[3], inverse, column, row, right, lower;
    vi texel_x, texel_y;
    const float last_x = (float)(columns - 1), last_y = (float)(rows - 1);
    auto clamped = [](vf a, float high) { const vf z = 0.f, h = high; a = a > z ? a : z; return a < h ? a : h; };
    auto place = [&]() {
        const vf cx = LOAD(px), cy = LOAD(py);
        for (int k = 0; k < 3; ++k) { x[k] = v[k][0] - cx * v[k][2]; y[k] = v[k][1] - cy * v[k][2]; }
        b[0] = x[1] * y[2] - x[2] * y[1];
        b[1] = x[2] * y[0] - x[0] * y[2];
        b[2] = x[0] * y[1] - x[1] * y[0];
        inverse = 1.f / (b[0] + b[1] + b[2]);
        for (int k = 0; k < 3; ++k) b[k] *= inverse;
        column = (b[0] * t[0][0] + b[1] * t[1][0] + b[2] * t[2][0]) * (float)columns - 0.5f;
        row = (1.f - (b[0] * t[0][1] + b[1] * t[1][1] + b[2] * t[2][1])) * (float)rows - 0.5f;
        const vf inside_x = clamped(column, last_x), inside_y = clamped(row, last_y);
        const vf low_x = clamped(__builtin_elementwise_floor(inside_x), last_x - 1.f);
        const vf low_y = clamped(__builtin_elementwise_floor(inside_y), last_y - 1.f);
        right = inside_x - low_x;
        lower = inside_y - low_y;
        texel_x = __builtin_convertvector(low_x, vi);
        texel_y = __builtin_convertvector(low_y, vi);
    };
    // what the face's corners add to the texture's colour
    const float* tint[3];
    auto corner_tints = [&](int f) {
        for (int k = 0; k < 3; ++k) tint[k] = tints.data + 3 * (long)faces.data[3 * (long)f + k];
    };
    // the four texels under a pixel in lanes x, y, z. That on the right is read and written one float early, so that no
    // access passes the end of the texture, which has two rows and columns at least
    const int below = 3 * columns;
    v4 upper_left, upper_right, lower_left, lower_right;
    auto texels = [&](int k) {
        const float* from = texture.data + 3 * ((long)texel_y[k] * columns + texel_x[k]);
        upper_left = *(const v4*)from;
        upper_right = (*(const v4*)(from + 2)).yzww;
        lower_left = *(const v4*)(from + below);
        lower_right = (*(const v4*)(from + below + 2)).yzww;
    };
"""
)

_PAINT = (
    _PLACE
    + """
    const int begin = chunk * faces_each;
    const int end = begin + faces_each < count ? begin + faces_each : count;
    for (int f = begin; f < end; ++f) {
        if (!shown.data[f]) continue;
        corners(f);
        if (tinted) corner_tints(f);
        batches(f, [&](int n) {
            place();
            vf added[3];
            for (int c = 0; tinted && c < 3; ++c) added[c] = b[0] * tint[0][c] + b[1] * tint[1][c] + b[2] * tint[2][c];
            for (int k = 0; k < n; ++k) {
                texels(k);
                const v4 above = upper_left + (upper_right - upper_left) * right[k];
                const v4 beneath = lower_left + (lower_right - lower_left) * right[k];
                v4 here = above + (beneath - above) * lower[k];
                if (tinted) here += (v4){added[0][k], added[1][k], added[2][k], 0.f};
                float* to = colour.data + 3 * (long)at[k];
                to[0] = here.x; to[1] = here.y; to[2] = here.z;
            }
        });
    }
"""
)

_ADJOINT = (
    _PLACE
    + """
    const int top = band * rows_each, bottom = top + rows_each < rows ? top + rows_each : rows;
    float* own = grad_texture.data + 3 * (long)top * columns;
    if (with_texture) for (long i = 0; i < 3 * (long)(bottom - top) * columns; ++i) own[i] = 0.f;
    for (int n = starts.data[band]; n < starts.data[band + 1]; ++n) {
        const int f = listed.data[n] >> 1;
        const bool at_home = listed.data[n] & 1, home = with_vertices && at_home, tints_here = with_tints && at_home;
        if (!shown.data[f] || !(home || tints_here || with_texture)) continue;
        corners(f);
        if (tinted) corner_tints(f);
        vf sums[9], tint_sums[9];
        for (int k = 0; k < 9; ++k) sums[k] = tint_sums[k] = 0.f;
        batches(f, [&](int n) {
            place();
            float across[LANES] = {}, down[LANES] = {}, given[3][LANES] = {};
            for (int k = 0; k < n; ++k) {
                const float* from = grad.data + 3 * (long)at[k];
                const v4 g = {from[0], from[1], from[2], 0.f};
                if (tinted) for (int c = 0; c < 3; ++c) given[c][k] = from[c];
                const float r = right[k], l = lower[k];
                if (with_texture) {
                    float* to = grad_texture.data + 3 * ((long)texel_y[k] * columns + texel_x[k]);
                    auto add = [&](float* pair, v4 both) {        // six floats of two texels, in accesses of equal size
                        const v4 here = both * (1.f - r), there = both * r;
                        const v4 four = {here.x, here.y, here.z, there.x};
                        const v2 two = {there.y, there.z};
                        *(v4*)pair += four;
                        *(v2*)(pair + 4) += two;
                    };
                    if (texel_y[k] >= top && texel_y[k] < bottom) add(to, g * (1.f - l));
                    if (texel_y[k] + 1 >= top && texel_y[k] + 1 < bottom) add(to + below, g * l);
                }
                if (home) {
                    texels(k);
                    const v4 by_x = (upper_right - upper_left) * (1.f - l) + (lower_right - lower_left) * l;
                    const v4 by_y = (lower_left - upper_left) * (1.f - r) + (lower_right - upper_right) * r;
                    across[k] = g.x * by_x.x + g.y * by_x.y + g.z * by_x.z;
                    down[k] = g.x * by_y.x + g.y * by_y.y + g.z * by_y.z;
                }
            }
            if (tints_here) {
                for (int k = 0; k < 3; ++k) for (int c = 0; c < 3; ++c) tint_sums[3 * k + c] += b[k] * LOAD(given[c]);
            }
            if (!home) return;
            const vf zero = 0.f;                                  // where the border clamps, the colour stands still
            const vf by_u = ((column > 0.f) & (column < last_x)) ? LOAD(across) * (float)columns : zero;
            const vf by_v = ((row > 0.f) & (row < last_y)) ? LOAD(down) * -(float)rows : zero;
            vf by_b[3], mean = 0.f;
            for (int k = 0; k < 3; ++k) {
                by_b[k] = by_u * t[k][0] + by_v * t[k][1];
                if (tinted) for (int c = 0; c < 3; ++c) by_b[k] += LOAD(given[c]) * tint[k][c];
                mean += by_b[k] * b[k];
            }
            const vf cx = LOAD(px), cy = LOAD(py);
            for (int k = 0; k < 3; ++k) by_b[k] = (by_b[k] - mean) * inverse;       // dL/du
            for (int k = 0; k < 3; ++k) {
                const int i = (k + 1) % 3, j = (k + 2) % 3;
                const vf by_x = y[i] * by_b[j] - y[j] * by_b[i];                    // dL/dx' = y' x dL/du
                const vf by_y = by_b[i] * x[j] - by_b[j] * x[i];                    // dL/dy' = dL/du x x'
                sums[3 * k] += by_x;
                sums[3 * k + 1] += by_y;
                sums[3 * k + 2] -= cx * by_x + cy * by_y;
            }
        });
        auto total = [](vf sum) {
            const auto half = sum.lo + sum.hi;
            const auto quarter = half.lo + half.hi;
            return quarter.x + quarter.y;
        };
        if (home) for (int k = 0; k < 9; ++k) by_face.data[9 * (long)f + k] = total(sums[k]);
        if (tints_here) for (int k = 0; k < 9; ++k) by_tint.data[9 * (long)f + k] = total(tint_sums[k]);
    }
"""
)

# Of a pair of pixels: near and far, the edge's ends relative to the first centre, and their cross product, the line
_PAIR = """
    const int p = first.data[n], q = second.data[n];
    const bool on_first = near_first.data[n];
    const int near = on_first ? p : q, far = on_first ? q : p;
    const float x = (float)(p % width) + 0.5f, y = (float)(p / width) + 0.5f;
    const float* u = vertices.data + 3 * (long)ends.data[2 * n];
    const float* v = vertices.data + 3 * (long)ends.data[2 * n + 1];
    const float a[3] = {u[0] - x * u[2], u[1] - y * u[2], u[2]}, b[3] = {v[0] - x * v[2], v[1] - y * v[2], v[2]};
    const float line[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    const int axis = vertical.data[n] ? 1 : 0;
    const float t = -line[2] / line[axis];
    const float weight = line[axis] * line[axis] / (line[0] * line[0] + line[1] * line[1]);
    const float s = on_first ? t : 1.f - t;
    const int target = s > 0.5f ? far : near;
    const float share = weight * (s - 0.5f);
"""

_BLEND = (
    """
    for (long n = 0; n < count; ++n) {
"""
    + _PAIR
    + """
        float* step = steps.data + 4 * n;                         // C_near - C_far, before any pair blends
        for (int c = 0; c < 3; ++c) step[c] = colour.data[3 * (long)near + c] - colour.data[3 * (long)far + c];
        step[3] = alpha.data[near] - alpha.data[far];
        shares.data[n] = share;
        targets.data[n] = target;
    }
    for (long n = 0; n < count; ++n) {
        const float* step = steps.data + 4 * n;
        const long target = targets.data[n];
        for (int c = 0; c < 3; ++c) colour.data[3 * target + c] += shares.data[n] * step[c];
        alpha.data[target] += shares.data[n] * step[3];
    }
"""
)

_BLEND_ADJOINT = (
    """
    for (long n = 0; n < count; ++n) {
"""
    + _PAIR
    + """
        const float* step = steps.data + 4 * n;
        const float* g = grad.data + 3 * (long)target;
        float by_s = weight * grad_alpha.data[target] * step[3];
        for (int c = 0; c < 3; ++c) by_s += weight * g[c] * step[c];
        const float by_t = on_first ? by_s : -by_s;
        float by_line[3] = {0.f, 0.f, -by_t / line[axis]};
        by_line[axis] = -by_t * t / line[axis];
        // line = a x b: dL/da = b x dL/dline, dL/db = dL/dline x a
        const float by_a[3] = {b[1] * by_line[2] - b[2] * by_line[1], b[2] * by_line[0] - b[0] * by_line[2],
            b[0] * by_line[1] - b[1] * by_line[0]};
        const float by_b[3] = {by_line[1] * a[2] - by_line[2] * a[1], by_line[2] * a[0] - by_line[0] * a[2],
            by_line[0] * a[1] - by_line[1] * a[0]};
        float* to = by_vertex.data + 3 * (long)ends.data[2 * n];
        to[0] += by_a[0]; to[1] += by_a[1]; to[2] += by_a[2] - x * by_a[0] - y * by_a[1];
        to = by_vertex.data + 3 * (long)ends.data[2 * n + 1];
        to[0] += by_b[0]; to[1] += by_b[1]; to[2] += by_b[2] - x * by_b[0] - y * by_b[1];
        for (int c = 0; c < 3; ++c) passed.data[9 * n + c] = share * g[c];      // given to near, taken from far
    }
    for (long n = 0; n < count; ++n) {
        const long near = near_first.data[n] ? first.data[n] : second.data[n];
        const long far = near_first.data[n] ? second.data[n] : first.data[n];
        for (int c = 0; c < 3; ++c) {
            float* kept = passed.data + 9 * n + 3 + 2 * c;
            kept[0] = grad.data[3 * near + c];
            grad.data[3 * near + c] += passed.data[9 * n + c];
            kept[1] = grad.data[3 * far + c];
            grad.data[3 * far + c] -= passed.data[9 * n + c];
        }
    }
"""
)

_RESTORE = """
    for (long n = count - 1; n >= 0; --n) {
        const long near = near_first.data[n] ? first.data[n] : second.data[n];
        const long far = near_first.data[n] ? second.data[n] : first.data[n];
        for (int c = 0; c < 3; ++c) {
            grad.data[3 * far + c] = passed.data[9 * n + 3 + 2 * c + 1];
            grad.data[3 * near + c] = passed.data[9 * n + 3 + 2 * c];
        }
    }
"""

_GATHER = """
    float* to = by_vertex.data + 3 * (long)vertex;
    for (int n = starts.data[vertex]; n < starts.data[vertex + 1]; ++n) {
        const int corner = corners.data[n];
        if (!shown.data[corner / 3]) continue;
        for (int c = 0; c < 3; ++c) to[c] += by_corner.data[3 * (long)corner + c];
    }
"""


@wp.func_native(_PAINT)
def _paint(
    chunk: int, faces_each: int, count: int, width: int, rows: int, columns: int, tinted: int,
    vertices: wp.array(dtype=float), faces: wp.array(dtype=wp.int32), uvs: wp.array(dtype=float),
    uv_faces: wp.array(dtype=wp.int32), texture: wp.array(dtype=float), tints: wp.array(dtype=float),
    boxes: wp.array(dtype=wp.int32), shown: wp.array(dtype=wp.uint8), face_id: wp.array(dtype=wp.int32),
    colour: wp.array(dtype=float),
): ...  # fmt: skip


@wp.kernel
def paint_faces(
    first: int, count: int, width: int, rows: int, columns: int, tinted: int,
    vertices: wp.array(dtype=float), faces: wp.array(dtype=wp.int32), uvs: wp.array(dtype=float),
    uv_faces: wp.array(dtype=wp.int32), texture: wp.array(dtype=float), tints: wp.array(dtype=float),
    boxes: wp.array(dtype=wp.int32), shown: wp.array(dtype=wp.uint8), face_id: wp.array(dtype=wp.int32),
    colour: wp.array(dtype=float),
):  # fmt: skip
    """Chunk `first + tid`: the colour of the pixels that show its faces, with `tints` [V, 3] where `tinted`; the
    background is left as it is."""
    _paint(
        first + wp.tid(), CHUNK, count, width, rows, columns, tinted, vertices, faces, uvs, uv_faces, texture, tints,
        boxes, shown, face_id, colour,
    )  # fmt: skip


@wp.func_native(_ADJOINT)
def _adjoint(
    band: int, rows_each: int, width: int, rows: int, columns: int, tinted: int, with_vertices: int,
    with_texture: int, with_tints: int, vertices: wp.array(dtype=float), faces: wp.array(dtype=wp.int32),
    uvs: wp.array(dtype=float), uv_faces: wp.array(dtype=wp.int32), texture: wp.array(dtype=float),
    tints: wp.array(dtype=float), boxes: wp.array(dtype=wp.int32), shown: wp.array(dtype=wp.uint8),
    face_id: wp.array(dtype=wp.int32), starts: wp.array(dtype=wp.int32), listed: wp.array(dtype=wp.int32),
    grad: wp.array(dtype=float), grad_texture: wp.array(dtype=float), by_face: wp.array(dtype=float),
    by_tint: wp.array(dtype=float),
): ...  # fmt: skip


@wp.kernel
def paint_adjoint(
    first: int, width: int, rows: int, columns: int, tinted: int, with_vertices: int, with_texture: int,
    with_tints: int, vertices: wp.array(dtype=float), faces: wp.array(dtype=wp.int32),
    uvs: wp.array(dtype=float), uv_faces: wp.array(dtype=wp.int32), texture: wp.array(dtype=float),
    tints: wp.array(dtype=float), boxes: wp.array(dtype=wp.int32), shown: wp.array(dtype=wp.uint8),
    face_id: wp.array(dtype=wp.int32), starts: wp.array(dtype=wp.int32), listed: wp.array(dtype=wp.int32),
    grad: wp.array(dtype=float), grad_texture: wp.array(dtype=float), by_face: wp.array(dtype=float),
    by_tint: wp.array(dtype=float),
):  # fmt: skip
    """Band `first + tid`: dL/dtexture of its rows from dL/dcolour, and dL/dcorners and dL/dtints [F, 3, 3] of the faces
    at home here.

    `listed` from `starts[band]` on holds 2 * face + (at home).
    """
    _adjoint(
        first + wp.tid(), BAND, width, rows, columns, tinted, with_vertices, with_texture, with_tints, vertices, faces,
        uvs, uv_faces, texture, tints, boxes, shown, face_id, starts, listed, grad, grad_texture, by_face, by_tint,
    )  # fmt: skip


@wp.func_native(_BLEND)
def _blend(
    count: int, width: int, vertices: wp.array(dtype=float), first: wp.array(dtype=wp.int64),
    second: wp.array(dtype=wp.int64), ends: wp.array(dtype=wp.int64), vertical: wp.array(dtype=wp.bool),
    near_first: wp.array(dtype=wp.bool), colour: wp.array(dtype=float), alpha: wp.array(dtype=float),
    steps: wp.array(dtype=float), shares: wp.array(dtype=float), targets: wp.array(dtype=wp.int32),
): ...  # fmt: skip


@wp.kernel
def blend_pairs(
    count: int, width: int, vertices: wp.array(dtype=float), first: wp.array(dtype=wp.int64),
    second: wp.array(dtype=wp.int64), ends: wp.array(dtype=wp.int64), vertical: wp.array(dtype=wp.bool),
    near_first: wp.array(dtype=wp.bool), colour: wp.array(dtype=float), alpha: wp.array(dtype=float),
    steps: wp.array(dtype=float), shares: wp.array(dtype=float), targets: wp.array(dtype=wp.int32),
):  # fmt: skip
    """All pairs, in their order: blends colour and alpha in place; `steps` [P, 4] is kept for the adjoint."""
    _blend(
        count, width, vertices, first, second, ends, vertical, near_first, colour, alpha, steps, shares, targets
    )  # fmt: skip


@wp.func_native(_BLEND_ADJOINT)
def _blend_adjoint(
    count: int, width: int, vertices: wp.array(dtype=float), first: wp.array(dtype=wp.int64),
    second: wp.array(dtype=wp.int64), ends: wp.array(dtype=wp.int64), vertical: wp.array(dtype=wp.bool),
    near_first: wp.array(dtype=wp.bool), steps: wp.array(dtype=float), grad: wp.array(dtype=float),
    grad_alpha: wp.array(dtype=float), passed: wp.array(dtype=float), by_vertex: wp.array(dtype=float),
): ...  # fmt: skip


@wp.kernel
def blend_adjoint(
    count: int, width: int, vertices: wp.array(dtype=float), first: wp.array(dtype=wp.int64),
    second: wp.array(dtype=wp.int64), ends: wp.array(dtype=wp.int64), vertical: wp.array(dtype=wp.bool),
    near_first: wp.array(dtype=wp.bool), steps: wp.array(dtype=float), grad: wp.array(dtype=float),
    grad_alpha: wp.array(dtype=float), passed: wp.array(dtype=float), by_vertex: wp.array(dtype=float),
):  # fmt: skip
    """All pairs, in their order: adds to dL/dvertices, and makes dL/dcolour, in place, that of the colour before.

    `passed` [P, 9] keeps what `restore_pairs` puts back.
    """
    _blend_adjoint(
        count, width, vertices, first, second, ends, vertical, near_first, steps, grad, grad_alpha, passed, by_vertex
    )  # fmt: skip


@wp.func_native(_RESTORE)
def _restore(
    count: int, first: wp.array(dtype=wp.int64), second: wp.array(dtype=wp.int64), near_first: wp.array(dtype=wp.bool),
    passed: wp.array(dtype=float), grad: wp.array(dtype=float),
): ...  # fmt: skip


@wp.kernel
def restore_pairs(
    count: int, first: wp.array(dtype=wp.int64), second: wp.array(dtype=wp.int64), near_first: wp.array(dtype=wp.bool),
    passed: wp.array(dtype=float), grad: wp.array(dtype=float),
):  # fmt: skip
    """Undo what `blend_adjoint` did to dL/dcolour, which is not ours: to the bit."""
    _restore(count, first, second, near_first, passed, grad)


@wp.func_native(_GATHER)
def _gather(
    vertex: int, starts: wp.array(dtype=wp.int32), corners: wp.array(dtype=wp.int32), shown: wp.array(dtype=wp.uint8),
    by_corner: wp.array(dtype=float), by_vertex: wp.array(dtype=float),
): ...  # fmt: skip


@wp.kernel
def gather_vertices(
    first: int, starts: wp.array(dtype=wp.int32), corners: wp.array(dtype=wp.int32), shown: wp.array(dtype=wp.uint8),
    by_corner: wp.array(dtype=float), by_vertex: wp.array(dtype=float),
):  # fmt: skip
    """Vertex `first + tid`: adds what its corners (3 * face + place) in shown faces were given."""
    _gather(first + wp.tid(), starts, corners, shown, by_corner, by_vertex)
