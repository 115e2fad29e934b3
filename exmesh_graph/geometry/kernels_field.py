"""Fields over the points of a grid, asked of all views: Warp kernels; plain forms in `hull` and `carve`.

Camera: [view, 3, 4] float32, world to homogeneous pixels (pixel centres at +0.5).
"""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

#: So many views may be outvoted at a point; more are left to the plain form.
MOST_WRONG = 7

_Ranks = wp.types.vector(length=MOST_WRONG + 1, dtype=float)


@wp.kernel
def outline_field(
    first: int, wrong: int, floor: float, points: wp.array2d(dtype=float), distances: wp.array3d(dtype=float),
    cameras: wp.array3d(dtype=float), focals: wp.array(dtype=float), values: wp.array(dtype=float),
):  # fmt: skip
    """values[p]: the (wrong + 1)-th smallest vote of the views, or anything below `floor` once it is below that."""
    p = first + wp.tid()
    height, width = distances.shape[1], distances.shape[2]
    lowest = _Ranks()
    for rank in range(wrong + 1):
        lowest[rank] = wp.inf
    for view in range(distances.shape[0]):
        image = _image(cameras, view, points, p)
        vote = float(wp.inf)
        if image[2] > 1.0e-6:
            inverse = 1.0 / image[2]
            x, y = image[0] * inverse - 0.5, image[1] * inverse - 0.5
            x_in, y_in = wp.clamp(x, 0.0, float(width - 1)), wp.clamp(y, 0.0, float(height - 1))
            column, row = wp.min(int(x_in), wp.max(width - 2, 0)), wp.min(int(y_in), wp.max(height - 2, 0))
            right, below = wp.min(column + 1, width - 1), wp.min(row + 1, height - 1)
            s, t = x_in - float(column), y_in - float(row)
            top = distances[view, row, column] * (1.0 - s) + distances[view, row, right] * s
            bottom = distances[view, below, column] * (1.0 - s) + distances[view, below, right] * s
            vote = top * (1.0 - t) + bottom * t
            if vote < 0.0:
                vote -= wp.length(wp.vec2(x - x_in, y - y_in))
            vote = vote * image[2] / focals[view]
        for rank in range(wrong + 1):  # the smallest, in order
            smaller = wp.min(lowest[rank], vote)
            vote = wp.max(lowest[rank], vote)
            lowest[rank] = smaller
        if lowest[wrong] < floor:
            break
    values[p] = lowest[wrong]


@wp.kernel
def depth_field(
    first: int, least: float, limit: float, points: wp.array2d(dtype=float), depths: wp.array3d(dtype=float),
    cameras: wp.array3d(dtype=float), values: wp.array(dtype=float),
):  # fmt: skip
    """values[p]: mean signed distance along z, positive behind the surface, of the views that speak, cut at -limit;
    +limit where fewer than `least` do."""
    p = first + wp.tid()
    height, width = depths.shape[1], depths.shape[2]
    total, speakers = float(0.0), int(0)  # noqa: RUF046, UP018 - so that they may change in a loop
    for view in range(depths.shape[0]):
        image = _image(cameras, view, points, p)
        if image[2] > 1.0e-6:
            x, y = wp.floor(image[0] / image[2]), wp.floor(image[1] / image[2])
            if x >= 0.0 and x < float(width) and y >= 0.0 and y < float(height):
                seen = depths[view, int(y), int(x)]
                behind = image[2] - seen
                if seen > 0.0 and behind < limit:
                    total += wp.max(behind, -limit)
                    speakers += 1
    values[p] = limit
    if float(speakers) >= least:
        values[p] = total / float(wp.max(speakers, 1))


@wp.func
def _image(cameras: wp.array3d(dtype=float), view: int, points: wp.array2d(dtype=float), p: int) -> wp.vec3:
    x, y, z = points[p, 0], points[p, 1], points[p, 2]
    image = wp.vec3()
    for k in range(3):
        image[k] = cameras[view, k, 0] * x + cameras[view, k, 1] * y + cameras[view, k, 2] * z + cameras[view, k, 3]
    return image
