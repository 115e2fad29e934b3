"""Warp kernels per Gaussian: projection to a screen-space splat, and its adjoint. Import through `runtime.kernels`.

A Gaussian has mean p, rotation R, scales s, opacity o. With the camera's x_c = W p + t, pixel = A (x_c, y_c) / z_c + c:

    J = A [[1, 0, -u], [0, 1, -v]] / z_c,  (u, v) = (x_c, y_c) / z_c      local affine map (Zwicker et al. 2001, EWA)
    M = J W R diag(s),   Sigma' = M M^T + BLUR I,   conic = Sigma'^-1,   o' = o sqrt(det M M^T / det Sigma')

The factor on the opacity keeps a Gaussian's contribution as it was before the blur (Yu et al. 2024, Mip-Splatting):
without it, planes seen edge on would show half a pixel of rim, and the fit would shrink the object by as much.

Its plane goes through the mean, square to the axis of the smallest scale: n = +-W R e_k turned to the camera, distance
d = n . x_c < 0 (planar Gaussians: Chen et al. 2024). Colour is spherical harmonics in the direction camera -> mean.
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python. This file is loaded once for each float
# type (`runtime.kernels`), which sets REAL beforehand.

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

REAL = globals().get("REAL", wp.float32)
Vec2 = wp.types.vector(2, REAL)
Vec3 = wp.types.vector(3, REAL)
Vec4 = wp.types.vector(4, REAL)
Vec8 = wp.types.vector(8, REAL)
Vec16 = wp.types.vector(16, REAL)
Mat22 = wp.types.matrix((2, 2), REAL)
Mat23 = wp.types.matrix((2, 3), REAL)
Mat33 = wp.types.matrix((3, 3), REAL)

ZERO = wp.constant(REAL(0.0))
HALF = wp.constant(REAL(0.5))
ONE = wp.constant(REAL(1.0))
TWO = wp.constant(REAL(2.0))
THREE = wp.constant(REAL(3.0))
FOUR = wp.constant(REAL(4.0))
BLUR = wp.constant(REAL(0.1))
LEAST = wp.constant(REAL(1.0 / 255.0))
MARGIN = wp.constant(REAL(0.15))
"""J is taken at a point at most this share of the picture outside it: far outside, the affine map is meaningless."""

# real spherical harmonics, sqrt of rationals over pi (Sloan 2008)
Y0 = wp.constant(REAL(0.28209479177387814))
Y1 = wp.constant(REAL(0.4886025119029199))
Y2A = wp.constant(REAL(1.0925484305920792))
Y2B = wp.constant(REAL(0.31539156525252005))
Y2C = wp.constant(REAL(0.5462742152960396))
Y3A = wp.constant(REAL(0.5900435899266435))
Y3B = wp.constant(REAL(2.890611442640554))
Y3C = wp.constant(REAL(0.4570457994644658))
Y3D = wp.constant(REAL(0.3731763325901154))
Y3E = wp.constant(REAL(1.445305721320277))


@wp.func
def rotation_of(q: Vec4) -> Mat33:
    """Rotation matrix of a unit quaternion (w, x, y, z)."""
    w = q[0]
    x = q[1]
    y = q[2]
    z = q[3]
    return Mat33(
        ONE - TWO * (y * y + z * z), TWO * (x * y - w * z), TWO * (x * z + w * y),
        TWO * (x * y + w * z), ONE - TWO * (x * x + z * z), TWO * (y * z - w * x),
        TWO * (x * z - w * y), TWO * (y * z + w * x), ONE - TWO * (x * x + y * y),
    )  # fmt: skip


@wp.func
def shortest(s: Vec3) -> int:
    k = int(0)  # noqa: UP018, RUF046
    if s[1] < s[0]:
        k = 1
    if s[2] < s[k]:
        k = 2
    return k


@wp.func
def axis_of(m: Mat33, k: int) -> Vec3:
    return Vec3(m[0, k], m[1, k], m[2, k])


@wp.func
def clamped(value: REAL, low: REAL, high: REAL) -> REAL:
    return wp.min(wp.max(value, low), high)


@wp.func
def harmonics(d: Vec3, degree: int, sh: wp.array2d(dtype=Vec3), g: int) -> Vec3:
    x = d[0]
    y = d[1]
    z = d[2]
    c = Y0 * sh[g, 0]
    if degree > 0:
        c += Y1 * (-y * sh[g, 1] + z * sh[g, 2] - x * sh[g, 3])
    if degree > 1:
        c += (
            Y2A * (x * y * sh[g, 4] - y * z * sh[g, 5] - x * z * sh[g, 7])
            + Y2B * (TWO * z * z - x * x - y * y) * sh[g, 6]
            + Y2C * (x * x - y * y) * sh[g, 8]
        )
    if degree > 2:
        c += (
            Y3A * (-y * (THREE * x * x - y * y) * sh[g, 9] - x * (x * x - THREE * y * y) * sh[g, 15])
            + Y3B * x * y * z * sh[g, 10]
            - Y3C * (FOUR * z * z - x * x - y * y) * (y * sh[g, 11] + x * sh[g, 13])
            + Y3D * z * (TWO * z * z - THREE * x * x - THREE * y * y) * sh[g, 12]
            + Y3E * z * (x * x - y * y) * sh[g, 14]
        )
    return c + Vec3(HALF, HALF, HALF)


@wp.func
def harmonics_adjoint(
    d: Vec3, degree: int, sh: wp.array2d(dtype=Vec3), g: int, grad: Vec3, grad_sh: wp.array2d(dtype=Vec3)
) -> Vec3:
    """Writes dL/dsh of Gaussian g; returns dL/dd, d taken as free in space."""
    x = d[0]
    y = d[1]
    z = d[2]
    gx = ZERO
    gy = ZERO
    gz = ZERO
    grad_sh[g, 0] = Y0 * grad
    if degree > 0:
        grad_sh[g, 1] = -Y1 * y * grad
        grad_sh[g, 2] = Y1 * z * grad
        grad_sh[g, 3] = -Y1 * x * grad
        gy -= Y1 * wp.dot(sh[g, 1], grad)
        gz += Y1 * wp.dot(sh[g, 2], grad)
        gx -= Y1 * wp.dot(sh[g, 3], grad)
    if degree > 1:
        grad_sh[g, 4] = Y2A * x * y * grad
        grad_sh[g, 5] = -Y2A * y * z * grad
        grad_sh[g, 6] = Y2B * (TWO * z * z - x * x - y * y) * grad
        grad_sh[g, 7] = -Y2A * x * z * grad
        grad_sh[g, 8] = Y2C * (x * x - y * y) * grad
        c4 = Y2A * wp.dot(sh[g, 4], grad)
        c5 = Y2A * wp.dot(sh[g, 5], grad)
        c6 = TWO * Y2B * wp.dot(sh[g, 6], grad)
        c7 = Y2A * wp.dot(sh[g, 7], grad)
        c8 = TWO * Y2C * wp.dot(sh[g, 8], grad)
        gx += y * c4 - x * c6 - z * c7 + x * c8
        gy += x * c4 - z * c5 - y * c6 - y * c8
        gz += -y * c5 + TWO * z * c6 - x * c7
    if degree > 2:
        b12 = TWO * z * z - THREE * x * x - THREE * y * y
        b11 = FOUR * z * z - x * x - y * y
        grad_sh[g, 9] = -Y3A * y * (THREE * x * x - y * y) * grad
        grad_sh[g, 10] = Y3B * x * y * z * grad
        grad_sh[g, 11] = -Y3C * y * b11 * grad
        grad_sh[g, 12] = Y3D * z * b12 * grad
        grad_sh[g, 13] = -Y3C * x * b11 * grad
        grad_sh[g, 14] = Y3E * z * (x * x - y * y) * grad
        grad_sh[g, 15] = -Y3A * x * (x * x - THREE * y * y) * grad
        d9 = Y3A * wp.dot(sh[g, 9], grad)
        d10 = Y3B * wp.dot(sh[g, 10], grad)
        d11 = Y3C * wp.dot(sh[g, 11], grad)
        d12 = Y3D * wp.dot(sh[g, 12], grad)
        d13 = Y3C * wp.dot(sh[g, 13], grad)
        d14 = Y3E * wp.dot(sh[g, 14], grad)
        d15 = Y3A * wp.dot(sh[g, 15], grad)
        six = REAL(6.0)
        gx += -six * x * y * d9 + y * z * d10 + TWO * x * y * d11 - six * x * z * d12
        gx += (THREE * x * x + y * y - FOUR * z * z) * d13 + TWO * x * z * d14 + THREE * (y * y - x * x) * d15
        gy += THREE * (y * y - x * x) * d9 + x * z * d10 + (x * x + THREE * y * y - FOUR * z * z) * d11
        gy += -six * y * z * d12 + TWO * x * y * d13 - TWO * y * z * d14 + six * x * y * d15
        gz += x * y * d10 - REAL(8.0) * y * z * d11 + THREE * (TWO * z * z - x * x - y * y) * d12
        gz += -REAL(8.0) * x * z * d13 + (x * x - y * y) * d14
    return Vec3(gx, gy, gz)


@wp.kernel
def project(
    means: wp.array(dtype=Vec3),
    scales: wp.array(dtype=Vec3),
    rotations: wp.array(dtype=Vec4),
    opacities: wp.array(dtype=REAL),
    sh: wp.array2d(dtype=Vec3),
    degree: int,
    camera: wp.array(dtype=REAL),
    height: int,
    width: int,
    near: REAL,
    screen: wp.array(dtype=Vec2),
    shape: wp.array(dtype=Vec4),
    feature: wp.array(dtype=Vec8),
    box: wp.array(dtype=wp.vec4i),
    depth: wp.array(dtype=REAL),
):
    """Splat of each Gaussian: mean on screen, (conic a, b, c; o'), (rgb, normal, distance, 1), pixel box.

    scales are logarithms, opacities logits, rotations need not be unit. Nothing is written for what is not drawn:
    behind `near`, outside the picture, fainter than 1/255, or not finite.
    """
    g = wp.tid()
    w = camera_rotation(camera)
    pc = w * means[g] + Vec3(camera[9], camera[10], camera[11])
    if not (pc[2] > near):
        return
    s = Vec3(wp.exp(scales[g][0]), wp.exp(scales[g][1]), wp.exp(scales[g][2]))
    q = rotations[g]
    length = wp.length(q)
    if not length > ZERO:
        return
    r = rotation_of(q / length)
    rc = w * r
    m = screen_axes(rc, pc, s, camera, height, width)
    x = (camera[12] * pc[0] + camera[13] * pc[1]) / pc[2] + camera[14]
    y = (camera[15] * pc[0] + camera[16] * pc[1]) / pc[2] + camera[17]
    row0 = Vec3(m[0, 0], m[0, 1], m[0, 2])
    row1 = Vec3(m[1, 0], m[1, 1], m[1, 2])
    xx = wp.dot(row0, row0)
    yy = wp.dot(row1, row1)
    xy = wp.dot(row0, row1)
    both = wp.cross(row0, row1)
    # det(M M^T + b I) without the cancellation of xx yy - xy^2
    det = wp.dot(both, both) + BLUR * (xx + yy) + BLUR * BLUR
    sum = det + x + y + xx + yy
    if sum - sum != ZERO:
        return
    o = wp.length(both) / wp.sqrt(det) / (ONE + wp.exp(-opacities[g]))
    if o < LEAST:
        return
    reach = TWO * wp.log(o / LEAST)
    half_x = wp.sqrt(reach * (xx + BLUR))
    half_y = wp.sqrt(reach * (yy + BLUR))
    fw = REAL(width)
    fh = REAL(height)
    x0 = int(wp.ceil(clamped(x - half_x - HALF, ZERO, fw)))
    y0 = int(wp.ceil(clamped(y - half_y - HALF, ZERO, fh)))
    x1 = int(wp.floor(clamped(x + half_x - HALF, -ONE, fw - ONE)))
    y1 = int(wp.floor(clamped(y + half_y - HALF, -ONE, fh - ONE)))
    if x1 < x0 or y1 < y0:
        return
    n = axis_of(rc, shortest(s))
    if wp.dot(n, pc) > ZERO:
        n = -n
    c = harmonics(view_direction(means[g], camera), degree, sh, g)
    screen[g] = Vec2(x, y)
    shape[g] = Vec4((yy + BLUR) / det, -xy / det, (xx + BLUR) / det, o)
    feature[g] = Vec8(
        wp.max(c[0], ZERO), wp.max(c[1], ZERO), wp.max(c[2], ZERO), n[0], n[1], n[2], wp.dot(n, pc), ONE
    )  # fmt: skip
    box[g] = wp.vec4i(x0, y0, x1, y1)
    depth[g] = pc[2]


@wp.func
def camera_rotation(camera: wp.array(dtype=REAL)) -> Mat33:
    return Mat33(
        camera[0], camera[1], camera[2], camera[3], camera[4], camera[5], camera[6], camera[7], camera[8]
    )  # fmt: skip


@wp.func
def view_direction(mean: Vec3, camera: wp.array(dtype=REAL)) -> Vec3:
    offset = mean - Vec3(camera[18], camera[19], camera[20])
    return offset / wp.length(offset)


@wp.func
def slopes(pc: Vec3, camera: wp.array(dtype=REAL), height: int, width: int) -> Vec4:
    """(u, v) where J is taken, and 1 or 0 for each: whether it moves with the mean."""
    u = pc[0] / pc[2]
    v = pc[1] / pc[2]
    # the picture's own bounds on (u, v), for any principal point and skew
    det = camera[12] * camera[16] - camera[13] * camera[15]
    low_u = REAL(1.0e30)
    low_v = REAL(1.0e30)
    high_u = -low_u
    high_v = -low_v
    for corner in range(4):
        px = -MARGIN * REAL(width) - camera[14]
        py = -MARGIN * REAL(height) - camera[17]
        if corner % 2 == 1:
            px = (ONE + MARGIN) * REAL(width) - camera[14]
        if corner / 2 == 1:
            py = (ONE + MARGIN) * REAL(height) - camera[17]
        a = (camera[16] * px - camera[13] * py) / det
        b = (camera[12] * py - camera[15] * px) / det
        low_u = wp.min(low_u, a)
        high_u = wp.max(high_u, a)
        low_v = wp.min(low_v, b)
        high_v = wp.max(high_v, b)
    free_u = ONE
    free_v = ONE
    if u < low_u or u > high_u:
        free_u = ZERO
    if v < low_v or v > high_v:
        free_v = ZERO
    return Vec4(clamped(u, low_u, high_u), clamped(v, low_v, high_v), free_u, free_v)


@wp.func
def affine_row(a: REAL, b: REAL, at: Vec4, z: REAL) -> Vec3:
    return Vec3(a / z, b / z, -(a * at[0] + b * at[1]) / z)


@wp.func
def screen_axes(rc: Mat33, pc: Vec3, s: Vec3, camera: wp.array(dtype=REAL), height: int, width: int) -> Mat23:
    """M = J W R diag(s), pixels per standard deviation."""
    at = slopes(pc, camera, height, width)
    t0 = affine_row(camera[12], camera[13], at, pc[2]) * rc
    t1 = affine_row(camera[15], camera[16], at, pc[2]) * rc
    return Mat23(t0[0] * s[0], t0[1] * s[1], t0[2] * s[2], t1[0] * s[0], t1[1] * s[1], t1[2] * s[2])


@wp.kernel
def list_tiles(
    order: wp.array(dtype=wp.int64),
    box: wp.array(dtype=wp.vec4i),
    first: wp.array(dtype=wp.int64),
    tile: int,
    across: int,
    tile_of: wp.array(dtype=wp.int32),
    gaussian_of: wp.array(dtype=wp.int32),
):
    """Per drawn Gaussian, nearest first: the tiles it touches, from slot `first[rank]` on."""
    rank = wp.tid()
    g = wp.int32(order[rank])
    b = box[g]
    slot = int(first[rank])
    for ty in range(b[1] / tile, b[3] / tile + 1):
        for tx in range(b[0] / tile, b[2] / tile + 1):
            tile_of[slot] = ty * across + tx
            gaussian_of[slot] = g
            slot += 1


@wp.kernel
def sum_slots(
    order: wp.array(dtype=wp.int64),
    first: wp.array(dtype=wp.int64),
    weights: wp.array(dtype=REAL),
    total: wp.array(dtype=REAL),
):
    """Per drawn Gaussian: the sum of its slots' weights."""
    rank = wp.tid()
    weight = REAL(0.0)
    for slot in range(int(first[rank]), int(first[rank + 1])):
        weight += weights[slot]
    total[int(order[rank])] = weight


@wp.kernel
def project_adjoint(
    order: wp.array(dtype=wp.int64),
    first: wp.array(dtype=wp.int64),
    slots: wp.array(dtype=Vec16),
    means: wp.array(dtype=Vec3),
    scales: wp.array(dtype=Vec3),
    rotations: wp.array(dtype=Vec4),
    opacities: wp.array(dtype=REAL),
    sh: wp.array2d(dtype=Vec3),
    degree: int,
    camera: wp.array(dtype=REAL),
    height: int,
    width: int,
    feature: wp.array(dtype=Vec8),
    shape: wp.array(dtype=Vec4),
    grad_means: wp.array(dtype=Vec3),
    grad_scales: wp.array(dtype=Vec3),
    grad_rotations: wp.array(dtype=Vec4),
    grad_opacities: wp.array(dtype=REAL),
    grad_sh: wp.array2d(dtype=Vec3),
    on_screen: wp.array(dtype=Vec2),
):
    """Sum the gradients of a Gaussian's slots and carry them back to its parameters.

    `slots` holds, per touched tile, dL/d(feature 8; screen 2; conic a, b, c; opacity; |screen| 2), see `blend_adjoint`.
    `on_screen` receives |sum dL/dscreen| and |sum |dL/dscreen||.
    """
    rank = wp.tid()
    g = int(order[rank])
    grad = Vec16()
    for slot in range(int(first[rank]), int(first[rank + 1])):
        grad += slots[slot]
    on_screen[g] = Vec2(
        wp.sqrt(grad[8] * grad[8] + grad[9] * grad[9]), wp.sqrt(grad[14] * grad[14] + grad[15] * grad[15])
    )
    w = camera_rotation(camera)
    pc = w * means[g] + Vec3(camera[9], camera[10], camera[11])
    s = Vec3(wp.exp(scales[g][0]), wp.exp(scales[g][1]), wp.exp(scales[g][2]))
    length = wp.length(rotations[g])
    q = rotations[g] / length
    rc = w * rotation_of(q)
    at = slopes(pc, camera, height, width)
    z = pc[2]
    j0 = affine_row(camera[12], camera[13], at, z)
    j1 = affine_row(camera[15], camera[16], at, z)
    t0 = j0 * rc
    t1 = j1 * rc

    # conic -> Sigma' : dL/dSigma' = -conic G conic, G the symmetric gradient
    a = shape[g][0]
    b = shape[g][1]
    c = shape[g][2]
    ga = grad[10]
    gb = HALF * grad[11]
    gc = grad[12]
    h00 = a * ga + b * gb
    h01 = a * gb + b * gc
    h10 = b * ga + c * gb
    h11 = b * gb + c * gc
    s00 = -(h00 * a + h01 * b)
    s01 = -(h00 * b + h01 * c)
    s11 = -(h10 * b + h11 * c)
    # Sigma' = M M^T + ... : dL/dM = 2 dL/dSigma' M, with M = (t0; t1) diag(s)
    m0 = Vec3(t0[0] * s[0], t0[1] * s[1], t0[2] * s[2])
    m1 = Vec3(t1[0] * s[0], t1[1] * s[1], t1[2] * s[2])
    g0 = TWO * (s00 * m0 + s01 * m1)
    g1 = TWO * (s01 * m0 + s11 * m1)
    # o' = o |c| / sqrt(det), c = m0 x m1, det = |c|^2 + BLUR (|m0|^2 + |m1|^2) + BLUR^2
    both = wp.cross(m0, m1)
    area = wp.length(both)
    det = area * area + BLUR * (wp.dot(m0, m0) + wp.dot(m1, m1)) + BLUR * BLUR
    share = area / wp.sqrt(det)
    o = ONE / (ONE + wp.exp(-opacities[g]))
    grad_opacities[g] = grad[13] * share * o * (ONE - o)
    by_share = grad[13] * o / wp.sqrt(det)
    by_both = (by_share * (ONE - area * area / det) / area) * both
    by_trace = by_share * area * BLUR / det
    g0 += wp.cross(m1, by_both) - by_trace * m0
    g1 += wp.cross(by_both, m0) - by_trace * m1
    grad_scales[g] = Vec3(g0[0] * m0[0] + g1[0] * m1[0], g0[1] * m0[1] + g1[1] * m1[1], g0[2] * m0[2] + g1[2] * m1[2])
    g0 = Vec3(g0[0] * s[0], g0[1] * s[1], g0[2] * s[2])
    g1 = Vec3(g1[0] * s[0], g1[1] * s[1], g1[2] * s[2])
    grad_rc = wp.outer(j0, g0) + wp.outer(j1, g1)
    gj0 = rc * g0
    gj1 = rc * g1

    # the mean: through its place on screen, through J, through its plane
    wu = camera[12] * grad[8] + camera[15] * grad[9]
    wv = camera[13] * grad[8] + camera[16] * grad[9]
    gp = Vec3(wu / z, wv / z, -(wu * pc[0] + wv * pc[1]) / (z * z))
    by_u = -(camera[12] * gj0[2] + camera[15] * gj1[2]) / z
    by_v = -(camera[13] * gj0[2] + camera[16] * gj1[2]) / z
    by_z = -(wp.dot(gj0, j0) + wp.dot(gj1, j1)) / z
    gp += Vec3(at[2] * by_u / z, at[3] * by_v / z, by_z - (at[2] * by_u * pc[0] + at[3] * by_v * pc[1]) / (z * z))
    n = Vec3(feature[g][3], feature[g][4], feature[g][5])
    gn = Vec3(grad[3], grad[4], grad[5]) + grad[6] * pc
    gp += grad[6] * n
    k = shortest(s)
    if wp.dot(axis_of(rc, k), pc) > ZERO:
        gn = -gn
    for i in range(3):
        grad_rc[i, k] = grad_rc[i, k] + gn[i]

    # colour; max(0, .) lets nothing through where it cut
    gcol = Vec3(ZERO, ZERO, ZERO)
    for i in range(3):
        if feature[g][i] > ZERO:
            gcol[i] = grad[i]
    offset = means[g] - Vec3(camera[18], camera[19], camera[20])
    far = wp.length(offset)
    d = offset / far
    gd = harmonics_adjoint(d, degree, sh, g, gcol, grad_sh)
    grad_means[g] = wp.transpose(w) * gp + (gd - wp.dot(gd, d) * d) / far

    # rotation matrix -> unit quaternion -> raw quaternion
    gr = wp.transpose(w) * grad_rc
    qw = q[0]
    x = q[1]
    y = q[2]
    v = q[3]
    gq = TWO * Vec4(
        x * (gr[2, 1] - gr[1, 2]) + y * (gr[0, 2] - gr[2, 0]) + v * (gr[1, 0] - gr[0, 1]),
        y * (gr[0, 1] + gr[1, 0]) + v * (gr[0, 2] + gr[2, 0]) + qw * (gr[2, 1] - gr[1, 2])
        - TWO * x * (gr[1, 1] + gr[2, 2]),
        x * (gr[0, 1] + gr[1, 0]) + v * (gr[1, 2] + gr[2, 1]) + qw * (gr[0, 2] - gr[2, 0])
        - TWO * y * (gr[0, 0] + gr[2, 2]),
        x * (gr[0, 2] + gr[2, 0]) + y * (gr[1, 2] + gr[2, 1]) + qw * (gr[1, 0] - gr[0, 1])
        - TWO * v * (gr[0, 0] + gr[1, 1]),
    )  # fmt: skip
    grad_rotations[g] = (gq - wp.dot(gq, q) * q) / length


@wp.kernel
def adam(
    value: wp.array2d(dtype=REAL),
    grad: wp.array2d(dtype=REAL),
    m: wp.array2d(dtype=REAL),
    v: wp.array2d(dtype=REAL),
    steps: wp.array(dtype=REAL),
    seen: wp.array(dtype=wp.bool),
    rate: REAL,
    rate_rest: REAL,
    epsilon: REAL,
):
    """Adam on the rows that are seen; `rate_rest` holds from column 3 on."""
    g = wp.tid()
    if not seen[g]:
        return
    first = ONE - wp.pow(REAL(0.9), steps[g])
    second = ONE - wp.pow(REAL(0.999), steps[g])
    for c in range(value.shape[1]):
        d = grad[g, c]
        a = REAL(0.9) * m[g, c] + REAL(0.1) * d
        b = REAL(0.999) * v[g, c] + REAL(0.001) * d * d
        m[g, c] = a
        v[g, c] = b
        r = rate
        if c > 2:
            r = rate_rest
        value[g, c] = value[g, c] - r * (a / first) / (wp.sqrt(b / second) + epsilon)
