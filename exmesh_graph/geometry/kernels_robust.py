"""The kernel of medians over views. Import through `robust`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

#: So many views; of more medians are taken in the plain way.
MOST = 64

_Values = wp.types.vector(length=MOST, dtype=float)


@wp.func
def _median(values: _Values, count: int):
    """Of the first `count` values."""
    for k in range(1, count):
        value = values[k]
        at = int(k)
        while at > 0 and values[wp.max(at - 1, 0)] > value:
            values[at] = values[at - 1]
            at = at - 1
        values[at] = value
    return (values[(count - 1) / 2] + values[count / 2]) / 2.0


@wp.kernel
def medians(
    first: int,
    views: int,
    points: int,
    channels: int,
    colours: wp.array(dtype=float),
    middle: wp.array(dtype=float),
    deviation: wp.array(dtype=float),
    counts: wp.array(dtype=wp.int64),
):
    """Point first + tid of colours [views points channels]: median, deviation, count; untouched where there is none."""
    p = first + wp.tid()
    count = int(0)  # noqa: UP018, RUF046
    for view in range(views):
        if not wp.isnan(colours[(view * points + p) * channels]):
            count = count + 1
    counts[p] = wp.int64(count)
    if count > 0:
        off = _Values()
        for c in range(channels):
            values = _Values()
            filled = int(0)  # noqa: UP018, RUF046
            for view in range(views):
                value = colours[(view * points + p) * channels + c]
                if not wp.isnan(value):
                    values[filled] = value
                    filled = filled + 1
            found = _median(values, count)
            middle[p * channels + c] = found
            filled = int(0)  # noqa: UP018, RUF046
            for view in range(views):
                value = colours[(view * points + p) * channels + c]
                if not wp.isnan(value):
                    off[filled] = off[filled] + wp.abs(value - found)
                    filled = filled + 1
        deviation[p] = 1.4826 * _median(off, count) / float(channels)
