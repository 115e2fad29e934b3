"""Warp kernels of texture lookup and shading, with their adjoints. Import through `warp_runtime.kernels`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.raster.kernels import barycentrics_at

wp.set_module_options({"enable_backward": False})


CLAMP = wp.constant(0)
REPEAT = wp.constant(1)
MIRROR = wp.constant(2)


@wp.func
def _texel_pair(coordinate: float, size: int, wrap: int) -> wp.vec3:
    # (lower texel, upper texel, weight of the upper) of a coordinate in texels
    if wrap == CLAMP:
        position = wp.clamp(coordinate - 0.5, 0.0, float(size - 1))
        low = wp.min(wp.floor(position), float(wp.max(size - 2, 0)))
        return wp.vec3(low, wp.min(low + 1.0, float(size - 1)), position - low)
    below = wp.floor(coordinate - 0.5)
    return wp.vec3(_wrapped(below, size, wrap), _wrapped(below + 1.0, size, wrap), coordinate - 0.5 - below)


@wp.func
def _wrapped(texel: float, size: int, wrap: int) -> float:
    period = float(size)
    if wrap == MIRROR:
        period = 2.0 * period
    inside = texel - period * wp.floor(texel / period)
    if inside >= float(size):
        inside = period - 1.0 - inside
    # rounding at far coordinates, and what is not a number, must stay inside the texture too
    return wp.clamp(inside, 0.0, float(size - 1))


@wp.kernel
def mark_texels(
    uv: wp.array(dtype=wp.vec2),
    seen: wp.array(dtype=wp.bool),
    height: int,
    width: int,
    wrap: int,
    touched: wp.array(dtype=wp.bool),
):
    """Set the texels that lookups at `uv` read, where `seen` (of length 0: everywhere)."""
    n = wp.tid()
    if seen.shape[0] > 0:  # noqa: SIM102 - an empty array must not be read
        if not seen[n]:
            return
    x = _texel_pair(uv[n][0] * float(width), width, wrap)
    y = _texel_pair((1.0 - uv[n][1]) * float(height), height, wrap)
    touched[int(y[0]) * width + int(x[0])] = True
    touched[int(y[0]) * width + int(x[1])] = True
    touched[int(y[1]) * width + int(x[0])] = True
    touched[int(y[1]) * width + int(x[1])] = True


@wp.kernel
def sample_bilinear(
    texture: wp.array(dtype=float),
    uv: wp.array(dtype=wp.vec2),
    height: int,
    width: int,
    channels: int,
    wrap: int,
    out: wp.array(dtype=float),
):
    """Bilinear lookup; texel (i, j) has its centre at u = (j + .5) / W, v = 1 - (i + .5) / H."""
    n = wp.tid()
    x = _texel_pair(uv[n][0] * float(width), width, wrap)
    y = _texel_pair((1.0 - uv[n][1]) * float(height), height, wrap)
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
    seen: wp.array(dtype=wp.bool),
    height: int,
    width: int,
    channels: int,
    wrap: int,
    with_uv: int,
    with_texture: int,
    place: wp.array(dtype=wp.int32),
    grad_texture: wp.array(dtype=float),
    grad_uv: wp.array(dtype=wp.vec2),
):
    """Adjoint of `sample_bilinear`: scatter to texels, and dL/duv where asked for (0 where the border clamps).

    Texel gradients go to row `place[texel]` of `grad_texture`, or to row `texel` where `place` has length 0. Points
    that are not `seen` are left out (of length 0: none is).
    """
    n = wp.tid()
    if seen.shape[0] > 0:  # noqa: SIM102 - an empty array must not be read
        if not seen[n]:
            return
    u = uv[n][0] * float(width)
    v = (1.0 - uv[n][1]) * float(height)
    x = _texel_pair(u, width, wrap)
    y = _texel_pair(v, height, wrap)
    top = int(y[0]) * width
    bottom = int(y[1]) * width
    ia = top + int(x[0])
    ib = top + int(x[1])
    id = bottom + int(x[0])
    ie = bottom + int(x[1])
    ga = ia
    gb = ib
    gd = id
    ge = ie
    if place.shape[0] > 0:
        ga = place[ia]
        gb = place[ib]
        gd = place[id]
        ge = place[ie]
    du = float(0.0)  # noqa: UP018 - Warp: a variable that changes in a loop
    dv = float(0.0)  # noqa: UP018
    for c in range(channels):
        g = grad[n * channels + c]
        if with_texture != 0:
            wp.atomic_add(grad_texture, ga * channels + c, g * (1.0 - x[2]) * (1.0 - y[2]))
            wp.atomic_add(grad_texture, gb * channels + c, g * x[2] * (1.0 - y[2]))
            wp.atomic_add(grad_texture, gd * channels + c, g * (1.0 - x[2]) * y[2])
            wp.atomic_add(grad_texture, ge * channels + c, g * x[2] * y[2])
        if with_uv != 0:
            a = texture[ia * channels + c]
            b = texture[ib * channels + c]
            d = texture[id * channels + c]
            e = texture[ie * channels + c]
            across = (b - a) * (1.0 - y[2]) + (e - d) * y[2]
            down = (d - a) * (1.0 - x[2]) + (e - b) * x[2]
            du += g * across
            dv += g * down
    if with_uv != 0:
        inside_x = float(wrap != CLAMP or (u - 0.5 > 0.0 and u - 0.5 < float(width - 1)))
        inside_y = float(wrap != CLAMP or (v - 0.5 > 0.0 and v - 0.5 < float(height - 1)))
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
    u = barycentrics_at(vertices[f[0]], vertices[f[1]], vertices[f[2]], x, y)
    b = u / (u[0] + u[1] + u[2])
    here = b[0] * uvs[t[0]] + b[1] * uvs[t[1]] + b[2] * uvs[t[2]]
    uv[pixel] = here
    column = _texel_pair(here[0] * float(width), width, CLAMP)
    row = _texel_pair((1.0 - here[1]) * float(height), height, CLAMP)
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
