"""Warp kernels of visibility: one source for CPU and CUDA. Import through `warp_runtime.kernels`.

Homogeneous pixel coordinates throughout: a vertex is (x z, y z, z). With a' = a - z_a (px, py), the barycentric
coordinates of the point seen at pixel (px, py) are the cross product of the rows x' and y'

    u_0 = x'_1 y'_2 - x'_2 y'_1  (and cyclic),    b_i = u_i / (u_0 + u_1 + u_2),    z = sum b_i z_i

which is perspective-correct and stays valid when some vertices lie behind the camera (Olano and Greer 1997).
Subtracting the pixel first keeps the cancellation out of float32.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

# Without fused multiply-add an edge function is exactly the negative of the one in the other direction: no centre can
# fall between two faces of an edge, on CUDA either.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

EMPTY = wp.constant(wp.int64(9223372036854775807))
TILE = wp.constant(16)
LIST_SHIFT = wp.constant(35)


@wp.func
def is_finite(v: wp.vec3) -> bool:
    # wp.isfinite is a function call for each component on a CPU
    nothing = v - v
    return nothing[0] + nothing[1] + nothing[2] == 0.0


@wp.func
def edge_at(a: wp.vec3, b: wp.vec3, x: float, y: float) -> float:
    return (a[0] - x * a[2]) * (b[1] - y * b[2]) - (b[0] - x * b[2]) * (a[1] - y * a[2])


@wp.func
def barycentrics_at(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, x: float, y: float) -> wp.vec3:
    return wp.vec3(edge_at(v1, v2, x, y), edge_at(v2, v0, x, y), edge_at(v0, v1, x, y))


@wp.func
def _grow(box: wp.vec4, p: wp.vec3) -> wp.vec4:
    x = p[0] / p[2]
    y = p[1] / p[2]
    return wp.vec4(wp.min(box[0], x), wp.min(box[1], y), wp.max(box[2], x), wp.max(box[3], y))


@wp.func
def _grow_clipped(box: wp.vec4, a: wp.vec3, b: wp.vec3, near: float) -> wp.vec4:
    # adds vertex a if it is in front of the near plane, and the point where edge ab pierces that plane
    if a[2] > near:
        box = _grow(box, a)
    if (a[2] > near) != (b[2] > near):
        box = _grow(box, a + (b - a) * ((near - a[2]) / (b[2] - a[2])))
    return box


@wp.func
def _pixel_box(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, near: float, height: int, width: int) -> wp.vec4i:
    """(first column, first row, last column, last row) of the centres that the visible part may cover."""
    box = wp.vec4(1.0e30, 1.0e30, -1.0e30, -1.0e30)
    if wp.min(wp.min(v0[2], v1[2]), v2[2]) > near:
        box = _grow(_grow(_grow(box, v0), v1), v2)
    else:
        box = _grow_clipped(box, v0, v1, near)
        box = _grow_clipped(box, v1, v2, near)
        box = _grow_clipped(box, v2, v0, near)
    # 1e-3 px of margin: the division above must not drop a centre that the edge functions accept
    return wp.vec4i(
        int(wp.ceil(wp.clamp(box[0] - 0.501, 0.0, float(width)))),
        int(wp.ceil(wp.clamp(box[1] - 0.501, 0.0, float(height)))),
        int(wp.floor(wp.clamp(box[2] - 0.499, -1.0, float(width - 1)))),
        int(wp.floor(wp.clamp(box[3] - 0.499, -1.0, float(height - 1)))),
    )


@wp.func
def _cover(
    i: int,
    v0: wp.vec3,
    v1: wp.vec3,
    v2: wp.vec3,
    box: wp.vec4i,
    width: int,
    near: float,
    cull_back: int,
    keys: wp.array(dtype=wp.int64),
):
    """Atomic minimum of (depth bits << 32 | face) at every pixel centre of the box that the face covers."""
    # no fragment of the face is nearer than its nearest vertex (1e-5 covers the rounding of z below)
    nearest = wp.max(near, wp.min(wp.min(v0[2], v1[2]), v2[2]) * 0.99999)
    bound = wp.int64(wp.cast(nearest, wp.int32)) << wp.int64(32)
    for row in range(box[1], box[3] + 1):
        y = float(row) + 0.5
        y0 = v0[1] - y * v0[2]
        y1 = v1[1] - y * v1[2]
        y2 = v2[1] - y * v2[2]
        for column in range(box[0], box[2] + 1):
            pixel = row * width + column
            if bound > keys[pixel]:
                continue
            x = float(column) + 0.5
            x0 = v0[0] - x * v0[2]
            x1 = v1[0] - x * v1[2]
            x2 = v2[0] - x * v2[2]
            u0 = x1 * y2 - x2 * y1
            u1 = x2 * y0 - x0 * y2
            u2 = x0 * y1 - x1 * y0
            total = u0 + u1 + u2
            # y points down, so a counter-clockwise face seen from outside has negative area
            if total > 0.0:
                if cull_back != 0:
                    continue
            else:
                u0 = -u0
                u1 = -u1
                u2 = -u2
                total = -total
            if u0 >= 0.0 and u1 >= 0.0 and u2 >= 0.0 and total > 0.0:
                z = (u0 * v0[2] + u1 * v1[2] + u2 * v2[2]) / total
                if z > near:
                    # a positive float's bits are ordered like the float
                    key = (wp.int64(wp.cast(z, wp.int32)) << wp.int64(32)) | wp.int64(i)
                    # the plain read is only a filter; the atomic decides
                    if key < keys[pixel]:
                        wp.atomic_min(keys, pixel, key)


@wp.func
def _across(low: int, high: int) -> int:
    return (high - low) / TILE + 1


@wp.kernel
def rasterize_faces(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    height: int,
    width: int,
    near: float,
    cull_back: int,
    largest: int,
    keys: wp.array(dtype=wp.int64),
    large: wp.array(dtype=wp.int32),
    first_tile: wp.array(dtype=wp.int64),
    counts: wp.array(dtype=wp.int64),
):
    """Per face: cover its pixels; one whose box has more than `largest` (> 0) pixels is put on the list `large`.

    `counts[0]` packs (faces on the list << 35 | tiles), so that one atomic gives a face both its place on the list and
    its first tile, and `first_tile` ascends along the list. The list's order may vary, the picture does not.
    """
    i = wp.tid()
    f = faces[i]
    v0 = vertices[f[0]]
    v1 = vertices[f[1]]
    v2 = vertices[f[2]]
    box = _pixel_box(v0, v1, v2, near, height, width)
    if box[2] < box[0] or box[3] < box[1]:
        return
    if not (is_finite(v0) and is_finite(v1) and is_finite(v2)):
        return
    if largest > 0 and (box[2] - box[0] + 1) * (box[3] - box[1] + 1) > largest:
        tiles = wp.int64(_across(box[0], box[2])) * wp.int64(_across(box[1], box[3]))
        before = wp.atomic_add(counts, 0, (wp.int64(1) << wp.int64(LIST_SHIFT)) + tiles)
        place = wp.int32(before >> wp.int64(LIST_SHIFT))
        large[place] = i
        first_tile[place] = before & ((wp.int64(1) << wp.int64(LIST_SHIFT)) - wp.int64(1))
        return
    _cover(i, v0, v1, v2, box, width, near, cull_back, keys)


@wp.kernel
def rasterize_tiles(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    height: int,
    width: int,
    near: float,
    cull_back: int,
    keys: wp.array(dtype=wp.int64),
    large: wp.array(dtype=wp.int32),
    first_tile: wp.array(dtype=wp.int64),
    count: int,
):
    """Per tile of TILE x TILE pixels of a large face: the same as `rasterize_faces` does for a small one."""
    tile = wp.int64(wp.tid())
    low = int(0)  # noqa: UP018, RUF046 - Warp: a variable that changes in a loop
    high = int(count)
    while high - low > 1:
        middle = (low + high) / 2
        if first_tile[middle] <= tile:
            low = middle
        else:
            high = middle
    i = large[low]
    f = faces[i]
    v0 = vertices[f[0]]
    v1 = vertices[f[1]]
    v2 = vertices[f[2]]
    box = _pixel_box(v0, v1, v2, near, height, width)
    n = int(tile - first_tile[low])
    across = _across(box[0], box[2])
    left = box[0] + (n % across) * TILE
    top = box[1] + (n / across) * TILE
    part = wp.vec4i(left, top, wp.min(left + TILE - 1, box[2]), wp.min(top + TILE - 1, box[3]))
    _cover(i, v0, v1, v2, part, width, near, cull_back, keys)


@wp.kernel
def resolve_fragments(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    keys: wp.array(dtype=wp.int64),
    width: int,
    face_id: wp.array(dtype=wp.int32),
    bary: wp.array(dtype=wp.vec3),
    depth: wp.array(dtype=float),
):
    """Per pixel: unpack the winning key and evaluate the barycentric coordinates once more.

    The background keeps what the arrays were filled with.
    """
    pixel = wp.tid()
    key = keys[pixel]
    if key == EMPTY:
        return
    i = wp.int32(key & wp.int64(0xFFFFFFFF))
    f = faces[i]
    x = float(pixel % width) + 0.5
    y = float(pixel // width) + 0.5
    u = barycentrics_at(vertices[f[0]], vertices[f[1]], vertices[f[2]], x, y)
    face_id[pixel] = i
    bary[pixel] = u / (u[0] + u[1] + u[2])
    depth[pixel] = wp.cast(wp.int32(key >> wp.int64(32)), float)


@wp.kernel
def barycentrics_of(
    first: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    face_id: wp.array(dtype=wp.int32),
    width: int,
    bary: wp.array(dtype=wp.vec3),
):
    """Pixel `first + tid`: barycentric coordinates in the face that it shows, 0 on the background."""
    pixel = first + wp.tid()
    bary[pixel] = wp.vec3(0.0, 0.0, 0.0)
    i = face_id[pixel]
    if i >= 0:
        f = faces[i]
        x = float(pixel % width) + 0.5
        y = float(pixel // width) + 0.5
        u = barycentrics_at(vertices[f[0]], vertices[f[1]], vertices[f[2]], x, y)
        bary[pixel] = u / (u[0] + u[1] + u[2])
