"""The kernel of the check of views against one another. Import through `agree`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def _pixel(m: wp.array(dtype=float), at: int, x: float, y: float, w: float):
    """(x' z, y' z, z), homogeneous pixel of the transfer that begins at `at`."""
    return wp.vec3(
        m[at] * x + m[at + 1] * y + m[at + 2] + m[at + 9] * w,
        m[at + 3] * x + m[at + 4] * y + m[at + 5] + m[at + 10] * w,
        m[at + 6] * x + m[at + 7] * y + m[at + 8] + m[at + 11] * w,
    )


@wp.kernel
def agree_pixels(
    first: int,
    height: int,
    width: int,
    asked: int,
    needed: int,
    miss: float,
    share: float,
    cosine: float,
    matrices: wp.array(dtype=float),
    chosen: wp.array(dtype=int),
    found: wp.array(dtype=float),
    normals: wp.array(dtype=wp.vec3),
    kept: wp.array(dtype=float),
    votes: wp.array(dtype=int),
):
    """Pixel first + tid of all: its inverse depth averaged with those that agree, 0 where fewer than `needed` do.

    found float32 [N, 3, H, W]: w, du, dv; normals [N H W] in the world; matrices, chosen: `sources`, [N, asked, ..].
    """
    item = first + wp.tid()
    plane = height * width
    view = item // plane
    pixel = item % plane
    base = view * 3 * plane + pixel
    w = found[base]
    votes[item] = 0
    kept[item] = 0.0
    if w > 0.0:
        x = float(pixel % width) + 0.5
        y = float(pixel // width) + 0.5
        total = w
        count = int(0)  # noqa: UP018, RUF046 - Warp: a variable that changes in a loop
        there_are = int(0)  # noqa: UP018, RUF046
        for s in range(asked):
            other = chosen[view * asked + s]
            if other >= 0:
                there_are = there_are + 1
                at = (view * asked + s) * 24
                p = _pixel(matrices, at, x, y, w)
                if p[2] > 1e-6:
                    u = p[0] / p[2]
                    v = p[1] / p[2]
                    if u >= 0.0 and u < float(width) and v >= 0.0 and v < float(height):
                        column = int(u)
                        row = int(v)
                        cell = other * 3 * plane + row * width + column
                        if found[cell] > 0.0:
                            ws = (
                                found[cell]
                                + found[cell + plane] * (u - 0.5 - float(column))
                                + found[cell + 2 * plane] * (v - 0.5 - float(row))
                            )
                            # the inverse depth of the same point in the source is w / z of the transfer
                            b = _pixel(matrices, at + 12, u, v, ws)
                            if b[2] > 1e-6 and ws > 0.0:
                                ex = b[0] / b[2] - x
                                ey = b[1] / b[2] - y
                                # at the pixel itself, by the slope of its own plane
                                back = ws / b[2] - found[base + plane] * ex - found[base + 2 * plane] * ey
                                if (
                                    ex * ex + ey * ey < miss * miss
                                    and wp.abs(back - w) < share * w
                                    and wp.dot(normals[item], normals[other * plane + row * width + column]) > cosine
                                ):
                                    total = total + back
                                    count = count + 1
        votes[item] = count
        if count >= wp.min(needed, wp.max(there_are, 1)):
            kept[item] = total / float(count + 1)
