"""A slow, sequential definition of a round of edge flips, on Python lists and dictionaries."""

from __future__ import annotations

import math

import numpy as np
from topology_reference import area_vector, degeneracy, incidence


def flip_round(vertices, faces, uvs, uv_faces, settings):
    """Returns (faces, uv_faces) as lists: every edge is judged on the mesh of the moment, by gain at the start."""
    p = [np.asarray(x, np.float64) for x in vertices]
    uv = [np.asarray(x, np.float64) for x in uvs]
    faces = [list(map(int, f)) for f in faces]
    corners = [list(map(int, f)) for f in uv_faces]
    edges, near = incidence(faces)
    rim = {v for edge, sides in edges.items() if len(sides) != 2 for v in edge}
    order = []
    for sides in edges.values():
        if len(sides) == 2:
            quad = find_quad(faces, corners, *sides)
            gain = None if quad is None else find_gain(p, quad[0], near, rim, settings.method)
            if gain is not None and gain > 0:
                order.append((-gain, 3 * sides[0][0] + sides[0][1], sides, quad))
    order.sort(key=lambda x: x[:2])
    touched = set()
    for _, _, (here, there), quad in order:
        (a, b, c, d), (ua, ub, uc, ud) = quad
        if touched & {a, b, c, d}:
            continue
        now, around = incidence(faces)
        if c == d or (min(c, d), max(c, d)) in now:
            continue
        if any(len(around[v]) <= (2 if v in rim else 3) for v in (a, b)):
            continue
        if not surface_is_kept(p, a, b, c, d, settings) or not texture_is_kept(p, uv, quad, settings):
            continue
        faces[here[0]], corners[here[0]] = [a, d, c], [ua, ud, uc]
        faces[there[0]], corners[there[0]] = [d, b, c], [ud, ub, uc]
        touched |= {a, b, c, d}
    return faces, corners


def find_quad(faces, corners, here, there):
    """((a, b, c, d), their UVs) of the edge, or None on a seam or where the windings disagree."""
    (f, k), (g, m) = here, there
    a, b, c = (faces[f][(k + i) % 3] for i in range(3))
    ua, ub, uc = (corners[f][(k + i) % 3] for i in range(3))
    other, uother = ([table[g][(m + i) % 3] for i in range(3)] for table in (faces, corners))
    if other[:2] != [b, a] or uother[:2] != [ub, ua]:
        return None
    return (a, b, c, other[2]), (ua, ub, uc, uother[2])


def find_gain(p, quad, near, rim, criterion):
    a, b, c, d = quad
    if criterion == "valence":
        off = {v: len(near[v]) - (4 if v in rim else 6) for v in quad}
        before = sum(off[v] ** 2 for v in quad)
        after = sum((off[v] - 1) ** 2 for v in (a, b)) + sum((off[v] + 1) ** 2 for v in (c, d))
        return (before - after) / 2
    angle = angle_at(p, c, a, b) + angle_at(p, d, a, b)
    return round(min(angle - math.pi, angle - angle_at(p, a, c, d) - angle_at(p, b, c, d)), 6)


def angle_at(p, at, one, two):
    u, v = p[one] - p[at], p[two] - p[at]
    return math.atan2(float(np.linalg.norm(np.cross(u, v))), float(np.dot(u, v)))


def surface_is_kept(p, a, b, c, d, settings):
    old, new = ([a, b, c], [b, a, d]), ([a, d, c], [d, b, c])
    for first, second in (old, new):
        n, m = area_vector(p, first), area_vector(p, second)
        size = float(np.linalg.norm(n) * np.linalg.norm(m))
        if size == 0 or float(np.dot(n, m)) < math.cos(settings.max_bend) * size:
            return False
    course = area_vector(p, old[0]) + area_vector(p, old[1])
    worst = min(degeneracy(p, face) for face in old)
    return all(
        float(np.dot(area_vector(p, face), course)) > 0
        and degeneracy(p, face) >= min(worst, settings.min_shape) * (1 - 1e-5)
        for face in new
    )


def texture_is_kept(p, uv, quad, settings):
    (a, b, c, d), (ua, ub, uc, ud) = quad

    def area(i, j, k):
        x, y = uv[j] - uv[i], uv[k] - uv[i]
        return 0.5 * float(x[0] * y[1] - x[1] * y[0])

    old = area(ua, ub, uc), area(ub, ua, ud)
    if min(old) <= 0 or min(area(ua, ud, uc), area(ud, ub, uc)) <= 0.02 * sum(old):
        return False
    # the points of both diagonals that are nearest to each other
    system = np.stack([p[b] - p[a], p[c] - p[d]], axis=1)
    s, t = np.linalg.lstsq(system, p[c] - p[a], rcond=None)[0]
    shift = (1 - s) * uv[ua] + s * uv[ub] - (1 - t) * uv[uc] - t * uv[ud]
    shorter = min(np.linalg.norm(uv[ub] - uv[ua]), np.linalg.norm(uv[ud] - uv[uc]))
    return float(np.linalg.norm(shift)) <= settings.max_shift * shorter
