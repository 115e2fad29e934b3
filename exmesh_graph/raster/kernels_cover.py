"""Visibility in strips of rows, for a CPU. Import through `runtime.kernels`.

The same picture as `kernels.rasterize_faces` gives, whose equations these are: the nearest face at each centre, of
equal depths the lowest. Faces are sorted into strips of rows, those that face the camera first, so that what lies
behind is mostly turned away by its nearest depth alone; a strip is one item, and nobody else writes its pixels.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.gpu.simd import PRELUDE

# as in kernels.py: without fused multiply-add no centre falls between two faces of an edge
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

CHUNK = wp.constant(1024)
"""Faces that one item sorts."""
STRIP = wp.constant(32)
"""Rows of a strip."""

# box of a face: (first column, first row, last column, last row), as kernels._pixel_box gives it
_SORT = """
    const int begin = chunk * faces_each;
    const int end = begin + faces_each < count ? begin + faces_each : count;
    int* tally = tallies.data + (long)chunk * 2 * strips;         // faces of the chunk by (facing away, strip)
    for (int k = 0; k < 2 * strips; ++k) tally[k] = 0;
    auto limited = [](float x, float low, float high) { return x < low ? low : (x > high ? high : x); };
    for (int f = begin; f < end; ++f) {
        const float* v[3];
        for (int k = 0; k < 3; ++k) v[k] = vertices.data + 3 * (long)faces.data[3 * (long)f + k];
        int* box = boxes.data + 4 * (long)f;
        box[0] = box[1] = 0;
        box[2] = box[3] = -1;                                     // shows nothing
        shown.data[f] = 0;
        float nothing = 0.f;
        for (int k = 0; k < 3; ++k) for (int c = 0; c < 3; ++c) nothing += v[k][c] - v[k][c];
        if (!(nothing == 0.f)) continue;                          // a vertex that is not finite
        float left = 1e30f, top = 1e30f, right = -1e30f, bottom = -1e30f;
        auto grow = [&](float px, float py, float pz) {
            const float x = px / pz, y = py / pz;
            left = x < left ? x : left;    right = x > right ? x : right;
            top = y < top ? y : top;       bottom = y > bottom ? y : bottom;
        };
        for (int k = 0; k < 3; ++k) {
            const float *a = v[k], *b = v[(k + 1) % 3];
            if (a[2] > near) grow(a[0], a[1], a[2]);
            if ((a[2] > near) != (b[2] > near)) {                 // where the edge pierces the near plane
                const float s = (near - a[2]) / (b[2] - a[2]);
                grow(a[0] + (b[0] - a[0]) * s, a[1] + (b[1] - a[1]) * s, a[2] + (b[2] - a[2]) * s);
            }
        }
        // 1e-3 px of margin: the division above must not drop a centre that the edge functions accept
        const int x0 = (int)__builtin_ceilf(limited(left - 0.501f, 0.f, (float)width));
        const int y0 = (int)__builtin_ceilf(limited(top - 0.501f, 0.f, (float)height));
        const int x1 = (int)__builtin_floorf(limited(right - 0.499f, -1.f, (float)(width - 1)));
        const int y1 = (int)__builtin_floorf(limited(bottom - 0.499f, -1.f, (float)(height - 1)));
        if (x1 < x0 || y1 < y0) continue;
        box[0] = x0; box[1] = y0; box[2] = x1; box[3] = y1;
        const float *a = v[0], *b = v[1], *c = v[2];
        const float side = a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0]);
        away.data[f] = side > 0.f;
        for (int s = y0 / rows; s <= y1 / rows; ++s) ++tally[(side > 0.f) * strips + s];
    }
"""

_LIST = """
    // lists by strip, facing and chunk, in this order: where each of this chunk's begins
    int place = 0;
    int* next = places.data + (long)chunk * 2 * strips;
    for (int s = 0; s < strips; ++s) {
        for (int side = 0; side < 2; ++side) {
            for (int k = 0; k < chunks; ++k) {
                if (k == chunk) next[side * strips + s] = place;
                place += tallies.data[((long)k * 2 + side) * strips + s];
            }
        }
        if (chunk == 0) ends.data[s] = place;
    }
    const int begin = chunk * faces_each;
    const int end = begin + faces_each < count ? begin + faces_each : count;
    for (int f = begin; f < end; ++f) {
        const int* box = boxes.data + 4 * (long)f;
        if (box[3] < box[1]) continue;
        for (int s = box[1] / rows; s <= box[3] / rows; ++s) lists.data[next[away.data[f] * strips + s]++] = f;
    }
"""

_COVER = (
    PRELUDE
    + """
    typedef int vi __attribute__((ext_vector_type(LANES), aligned(4)));
    const vf lane = {0.5f, 1.5f, 2.5f, 3.5f, 4.5f, 5.5f, 6.5f, 7.5f};
    const vi number = {0, 1, 2, 3, 4, 5, 6, 7};
    const int top = strip * rows;
    const int bottom = top + rows < height ? top + rows : height;
    for (long p = (long)top * width; p < (long)bottom * width; ++p) face_id.data[p] = -1;
    for (long p = (long)top * width; p < (long)bottom * width; ++p) depth.data[p] = __builtin_inff();
    for (int n = strip ? ends.data[strip - 1] : 0; n < ends.data[strip]; ++n) {
        const int f = lists.data[n];
        const int* box = boxes.data + 4 * (long)f;
        const float* a = vertices.data + 3 * (long)faces.data[3 * (long)f];
        const float* b = vertices.data + 3 * (long)faces.data[3 * (long)f + 1];
        const float* c = vertices.data + 3 * (long)faces.data[3 * (long)f + 2];
        const float lowest = a[2] < b[2] ? (a[2] < c[2] ? a[2] : c[2]) : (b[2] < c[2] ? b[2] : c[2]);
        // no fragment of the face is nearer than its nearest vertex (1e-5 covers the rounding of z below)
        const float nearest = lowest * 0.99999f > near ? lowest * 0.99999f : near;
        const int first = box[1] > top ? box[1] : top;
        const int last = box[3] < bottom - 1 ? box[3] : bottom - 1;
        for (int row = first; row <= last; ++row) {
            const float y = (float)row + 0.5f;
            const float ya = a[1] - y * a[2], yb = b[1] - y * b[2], yc = c[1] - y * c[2];
            for (int column = box[0]; column <= box[2]; column += LANES) {
                const int left = width - column;                  // fewer than LANES at the image's border
                float* at = depth.data + (long)row * width + column;
                int* id = face_id.data + (long)row * width + column;
                vf before;
                if (left >= LANES) before = LOAD(at);
                else for (int k = 0; k < LANES; ++k) before[k] = k < left ? at[k] : 0.f;
                if (!__builtin_reduce_or(before >= nearest)) continue;
                const vf x = lane + (float)column;
                const vf xa = a[0] - x * a[2], xb = b[0] - x * b[2], xc = c[0] - x * c[2];
                vf u = xb * yc - xc * yb, v = xc * ya - xa * yc, w = xa * yb - xb * ya;
                vf total = u + v + w;
                // y points down, so a counter-clockwise face seen from outside has negative area
                const vi positive = total > 0.f;
                u = positive ? u : -u;
                v = positive ? v : -v;
                w = positive ? w : -w;
                total = positive ? total : -total;
                vi inside = (u >= 0.f) & (v >= 0.f) & (w >= 0.f) & (total > 0.f);
                if (cull_back) inside &= ~positive;
                if (!__builtin_reduce_or(inside)) continue;
                const vf z = (u * a[2] + v * b[2] + w * c[2]) / total;
                if (left >= LANES) {
                    const vi own = *(const vi*)id;
                    const vi wins = inside & (z > near) & ((z < before) | ((z == before) & (own > f)));
                    STORE(at, wins ? z : before);
                    *(vi*)id = wins ? f : own;
                } else {
                    for (int k = 0; k < left; ++k) {
                        if (inside[k] && z[k] > near && (z[k] < at[k] || (z[k] == at[k] && id[k] > f))) {
                            at[k] = z[k];
                            id[k] = f;
                        }
                    }
                }
            }
        }
    }
    // the background's depth; which faces are shown; for a painter, coverage and a black background
    int before = -1;
    auto finish = [&](long p) {
        const int f = face_id.data[p];
        if (f < 0) depth.data[p] = 0.f;
        else if (f != before) __atomic_store_n(shown.data + f, 1, __ATOMIC_RELAXED);
        before = f;
        if (!paints) return;
        alpha.data[p] = f < 0 ? 0.f : 1.f;
        for (int c = 0; c < 3; ++c) colour.data[3 * p + c] = 0.f;
    };
    const vf zero = 0.f;
    const long end = (long)bottom * width;
    for (long p = (long)top * width; p < end; p += LANES) {
        if (p + LANES <= end && __builtin_reduce_and(*(const vi*)(face_id.data + p) < 0)) {
            STORE(depth.data + p, zero);
            if (!paints) continue;
            STORE(alpha.data + p, zero);
            for (int c = 0; c < 3; ++c) STORE(colour.data + 3 * p + c * LANES, zero);
        } else {
            for (long q = p; q < p + LANES && q < end; ++q) finish(q);
        }
    }
"""
)


@wp.func_native(_SORT)
def _sort(
    chunk: int,
    faces_each: int,
    count: int,
    rows: int,
    strips: int,
    height: int,
    width: int,
    near: float,
    vertices: wp.array(dtype=float),
    faces: wp.array(dtype=wp.int32),
    boxes: wp.array(dtype=wp.int32),
    away: wp.array(dtype=wp.uint8),
    shown: wp.array(dtype=wp.uint8),
    tallies: wp.array(dtype=wp.int32),
): ...


@wp.kernel
def sort_faces(
    first: int,
    count: int,
    strips: int,
    height: int,
    width: int,
    near: float,
    vertices: wp.array(dtype=float),
    faces: wp.array(dtype=wp.int32),
    boxes: wp.array(dtype=wp.int32),
    away: wp.array(dtype=wp.uint8),
    shown: wp.array(dtype=wp.uint8),
    tallies: wp.array(dtype=wp.int32),
):
    """Chunk `first + tid`: its faces' pixel boxes, whether they face away, and how many lie in each strip."""
    _sort(
        first + wp.tid(), CHUNK, count, STRIP, strips, height, width, near, vertices, faces, boxes, away, shown, tallies
    )


@wp.func_native(_LIST)
def _list(
    chunk: int,
    chunks: int,
    faces_each: int,
    count: int,
    rows: int,
    strips: int,
    boxes: wp.array(dtype=wp.int32),
    away: wp.array(dtype=wp.uint8),
    tallies: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.int32),
    ends: wp.array(dtype=wp.int32),
    lists: wp.array(dtype=wp.int32),
): ...


@wp.kernel
def list_faces(
    first: int,
    chunks: int,
    count: int,
    strips: int,
    boxes: wp.array(dtype=wp.int32),
    away: wp.array(dtype=wp.uint8),
    tallies: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.int32),
    ends: wp.array(dtype=wp.int32),
    lists: wp.array(dtype=wp.int32),
):
    """Chunk `first + tid`: its faces into the lists of their strips; `ends` [strips] is where each list ends."""
    _list(first + wp.tid(), chunks, CHUNK, count, STRIP, strips, boxes, away, tallies, places, ends, lists)


@wp.func_native(_COVER)
def _cover(
    strip: int,
    rows: int,
    height: int,
    width: int,
    near: float,
    cull_back: int,
    paints: int,
    vertices: wp.array(dtype=float),
    faces: wp.array(dtype=wp.int32),
    boxes: wp.array(dtype=wp.int32),
    ends: wp.array(dtype=wp.int32),
    lists: wp.array(dtype=wp.int32),
    shown: wp.array(dtype=wp.uint8),
    face_id: wp.array(dtype=wp.int32),
    depth: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    colour: wp.array(dtype=float),
): ...


@wp.kernel
def cover_strips(
    first: int,
    height: int,
    width: int,
    near: float,
    cull_back: int,
    paints: int,
    vertices: wp.array(dtype=float),
    faces: wp.array(dtype=wp.int32),
    boxes: wp.array(dtype=wp.int32),
    ends: wp.array(dtype=wp.int32),
    lists: wp.array(dtype=wp.int32),
    shown: wp.array(dtype=wp.uint8),
    face_id: wp.array(dtype=wp.int32),
    depth: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    colour: wp.array(dtype=float),
):
    """Strip `first + tid`: face and depth of its pixels (-1 and 0 on the background), and which faces are shown.

    If it `paints`, also where it is covered, and black all over as the ground that is painted on.
    """
    _cover(
        first + wp.tid(), STRIP, height, width, near, cull_back, paints, vertices, faces, boxes, ends, lists, shown,
        face_id, depth, alpha, colour,
    )  # fmt: skip
