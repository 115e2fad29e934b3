"""Distance from points to a mesh: a Warp kernel. The plain form is `distance.distance_to_mesh_plain`.

Warp finds the nearest face in float32, which errs with needles. So needles near enough to matter are asked again, and
every distance that counts is taken in float64.
"""

# mypy: ignore-errors
# ruff: noqa: UP018, RUF046
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def _to_segment(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d) -> wp.float64:
    """Squared."""
    along = b - a
    length = wp.dot(along, along)
    t = wp.float64(0.0)
    if length > wp.float64(0.0):
        t = wp.clamp(wp.dot(p - a, along) / length, wp.float64(0.0), wp.float64(1.0))
    rest = p - a - t * along
    return wp.dot(rest, rest)


@wp.func
def _squared(p: wp.vec3d, corners: wp.array(dtype=wp.vec3d), f: wp.vec3i) -> wp.float64:
    """As `distance.squared_distance`."""
    a, b, c = corners[f[0]], corners[f[1]], corners[f[2]]
    normal = wp.cross(b - a, c - a)
    area = wp.dot(normal, normal)
    v = wp.dot(wp.cross(p - a, c - a), normal)
    w = wp.dot(wp.cross(b - a, p - a), normal)
    least = wp.min(_to_segment(p, a, b), wp.min(_to_segment(p, b, c), _to_segment(p, c, a)))
    if area > wp.float64(0.0) and v >= wp.float64(0.0) and w >= wp.float64(0.0) and v + w <= area:
        height = wp.dot(p - a, normal)
        least = wp.min(least, height * height / area)
    return least


@wp.kernel
def distance(
    first: int, mesh: wp.uint64, needles: wp.uint64, count: int, corners: wp.array(dtype=wp.vec3d),
    faces: wp.array(dtype=wp.vec3i), thin: wp.array(dtype=wp.vec3i), points: wp.array(dtype=wp.vec3d),
    found: wp.array(dtype=wp.float64),
):  # fmt: skip
    """found[p]: from points[p] to the mesh of `faces`, of which `count` are needles, those of `thin`."""
    p = first + wp.tid()
    place = wp.vec3(points[p])
    best = wp.float64(1.0e60)
    query = wp.mesh_query_point_no_sign(mesh, place, 1.0e30)
    if query.result:
        best = _squared(points[p], corners, faces[query.face])
    if count > 0:
        reach = float(wp.sqrt(best)) * 1.000001 + 1.0e-6
        around = wp.vec3(reach, reach, reach)
        near = wp.mesh_query_aabb(needles, place - around, place + around)
        needle = int(0)
        while wp.mesh_query_aabb_next(near, needle):
            best = wp.min(best, _squared(points[p], corners, thin[needle]))
    found[p] = wp.sqrt(best)
