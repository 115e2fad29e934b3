"""Placing the boxes and wires of a graph: layers from top to bottom, repeat blocks as frames around their nodes.

Layers are longest paths from the sources. A wire that skips layers runs through one way point per layer, shared by all
wires from the same box, so that it passes beside the others. Boxes are ordered by the mean place of their neighbours
(the barycentre heuristic of Sugiyama, Tagawa and Toda 1981) and then moved as near to these as their order allows
(least squares under separation, solved exactly by pooling adjacent violators). A frame is laid out by itself and takes
part in the layout around it as one box; wires cross its border at points that its own layout chooses.
"""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

GAP_X, GAP_Y = 26.0, 34.0
MARGIN, TITLE = 16.0, 24.0
_SWEEPS, _STRAIGHTEN = 12, 80
_PATIENCE = 60_000  # of sweeps times wires
NAMED = 100  # boxes that a piece between way points names; a wire into all of 1000 rounds would name a million

Key = tuple[str, str, int]
"""("box", name, layer), ("way", source, layer), ("in", source, 0) or ("out", source, last) of one scope"""
Link = tuple[Key, Key, str]


@dataclass(frozen=True)
class BlockFrame:
    """A repeat block: the rectangle around its nodes. `name` is its full name, blocks around it included."""

    name: str
    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class Piece:
    """A piece of a wire from a box: a curve from (x0, y0) to (x1, y1), upright at both ends.

    `to` are the boxes it leads to, of a piece between way points at most one more than NAMED; `arrow` tells whether it
    ends at one.
    """

    source: str
    to: frozenset[str]
    x0: float
    y0: float
    x1: float
    y1: float
    arrow: bool = False


@dataclass
class Layout:
    """Where everything lies, in pixels from the upper left corner. `boxes` are centres."""

    width: float
    height: float
    boxes: dict[str, tuple[float, float]] = field(default_factory=dict)
    frames: list[BlockFrame] = field(default_factory=list)
    pieces: list[Piece] = field(default_factory=list)
    tops: dict[str, float] = field(default_factory=dict)
    bottoms: dict[str, float] = field(default_factory=dict)


def arrange(
    sizes: Mapping[str, tuple[float, float]], edges: Iterable[tuple[str, str]], scopes: Mapping[str, Sequence[str]]
) -> Layout:
    """Lay out boxes of the given (width, height), connected by (source, target) edges without cycles.

    `scopes` names for every box the frames it lies in, from the outermost on.
    """
    wires = list(dict.fromkeys((a, b) for a, b in edges if a != b))
    layout = _Scope((), sizes, wires, {name: tuple(scopes.get(name, ())) for name in sizes}).lay()
    ends = {(piece.source, target) for piece in layout.pieces if piece.arrow for target in piece.to}
    foot = {name: y + sizes[name][1] / 2 for name, (_, y) in layout.boxes.items()}
    starts = {(p.source, target) for p in layout.pieces if abs(p.y0 - foot[p.source]) < 0.5 for target in p.to}
    seen = ends & starts
    for a, b in wires:
        if (a, b) not in seen:  # against the flow of the layers, as between frames that feed each other
            (x0, y0), (x1, y1) = layout.boxes[a], layout.boxes[b]
            down, up = sizes[a][1] / 2, sizes[b][1] / 2
            layout.pieces = [piece for piece in layout.pieces if piece.source != a or piece.to != {b}]
            layout.pieces.append(Piece(a, frozenset({b}), x0, y0 + down, x1, y1 - up, arrow=True))
    return layout


class _Scope:
    """The layout of one frame, or of the whole picture."""

    def __init__(
        self,
        path: tuple[str, ...],
        sizes: Mapping[str, tuple[float, float]],
        edges: Sequence[tuple[str, str]],
        scopes: Mapping[str, tuple[str, ...]],
    ) -> None:
        self.path, self.sizes, self.edges, self.scopes = path, sizes, edges, scopes
        self.inner: dict[str, Layout] = {}
        depth = len(path)
        self.item_of = {}
        inside: dict[tuple[str, ...], dict[str, tuple[str, ...]]] = {}
        for name, scope in scopes.items():
            self.item_of[name] = name if len(scope) == depth else ".".join(scope[: depth + 1])
            if len(scope) > depth:
                inside.setdefault(scope[: depth + 1], {})[name] = scope
        touching: dict[tuple[str, ...], list[tuple[str, str]]] = {frame: [] for frame in inside}
        for a, b in edges:  # each to the frames that it touches, so that no frame looks at all wires
            for frame in {scopes[end][: depth + 1] for end in (a, b) if len(scopes.get(end, ())) > depth}:
                touching[frame].append((a, b))
        for frame, members in inside.items():
            self.inner[".".join(frame)] = _Scope(frame, sizes, touching[frame], members).lay()

    def lay(self) -> Layout:
        """Place everything in this scope."""
        self._layers()
        self._links()
        rows = self._order()
        xs = self._straighten(rows)
        return self._draw(rows, xs)

    def size(self, item: str) -> tuple[float, float]:
        inside = self.inner.get(item)
        return (inside.width, inside.height) if inside else self.sizes[item]

    def _layers(self) -> None:
        """The layer of every item: longest path; items without inputs go right above their first user."""
        items = list(dict.fromkeys(self.item_of.values()))
        near: dict[str, set[str]] = {item: set() for item in items}
        for a, b in self.edges:
            if a in self.item_of and b in self.item_of and self.item_of[a] != self.item_of[b]:
                near[self.item_of[b]].add(self.item_of[a])
        fed = {self.item_of[b] for a, b in self.edges if b in self.item_of and a not in self.item_of}
        used: dict[str, list[str]] = {item: [] for item in items}
        for item in items:
            for source in near[item]:
                used[source].append(item)
        layer: dict[str, int] = {}
        lacks = {item: len(near[item]) for item in items}
        waiting, ready = dict.fromkeys(items), [item for item in items if not lacks[item]]
        while waiting:
            for item in ready or [next(iter(waiting))]:  # a cycle between frames: place one anyway
                layer[item] = 1 + max((layer[source] for source in near[item] if source in layer), default=-1)
                del waiting[item]
                for user in used[item]:
                    lacks[user] -= 1
            placed, ready = ready or [item], []
            ready = [u for u in dict.fromkeys(u for i in placed for u in used[i]) if u in waiting and lacks[u] <= 0]
        for item in items:
            users = [layer[other] for other in used[item]]
            if not near[item] and item not in fed and users:
                layer[item] = max(layer[item], min(users) - 1)
        shift = 1 if fed else 0
        self.layer = {item: number + shift for item, number in layer.items()}
        self.last = max(self.layer.values(), default=0)

    def _links(self) -> None:
        """Every wire cut into steps from one layer to the next: {(upper, lower, source): boxes it leads to}."""
        self.links: dict[Link, set[str]] = {}
        reached: dict[str, int] = {}  # the layer that the way points of a source go down to
        goals: dict[str, list[tuple[int, str]]] = {}
        leaving = any(a in self.item_of and b not in self.item_of for a, b in self.edges)
        end_layer = self.last + (1 if leaving else 0)
        for a, b in self.edges:
            mine, theirs = self.item_of.get(a), self.item_of.get(b)
            if mine == theirs:  # both outside, or both in one frame
                continue
            start: Key = ("in", a, 0) if mine is None else ("box", mine, self.layer[mine])
            end: Key = ("out", a, end_layer) if theirs is None else ("box", theirs, self.layer[theirs])
            if start[2] < end[2]:  # else against the flow: see `arrange`
                last = start if reached.setdefault(a, start[2]) == start[2] else ("way", a, reached[a])
                for layer in range(reached[a] + 1, end[2]):
                    last, above = ("way", a, layer), last
                    self.links[above, last, a] = set()
                reached[a] = max(reached[a], end[2] - 1)
                before: Key = start if end[2] - 1 == start[2] else ("way", a, end[2] - 1)
                self.links.setdefault((before, end, a), set()).add(b)
                goals.setdefault(a, []).append((end[2], b))
        for found in goals.values():
            found.sort()
        for (upper, lower, a), to in self.links.items():
            if lower[0] == "way":
                first = bisect.bisect_right(goals[a], (lower[2], chr(0x10FFFF)))
                to.update(b for _, b in goals[a][first : None if upper[0] == "box" else first + NAMED + 1])
        self.last = end_layer

    def _order(self) -> list[list[Key]]:
        keys: dict[Key, None] = {("box", item, layer): None for item, layer in self.layer.items()}
        for upper, lower, _ in self.links:
            keys[upper] = keys[lower] = None
        rows: list[list[Key]] = [[] for _ in range(self.last + 1)]
        for key in keys:
            rows[key[2]].append(key)
        self.above: dict[Key, list[tuple[Key, str]]] = {key: [] for key in keys}
        self.below: dict[Key, list[tuple[Key, str]]] = {key: [] for key in keys}
        for upper, lower, source in self.links:
            self.above[lower].append((upper, source))
            self.below[upper].append((lower, source))
        best, fewest = [list(row) for row in rows], self._crossings(rows)
        place = {key: index / max(1, len(row) - 1) for row in rows for index, key in enumerate(row)}
        for sweep in range(_SWEEPS):
            down = sweep % 2 == 0
            near = self.above if down else self.below
            for row in rows if down else rows[::-1]:
                mean = {k: sum(place[n] for n, _ in near[k]) / len(near[k]) if near[k] else place[k] for k in row}
                row.sort(key=lambda key: mean[key])
                place.update((key, index / max(1, len(row) - 1)) for index, key in enumerate(row))
            crossings = self._crossings(rows)
            if crossings < fewest:
                best, fewest = [list(row) for row in rows], crossings
        return best

    def _crossings(self, rows: Sequence[Sequence[Key]]) -> int:
        place = {key: index for row in rows for index, key in enumerate(row)}
        total = 0
        by_layer: dict[int, list[tuple[int, int]]] = {}
        for upper, lower, _ in self.links:
            by_layer.setdefault(upper[2], []).append((place[upper], place[lower]))
        for pairs in by_layer.values():
            ends: list[int] = []
            for _, end in sorted(pairs):
                total += len(ends) - bisect.bisect_right(ends, end)
                bisect.insort(ends, end)
        return total

    def _width(self, key: Key) -> float:
        return self.size(key[1])[0] if key[0] == "box" else 6.0

    def _straighten(self, rows: Sequence[Sequence[Key]]) -> dict[Key, float]:
        """Centres along x."""
        xs: dict[Key, float] = {}
        for row in rows:
            x = 0.0
            for key in row:
                xs[key] = x + self._width(key) / 2
                x += self._width(key) + GAP_X
        for sweep in range(min(_STRAIGHTEN, 8 + _PATIENCE // (1 + len(self.links)))):
            for row in rows if sweep % 2 == 0 else rows[::-1]:
                wanted, weights = [], []
                for key in row:
                    goals = [
                        (
                            xs[n] + self._port(n, wire, bottom=down) - self._port(key, wire, bottom=not down),
                            _pull(key, n),
                        )
                        for near, down in ((self.above, True), (self.below, False))
                        for n, wire in near[key]
                    ]
                    weight = sum(pull for _, pull in goals)
                    wanted.append(sum(x * pull for x, pull in goals) / weight if goals else xs[key])
                    weights.append(weight or 0.05)
                gaps = [(self._width(a) + self._width(b)) / 2 + GAP_X for a, b in itertools.pairwise(row)]
                for key, x in zip(row, _apart(wanted, weights, gaps), strict=True):
                    xs[key] = x
        left = min((x - self._width(key) / 2 for key, x in xs.items()), default=0.0)
        return {key: x - left + MARGIN for key, x in xs.items()}

    def _port(self, key: Key, source: str, *, bottom: bool) -> float:
        """Where a wire from `source` leaves or enters a frame, from the frame's centre."""
        inside = self.inner.get(key[1]) if key[0] == "box" else None
        if inside is None:
            return 0.0
        return (inside.bottoms if bottom else inside.tops).get(source, inside.width / 2) - inside.width / 2

    def _draw(self, rows: Sequence[Sequence[Key]], xs: Mapping[Key, float]) -> Layout:
        top = (TITLE if self.path else 0.0) + MARGIN
        ys: list[tuple[float, float]] = []
        for row in rows:
            height = max((self.size(key[1])[1] for key in row if key[0] == "box"), default=0.0)
            ys.append((top, top + height))
            top += height + (GAP_Y if height else 0.0)
        width = max((xs[key] + self._width(key) / 2 for row in rows for key in row), default=0.0) + MARGIN
        height = top - GAP_Y + MARGIN
        layout = Layout(width, height)
        ends: dict[Key, tuple[float, float]] = {}
        users: dict[Key, set[str]] = {}
        for (upper, _, _), to in self.links.items():
            users.setdefault(upper, set()).update(to)
        for row in rows:
            for key in row:
                y0, y1 = ys[key[2]]
                if key[0] == "box":
                    middle, half = (y0 + y1) / 2, self.size(key[1])[1] / 2
                    ends[key] = middle - half, middle + half
                    self._place(layout, key[1], xs[key], middle)
                elif key[0] == "way":
                    ends[key] = y0, y1
                    layout.pieces.append(Piece(key[1], frozenset(users[key]), xs[key], y0, xs[key], y1))
                else:
                    ends[key] = (0.0, 0.0) if key[0] == "in" else (height, height)
                    (layout.tops if key[0] == "in" else layout.bottoms)[key[1]] = xs[key]
        entries = self._entries(xs)
        for (upper, lower, source), to in self.links.items():
            leaf = lower[0] == "box" and lower[1] not in self.inner
            x0 = xs[upper] + self._port(upper, source, bottom=True)
            x1 = entries.get((upper, lower, source), xs[lower] + self._port(lower, source, bottom=False))
            ends_at = (x0, ends[upper][1], x1, ends[lower][0])
            layout.pieces.append(Piece(source, frozenset(to), *ends_at, arrow=leaf))
        return layout

    def _entries(self, xs: Mapping[Key, float]) -> dict[Link, float]:
        """Where wires meet the upper side of a box: side by side, in the order they come from."""
        arriving: dict[Key, list[Link]] = {}
        for link in self.links:
            if link[1][0] == "box" and link[1][1] not in self.inner:
                arriving.setdefault(link[1], []).append(link)
        places = {}
        for lower, links in arriving.items():
            links.sort(key=lambda link: xs[link[0]] + self._port(link[0], link[2], bottom=True))
            step = min(16.0, (self._width(lower) - 24) / len(links))
            for index, link in enumerate(links):
                places[link] = xs[lower] + step * (index - (len(links) - 1) / 2)
        return places

    def _place(self, layout: Layout, item: str, x: float, y: float) -> None:
        """Put a box, or a frame with all it holds, into the layout."""
        inside = self.inner.get(item)
        if inside is None:
            layout.boxes[item] = x, y
            return
        left, top = x - inside.width / 2, y - inside.height / 2
        layout.frames.append(BlockFrame(item, left, top, inside.width, inside.height))
        layout.boxes.update({name: (bx + left, by + top) for name, (bx, by) in inside.boxes.items()})
        layout.frames += [replace(f, x=f.x + left, y=f.y + top) for f in inside.frames]
        for p in inside.pieces:
            layout.pieces.append(replace(p, x0=p.x0 + left, y0=p.y0 + top, x1=p.x1 + left, y1=p.y1 + top))


def _pull(key: Key, other: Key) -> float:
    """How much a piece of a wire wants to be upright: long wires most, then those between neighbours."""
    ways = (key[0] == "way") + (other[0] == "way")
    return (3.0, 1.0, 12.0)[ways]


def _apart(wanted: Sequence[float], weights: Sequence[float], gaps: Sequence[float]) -> list[float]:
    """The places nearest to `wanted` (weighted least squares) with at least `gaps` between neighbours."""
    offsets = [0.0]
    for gap in gaps:
        offsets.append(offsets[-1] + gap)
    pools: list[tuple[float, float, int]] = []  # mean, weight, count
    for goal, weight, offset in zip(wanted, weights, offsets, strict=True):
        mean, total, count = goal - offset, weight, 1
        while pools and pools[-1][0] > mean:
            before, heavy, many = pools.pop()
            mean = (mean * total + before * heavy) / (total + heavy)
            total, count = total + heavy, count + many
        pools.append((mean, total, count))
    places = [mean for mean, _, count in pools for _ in range(count)]
    return [place + offset for place, offset in zip(places, offsets, strict=True)]
