"""Warp kernels of the rasteriser: one source for CPU and CUDA. Import through `warp_runtime.kernels`.

Homogeneous pixel coordinates throughout: a vertex is (x z, y z, z). With a' = a - z_a (px, py), the barycentric
coordinates of the point seen at pixel (px, py) are the cross product of the rows x' and y'

    u_0 = x'_1 y'_2 - x'_2 y'_1  (and cyclic),    b_i = u_i / (u_0 + u_1 + u_2),    z = sum b_i z_i

which is perspective-correct and stays valid when some vertices lie behind the camera (Olano and Greer 1997).
Subtracting the pixel first keeps the cancellation out of float32.
"""

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
    du = float(0.0)
    dv = float(0.0)
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
