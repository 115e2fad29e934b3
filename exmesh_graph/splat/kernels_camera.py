"""Warp functions that projection and its adjoint share: rotations, the camera, the local affine map."""

# mypy: ignore-errors
# ruff: noqa: F821
# Kernels are written in Warp's own language, which only looks like Python. This file is loaded once for each float
# type (`runtime.kernels`), which sets REAL, its vectors and its numbers beforehand.

import warp as wp

MARGIN = wp.constant(REAL(0.15))
"""J is taken at a point at most this share of the picture outside it: far outside, the affine map is meaningless."""


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
