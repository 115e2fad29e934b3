"""Warp kernel of the scan over silhouette edges. Import through `warp_runtime.kernels`."""

# mypy: ignore-errors
# Kernels are written in Warp's own language, which only looks like Python.

import warp as wp

from exmesh_graph.raster.kernels import EMPTY, edge_at, is_finite

wp.set_module_options({"enable_backward": False})


@wp.func
def _propose(
    near_pixel: int,
    far_pixel: int,
    z: float,
    code: int,
    face_id: wp.array(dtype=wp.int32),
    depth: wp.array(dtype=float),
    behind: float,
    in_front: float,
    reach: float,
    keys: wp.array(dtype=wp.int64),
    slot: int,
    found: wp.array(dtype=wp.int64),
    count: wp.array(dtype=wp.int32),
):
    # the pair is accepted if the near pixel shows a surface and the edge lies before the far pixel's surface
    if face_id[near_pixel] < 0:
        return
    z_near = depth[near_pixel]
    if face_id[far_pixel] >= 0:
        z_far = depth[far_pixel]
        if z_near >= z_far or z >= z_far - behind * wp.min(z, reach):
            return
    # at a grazing silhouette the near centre lies far before the edge, so only an edge well in FRONT is refused
    if z > z_near - in_front * wp.min(z, reach):
        key = (wp.int64(wp.cast(z, wp.int32)) << wp.int64(32)) | wp.int64(code)
        if wp.atomic_min(keys, slot, key) == EMPTY:
            place = wp.atomic_add(count, 0, 1)
            if place < found.shape[0]:
                found[place] = wp.int64(slot)


@wp.func
def _side(a: wp.vec3, b: wp.vec3, c: wp.vec3, near: float) -> bool:
    # on which side of the image line from a to b the third corner lies, seen from an end in front of the camera
    if a[2] > near:
        return edge_at(b, c, a[0] / a[2], a[1] / a[2]) > 0.0
    return edge_at(c, a, b[0] / b[2], b[1] / b[2]) > 0.0


@wp.func
def _crossing(ap: float, aq: float, az: float, bp: float, bq: float, bz: float, q: float) -> wp.vec2:
    # (p, depth) where the image segment from (ap, aq) to (bp, bq) has the second coordinate q
    s = (q - aq) / (bq - aq)
    return wp.vec2(ap + s * (bp - ap), 1.0 / ((1.0 - s) / az + s / bz))


@wp.func
def _crossing_of_ends(ap: float, aq: float, az: float, bp: float, bq: float, bz: float, q: float) -> wp.vec2:
    # the same from homogeneous ends, one of which may lie behind the camera: the cut at the near plane can be
    # millions of pixels away, where float32 has no fractions of a pixel left
    a = aq - q * az
    b = bq - q * bz
    z = az * b - bz * a
    return wp.vec2((ap * b - bp * a) / z, z / (b - a))


@wp.kernel
def mark_silhouette(
    first: int,
    vertices: wp.array(dtype=wp.vec3),
    edges: wp.array(dtype=wp.vec2i),
    opposite: wp.array(dtype=wp.vec2i),
    near: float,
    marks: wp.array(dtype=wp.bool),
):
    """Edge `first + tid`: whether it lies before the camera, and has one face or two on the same side in the image."""
    e = first + wp.tid()
    a = vertices[edges[e][0]]
    b = vertices[edges[e][1]]
    marks[e] = False
    if not (is_finite(a) and is_finite(b)) or wp.max(a[2], b[2]) <= near:
        return
    if opposite[e][1] >= 0:  # noqa: SIM102 - an index of -1 must not be read
        # two faces on the same side of their edge in the image: the surface turns away here
        if _side(a, b, vertices[opposite[e][0]], near) != _side(a, b, vertices[opposite[e][1]], near):
            return
    marks[e] = True


@wp.kernel
def find_silhouette(
    vertices: wp.array(dtype=wp.vec3),
    edges: wp.array(dtype=wp.vec2i),
    opposite: wp.array(dtype=wp.vec2i),
    listed: wp.array(dtype=wp.int64),
    face_id: wp.array(dtype=wp.int32),
    depth: wp.array(dtype=float),
    height: int,
    width: int,
    near: float,
    behind: float,
    in_front: float,
    reach: float,
    keys: wp.array(dtype=wp.int64),
    found: wp.array(dtype=wp.int64),
    count: wp.array(dtype=wp.int32),
):
    """Per silhouette edge of `listed`: the pairs of neighbouring centres it passes between, nearest edge per pair.

    An edge that crosses the near plane is cut there. Pairs are (p, p + 1) in slot p, and (p, p + width) in slot
    height * width + p. The low 32 bits of a key are 2 * edge + 1 if the pair's first pixel lies on the surface's side,
    2 * edge otherwise. Slots that were empty go on the list `found`, as far as it reaches; `count` is their number.
    """
    e = int(listed[wp.tid()])
    first_end = vertices[edges[e][0]]
    second_end = vertices[edges[e][1]]
    a = first_end
    b = second_end
    cut = first_end[2] <= near or second_end[2] <= near
    if cut:
        middle = first_end + (second_end - first_end) * ((near - first_end[2]) / (second_end[2] - first_end[2]))
        middle[2] = near
        if first_end[2] <= near:
            a = middle
        else:
            b = middle
    side = _side(first_end, second_end, vertices[opposite[e][0]], near)
    ax = a[0] / a[2]
    ay = a[1] / a[2]
    bx = b[0] / b[2]
    by = b[1] / b[2]

    # half-open ranges: an end point shared by two edges is counted once
    first = int(wp.ceil(wp.clamp(wp.min(ay, by) - 0.5, 0.0, float(height))))
    last = int(wp.ceil(wp.clamp(wp.max(ay, by) - 0.5, 0.0, float(height))))
    for row in range(first, last):
        y = float(row) + 0.5
        at = _crossing(ax, ay, a[2], bx, by, b[2], y)
        if cut:
            at = _crossing_of_ends(
                first_end[0], first_end[1], first_end[2], second_end[0], second_end[1], second_end[2], y
            )
        x = at[0] - 0.5
        z = at[1]
        if x >= 0.0 and x < float(width - 1):
            p = row * width + int(wp.floor(x))
            if (by > ay) == side:
                _propose(p, p + 1, z, 2 * e + 1, face_id, depth, behind, in_front, reach, keys, p, found, count)
            else:
                _propose(p + 1, p, z, 2 * e, face_id, depth, behind, in_front, reach, keys, p, found, count)

    first = int(wp.ceil(wp.clamp(wp.min(ax, bx) - 0.5, 0.0, float(width))))
    last = int(wp.ceil(wp.clamp(wp.max(ax, bx) - 0.5, 0.0, float(width))))
    for column in range(first, last):
        x = float(column) + 0.5
        at = _crossing(ay, ax, a[2], by, bx, b[2], x)
        if cut:
            at = _crossing_of_ends(
                first_end[1], first_end[0], first_end[2], second_end[1], second_end[0], second_end[2], x
            )
        y = at[0] - 0.5
        z = at[1]
        if y >= 0.0 and y < float(height - 1):
            p = int(wp.floor(y)) * width + column
            if (bx < ax) == side:
                _propose(
                    p,
                    p + width,
                    z,
                    2 * e + 1,
                    face_id,
                    depth,
                    behind,
                    in_front,
                    reach,
                    keys,
                    height * width + p,
                    found,
                    count,
                )
            else:
                _propose(
                    p + width,
                    p,
                    z,
                    2 * e,
                    face_id,
                    depth,
                    behind,
                    in_front,
                    reach,
                    keys,
                    height * width + p,
                    found,
                    count,
                )
