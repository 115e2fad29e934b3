"""Warp kernels of the rasteriser: one source for CPU and CUDA. Import through `warp_runtime.kernels`.

Homogeneous pixel coordinates throughout: a vertex is (x z, y z, z). With a' = a - z_a (px, py), the barycentric
coordinates of the point seen at pixel (px, py) are the cross product of the rows x' and y'

    u_0 = x'_1 y'_2 - x'_2 y'_1  (and cyclic),    b_i = u_i / (u_0 + u_1 + u_2),    z = sum b_i z_i

which is perspective-correct and stays valid when some vertices lie behind the camera (Olano and Greer 1997).
Subtracting the pixel first keeps the cancellation out of float32.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False})

EMPTY = wp.constant(wp.int64(9223372036854775807))


@wp.func
def _edge(a: wp.vec3, b: wp.vec3, x: float, y: float) -> float:
    return (a[0] - x * a[2]) * (b[1] - y * b[2]) - (b[0] - x * b[2]) * (a[1] - y * a[2])


@wp.func
def _shared_edge(a: wp.vec3, b: wp.vec3, ia: int, ib: int, x: float, y: float) -> float:
    # both faces of an edge evaluate it in the same order, so that rounding (fused multiply-add) cannot open a gap
    if ia < ib:
        return _edge(a, b, x, y)
    return -_edge(b, a, x, y)


@wp.func
def _barycentrics(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, f: wp.vec3i, x: float, y: float) -> wp.vec3:
    return wp.vec3(
        _shared_edge(v1, v2, f[1], f[2], x, y),
        _shared_edge(v2, v0, f[2], f[0], x, y),
        _shared_edge(v0, v1, f[0], f[1], x, y),
    )


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


@wp.kernel
def rasterize_faces(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    height: int,
    width: int,
    near: float,
    cull_back: int,
    keys: wp.array(dtype=wp.int64),
):
    """Per face: atomic minimum of (depth bits << 32 | face) at every pixel centre the face covers."""
    i = wp.tid()
    f = faces[i]
    v0 = vertices[f[0]]
    v1 = vertices[f[1]]
    v2 = vertices[f[2]]
    if not (wp.isfinite(v0) and wp.isfinite(v1) and wp.isfinite(v2)):
        return

    box = wp.vec4(1.0e30, 1.0e30, -1.0e30, -1.0e30)
    box = _grow_clipped(box, v0, v1, near)
    box = _grow_clipped(box, v1, v2, near)
    box = _grow_clipped(box, v2, v0, near)
    # 1e-3 px of margin: the division above must not drop a centre that the edge functions accept
    x_low = int(wp.ceil(wp.clamp(box[0] - 0.501, 0.0, float(width))))
    y_low = int(wp.ceil(wp.clamp(box[1] - 0.501, 0.0, float(height))))
    x_high = int(wp.floor(wp.clamp(box[2] - 0.499, -1.0, float(width - 1))))
    y_high = int(wp.floor(wp.clamp(box[3] - 0.499, -1.0, float(height - 1))))

    for row in range(y_low, y_high + 1):
        y = float(row) + 0.5
        for column in range(x_low, x_high + 1):
            u = _barycentrics(v0, v1, v2, f, float(column) + 0.5, y)
            total = u[0] + u[1] + u[2]
            # y points down, so a counter-clockwise face seen from outside has negative area
            if total > 0.0:
                if cull_back != 0:
                    continue
            else:
                u = -u
                total = -total
            if u[0] >= 0.0 and u[1] >= 0.0 and u[2] >= 0.0 and total > 0.0:
                z = (u[0] * v0[2] + u[1] * v1[2] + u[2] * v2[2]) / total
                if z > near:
                    # a positive float's bits are ordered like the float
                    key = (wp.int64(wp.cast(z, wp.int32)) << wp.int64(32)) | wp.int64(i)
                    # the plain read is only a filter; the atomic decides
                    if key < keys[row * width + column]:
                        wp.atomic_min(keys, row * width + column, key)


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
    """Per pixel: unpack the winning key and evaluate the barycentric coordinates once more."""
    pixel = wp.tid()
    key = keys[pixel]
    if key == EMPTY:
        face_id[pixel] = -1
        bary[pixel] = wp.vec3(0.0, 0.0, 0.0)
        depth[pixel] = 0.0
        return
    i = wp.int32(key & wp.int64(0xFFFFFFFF))
    f = faces[i]
    x = float(pixel % width) + 0.5
    y = float(pixel // width) + 0.5
    u = _barycentrics(vertices[f[0]], vertices[f[1]], vertices[f[2]], f, x, y)
    face_id[pixel] = i
    bary[pixel] = u / (u[0] + u[1] + u[2])
    depth[pixel] = wp.cast(wp.int32(key >> wp.int64(32)), float)


@wp.func
def _texel_pair(coordinate: float, size: int) -> wp.vec3:
    # (lower texel, upper texel, weight of the upper) of a coordinate in texels, clamped at the border
    position = wp.clamp(coordinate - 0.5, 0.0, float(size - 1))
    low = wp.min(wp.floor(position), float(wp.max(size - 2, 0)))
    return wp.vec3(low, wp.min(low + 1.0, float(size - 1)), position - low)


@wp.kernel
def sample_bilinear(
    texture: wp.array(dtype=float),
    uv: wp.array(dtype=wp.vec2),
    height: int,
    width: int,
    channels: int,
    out: wp.array(dtype=float),
):
    """Bilinear lookup; texel (i, j) has its centre at u = (j + .5) / W, v = 1 - (i + .5) / H."""
    n = wp.tid()
    x = _texel_pair(uv[n][0] * float(width), width)
    y = _texel_pair((1.0 - uv[n][1]) * float(height), height)
    top = int(y[0]) * width
    bottom = int(y[1]) * width
    left = int(x[0])
    right = int(x[1])
    for c in range(channels):
        a = texture[(top + left) * channels + c]
        b = texture[(top + right) * channels + c]
        d = texture[(bottom + left) * channels + c]
        e = texture[(bottom + right) * channels + c]
        upper = a + (b - a) * x[2]
        lower = d + (e - d) * x[2]
        out[n * channels + c] = upper + (lower - upper) * y[2]


@wp.kernel
def sample_bilinear_adjoint(
    texture: wp.array(dtype=float),
    uv: wp.array(dtype=wp.vec2),
    grad: wp.array(dtype=float),
    height: int,
    width: int,
    channels: int,
    with_uv: int,
    with_texture: int,
    grad_texture: wp.array(dtype=float),
    grad_uv: wp.array(dtype=wp.vec2),
):
    """Adjoint of `sample_bilinear`: scatter to texels, and dL/duv where asked for (0 where the border clamps)."""
    n = wp.tid()
    u = uv[n][0] * float(width)
    v = (1.0 - uv[n][1]) * float(height)
    x = _texel_pair(u, width)
    y = _texel_pair(v, height)
    top = int(y[0]) * width
    bottom = int(y[1]) * width
    left = int(x[0])
    right = int(x[1])
    du = float(0.0)  # noqa: UP018 - Warp: a variable that changes in a loop
    dv = float(0.0)  # noqa: UP018
    for c in range(channels):
        g = grad[n * channels + c]
        ia = (top + left) * channels + c
        ib = (top + right) * channels + c
        id = (bottom + left) * channels + c
        ie = (bottom + right) * channels + c
        if with_texture != 0:
            wp.atomic_add(grad_texture, ia, g * (1.0 - x[2]) * (1.0 - y[2]))
            wp.atomic_add(grad_texture, ib, g * x[2] * (1.0 - y[2]))
            wp.atomic_add(grad_texture, id, g * (1.0 - x[2]) * y[2])
            wp.atomic_add(grad_texture, ie, g * x[2] * y[2])
        if with_uv != 0:
            across = (texture[ib] - texture[ia]) * (1.0 - y[2]) + (texture[ie] - texture[id]) * y[2]
            down = (texture[id] - texture[ia]) * (1.0 - x[2]) + (texture[ie] - texture[ib]) * x[2]
            du += g * across
            dv += g * down
    if with_uv != 0:
        inside_x = float(u - 0.5 > 0.0 and u - 0.5 < float(width - 1))
        inside_y = float(v - 0.5 > 0.0 and v - 0.5 < float(height - 1))
        grad_uv[n] = wp.vec2(du * float(width) * inside_x, -dv * float(height) * inside_y)


@wp.kernel
def shade(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    uvs: wp.array(dtype=wp.vec2),
    uv_faces: wp.array(dtype=wp.vec3i),
    texture: wp.array(dtype=float),
    face_id: wp.array(dtype=wp.int32),
    image_width: int,
    height: int,
    width: int,
    channels: int,
    uv: wp.array(dtype=wp.vec2),
    out: wp.array(dtype=float),
):
    """Per pixel: perspective-correct uv, then the bilinear texture value (0 on the background)."""
    pixel = wp.tid()
    i = face_id[pixel]
    if i < 0:
        return
    f = faces[i]
    t = uv_faces[i]
    x = float(pixel % image_width) + 0.5
    y = float(pixel // image_width) + 0.5
    u = _barycentrics(vertices[f[0]], vertices[f[1]], vertices[f[2]], f, x, y)
    b = u / (u[0] + u[1] + u[2])
    here = b[0] * uvs[t[0]] + b[1] * uvs[t[1]] + b[2] * uvs[t[2]]
    uv[pixel] = here
    column = _texel_pair(here[0] * float(width), width)
    row = _texel_pair((1.0 - here[1]) * float(height), height)
    ia = (int(row[0]) * width + int(column[0])) * channels
    ib = (int(row[0]) * width + int(column[1])) * channels
    id = (int(row[1]) * width + int(column[0])) * channels
    ie = (int(row[1]) * width + int(column[1])) * channels
    for c in range(channels):
        upper = texture[ia + c] + (texture[ib + c] - texture[ia + c]) * column[2]
        lower = texture[id + c] + (texture[ie + c] - texture[id + c]) * column[2]
        out[pixel * channels + c] = upper + (lower - upper) * row[2]


@wp.kernel
def shade_vertices_adjoint(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    uvs: wp.array(dtype=wp.vec2),
    uv_faces: wp.array(dtype=wp.vec3i),
    face_id: wp.array(dtype=wp.int32),
    grad_uv: wp.array(dtype=wp.vec2),
    image_width: int,
    grad_vertices: wp.array(dtype=wp.vec3),
):
    """dL/d(homogeneous pixel coordinates) from dL/duv per pixel.

    With rows X = x', Y = y' over the corners: u = X x Y, b = u / sum(u), so dL/du = (dL/db - b . dL/db) / sum(u),
    dL/dX = Y x dL/du, dL/dY = dL/du x X, and x'_i = x_i - p_x z_i gives the depth's share.
    """
    pixel = wp.tid()
    i = face_id[pixel]
    if i < 0:
        return
    g = grad_uv[pixel]
    if g[0] == 0.0 and g[1] == 0.0:
        return
    f = faces[i]
    t = uv_faces[i]
    x = float(pixel % image_width) + 0.5
    y = float(pixel // image_width) + 0.5
    v0 = vertices[f[0]]
    v1 = vertices[f[1]]
    v2 = vertices[f[2]]
    row_x = wp.vec3(v0[0] - x * v0[2], v1[0] - x * v1[2], v2[0] - x * v2[2])
    row_y = wp.vec3(v0[1] - y * v0[2], v1[1] - y * v1[2], v2[1] - y * v2[2])
    u = wp.cross(row_x, row_y)
    total = u[0] + u[1] + u[2]
    b = u / total
    grad_b = wp.vec3(wp.dot(g, uvs[t[0]]), wp.dot(g, uvs[t[1]]), wp.dot(g, uvs[t[2]]))
    mean = wp.dot(grad_b, b)
    grad_u = (grad_b - wp.vec3(mean, mean, mean)) / total
    grad_x = wp.cross(row_y, grad_u)
    grad_y = wp.cross(grad_u, row_x)
    wp.atomic_add(grad_vertices, f[0], wp.vec3(grad_x[0], grad_y[0], -x * grad_x[0] - y * grad_y[0]))
    wp.atomic_add(grad_vertices, f[1], wp.vec3(grad_x[1], grad_y[1], -x * grad_x[1] - y * grad_y[1]))
    wp.atomic_add(grad_vertices, f[2], wp.vec3(grad_x[2], grad_y[2], -x * grad_x[2] - y * grad_y[2]))


@wp.func
def _propose(
    near_pixel: int,
    far_pixel: int,
    z: float,
    code: int,
    face_id: wp.array(dtype=wp.int32),
    depth: wp.array(dtype=float),
    behind: float,
    in_front: float,
    keys: wp.array(dtype=wp.int64),
    slot: int,
):
    # the pair is accepted if the near pixel shows a surface and the edge lies before the far pixel's surface
    if face_id[near_pixel] < 0:
        return
    z_near = depth[near_pixel]
    if face_id[far_pixel] >= 0:
        z_far = depth[far_pixel]
        if z_near >= z_far or z >= z_far - behind * z:
            return
    # at a grazing silhouette the near centre lies far before the edge, so only an edge well in FRONT is refused
    if z > z_near - in_front * z:
        wp.atomic_min(keys, slot, (wp.int64(wp.cast(z, wp.int32)) << wp.int64(32)) | wp.int64(code))


@wp.kernel
def find_silhouette(
    vertices: wp.array(dtype=wp.vec3),
    edges: wp.array(dtype=wp.vec2i),
    opposite: wp.array(dtype=wp.vec2i),
    face_id: wp.array(dtype=wp.int32),
    depth: wp.array(dtype=float),
    height: int,
    width: int,
    near: float,
    behind: float,
    in_front: float,
    keys: wp.array(dtype=wp.int64),
):
    """Per silhouette edge: the pairs of neighbouring pixel centres it passes between, nearest edge per pair.

    Pairs are (p, p + 1) in slot p, and (p, p + width) in slot height * width + p. The low 32 bits of a key are
    2 * edge + 1 if the pair's first pixel lies on the surface's side, 2 * edge otherwise.
    """
    e = wp.tid()
    a = vertices[edges[e][0]]
    b = vertices[edges[e][1]]
    if not (wp.isfinite(a) and wp.isfinite(b)):
        return
    if a[2] <= near or b[2] <= near:
        return
    ax = a[0] / a[2]
    ay = a[1] / a[2]
    side = _edge(b, vertices[opposite[e][0]], ax, ay) > 0.0
    if opposite[e][1] >= 0:  # noqa: SIM102 - an index of -1 must not be read
        # two faces on the same side of their edge in the image: the surface turns away here
        if (_edge(b, vertices[opposite[e][1]], ax, ay) > 0.0) != side:
            return
    bx = b[0] / b[2]
    by = b[1] / b[2]

    # half-open ranges: an end point shared by two edges is counted once
    first = int(wp.ceil(wp.clamp(wp.min(ay, by) - 0.5, 0.0, float(height))))
    last = int(wp.ceil(wp.clamp(wp.max(ay, by) - 0.5, 0.0, float(height))))
    for row in range(first, last):
        s = (float(row) + 0.5 - ay) / (by - ay)
        x = ax + s * (bx - ax) - 0.5
        if x >= 0.0 and x < float(width - 1):
            z = 1.0 / ((1.0 - s) / a[2] + s / b[2])
            p = row * width + int(wp.floor(x))
            if (by > ay) == side:
                _propose(p, p + 1, z, 2 * e + 1, face_id, depth, behind, in_front, keys, p)
            else:
                _propose(p + 1, p, z, 2 * e, face_id, depth, behind, in_front, keys, p)

    first = int(wp.ceil(wp.clamp(wp.min(ax, bx) - 0.5, 0.0, float(width))))
    last = int(wp.ceil(wp.clamp(wp.max(ax, bx) - 0.5, 0.0, float(width))))
    for column in range(first, last):
        s = (float(column) + 0.5 - ax) / (bx - ax)
        y = ay + s * (by - ay) - 0.5
        if y >= 0.0 and y < float(height - 1):
            z = 1.0 / ((1.0 - s) / a[2] + s / b[2])
            p = int(wp.floor(y)) * width + column
            if (bx < ax) == side:
                _propose(p, p + width, z, 2 * e + 1, face_id, depth, behind, in_front, keys, height * width + p)
            else:
                _propose(p + width, p, z, 2 * e, face_id, depth, behind, in_front, keys, height * width + p)
