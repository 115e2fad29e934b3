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
# ruff: noqa: F821
# See kernels_camera.py; the functions of that file and of kernels_harmonics.py are set beforehand too.

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

BLUR = wp.constant(REAL(0.1))


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
