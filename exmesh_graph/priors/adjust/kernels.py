"""The kernel of what patches of one view say of the cameras. Import through `system`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

vec9 = wp.types.vector(length=9, dtype=wp.float64)
mat99 = wp.types.matrix(shape=(9, 9), dtype=wp.float64)
mat93 = wp.types.matrix(shape=(9, 3), dtype=wp.float64)


@wp.func
def _inside(at: wp.vec2d, width: int, height: int):
    """Whether a pixel, its centre at +0.5, has four neighbours."""
    x = at[0] - wp.float64(0.5)
    y = at[1] - wp.float64(0.5)
    least = wp.float64(0.0)
    edge = wp.float64(1.001)
    return x >= least and y >= least and x <= wp.float64(width) - edge and y <= wp.float64(height) - edge


@wp.func
def _sampled(values: wp.array(dtype=wp.vec3), base: int, width: int, height: int, at: wp.vec2d):
    """Value and slopes at a pixel, bilinear; of the nearest place inside where it is outside."""
    x = wp.clamp(at[0] - wp.float64(0.5), wp.float64(0.0), wp.float64(width) - wp.float64(1.001))
    y = wp.clamp(at[1] - wp.float64(0.5), wp.float64(0.0), wp.float64(height) - wp.float64(1.001))
    left = int(x)
    top = int(y)
    across = x - wp.float64(left)
    down = y - wp.float64(top)
    here = base + top * width + left
    one = wp.float64(1.0)
    a = wp.vec3d(values[here]) * (one - across) + wp.vec3d(values[here + 1]) * across
    b = wp.vec3d(values[here + width]) * (one - across) + wp.vec3d(values[here + width + 1]) * across
    return a * (one - down) + b * down


@wp.func
def _mean(values: vec9):
    total = wp.float64(0.0)
    for n in range(9):
        total += values[n]
    return total / wp.float64(9.0)


@wp.kernel
def compare(
    first: int,
    asked: int,
    width: int,
    height: int,
    own: int,
    zoom: wp.float64,
    bend: wp.float64,
    flat: wp.float64,
    floor: wp.float64,
    robust: wp.float64,
    values: wp.array(dtype=wp.vec3),
    intrinsics: wp.array(dtype=wp.mat33d),
    poses: wp.array(dtype=wp.mat44d),
    sources: wp.array(dtype=int),
    shown: wp.array(dtype=wp.vec2d),
    local: wp.array(dtype=wp.vec3d),
    products: wp.array(dtype=mat99),
    slopes: wp.array(dtype=vec9),
    alike: wp.array(dtype=wp.float64),
):
    """Patch first + tid of view `own` in each of the `asked` sources, as `reference.compared` does it.

    shown [P 9], local [P 9], of `system.placed`; products, slopes, alike [P asked], written
    """
    patch = first + wp.tid()
    plane = width * height
    one = wp.float64(1.0)
    k = intrinsics[own]
    pose = poses[own]
    there = bool(True)  # noqa: UP018 - Warp: a variable that changes in a loop
    mine = vec9()
    for n in range(9):
        q = shown[patch * 9 + n]
        at = wp.vec2d(k[0, 0] * q[0] + k[0, 2], k[1, 1] * q[1] + k[1, 2])
        there = there and _inside(at, width, height)
        mine[n] = _sampled(values, own * plane, width, height, at)[0]
    centre = _mean(mine)
    spread = wp.float64(0.0)
    for n in range(9):
        mine[n] = mine[n] - centre
        spread += mine[n] * mine[n]
    spread = wp.sqrt(spread / wp.float64(9.0))
    mine = mine / (spread + floor)
    there = there and spread > flat
    for s in range(asked):
        item = patch * asked + s
        alike[item] = wp.float64(-2.0)
        if there:
            source = sources[s]
            ks = intrinsics[source]
            to = poses[source]
            seen = bool(True)  # noqa: UP018
            other = vec9()
            gradients = mat93()
            places = mat93()
            rays = mat93()
            for n in range(9):
                off = local[patch * 9 + n]
                place = wp.vec3d(
                    pose[0, 0] * off[0] + pose[0, 1] * off[1] + pose[0, 2] * off[2] + pose[0, 3],
                    pose[1, 0] * off[0] + pose[1, 1] * off[1] + pose[1, 2] * off[2] + pose[1, 3],
                    pose[2, 0] * off[0] + pose[2, 1] * off[1] + pose[2, 2] * off[2] + pose[2, 3],
                )
                away = place - wp.vec3d(to[0, 3], to[1, 3], to[2, 3])
                depth = to[0, 2] * away[0] + to[1, 2] * away[1] + to[2, 2] * away[2]
                seen = seen and depth > wp.float64(1e-3)
                depth = wp.max(depth, wp.float64(1e-3))
                u = (to[0, 0] * away[0] + to[1, 0] * away[1] + to[2, 0] * away[2]) / depth
                v = (to[0, 1] * away[0] + to[1, 1] * away[1] + to[2, 1] * away[2]) / depth
                out = zoom * (one + bend * (u * u + v * v))
                at = wp.vec2d(ks[0, 0] * out * u + ks[0, 2], ks[1, 1] * out * v + ks[1, 2])
                seen = seen and _inside(at, width, height)
                found = _sampled(values, source * plane, width, height, at)
                other[n] = found[0]
                gradients[n] = wp.vec3d(zoom * found[1] * ks[0, 0], zoom * found[2] * ks[1, 1], depth)
                rays[n] = wp.vec3d(u, v, u * u + v * v)
                places[n] = place
            centre = _mean(other)
            spread = wp.float64(0.0)
            for n in range(9):
                other[n] = other[n] - centre
                spread += other[n] * other[n]
            spread = wp.sqrt(spread / wp.float64(9.0))
            over = spread + floor
            other = other / over
            if seen and spread > flat:
                correlation = wp.dot(other, mine) / wp.float64(9.0)
                alike[item] = correlation
                rows = mat99()
                middle = vec9()
                for n in range(9):
                    g = gradients[n]
                    r = rays[n]
                    off = local[patch * 9 + n]
                    radial = g[0] * r[0] + g[1] * r[1]
                    out = one + bend * r[2]
                    gx = (g[0] * out + wp.float64(2.0) * bend * radial * r[0]) / g[2]
                    gy = (g[1] * out + wp.float64(2.0) * bend * radial * r[1]) / g[2]
                    gz = -(gx * r[0] + gy * r[1])
                    w = wp.vec3d(
                        to[0, 0] * gx + to[0, 1] * gy + to[0, 2] * gz,
                        to[1, 0] * gx + to[1, 1] * gy + to[1, 2] * gz,
                        to[2, 0] * gx + to[2, 1] * gy + to[2, 2] * gz,
                    )
                    turned = wp.cross(places[n], w)
                    # back in the axes of the patch's own camera
                    wx = pose[0, 0] * w[0] + pose[1, 0] * w[1] + pose[2, 0] * w[2]
                    wy = pose[0, 1] * w[0] + pose[1, 1] * w[1] + pose[2, 1] * w[2]
                    wz = pose[0, 2] * w[0] + pose[1, 2] * w[1] + pose[2, 2] * w[2]
                    square = (off[0] * off[0] + off[1] * off[1]) / (off[2] * off[2])
                    inward = -(wx * off[0] + wy * off[1]) / (one + wp.float64(3.0) * bend * square)
                    row = vec9(
                        turned[0], turned[1], turned[2], w[0], w[1], w[2],
                        wx * off[0] + wy * off[1] + wz * off[2],
                        inward * (one + bend * square) + radial * out,
                        inward * square + radial * r[2],
                    )  # fmt: skip
                    rows[n] = row
                    middle += row
                middle = middle / wp.float64(9.0)
                spreading = vec9()
                for n in range(9):
                    rows[n] = rows[n] - middle
                    spreading += other[n] * rows[n]
                spreading = spreading * (over / (wp.float64(9.0) * wp.max(over - floor, wp.float64(1e-9))))
                weight = one + wp.float64(2.0) * (one - correlation) / robust
                weight = one / (weight * weight)
                slope = vec9()
                for n in range(9):
                    rows[n] = (rows[n] - other[n] * spreading) / over
                    slope += (other[n] - mine[n]) * rows[n]
                slopes[item] = weight * slope
                products[item] = weight * (wp.transpose(rows) * rows)
