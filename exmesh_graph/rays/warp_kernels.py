"""Warp kernels of the ray queries: one source for CPU and CUDA. Import through `warp_bvh`.

The hierarchy comes from Warp, the triangle test is our own (Woop, Benthin and Wald 2013), because Warp's mesh queries
(1.19) test boxes without a margin: rays from inside an axis-aligned box towards its edges left it, 1 in 200.

    along the ray's largest axis k:  A = a - o,  a' = (A_x - A_k d_x / d_k, A_y - A_k d_y / d_k)
    u_0 = b' x c', u_1 = c' x a', u_2 = a' x b';  a hit where no two of them differ in sign
"""

# mypy: ignore-errors
# ruff: noqa: UP018, RUF046
# Kernels are written in Warp's own language, which only looks like Python: int(0) is a variable that changes in a loop.

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def _across(a: wp.vec2, b: wp.vec2) -> float:
    value = a[0] * b[1] - a[1] * b[0]
    if value == 0.0:  # float32 cannot tell the side: decide in float64
        value = float(wp.float64(a[0]) * wp.float64(b[1]) - wp.float64(a[1]) * wp.float64(b[0]))
    return value


@wp.func
def _shared_edge(a: wp.vec2, b: wp.vec2, ia: int, ib: int) -> float:
    # both faces of an edge evaluate it in the same order, so that rounding (fused multiply-add) cannot open a gap
    if ia < ib:
        return _across(a, b)
    return -_across(b, a)


@wp.func
def _sheared(point: wp.vec3, origin: wp.vec3, d: wp.vec3, k: int) -> wp.vec3:
    p = point - origin
    z = p[k]
    x = (k + 1) % 3
    y = (k + 2) % 3
    return wp.vec3(p[x] - d[x] / d[k] * z, p[y] - d[y] / d[k] * z, z / d[k])


@wp.func
def _meet(points: wp.array(dtype=wp.vec3), f: wp.vec3i, origin: wp.vec3, d: wp.vec3, k: int) -> wp.vec4:
    """Weights of the corners and t, which is negative where the ray misses."""
    a = _sheared(points[f[0]], origin, d, k)
    b = _sheared(points[f[1]], origin, d, k)
    c = _sheared(points[f[2]], origin, d, k)
    u = _shared_edge(wp.vec2(b[0], b[1]), wp.vec2(c[0], c[1]), f[1], f[2])
    v = _shared_edge(wp.vec2(c[0], c[1]), wp.vec2(a[0], a[1]), f[2], f[0])
    w = _shared_edge(wp.vec2(a[0], a[1]), wp.vec2(b[0], b[1]), f[0], f[1])
    if wp.min(u, wp.min(v, w)) < 0.0 and wp.max(u, wp.max(v, w)) > 0.0:
        return wp.vec4(0.0, 0.0, 0.0, -1.0)
    total = u + v + w
    if total == 0.0:
        return wp.vec4(0.0, 0.0, 0.0, -1.0)
    u, v, w = u / total, v / total, w / total
    return wp.vec4(u, v, w, u * a[2] + v * b[2] + w * c[2])


@wp.func
def _largest(d: wp.vec3) -> int:
    x = wp.abs(d[0])
    y = wp.abs(d[1])
    z = wp.abs(d[2])
    if x > y and x > z:
        return 0
    if y > z:
        return 1
    return 2


@wp.kernel
def boxes(
    points: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    margin: float,
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    f = faces[i]
    pad = wp.vec3(margin, margin, margin)
    low[i] = wp.min(points[f[0]], wp.min(points[f[1]], points[f[2]])) - pad
    high[i] = wp.max(points[f[0]], wp.max(points[f[1]], points[f[2]])) + pad


@wp.kernel
def closest(
    tree: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    origin: wp.array(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    t_max: wp.array(dtype=float),
    face: wp.array(dtype=int),
    t: wp.array(dtype=float),
    bary: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    o = origin[i]
    d = direction[i]
    k = _largest(d)
    nearest = float(t_max[i])
    winner = int(-1)
    weights = wp.vec3(0.0, 0.0, 0.0)
    query = wp.bvh_query_ray(tree, o, d)
    candidate = int(0)
    while wp.bvh_query_next(query, candidate, nearest):
        hit = _meet(points, faces[candidate], o, d, k)
        if hit[3] > 0.0 and hit[3] < nearest:
            nearest = hit[3]
            winner = candidate
            weights = wp.vec3(hit[0], hit[1], hit[2])
    face[i] = winner
    t[i] = wp.where(winner < 0, wp.inf, nearest)
    bary[i] = weights


@wp.kernel
def occluded(
    tree: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    origin: wp.array(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    t_max: wp.array(dtype=float),
    blocked: wp.array(dtype=wp.uint8),
):
    i = wp.tid()
    o = origin[i]
    d = direction[i]
    k = _largest(d)
    limit = t_max[i]
    blocked[i] = wp.uint8(0)
    query = wp.bvh_query_ray(tree, o, d)
    candidate = int(0)
    while wp.bvh_query_next(query, candidate, limit):
        hit = _meet(points, faces[candidate], o, d, k)
        if hit[3] > 0.0 and hit[3] < limit:
            blocked[i] = wp.uint8(1)
            return
