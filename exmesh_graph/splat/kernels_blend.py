"""Warp kernels per tile: which splats it touches, their front-to-back blending by depth, and its adjoint.

Import via `runtime.kernels`.

    C = sum_i w_i f_i,   w_i = T_i a_i,   T_i = prod_{j<i} (1 - a_j),   a_i = min(0.99, o_i exp(-q_i / 2))

over splats with a_i >= 1/255, as long as T_i >= 1e-4. f is (rgb, normal, distance, 1): the last sums up to coverage.

One thread a tile; inside it splats are the outer loop and the pixels a splat reaches the inner one, so that a splat of
a few pixels costs a few pixels, however large the tile. A thread writes only to pixels of its tile and to slots of
(splat, tile) pairs of its own: no atomics, hence the same bytes on every run. Tiles are large on a CPU, where they keep
a picture's part in the cache, and small on CUDA, where they are the parallelism.
"""

# mypy: ignore-errors
# ruff: noqa: F821
# See kernels_camera.py.

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

MOST = wp.constant(REAL(0.99))
OPAQUE = wp.constant(REAL(1e-4))


@wp.kernel
def list_tiles(
    order: wp.array(dtype=wp.int64),
    box: wp.array(dtype=wp.vec4i),
    first: wp.array(dtype=wp.int64),
    tile: int,
    across: int,
    tile_of: wp.array(dtype=wp.int32),
    gaussian_of: wp.array(dtype=wp.int32),
):
    """Per drawn Gaussian, nearest first: the tiles it touches, from slot `first[rank]` on."""
    rank = wp.tid()
    g = wp.int32(order[rank])
    b = box[g]
    slot = int(first[rank])
    for ty in range(b[1] / tile, b[3] / tile + 1):
        for tx in range(b[0] / tile, b[2] / tile + 1):
            tile_of[slot] = ty * across + tx
            gaussian_of[slot] = g
            slot += 1


@wp.kernel
def sum_slots(
    order: wp.array(dtype=wp.int64),
    first: wp.array(dtype=wp.int64),
    weights: wp.array(dtype=REAL),
    total: wp.array(dtype=REAL),
):
    """Per drawn Gaussian: the sum of its slots' weights."""
    rank = wp.tid()
    weight = REAL(0.0)
    for slot in range(int(first[rank]), int(first[rank + 1])):
        weight += weights[slot]
    total[int(order[rank])] = weight


@wp.func
def span(shape: Vec4, reach: REAL, dy: REAL, x: REAL, low: int, high: int) -> wp.vec2i:
    """Columns low..high whose centres the ellipse a dx^2 + 2 b dx dy + c dy^2 <= reach may hold in a row."""
    middle = x - HALF - shape[1] * dy / shape[0]
    inside = shape[1] * shape[1] * dy * dy - shape[0] * (shape[2] * dy * dy - reach)
    if inside < ZERO:
        return wp.vec2i(1, 0)
    half = wp.sqrt(inside) / shape[0] + REAL(1.0e-3)
    left = wp.max(middle - half, REAL(low))
    right = wp.min(middle + half, REAL(high))
    return wp.vec2i(int(wp.ceil(left)), int(wp.floor(right)))


@wp.kernel
def blend(
    start: wp.array(dtype=wp.int64),
    slot_of: wp.array(dtype=wp.int64),
    gaussian_of: wp.array(dtype=wp.int32),
    screen: wp.array(dtype=Vec2),
    shape: wp.array(dtype=Vec4),
    feature: wp.array(dtype=Vec8),
    box: wp.array(dtype=wp.vec4i),
    tile: int,
    across: int,
    height: int,
    width: int,
    out: wp.array(dtype=Vec8),
    left: wp.array(dtype=REAL),
    last: wp.array(dtype=wp.int32),
    middle: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=REAL),
):
    """`out` [P] sums of w f; `left` [P] transmittance (1 before); `last` [P] one past the last entry that was blended;
    `middle` [P] the Gaussian at which transmittance falls below 1/2 (-1 before).

    `weights` [slots] receives each slot's sum of w: what the splat contributes to the picture.
    """
    n = wp.tid()
    x_low = (n % across) * tile
    y_low = (n / across) * tile
    x_high = wp.min(x_low + tile, width) - 1
    y_high = wp.min(y_low + tile, height) - 1
    live = (x_high - x_low + 1) * (y_high - y_low + 1)
    for e in range(int(start[n]), int(start[n + 1])):
        if live == 0:
            break
        slot = int(slot_of[e])
        g = gaussian_of[slot]
        centre = screen[g]
        s = shape[g]
        f = feature[g]
        b = box[g]
        reach = TWO * wp.log(s[3] / LEAST)
        total = ZERO
        for row in range(wp.max(b[1], y_low), wp.min(b[3], y_high) + 1):
            dy = REAL(row) + HALF - centre[1]
            columns = span(s, reach, dy, centre[0], wp.max(b[0], x_low), wp.min(b[2], x_high))
            for column in range(columns[0], columns[1] + 1):
                pixel = row * width + column
                t = left[pixel]
                if t < OPAQUE:
                    continue
                dx = REAL(column) + HALF - centre[0]
                alpha = wp.min(MOST, s[3] * wp.exp(-HALF * (dx * (s[0] * dx + TWO * s[1] * dy) + s[2] * dy * dy)))
                if alpha < LEAST:
                    continue
                w = t * alpha
                out[pixel] = out[pixel] + w * f
                total += w
                if t >= HALF and t * (ONE - alpha) < HALF:
                    middle[pixel] = g
                t = t * (ONE - alpha)
                left[pixel] = t
                last[pixel] = e + 1
                if t < OPAQUE:
                    live -= 1
        weights[slot] = total


@wp.kernel
def blend_adjoint(
    start: wp.array(dtype=wp.int64),
    slot_of: wp.array(dtype=wp.int64),
    gaussian_of: wp.array(dtype=wp.int32),
    screen: wp.array(dtype=Vec2),
    shape: wp.array(dtype=Vec4),
    feature: wp.array(dtype=Vec8),
    box: wp.array(dtype=wp.vec4i),
    tile: int,
    across: int,
    height: int,
    width: int,
    last: wp.array(dtype=wp.int32),
    grad: wp.array(dtype=Vec8),
    left: wp.array(dtype=REAL),
    behind: wp.array(dtype=REAL),
    slots: wp.array(dtype=Vec16),
):
    """Back to front: with u = dL/dC . f and B the sum of w u over what lies behind,  dL/da = T u - B / (1 - a).

    `left` holds the forward pass's transmittance and is consumed; `behind` is B, 0 before. Each slot receives
    dL/d(feature 8; screen x, y; conic a, b, c; opacity), then sums over pixels of |dL/dscreen x| and |... y|.
    """
    n = wp.tid()
    x_low = (n % across) * tile
    y_low = (n / across) * tile
    x_high = wp.min(x_low + tile, width) - 1
    y_high = wp.min(y_low + tile, height) - 1
    begin = int(start[n])
    end = int(start[n + 1])
    for k in range(end - begin):
        e = end - 1 - k
        slot = int(slot_of[e])
        g = gaussian_of[slot]
        centre = screen[g]
        s = shape[g]
        f = feature[g]
        b = box[g]
        reach = TWO * wp.log(s[3] / LEAST)
        gf = Vec8()
        gx = ZERO
        gy = ZERO
        ga = ZERO
        gb = ZERO
        gc = ZERO
        go = ZERO
        ax = ZERO
        ay = ZERO
        for row in range(wp.max(b[1], y_low), wp.min(b[3], y_high) + 1):
            dy = REAL(row) + HALF - centre[1]
            columns = span(s, reach, dy, centre[0], wp.max(b[0], x_low), wp.min(b[2], x_high))
            for column in range(columns[0], columns[1] + 1):
                pixel = row * width + column
                if e >= last[pixel]:
                    continue
                dx = REAL(column) + HALF - centre[0]
                falloff = wp.exp(-HALF * (dx * (s[0] * dx + TWO * s[1] * dy) + s[2] * dy * dy))
                raw = s[3] * falloff
                alpha = wp.min(MOST, raw)
                if alpha < LEAST:
                    continue
                t = left[pixel] / (ONE - alpha)
                left[pixel] = t
                w = t * alpha
                gp = grad[pixel]
                u = wp.dot(gp, f)
                gf += w * gp
                back = behind[pixel]
                behind[pixel] = back + w * u
                if raw <= MOST:
                    by_alpha = t * u - back / (ONE - alpha)
                    go += falloff * by_alpha
                    by_q = -HALF * raw * by_alpha
                    ga += by_q * dx * dx
                    gb += by_q * TWO * dx * dy
                    gc += by_q * dy * dy
                    px = -TWO * by_q * (s[0] * dx + s[1] * dy)
                    py = -TWO * by_q * (s[1] * dx + s[2] * dy)
                    gx += px
                    gy += py
                    ax += wp.abs(px)
                    ay += wp.abs(py)
        slots[slot] = Vec16(
            gf[0], gf[1], gf[2], gf[3], gf[4], gf[5], gf[6], gf[7], gx, gy, ga, gb, gc, go, ax, ay
        )  # fmt: skip
