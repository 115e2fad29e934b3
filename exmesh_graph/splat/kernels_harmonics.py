"""Warp functions of real spherical harmonics to degree 3, and their adjoint (constants: Sloan 2008)."""

# mypy: ignore-errors
# ruff: noqa: F821
# See kernels_camera.py.

import warp as wp

THREE = wp.constant(REAL(3.0))
FOUR = wp.constant(REAL(4.0))
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
