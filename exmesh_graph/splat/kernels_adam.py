"""Warp kernel of Adam's step over rows of parameters (`optimiser.GaussianAdam`); plain form: `optim.adam_step`."""

# mypy: ignore-errors
# ruff: noqa: F821
# See kernels_camera.py.

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


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
