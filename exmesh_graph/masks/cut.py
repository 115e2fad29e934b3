"""An outline moved to the edge in the picture: the least cut through a band around it.

Boykov and Jolly 2001 (the cut), Rother, Kolmogorov and Blake 2004 (colours of both sides, pixel pairs weighed by
contrast). The colours are not a mixture of Gaussians here: a pixel is compared with the samples of either side that are
nearest in colour and place together, so that a side may have other colours elsewhere.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt, maximum_filter, uniform_filter
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow
from scipy.spatial import cKDTree
from skimage.color import rgb2lab

from exmesh_graph.errors import DataError

_SCALE = 1000
"""Capacities are integers: a cost of 1 in so many parts."""
_LAB = 10.0
"""CIELAB units that weigh as much as `_REACH` band widths of distance."""
_REACH = 2.0
_SEEN = 3.0
"""Band widths from the outline within which samples lie."""
_NEAREST = 5
_EPS = 1.0
"""A sample may be so many times farther than the nearest, and 1: a third less time; one pixel of 9000 changes."""
_SAMPLES = 6000
_CORE = 0.6
_HOLE = 2.5
_GAP = 0.7
"""Chance, mean of a window of so many pixels, from which on the inside shows the table."""
_WINDOW = 3
_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))


def moved_to_edges(
    picture: np.ndarray, drawn: np.ndarray, band: float, smoothness: float = 2.0, table: np.ndarray | None = None
) -> np.ndarray:
    """bool [H, W]: the outline of `drawn` bool [H, W], moved by at most `band` pixels to where the picture has an edge.

    picture     float32 [H, W, 3], display colour in [0, 1]
    smoothness  cost of a pixel's length of outline where the picture is flat, beside at most 1 for a pixel whose
                colours are those of the other side
    table       [H, W] in (0, 1): how likely a pixel shows the table below the object, 0.5 where that is not known
                (`ground.table_shown`). It counts beside the colours, and gaps that show the table are open too

    Pixels farther than `band` from the outline stay as they are; so does the middle of parts that are thinner than
    that. Where a side has no pixel to learn its colours from, `drawn` is returned. Raises DataError for other shapes.
    """
    if picture.shape != (*drawn.shape, 3):
        raise DataError(
            f"the picture has the shape {list(picture.shape)}, the outline {list(drawn.shape)}",
            where="masks.cut.moved_to_edges", expected="[H, W, 3] and [H, W] of the same size",
        )  # fmt: skip
    result = drawn.copy()
    if drawn.all() or not drawn.any():
        return result
    around = _around(drawn, int(np.ceil(_SEEN * band)) + 2)
    picture, drawn = picture[around], drawn[around]
    sure_in, sure_out, band_of = sides(drawn, band)
    own = sure_in
    if table is not None:
        table = table[around]
        gap = sure_in & (table > 0.5) & (uniform_filter(table, _WINDOW, mode="nearest") > _GAP)
        sure_in, band_of = sure_in & ~gap, band_of | gap
        own = sure_in & (table <= 0.5)
    if not own.any() or not sure_out.any() or not band_of.any():
        return result
    lab = rgb2lab(np.clip(picture, 0, 1)).astype(np.float32)
    unlike = _unlike(lab, own, sure_out, band_of, band)
    if table is not None:
        unlike = together(unlike, table[band_of])
    kept = least_cut(unlike, _contrast(lab, band_of), band_of, sure_in, smoothness)
    result[around][band_of] = kept
    return result


def together(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The chance of what two independent chances in (0, 1) speak of; 0.5 says nothing."""
    both = first * second
    return both / np.maximum(both + (1 - first) * (1 - second), 1e-12)


def _around(drawn: np.ndarray, margin: int) -> tuple[slice, slice]:
    """The part of the picture that holds the whole outline and `margin` pixels more: nothing else has a say."""
    edge = np.zeros_like(drawn)
    edge[1:] |= drawn[1:] != drawn[:-1]
    edge[:, 1:] |= drawn[:, 1:] != drawn[:, :-1]
    lines = np.flatnonzero(edge.any(axis=1)), np.flatnonzero(edge.any(axis=0))
    rows, columns = (slice(max(0, int(line[0]) - margin), int(line[-1]) + 1 + margin) for line in lines)
    return rows, columns


def sides(drawn: np.ndarray, band: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(certainly inside, certainly outside, open) bool [H, W]: the open pixels are within `band` of the outline.

    Of a part, or a gap, thinner than twice the band the middle is certain: what is deeper than 0.6 of the deepest pixel
    nearby. Of gaps thinner than five pixels nothing is: a surface with cracks has such.
    """
    if drawn.all() or not drawn.any():
        return drawn.copy(), ~drawn, np.zeros_like(drawn)
    sure_in, sure_out = _core(drawn, band, 0.0), _core(~drawn, band, _HOLE)
    return sure_in, sure_out, ~sure_in & ~sure_out


def _core(side: np.ndarray, band: float, least: float) -> np.ndarray:
    deep = distance_transform_edt(side)
    local = maximum_filter(deep, size=2 * int(np.ceil(band)) + 1)
    return side & (deep > np.minimum(band, np.maximum(_CORE * local, least)))


def _unlike(lab: np.ndarray, sure_in: np.ndarray, sure_out: np.ndarray, band_of: np.ndarray, band: float) -> np.ndarray:
    """float64 [P] in [0, 1] for the open pixels: 0 where the colour is the inside's, 1 where it is the outside's."""
    near = distance_transform_edt(~band_of) <= (_SEEN - 1) * band
    places = np.argwhere(band_of)
    features = _features(lab, places, band)
    far = []
    for side in (sure_in & near, sure_out & near):
        there = np.argwhere(side)
        there = there[:: max(1, len(there) // _SAMPLES)]
        tree = cKDTree(_features(lab, there, band))
        count = min(_NEAREST, len(there))
        far.append(tree.query(features, k=count, eps=_EPS)[0].reshape(len(places), -1).mean(axis=1))
    return (far[0] + 1e-3) / (far[0] + far[1] + 2e-3)


def _features(lab: np.ndarray, places: np.ndarray, band: float) -> np.ndarray:
    return np.concatenate([lab[places[:, 0], places[:, 1]] / _LAB, places / (_REACH * band)], axis=1)


def _contrast(lab: np.ndarray, band_of: np.ndarray) -> list[np.ndarray]:
    """For each kind of neighbour float64 [H, W] in [0, 1]: 1 where a pixel and that neighbour are of one colour."""
    height, width = band_of.shape
    steps = []
    for down, right in _NEIGHBOURS:
        step = np.full((height, width), np.nan)
        here, there = _pair(height, width, down, right)
        step[here] = np.square(lab[here] - lab[there]).sum(axis=-1)
        steps.append(step)
    mean = np.nanmean(np.stack(steps)[:, band_of])
    return [np.exp(-step / (2 * max(float(mean), 1e-12))) for step in steps]


def _pair(height: int, width: int, down: int, right: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices (pixels, their neighbours) for a step to the neighbour."""
    rows, below = slice(0, height - down), slice(down, height)
    if right >= 0:
        return (rows, slice(0, width - right)), (below, slice(right, width))
    return (rows, slice(-right, width)), (below, slice(0, width + right))


def least_cut(
    unlike: np.ndarray, contrast: list[np.ndarray], band_of: np.ndarray, sure_in: np.ndarray, smoothness: float
) -> np.ndarray:
    """bool [P] of the open pixels, inside or not, by the cut of least cost.

    An open pixel costs `unlike` inside and 1 - `unlike` outside; a pair of neighbours that the cut parts costs
    `smoothness` times its `contrast` over its distance, against certain pixels too.
    """
    height, width = band_of.shape
    count = int(band_of.sum())
    number = np.full((height, width), -1)
    number[band_of] = np.arange(count)
    source, sink = count, count + 1
    number[sure_in & (number < 0)] = source
    number[number < 0] = sink
    tails, heads, costs = [], [], []
    for (down, right), like in zip(_NEIGHBOURS, contrast, strict=True):
        here, there = _pair(height, width, down, right)
        a, b = number[here].ravel(), number[there].ravel()
        cost = smoothness / np.hypot(down, right) * like[here].ravel()
        used = (np.minimum(a, b) < count) & (a != b)
        tails.append(a[used])
        heads.append(b[used])
        costs.append(cost[used])
    pixels = np.arange(count)
    a = np.concatenate([*tails, *heads, np.full(count, source), pixels])
    b = np.concatenate([*heads, *tails, pixels, np.full(count, sink)])
    cost = np.concatenate([*costs, *costs, 1 - unlike, unlike])
    whole = np.rint(_SCALE * cost).astype(np.int64)
    graph = coo_matrix((whole, (a, b)), shape=(count + 2, count + 2)).tocsr()
    graph.sum_duplicates()
    graph = csr_matrix(graph.astype(np.int32))
    flow = maximum_flow(graph, source, sink).flow
    left = graph - flow
    left.data = np.maximum(left.data, 0)
    left.eliminate_zeros()
    reached = breadth_first_order(left, source, return_predecessors=False)
    inside = np.zeros(count + 2, bool)
    inside[reached] = True
    return inside[:count]
