"""A mesh cut into few, nearly flat discs: small patches grown from even seeds, then merged, flattest pair first.

The measure of a region is 1 - |mean normal|^2, normals weighted by area: 0 on a plane, 0.6 on half a cylinder, 0.75 on
a hemisphere. Merging by it is hierarchical face clustering (Garland, Willmott and Heckbert 2001) with the measure of
variational shape approximation (Cohen-Steiner, Alliez and Desbrun 2004): cuts come to lie on creases. The tree of the
merges stays, so that a chart that cannot be laid flat can be taken apart again where its last two regions met.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field

import numpy as np

from exmesh_graph.geometry.adjacency import area_vectors, edge_lengths
from exmesh_graph.types.edges import Edges
from exmesh_graph.uv.patches import small_patches, smooth_normals

_COMPACT = 0.005 / (4.0 * np.pi)  # worth of a short outline, against flatness


@dataclass
class Partition:
    """Regions of a mesh as trees: `patch` int64 [F] is the leaf of every face, `roots` are the regions in use."""

    patch: np.ndarray
    children: dict[int, tuple[int, int]] = field(default_factory=dict)
    roots: list[int] = field(default_factory=list)

    def regions(self) -> np.ndarray:
        """int64 [F], index into `roots` of the region of every face; -1 where it is in none of them."""
        of = np.full(int(self.patch.max(initial=-1)) + 1, -1, np.int64)
        for index, root in enumerate(self.roots):
            stack = [root]
            while stack:
                node = stack.pop()
                if node in self.children:
                    stack += self.children[node]
                elif node < len(of):
                    of[node] = index
        return of[self.patch]

    def halves(self, root: int, centres: np.ndarray) -> list[int]:
        """The two parts of a region: where its last two parts met, or (a patch) across its longest extent.

        centres  float [F, 3], of all faces. One face cannot be halved.
        """
        if root not in self.children:
            here = np.flatnonzero(self.patch == root)
            offsets = centres[here] - centres[here].mean(axis=0)
            along = offsets @ np.linalg.eigh(offsets.T @ offsets)[1][:, 2]
            order = here[np.argsort(along, kind="stable")]
            new = max(int(self.patch.max()), max(self.children, default=0), root) + 1
            self.children[root] = (new, new + 1)
            self.patch[order[: len(order) // 2]] = new
            self.patch[order[len(order) // 2 :]] = new + 1
        return list(self.children[root])


def partition(points: np.ndarray, faces: np.ndarray, edges: Edges, bend: float) -> Partition:
    """Cut a mesh into regions that bend no more than `bend`; most are discs.

    points  float [V, 3], scaled to a mean face area of about 1; faces int [F, 3]; edges: theirs, manifold
    bend    bound of 1 - |mean normal|^2 in a region
    """
    vectors = area_vectors(points, faces)
    area = 0.5 * np.linalg.norm(vectors, axis=1)
    here, there = (edges.halfedges[edges.interior] // 3).T
    normals = smooth_normals(vectors, here, there)
    centres = points[faces].mean(axis=1)
    patch = small_patches(centres, normals, area, here, there, bend)

    length = edge_lengths(points, edges)[edges.interior]
    cut = patch[here] != patch[there]
    borders = _borders(patch[here][cut], patch[there][cut], length[cut], edges.vertices[edges.interior][cut])
    count = int(patch.max()) + 1
    total = np.bincount(patch, area, count)
    sums = np.stack([np.bincount(patch, area * normals[:, k], count) for k in range(3)], axis=1)
    rim = np.zeros(count)
    np.add.at(rim, patch[here][cut], length[cut])
    np.add.at(rim, patch[there][cut], length[cut])
    return _merge(patch, borders, total.tolist(), sums.tolist(), rim.tolist(), bend)


class Rejoin:
    """Charts that were taken apart to be laid flat, joined again where their union can be laid flat too: pairs with the
    longest common border first, at a time as many as do not meet. `wish` names unions, `done` is told which failed."""

    def __init__(self, points: np.ndarray, faces: np.ndarray, edges: Edges, bend: float, chart: np.ndarray) -> None:
        """chart  int64 [F], the chart of every face"""
        self.bend, self.chart = bend, chart.copy()
        vectors = area_vectors(points, faces)
        self.area = 0.5 * np.linalg.norm(vectors, axis=1)
        self.here, self.there = (edges.halfedges[edges.interior] // 3).T
        self.normals = smooth_normals(vectors, self.here, self.there)
        self.length, self.ends = edge_lengths(points, edges)[edges.interior], edges.vertices[edges.interior]
        self.tried: set[tuple[int, int]] = set()
        self.pairs: list[tuple[int, int]] = []

    def wish(self) -> np.ndarray | None:
        """int64 [F], the union that each face would be of, -1 in none; None when there is nothing left to try."""
        one, two = self.chart[self.here], self.chart[self.there]
        cut = one != two
        borders = _borders(one[cut], two[cut], self.length[cut], self.ends[cut])
        count = int(self.chart.max()) + 1
        area = np.bincount(self.chart, self.area, count)
        sums = np.stack([np.bincount(self.chart, self.area * self.normals[:, k], count) for k in range(3)], axis=1)
        rim = [sum(border.length for border in around.values()) for around in borders]
        found = []
        for i, around in enumerate(borders):
            for j, border in around.items():
                if i < j and border.one_line and (i, j) not in self.tried:
                    joint = float(area[i] + area[j])
                    if _waste(joint, (sums[i] + sums[j]).tolist()) <= self.bend * joint:
                        found.append((-border.length / max(min(rim[i], rim[j]), 1e-300), i, j))
        taken: set[int] = set()
        self.pairs = []
        for _, i, j in sorted(found):
            if i not in taken and j not in taken:
                taken |= {i, j}
                self.pairs.append((i, j))
        if not self.pairs:
            return None
        self.tried |= set(self.pairs)
        union = np.full(count, -1, np.int64)
        for k, pair in enumerate(self.pairs):
            union[list(pair)] = k
        return union[self.chart]

    def done(self, failed: np.ndarray) -> None:
        """The unions of the last wish are charts now, but for those at the places `failed`."""
        new = np.arange(int(self.chart.max()) + 1)
        for k in np.setdiff1d(np.arange(len(self.pairs)), failed).tolist():
            new[list(self.pairs[k])] = len(new) + k
        self.chart = new[self.chart]


class _Border:
    """What two regions have in common: edges, their length, their vertices."""

    __slots__ = ("edges", "length", "vertices")

    def __init__(self) -> None:
        self.edges, self.length = 0, 0.0
        self.vertices: set[int] = set()

    def take(self, other: _Border) -> None:
        self.edges += other.edges
        self.length += other.length
        self.vertices |= other.vertices

    @property
    def one_line(self) -> bool:
        """Two discs joined along one open line are a disc; along more lines, or a closed one, they are not."""
        return len(self.vertices) - self.edges == 1


def _borders(one: np.ndarray, two: np.ndarray, length: np.ndarray, ends: np.ndarray) -> list[dict[int, _Border]]:
    borders: list[dict[int, _Border]] = [{} for _ in range(int(max(one.max(initial=-1), two.max(initial=-1))) + 1)]
    for i, j, size, (a, b) in zip(one.tolist(), two.tolist(), length.tolist(), ends.tolist(), strict=True):
        border = borders[i].get(j)
        if border is None:
            border = borders[i][j] = borders[j][i] = _Border()
        border.edges += 1
        border.length += size
        border.vertices.update((a, b))
    return borders


def _merge(
    patch: np.ndarray,
    borders: list[dict[int, _Border]],
    area: list[float],
    sums: list[list[float]],
    rim: list[float],
    bend: float,
) -> Partition:
    """Join the pair that costs least, over and over. Joint regions get new numbers: no entry of the heap goes stale."""
    result = Partition(patch)
    count = len(area)
    around: dict[int, dict[int, _Border]] = {i: borders[i] if i < len(borders) else {} for i in range(count)}
    waste = [_waste(area[i], sums[i]) for i in range(count)]

    def cost(i: int, j: int) -> float | None:
        border = around[i][j]
        if not border.one_line:
            return None
        joint = area[i] + area[j]
        bent = _waste(joint, [a + b for a, b in zip(sums[i], sums[j], strict=True)])
        if bent > bend * joint:
            return None
        outline = rim[i] + rim[j] - 2.0 * border.length
        return bent - waste[i] - waste[j] + _COMPACT * (outline**2 - rim[i] ** 2 - rim[j] ** 2)

    heap = [(c, i, j) for i in around for j in around[i] if i < j and (c := cost(i, j)) is not None]
    heapq.heapify(heap)
    while heap:
        _, i, j = heapq.heappop(heap)
        if i not in around or j not in around:
            continue
        new = len(area)
        result.children[new] = (i, j)
        area.append(area[i] + area[j])
        sums.append([a + b for a, b in zip(sums[i], sums[j], strict=True)])
        rim.append(rim[i] + rim[j] - 2.0 * around[i][j].length)
        waste.append(_waste(area[new], sums[new]))
        large, small = around.pop(i), around.pop(j)
        large.pop(j)
        small.pop(i)
        if len(large) < len(small):
            large, small = small, large
        for k, border in small.items():
            if k in large:
                large[k].take(border)
            else:
                large[k] = border
        around[new] = large
        for k, border in large.items():
            around[k].pop(i, None)
            around[k].pop(j, None)
            around[k][new] = border
        for k in large:
            c = cost(k, new)
            if c is not None:
                heapq.heappush(heap, (c, k, new))
    result.roots = sorted(around)
    return result


def _waste(area: float, total: list[float]) -> float:
    """Area times 1 - |mean normal|^2."""
    x, y, z = total
    return area - (x * x + y * y + z * z) / area if area > 0 else 0.0
