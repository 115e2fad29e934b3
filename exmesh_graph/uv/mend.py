"""What charting leaves over: mirrored charts, folded faces, faces without area."""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.adjacency import components, corner_fans, face_areas, signed_areas_2d
from exmesh_graph.types.edges import edges_of
from exmesh_graph.uv.flatten import flat_corners

_NO_AREA = 1e-7  # of a mean face


def mend(
    points: np.ndarray, faces: np.ndarray, flat: np.ndarray, corners: np.ndarray, uncharted: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turn mirrored charts over; give every face that is folded over inside its chart an island of its own.

    points float64 [V, 3] with a mean face area of 1; flat [T, 2], corners [F, 3]; uncharted bool [F]: in no chart.
    Returns (flat, corners, orphans): orphans bool [F] are the faces without area, which no chart can hold; their
    corners mean nothing.
    """
    chart = components(corners)
    size = signed_areas_2d(flat, corners)
    mirrored = np.bincount(chart, weights=np.where(uncharted, 0.0, size)) < 0
    sign = np.ones(len(flat))
    sign[corners[mirrored[chart]].reshape(-1)] = -1.0
    flat = np.stack([flat[:, 0] * sign, flat[:, 1]], axis=1)

    area = face_areas(points, faces)
    orphans = area <= _NO_AREA
    folded = np.flatnonzero(((signed_areas_2d(flat, corners) <= 1e-3 * area) | uncharted) & ~orphans)
    islands = flat_corners(points, faces[folded]).reshape(-1)
    corners = corners.copy()
    corners[folded] = len(flat) + np.arange(3 * len(folded)).reshape(-1, 3)
    flat = np.concatenate([flat, np.stack([islands.real, islands.imag], axis=1)])
    # what was left out may have held two charts together that now touch at a point only: they will move apart
    corners[~orphans], origin = corner_fans(corners[~orphans])
    return flat[origin], corners, orphans


def adopt(
    points: np.ndarray, faces: np.ndarray, uvs: np.ndarray, corners: np.ndarray, orphans: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Faces without area take the UVs of the face across their longest edge; their third corner falls on that edge.

    Those that touch no face with area lie on one point of the atlas: nothing of them is ever seen.
    """
    waiting = list(np.flatnonzero(orphans))
    if not waiting:
        return uvs, corners
    edges, corners = edges_of(faces), corners.copy()
    extra: list[np.ndarray] = []
    ready = ~orphans
    while waiting:
        left = []
        for f in waiting:
            p = points[faces[f]]
            length = np.linalg.norm(np.roll(p, -1, axis=0) - p, axis=1)
            for k in np.argsort(-length, kind="stable"):
                pair = edges.halfedges[edges.face_edges[f, k]]
                other = pair[0] + pair[1] - (3 * f + k)
                if pair[1] < 0 or (3 * f + k) not in pair or not ready[other // 3]:
                    continue
                neighbour = list(faces[other // 3])
                i, j, o = k, (k + 1) % 3, (k + 2) % 3
                ui, uj = (int(corners[other // 3][neighbour.index(faces[f, m])]) for m in (i, j))
                along = p[j] - p[i]
                t = np.clip(np.dot(p[o] - p[i], along) / max(float(np.dot(along, along)), 1e-300), 0.0, 1.0)
                corners[f, [i, j, o]] = ui, uj, len(uvs) + len(extra)
                extra.append((1.0 - t) * _at(uvs, extra, ui) + t * _at(uvs, extra, uj))
                ready[f] = True
                break
            else:
                left.append(f)
        if len(left) == len(waiting):
            somewhere = uvs[corners[np.flatnonzero(~orphans)[0]]].mean(axis=0)
            for f in left:
                corners[f] = len(uvs) + len(extra) + np.arange(3)
                extra += [somewhere] * 3
            break
        waiting = left
    return np.concatenate([uvs, np.array(extra)]), corners


def _at(uvs: np.ndarray, extra: list[np.ndarray], index: int) -> np.ndarray:
    return uvs[index] if index < len(uvs) else extra[index - len(uvs)]
