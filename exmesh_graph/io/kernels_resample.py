"""Kernels that look pictures up between their pixels. Import through `resample`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

_POLE = wp.constant(-0.2679491924311227)  # sqrt(3) - 2

wp.set_module_options({"enable_backward": False})


@wp.kernel
def look_up(
    first: int,
    height: int,
    width: int,
    channels: int,
    picture: wp.array(dtype=float),
    places: wp.array(dtype=wp.vec2d),
    found: wp.array(dtype=float),
):
    """found [P channels] at place first + tid, bilinear; untouched where that is outside the pixels' middles."""
    p = first + wp.tid()
    row = places[p][0]
    column = places[p][1]
    least = wp.float64(0.0)
    if row >= least and column >= least and row <= wp.float64(height - 1) and column <= wp.float64(width - 1):
        top = wp.min(int(row), wp.max(height - 2, 0))
        left = wp.min(int(column), wp.max(width - 2, 0))
        down = row - wp.float64(top)
        across = column - wp.float64(left)
        right = wp.min(1, width - 1) * channels
        below = wp.min(1, height - 1) * width * channels
        here = (top * width + left) * channels
        one = wp.float64(1.0)
        for c in range(channels):
            upper = wp.float64(picture[here + c]) * (one - across) + wp.float64(picture[here + right + c]) * across
            lower = (
                wp.float64(picture[here + below + c]) * (one - across)
                + wp.float64(picture[here + below + right + c]) * across
            )
            found[p * channels + c] = float(upper * (one - down) + lower * down)


@wp.kernel
def spline_lines(first: int, length: int, step: int, lines: int, apart: int, values: wp.array(dtype=float)):
    """Cubic B-spline coefficients of line first + tid, in place: `length` values, `step` apart, beyond which the end
    ones go on for ever. Lines begin at whole multiples of `apart`, `lines` side by side from each on."""
    line = first + wp.tid()
    start = (line // lines) * apart + line % lines
    last = start + (length - 1) * step
    z = float(_POLE)
    end = values[last] / (1.0 - z)  # what the sum from the left tends to, beyond the end
    before = values[start] / (1.0 - z)
    values[start] = before
    for k in range(1, length):
        at = start + k * step
        before = values[at] + z * before
        values[at] = before
    after = -z * (end / (1.0 - z) + (before - end) / (1.0 - z * z))
    values[last] = 6.0 * after
    for k in range(1, length):
        at = last - k * step
        after = z * (after - values[at])
        values[at] = 6.0 * after


@wp.func
def _weights(t: float):
    """Of the four coefficients around a place t in [0, 1) beyond the second."""
    u = 1.0 - t
    return wp.vec4(
        u * u * u / 6.0, (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0, (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
        t * t * t / 6.0,
    )  # fmt: skip


@wp.kernel
def look_up_smoothly(
    first: int,
    height: int,
    width: int,
    channels: int,
    margin: int,
    coefficients: wp.array(dtype=float),
    places: wp.array(dtype=wp.vec2d),
    found: wp.array(dtype=float),
):
    """found [P channels] at place first + tid of a spline whose coefficients lie `margin` beyond the picture too."""
    p = first + wp.tid()
    edge = wp.float64(margin)
    row = wp.clamp(places[p][0] + edge, wp.float64(1.0), wp.float64(height) - wp.float64(3.001))
    column = wp.clamp(places[p][1] + edge, wp.float64(1.0), wp.float64(width) - wp.float64(3.001))
    top = int(row)
    left = int(column)
    down = _weights(float(row - wp.float64(top)))
    across = _weights(float(column - wp.float64(left)))
    for c in range(channels):
        total = 0.0
        for j in range(4):
            line = ((top - 1 + j) * width + left - 1) * channels + c
            part = 0.0
            for i in range(4):
                part += across[i] * coefficients[line + i * channels]
            total += down[j] * part
        found[p * channels + c] = total
