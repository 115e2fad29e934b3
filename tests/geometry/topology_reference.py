"""Slow, sequential definitions of a split round and a merge round, on Python lists and dictionaries."""

from __future__ import annotations

import math

import numpy as np

from exmesh_graph.geometry.split import MU_MAX, MU_MIN


def incidence(faces):
    """({undirected edge: [(face, corner k of the half-edge)]}, {vertex: neighbours}); dead faces are None."""
    edges, near = {}, {}
    for f, face in enumerate(faces):
        if face is None:
            continue
        for k in range(3):
            a, b = face[k], face[(k + 1) % 3]
            edges.setdefault((min(a, b), max(a, b)), []).append((f, k))
            near.setdefault(a, set()).add(b)
            near.setdefault(b, set()).add(a)
    return edges, near


def area_vector(p, face):
    return np.cross(p[face[1]] - p[face[0]], p[face[2]] - p[face[0]])


def degeneracy(p, face):
    longest = max(float(np.linalg.norm(p[face[k]] - p[face[k - 1]])) for k in range(3))
    return 0.5 * float(np.linalg.norm(area_vector(p, face))) / longest**2 if longest > 0 else 0.0


def quantised(values):
    largest = max((abs(x) for x in values), default=0.0)
    return [float(np.round(x / largest, 6)) if largest > 0 else 0.0 for x in values]


def ranks(values):
    """Mean rank of equal values, scaled to [0, 1]."""
    values = quantised(values)
    below = [sum(x < value for x in values) for value in values]
    equal = [sum(x == value for x in values) for value in values]
    return [(b + 0.5 * (e - 1)) / max(len(values) - 1, 1) for b, e in zip(below, equal, strict=True)]


def curvature(p, faces):
    edges, _ = incidence(faces)
    angles = [[] for _ in faces]
    for sides in edges.values():
        if len(sides) != 2:
            continue
        n, m = (area_vector(p, faces[f]) for f, _ in sides)
        if np.any(n) and np.any(m):
            angle = math.atan2(float(np.linalg.norm(np.cross(n, m))), float(np.dot(n, m)))
            for f, _ in sides:
                angles[f].append(angle)
    return [sum(a) / len(a) if a else 0.0 for a in angles]


def split_round(vertices, faces, uvs, uv_faces, gradient, budget, settings):
    """The paper's pass, face by face. Returns (vertices, faces, uvs, uv_faces) as lists."""
    p = [np.asarray(x, np.float64) for x in vertices]
    uv = [np.asarray(x, np.float64) for x in uvs]
    faces = [list(map(int, f)) for f in faces]
    corners = [list(map(int, f)) for f in uv_faces]
    edges, near = incidence(faces)  # of the start of the round: degrees are taken once
    start = [list(f) for f in faces]
    areas = quantised([0.5 * float(np.linalg.norm(area_vector(p, f))) for f in faces])
    limit = np.quantile(areas, settings.area_quantile)
    g = [float(np.mean([float(gradient[v]) for v in f])) for f in faces]
    k = curvature(p, faces)
    w_g, w_k = settings.gradient_weight, settings.curvature_weight
    if settings.score == "ranks":
        score = [round(w_g * a + w_k * b, 9) for a, b in zip(ranks(g), ranks(k), strict=True)]
    else:
        score = quantised([w_g * a + w_k * b for a, b in zip(g, k, strict=True)])
    order = [f for f in range(len(faces)) if areas[f] >= limit and areas[f] > 0]
    order.sort(key=lambda f: (-score[f], f))

    def far_side(f, c):
        """(neighbour face, its corner opposite to half-edge c of f) or None."""
        i, j = faces[f][c], faces[f][(c + 1) % 3]
        sides = edges[min(i, j), max(i, j)]
        if len(sides) != 2:
            return None
        other, k = next(side for side in sides if side != (f, c))
        return other, k

    touched, added = set(), 0
    for f in order:
        if f in touched:
            continue
        i_, scores = faces[f], []
        for c in range(3):
            i, j, o = i_[c], i_[(c + 1) % 3], i_[(c + 2) % 3]
            beyond = far_side(f, c)
            if settings.edge_degrees == "endpoints":
                mean = 0.5 * (len(near[i]) + len(near[j]))
            elif beyond is None:
                mean = len(near[o])
            else:
                mean = 0.5 * (len(near[o]) + len(near[start[beyond[0]][(beyond[1] + 2) % 3]]))
            scores.append(float(np.linalg.norm(p[j] - p[i])) / mean)
        c = next(c for c in range(3) if scores[c] >= max(scores) * (1 - 1e-5))
        i, j, o = i_[c], i_[(c + 1) % 3], i_[(c + 2) % 3]
        beyond = far_side(f, c)
        if len(edges[min(i, j), max(i, j)]) > 2 or (beyond and beyond[0] in touched):
            continue
        along = p[j] - p[i]
        mu, opposites = 0.5, [o]
        if beyond:
            d = faces[beyond[0]][(beyond[1] + 2) % 3]
            opposites.append(d)
            mu = 0.5 * sum(float(np.dot(p[x] - p[i], along) / np.dot(along, along)) for x in (o, d))
        if not MU_MIN - 1e-6 <= mu <= MU_MAX + 1e-6:
            continue
        if any(len(near[x]) >= settings.max_degree for x in opposites):
            continue
        if added + 1 + bool(beyond) > budget:
            break
        s = len(p)
        p.append((1 - mu) * p[i] + mu * p[j])
        pair = (corners[f][c], corners[f][(c + 1) % 3])
        new_uv = len(uv)
        uv.append((1 - mu) * uv[pair[0]] + mu * uv[pair[1]])
        halves = [(f, c, new_uv)]
        if beyond:
            g_, k_ = beyond
            at = {faces[g_][k_]: corners[g_][k_], faces[g_][(k_ + 1) % 3]: corners[g_][(k_ + 1) % 3]}
            if (at[i], at[j]) != pair:  # a seam: its own coordinate in its own island
                new_uv = len(uv)
                uv.append((1 - mu) * uv[at[i]] + mu * uv[at[j]])
            halves.append((g_, k_, new_uv))
        for face, k, new in halves:
            first, second = list(faces[face]), list(faces[face])
            uv_first, uv_second = list(corners[face]), list(corners[face])
            first[(k + 1) % 3], uv_first[(k + 1) % 3] = s, new
            second[k], uv_second[k] = s, new
            faces[face], corners[face] = first, uv_first
            faces.append(second)
            corners.append(uv_second)
            touched |= {face, len(faces) - 1}
        added += len(halves)
    return p, faces, uv, corners


def merge_round(vertices, faces, uvs, uv_faces, seen, settings):
    """One pass of collapses. Each face picks its edge on the mesh as it was at the start of the round; a collapse is
    skipped when a face around either vertex has been changed, else it must still be legal on the mesh of the moment.

    Returns ({removed: survivor}, live faces, their UV indices).
    """
    p = [np.asarray(x, np.float64) for x in vertices]
    uv = [np.asarray(x, np.float64) for x in uvs]
    faces = [list(map(int, f)) for f in faces]
    corners = [list(map(int, f)) for f in uv_faces]
    start = [list(f) for f in faces], [list(c) for c in corners]
    areas = quantised([0.5 * float(np.linalg.norm(area_vector(p, f))) for f in faces])
    limit = np.quantile(areas, settings.area_quantile)
    shape = [round(degeneracy(p, f), 6) for f in faces]
    order = [f for f in range(len(faces)) if areas[f] <= limit and (not seen[f] or shape[f] < settings.degenerate)]
    order.sort(key=lambda f: (shape[f], f))
    at_start = Situation(p, uv, *start)
    touched, gone = set(), {}
    for f in order:
        pick = next(
            (
                at_start.collapse(f, c, settings)
                for c in at_start.preference(f)[: settings.tries]
                if at_start.collapse(f, c, settings)
            ),
            None,
        )
        if pick is None:
            continue
        r, s = pick
        ring = {g for g, q in enumerate(start[0]) if r in q or s in q}
        if touched & ring:
            continue
        now = Situation(p, uv, faces, corners)
        c = next(c for c in range(3) if {faces[f][c], faces[f][(c + 1) % 3]} == {r, s})
        assert now.collapse(f, c, settings) == (r, s), "disjoint rings were not enough"
        target = uv_targets(faces, corners, r, s)
        for g in ring:
            if r not in faces[g]:
                continue
            if s in faces[g]:
                faces[g] = None
                continue
            k = faces[g].index(r)
            faces[g][k] = s
            if settings.uv == "survivor":
                corners[g][k] = next(iter(target[corners[g][k]]))
        touched |= ring
        gone[r] = s
    live = [g for g, q in enumerate(faces) if q]
    return gone, [faces[g] for g in live], [corners[g] for g in live]


class Situation:
    """A mesh at one moment, and the question whether an edge of it may collapse."""

    def __init__(self, p, uv, faces, corners):
        self.p, self.uv, self.faces, self.corners = p, uv, faces, corners
        self.edges, self.near = incidence(faces)
        alive = [c if f else None for f, c in zip(faces, corners, strict=True)]
        self.rim = {v for edge, s in self.edges.items() if len(s) == 1 for v in edge}
        self.turn, self.uv_turn = turns(p, faces), turns(uv, alive)
        self.marks = {}
        for g, q in zip(faces, corners, strict=True):
            for a, b in zip(g or (), q, strict=False):
                self.marks.setdefault(a, set()).add(b)

    def preference(self, f):
        face = self.faces[f]
        length = [float(np.linalg.norm(self.p[face[(c + 1) % 3]] - self.p[face[c]])) for c in range(3)]
        longest = max(length)
        relative = [round(x / longest, 5) if longest > 0 else 0.0 for x in length]
        return sorted(range(3), key=lambda c: (len(self.sides(f, c)) != 1, relative[c], c))

    def sides(self, f, c):
        a, b = self.faces[f][c], self.faces[f][(c + 1) % 3]
        return self.edges[min(a, b), max(a, b)]

    def collapse(self, f, c, settings):
        """(removed, survivor), or None when this edge may not collapse."""
        i, j = self.faces[f][c], self.faces[f][(c + 1) % 3]
        seams = settings.uv == "survivor"
        fixed = {v: 2 * (v in self.rim) + (seams and len(self.marks[v]) > 1) for v in (i, j)}
        if fixed[i] != fixed[j]:
            r = min(i, j, key=lambda v: fixed[v])
        elif len(self.near[i]) != len(self.near[j]):
            r = min(i, j, key=lambda v: len(self.near[v]))
        else:
            r = max(i, j)
        s = j if r == i else i
        sides = self.sides(f, c)
        if len(sides) > 2 or (len(sides) == 2 and i in self.rim and j in self.rim):
            return None
        bend = min([self.turn.get(r, 1.0)] + [self.uv_turn.get(a, 1.0) for a in self.marks[r]])
        if settings.checks == "shape" and round(bend, 6) < settings.outline_cosine:
            return None
        bad = collapse_is_bad(self.p, self.uv, self.faces, self.corners, self.near, self.rim, sides, r, s, settings)
        return None if bad else (r, s)


def turns(points, faces):
    """{border vertex: cosine of the turn of the border there}; -1 where several borders meet."""
    edges, _ = incidence(faces)
    border = [(faces[f][k], faces[f][(k + 1) % 3]) for s in edges.values() if len(s) == 1 for f, k in s]
    result = {}
    for v in {a for a, _ in border}:
        leaves, arrives = [b for a, b in border if a == v], [a for a, b in border if b == v]
        if len(leaves) != 1 or len(arrives) != 1:
            result[v] = -1.0
            continue
        d, e = points[v] - points[arrives[0]], points[leaves[0]] - points[v]
        size = float(np.linalg.norm(d) * np.linalg.norm(e))
        result[v] = float(np.dot(d, e)) / size if size > 0 else 0.0
    return result


def uv_targets(faces, corners, r, s):
    """{UV of r: UVs of s in the same chart}, from the faces that hold both."""
    target = {}
    for g, q in zip(faces, corners, strict=True):
        if g and r in g and s in g:
            target.setdefault(q[g.index(r)], set()).add(q[g.index(s)])
    return target


def collapse_is_bad(p, uv, faces, corners, near, rim, sides, r, s, settings):
    opposite = [next(v for v in faces[g] if v not in (r, s)) for g, _ in sides]
    if near[r] & near[s] != set(opposite):
        return True
    if any(len(near[v]) <= (2 if v in rim else 3) for v in opposite):
        return True
    target = uv_targets(faces, corners, r, s)
    for g, q in zip(faces, corners, strict=True):
        if not g or r not in g or s in g:
            continue
        after = [s if v == r else v for v in g]
        n, m = area_vector(p, g), area_vector(p, after)
        before, then = degeneracy(p, g), degeneracy(p, after)
        product = float(np.linalg.norm(n) * np.linalg.norm(m))
        shape = settings.checks == "shape"
        if shape and before > 1e-6 and float(np.dot(n, m)) <= settings.min_cosine * product:
            return True
        if (shape and then < min(before, settings.degenerate) * (1 - 1e-5)) or then < 1e-6:
            return True
        if settings.uv == "own":
            continue
        k = g.index(r)
        if len(target.get(q[k], ())) != 1:
            return True
        moved = list(q)
        moved[k] = next(iter(target[q[k]]))
        old, new = uv_area(uv, q), uv_area(uv, moved)
        if shape and old > 0 and new <= 1e-3 * old * min(1.0, settings.degenerate):
            return True
    return False


def uv_area(uv, corner):
    (ax, ay), (bx, by), (cx, cy) = (uv[k] for k in corner)
    return 0.5 * ((bx - ax) * (cy - ay) - (cx - ax) * (by - ay))
