"""The run's graph as inline SVG: layers from top to bottom, repeat blocks folded.

Layers are topological generations. A wire that skips layers runs through one way point per layer, shared by all
wires from the same node, so that it passes beside the boxes; boxes are ordered by the mean place of their
neighbours (the barycentre heuristic of Sugiyama et al. 1981).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from exmesh_graph.report.text import seconds

_BOX = (150.0, 40.0)
_GAP = (22.0, 34.0)
_WAY_WIDTH = 14.0
_SWEEPS = 8


@dataclass(frozen=True)
class Box:
    """What a box shows: `count` executions folded into one, their common state and summed seconds."""

    name: str
    type: str
    state: str
    seconds: float
    count: int


Key = tuple[str, int]  # (node, layer): the node's box in its own layer, a way point in later ones


def graph_picture(boxes: Sequence[Box], edges: Sequence[tuple[str, str]]) -> str:
    """SVG of the graph; an empty string when there is nothing to draw."""
    if not boxes:
        return ""
    layer_of = _layers(boxes, edges)
    links = _links(layer_of, edges)
    rows = _order(boxes, layer_of, links)
    centre = _places(rows, layer_of)
    width = max(x for x, _ in centre.values()) + _BOX[0] / 2 + 12
    height = max(y for _, y in centre.values()) + _BOX[1] / 2 + 12
    parts = [
        f'<svg class="graph" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" height="{height:.0f}" '
        'role="img" aria-label="graph of the run">'
    ]
    half = _BOX[1] / 2
    for a, b in links:  # between two rows, so that no wire runs under a box
        (x0, y0), (x1, y1) = centre[a], centre[b]
        y0, y1 = y0 + half, y1 - half
        middle = (y0 + y1) / 2
        parts.append(
            f'<path class="wire" d="M{x0:.1f} {y0:.1f}C{x0:.1f} {middle:.1f} {x1:.1f} {middle:.1f} {x1:.1f} {y1:.1f}"/>'
        )
    for (name, layer), (x, y) in centre.items():
        if layer != layer_of[name]:  # a way point: straight past the boxes of its row
            parts.append(f'<path class="wire" d="M{x:.1f} {y - half:.1f}v{_BOX[1]:.1f}"/>')
    for box in boxes:
        parts.append(_box(box, *centre[box.name, layer_of[box.name]]))
    return "".join(parts) + "</svg>"


def _box(box: Box, x: float, y: float) -> str:
    name = box.name if box.count == 1 else f"{box.name} ×{box.count}"
    left, top = x - _BOX[0] / 2, y - _BOX[1] / 2
    return (
        f'<g class="box {escape(box.state)}"><title>{escape(f"{box.type}, {box.state}")}</title>'
        f'<rect x="{left:.1f}" y="{top:.1f}" width="{_BOX[0]:.0f}" height="{_BOX[1]:.0f}" rx="6"/>'
        f'<text class="name" x="{x:.1f}" y="{y - 3:.1f}" text-anchor="middle">{escape(_cut(name, 22))}</text>'
        f'<text class="under" x="{x:.1f}" y="{y + 12:.1f}" text-anchor="middle">'
        f"{escape(_cut(box.type, 16))} · {escape(seconds(box.seconds))}</text></g>"
    )


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"


def _layers(boxes: Sequence[Box], edges: Sequence[tuple[str, str]]) -> dict[str, int]:
    import networkx as nx

    graph = nx.DiGraph()
    graph.add_nodes_from(box.name for box in boxes)
    graph.add_edges_from(edges)
    return {name: layer for layer, names in enumerate(nx.topological_generations(graph)) for name in names}


def _links(layer_of: Mapping[str, int], edges: Sequence[tuple[str, str]]) -> list[tuple[Key, Key]]:
    """Every wire cut into pieces from one layer to the next."""
    links: dict[tuple[Key, Key], None] = {}
    for producer, consumer in edges:
        for layer in range(layer_of[producer], layer_of[consumer]):
            end = (consumer, layer + 1) if layer + 1 == layer_of[consumer] else (producer, layer + 1)
            links[(producer, layer), end] = None
    return list(links)


def _order(boxes: Sequence[Box], layer_of: Mapping[str, int], links: Sequence[tuple[Key, Key]]) -> list[list[Key]]:
    keys: dict[Key, None] = {(box.name, layer_of[box.name]): None for box in boxes}
    for a, b in links:
        keys[a] = keys[b] = None
    rows: list[list[Key]] = [[] for _ in range(max(layer_of.values()) + 1)]
    for key in keys:
        rows[key[1]].append(key)
    above: dict[Key, list[Key]] = {key: [] for key in keys}
    below: dict[Key, list[Key]] = {key: [] for key in keys}
    for a, b in links:
        above[b].append(a)
        below[a].append(b)
    for sweep in range(_SWEEPS):
        down = sweep % 2 == 0
        for row in rows if down else reversed(rows):
            place = {key: index / max(1, len(r) - 1) for r in rows for index, key in enumerate(r)}
            near = above if down else below
            mean = {key: sum(place[n] for n in near[key]) / len(near[key]) if near[key] else place[key] for key in row}
            row.sort(key=lambda key: mean[key])
    return rows


def _places(rows: Sequence[Sequence[Key]], layer_of: Mapping[str, int]) -> dict[Key, tuple[float, float]]:
    """Centres, every row centred on the widest one."""

    def width(key: Key) -> float:
        return _BOX[0] if layer_of[key[0]] == key[1] else _WAY_WIDTH

    widths = [sum(width(key) + _GAP[0] for key in row) - _GAP[0] for row in rows]
    centre: dict[Key, tuple[float, float]] = {}
    for index, row in enumerate(rows):
        x = 12 + (max(widths) - widths[index]) / 2
        y = 12 + _BOX[1] / 2 + index * (_BOX[1] + _GAP[1])
        for key in row:
            centre[key] = (x + width(key) / 2, y)
            x += width(key) + _GAP[0]
    return centre
