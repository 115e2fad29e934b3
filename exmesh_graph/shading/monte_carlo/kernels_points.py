"""Warp kernel of a point's weights among coarse points: one source for CPU and CUDA. Formulas as in `points`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def _tent(distance: wp.int64, least: float) -> float:
    return wp.max(1.0 - 0.5 * float(wp.abs(distance)), least)


@wp.kernel
def weigh(
    first: int,
    width: wp.int64,
    steepest: float,
    power: float,
    least: float,
    position: wp.array(dtype=wp.vec3),
    flat: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    pixel: wp.array(dtype=wp.int64),
    near: wp.array(dtype=wp.int64),
    there: wp.array(dtype=wp.bool),
    weight: wp.array(dtype=float),
):
    """Of point `first + tid`: the weights of its four candidates `near`, not yet divided by their sum."""
    i = first + wp.tid()
    for k in range(4):
        w = float(0.0)  # noqa: UP018  a Warp constant may not change inside a loop
        if there[4 * i + k]:
            j = int(near[4 * i + k])
            step = position[j] - position[i]
            away = wp.max(wp.abs(wp.dot(step, flat[i])), wp.abs(wp.dot(step, flat[j])))
            slope = away / wp.max(wp.length(step), 1.0e-20) / steepest
            cosine = wp.max(wp.dot(normal[i], normal[j]), 0.0)
            across = _tent(pixel[i] % width - pixel[j] % width, least)
            down = _tent(pixel[i] / width - pixel[j] / width, least)
            w = across * down * wp.exp(-slope * slope) * wp.pow(cosine, power)
        weight[4 * i + k] = w
