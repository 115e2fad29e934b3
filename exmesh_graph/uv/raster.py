"""Which face and which point of it each texel of an atlas shows; values for the texels between charts."""

from __future__ import annotations

import numpy as np

from exmesh_graph.types.edges import edges_of

_CHUNK = 4_000_000  # texel-edge pairs held at once by the border search


def rasterize_atlas(
    uvs: np.ndarray, uv_faces: np.ndarray, size: int | tuple[int, int], margin: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Find the face under every texel centre.

    uvs       float [T, 2], origin lower left; uv_faces int [F, 3]
    size      R, or (H, W), in texels; row 0 is v = 1
    margin    in texels: centres outside all charts, but no farther than this from one, get the nearest point of
              the nearest chart (sqrt(2)/2 or more covers every texel that a chart touches, sqrt(2) every texel
              that a bilinear lookup in a chart reads)

    Returns face_id int32 [H, W] (-1 outside) and bary float32 [H, W, 3] (0 outside; never negative).
    A centre on a shared edge belongs to one face, chosen by a half-open rule: same inputs, same bytes.
    """
    height, width = (size, size) if isinstance(size, int) else size
    corners = np.asarray(uvs, np.float64)[uv_faces]
    x = corners[..., 0] * width - 0.5  # texel centre (row i, column j) lies at x = j, y = i
    y = (1.0 - corners[..., 1]) * height - 0.5
    face_id = np.full(height * width, -1, np.int32)
    bary = np.zeros((height * width, 3), np.float32)

    row, column, face = _covered_centres(x, y, height, width)
    texel = row * width + column
    face_id[texel] = face
    bary[texel] = _barycentric(x[face], y[face], column, row)
    if margin > 0:
        _fill_margin(face_id, bary, x, y, uv_faces, margin, height, width)
    return face_id.reshape(height, width), bary.reshape(height, width, 3)


def coverage_counts(uvs: np.ndarray, uv_faces: np.ndarray, size: int | tuple[int, int]) -> np.ndarray:
    """int64 [H, W], how many faces lie over each texel centre: more than 1 where charts overlap."""
    height, width = (size, size) if isinstance(size, int) else size
    corners = np.asarray(uvs, np.float64)[uv_faces]
    x, y = corners[..., 0] * width - 0.5, (1.0 - corners[..., 1]) * height - 0.5
    row, column, _ = _covered_centres(x, y, height, width)
    return np.bincount(row * width + column, minlength=height * width).reshape(height, width)


def _covered_centres(
    x: np.ndarray, y: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row, column, face) of the centres inside each triangle: rows first, then an exact span in each row."""
    top = np.maximum(np.ceil(y.min(axis=1)), 0).astype(np.int64)
    bottom = np.minimum(np.ceil(y.max(axis=1)), height).astype(np.int64)  # rows top .. bottom - 1
    rows_of = np.maximum(bottom - top, 0)
    face = np.repeat(np.arange(len(x)), rows_of)
    row = np.arange(len(face)) - np.repeat(np.cumsum(rows_of) - rows_of, rows_of) + top[face]
    left = np.full(len(face), np.inf)
    right = np.full(len(face), -np.inf)
    for k in range(3):
        # Walk every edge from its lower to its higher end, so that both faces of an edge compute the same crossing.
        x0, y0, x1, y1 = x[:, k], y[:, k], x[:, (k + 1) % 3], y[:, (k + 1) % 3]
        swap = (y0 > y1) | ((y0 == y1) & (x0 > x1))
        x0, x1 = np.where(swap, x1, x0), np.where(swap, x0, x1)
        y0, y1 = np.where(swap, y1, y0), np.where(swap, y0, y1)
        a, b, c, d = x0[face], y0[face], x1[face], y1[face]
        hit = (row >= b) & (row < d)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = a + (row - b) / (d - b) * (c - a)
        left = np.where(hit, np.minimum(left, crossing), left)
        right = np.where(hit, np.maximum(right, crossing), right)
    valid = left <= right
    face, row, left, right = face[valid], row[valid], left[valid], right[valid]
    first = np.maximum(np.ceil(left), 0).astype(np.int64)
    last = np.minimum(np.ceil(right), width).astype(np.int64)
    length = np.maximum(last - first, 0)
    column = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length) + np.repeat(first, length)
    return np.repeat(row, length), column, np.repeat(face, length)


def _barycentric(x: np.ndarray, y: np.ndarray, px: np.ndarray, py: np.ndarray) -> np.ndarray:
    """Barycentric coordinates [N, 3] of points in triangles x, y [N, 3], clamped to the triangle."""
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    safe = np.where(area == 0, 1.0, area)
    b1 = ((px - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (py - y[:, 0])) / safe
    b2 = ((x[:, 1] - x[:, 0]) * (py - y[:, 0]) - (px - x[:, 0]) * (y[:, 1] - y[:, 0])) / safe
    weights = np.clip(np.stack([1.0 - b1 - b2, b1, b2], axis=1), 0.0, 1.0)
    return weights / weights.sum(axis=1, keepdims=True)


def _fill_margin(
    face_id: np.ndarray,
    bary: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    uv_faces: np.ndarray,
    margin: float,
    height: int,
    width: int,
) -> None:
    """Give uncovered texels near a chart the nearest chart point, which always lies on a border edge."""
    edges = edges_of(uv_faces)
    half = edges.halfedges[edges.count == 1, 0]
    face, k = half // 3, half % 3
    ax, ay = x[face, k], y[face, k]
    dx, dy = x[face, (k + 1) % 3] - ax, y[face, (k + 1) % 3] - ay
    left = np.maximum(np.ceil(np.minimum(ax, ax + dx) - margin), 0).astype(np.int64)
    right = np.minimum(np.floor(np.maximum(ax, ax + dx) + margin), width - 1).astype(np.int64)
    top = np.maximum(np.ceil(np.minimum(ay, ay + dy) - margin), 0).astype(np.int64)
    bottom = np.minimum(np.floor(np.maximum(ay, ay + dy) + margin), height - 1).astype(np.int64)
    columns, rows = np.maximum(right - left + 1, 0), np.maximum(bottom - top + 1, 0)
    pairs = columns * rows
    length2 = dx * dx + dy * dy
    best = np.full(len(face_id), np.inf)
    for block in np.split(np.arange(len(half)), np.flatnonzero(np.diff(np.cumsum(pairs) // _CHUNK)) + 1):
        edge = np.repeat(block, pairs[block])
        within = np.arange(len(edge)) - np.repeat(np.cumsum(pairs[block]) - pairs[block], pairs[block])
        column = left[edge] + within % columns[edge]
        row = top[edge] + within // columns[edge]
        free = face_id[row * width + column] < 0
        free |= np.isfinite(best[row * width + column])  # filled by an earlier block: may still be improved
        edge, column, row = edge[free], column[free], row[free]
        px, py = column - ax[edge], row - ay[edge]
        t = np.clip((px * dx[edge] + py * dy[edge]) / np.where(length2[edge] == 0, 1.0, length2[edge]), 0.0, 1.0)
        distance = np.hypot(px - t * dx[edge], py - t * dy[edge])
        near = distance <= margin
        edge, t, distance, texel = edge[near], t[near], distance[near], (row * width + column)[near]
        order = np.lexsort((face[edge], distance, texel))
        texel, edge, t, distance = texel[order], edge[order], t[order], distance[order]
        first = np.flatnonzero(np.r_[True, texel[1:] != texel[:-1]]) if len(texel) else texel
        first = first[distance[first] < best[texel[first]]]
        texel, edge, t = texel[first], edge[first], t[first]
        best[texel] = distance[first]
        face_id[texel] = face[edge]
        weights = np.zeros((len(texel), 3), np.float32)
        index = np.arange(len(texel))
        weights[index, k[edge]] = 1.0 - t
        weights[index, (k[edge] + 1) % 3] = t
        bary[texel] = weights


def dilate(texture: np.ndarray, mask: np.ndarray, radius: float | None = None) -> np.ndarray:
    """Give uncovered texels the value of the nearest covered one.

    texture  float [H, W] or [H, W, C]; mask bool [H, W], covered texels
    radius   in texels; None fills everything
    A texture without covered texels comes back as it was.
    """
    out = texture.copy()
    targets, sources = dilation_sources(mask, radius)
    out[targets] = texture[sources]
    return out


def dilation_sources(mask: np.ndarray, radius: float | None = None) -> tuple[tuple[np.ndarray, ...], ...]:
    """((rows, columns) of the texels that `dilate` fills, (rows, columns) that they take their values from)."""
    from scipy.ndimage import distance_transform_edt

    if not mask.any() or mask.all():
        none = np.zeros(0, np.int64)
        return (none, none), (none, none)
    distance, (rows, columns) = distance_transform_edt(~mask, return_indices=True)
    fill = np.nonzero(~mask if radius is None else ~mask & (distance <= radius))
    return fill, (rows[fill], columns[fill])
