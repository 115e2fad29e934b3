"""The kernel that looks pictures up. Import through `sampled`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

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
