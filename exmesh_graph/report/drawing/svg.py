"""A graph as SVG that stands alone: boxes coloured by state, repeat blocks as frames, ports on hover."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from string import Template

from exmesh_graph.report.drawing.layout import NAMED, Layout, Piece, arrange
from exmesh_graph.report.templates import asset_text
from exmesh_graph.report.text import seconds, size

_ROUND = re.compile(r"^(?P<block>.+)\[(?P<round>\d+)\]\.(?P<inner>.+)$")
_NAME, _UNDER = 7.3, 6.0  # widths of letters
_HEIGHT, _LINE = 42.0, 15.0
_MOST = 300  # boxes in the picture of a report; 1000 take seconds to arrange
_STATES = {"done": "ran", "hit": "from the store", "run": "would run", "unknown": "unknown", "failed": "failed",
           "running": "running", "blocked": "blocked", "waiting": "waiting", "interrupted": "interrupted",
           "idle": "not needed",
           "added": "added", "removed": "removed", "changed": "changed", "rerun": "would run again"}  # fmt: skip


_LIGHT = {"ink": "#1d2327", "soft": "#66717a", "line": "#d4d9dc", "paper": "#ffffff", "frame": "#f3f5f6",
          "done": "#1f6f8b", "hit": "#7fa9b8", "bad": "#b3261e", "add": "#2e7d32", "change": "#b7791f"}  # fmt: skip
_DARK = {"ink": "#e6eaec", "soft": "#98a4ac", "line": "#3a444a", "paper": "#1c2226", "frame": "#171c20",
         "done": "#5cb3d0", "hit": "#4d7482", "bad": "#ef6f66", "add": "#7fc27f", "change": "#e0b05c"}  # fmt: skip
_COLOURS = {"done": "done", "run": "done", "running": "done", "rerun": "done", "hit": "hit", "failed": "bad",
            "interrupted": "bad", "added": "add", "removed": "bad", "changed": "change"}  # fmt: skip
_FILLED = ("done", "run", "failed", "added", "removed", "changed")


@dataclass(frozen=True)
class Box:
    """A node as drawn: `count` executions folded into one, their common state, summed seconds and bytes.

    `note` stands in the third line instead of seconds and bytes; `hover` are lines shown under the pointer.
    """

    name: str
    type: str
    state: str = ""
    seconds: float | None = None
    count: int = 1
    bytes: int = 0
    note: str = ""
    hover: tuple[str, ...] = ()

    @property
    def scopes(self) -> tuple[str, ...]:
        """The repeat blocks around it: `rounds.uv` lies in rounds, `rounds[2].uv` in rounds[2]."""
        return tuple(self.name.split(".")[:-1])

    @property
    def short(self) -> str:
        return self.name.split(".")[-1]

    @property
    def third(self) -> str:
        """The third line."""
        parts = [seconds(self.seconds) if self.seconds else "", size(self.bytes) if self.bytes else ""]
        return self.note or " · ".join(part for part in parts if part)


@dataclass(frozen=True)
class GraphPicture:
    """What is drawn: boxes, (source, target) wires, wires back to the next round, states of wires that stand out."""

    boxes: Sequence[Box]
    edges: Sequence[tuple[str, str]]
    loops: Sequence[tuple[str, str]] = ()
    edge_states: Mapping[tuple[str, str], str] = field(default_factory=dict)
    title: str = ""


def graph_picture(boxes: Sequence[Box], edges: Sequence[tuple[str, str]]) -> str:
    """SVG of folded boxes and the wires of all rounds; "" for no boxes, a sentence where nobody could read it."""
    if len(boxes) > _MOST:
        return f"<p>{len(boxes)} boxes are not drawn here; <code>exmesh show</code> draws them.</p>"
    return draw(GraphPicture(boxes, fold_edges(edges), fold_loops(edges))) if boxes else ""


def draw(picture: GraphPicture) -> str:
    """The SVG text."""
    boxes = {box.name: box for box in picture.boxes}
    third = any(box.third for box in picture.boxes)
    sizes = {name: _size(box, third) for name, box in boxes.items()}
    layout = arrange(sizes, picture.edges, {name: box.scopes for name, box in boxes.items()})
    states = {*(box.state for box in picture.boxes), *picture.edge_states.values()}
    legend = [(state, words) for state, words in _STATES.items() if state in states]
    top = (30 if picture.title else 0) + (24 if legend else 0)
    width = max(layout.width, 30 + 8 * len(picture.title), 420 if legend else 0)
    name = escape(picture.title or "graph", quote=True)
    style = _style()
    parts = [
        f'<svg class="graph" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {layout.height + top:.0f}" '
        f'width="{width:.0f}" height="{layout.height + top:.0f}" role="img" aria-label="{name}"><style>{style}</style>'
    ]
    if picture.title:
        parts.append(f'<text class="gp-title" x="16" y="26">{escape(picture.title)}</text>')
    parts += _legend_items(legend, 16, top - 10)
    parts.append(f'<g transform="translate({(width - layout.width) / 2:.1f} {top})">')
    for frame in layout.frames:
        parts.append(
            f'<g class="gp-frame"><rect x="{frame.x:.1f}" y="{frame.y:.1f}" width="{frame.width:.1f}" '
            f'height="{frame.height:.1f}" rx="10"/></g>'
        )
    parts += [_loop(a, b, layout, sizes) for a, b in picture.loops if a in layout.boxes and b in layout.boxes]
    parts += [_wire(piece, picture.edge_states) for piece in layout.pieces]
    for frame in layout.frames:
        title = escape(_frame_title(frame.name, picture.boxes))
        parts.append(f'<text class="gp-frame-title" x="{frame.x + 12:.1f}" y="{frame.y + 19:.1f}">{title}</text>')
    parts += [_box(box, *layout.boxes[name], *sizes[name]) for name, box in boxes.items()]
    return "".join(parts) + "</g></svg>"


def fold_name(name: str) -> str:
    """`rounds[3].refine` -> `rounds.refine`: the node of a repeat block, whatever its round."""
    match = _ROUND.match(name)
    return f"{fold_name(match['block'])}.{match['inner']}" if match else name


def fold_edges(edges: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Edges between folded nodes, without those that carry state from one round to the next."""
    pairs = [(fold_name(a), fold_name(b)) for a, b in edges if not _to_next_round(a, b)]
    return [pair for pair in dict.fromkeys(pairs) if pair[0] != pair[1]]


def fold_loops(edges: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """The folded edges that carry state from one round to the next."""
    return list(dict.fromkeys((fold_name(a), fold_name(b)) for a, b in edges if _to_next_round(a, b)))


def _to_next_round(producer: str, consumer: str) -> bool:
    a, b = _ROUND.match(producer), _ROUND.match(consumer)
    return bool(a and b and a["block"] == b["block"] and a["round"] != b["round"])


@functools.cache
def _style() -> str:
    """The style sheet, light and dark, in plain colours: some viewers know neither variables nor colour functions."""
    sheet = Template(asset_text(__package__, "style.css"))
    themes = []
    for palette in (_LIGHT, _DARK):
        rules = []
        for state, name in _COLOURS.items():
            colour = palette[name]
            fill = _mixed(colour, palette["paper"]) if state in _FILLED else palette["paper"]
            rules.append(
                f".graph .gp-box.{state} .gp-body{{stroke:{colour};fill:{fill}}}"
                f".graph .gp-box.{state} .gp-stripe,.graph .gp-wire.{state} path{{stroke:{colour}}}"
                f".graph .gp-wire.{state} .gp-head{{fill:{colour};stroke:none}}"
            )
        themes.append(sheet.substitute(palette, states="\n".join(rules)))
    return f"{themes[0]}@media(prefers-color-scheme:dark){{\n{themes[1]}}}"


def _mixed(colour: str, paper: str) -> str:
    """A tenth of a colour on paper."""
    pairs = zip(bytes.fromhex(colour[1:]), bytes.fromhex(paper[1:]), strict=True)
    return "#" + "".join(f"{round(0.09 * a + 0.91 * b):02x}" for a, b in pairs)


def _size(box: Box, third: bool) -> tuple[float, float]:
    letters = (_NAME * len(_heading(box)), _UNDER * len(box.type), _UNDER * len(box.third))
    return max(118.0, max(letters) + 30), _HEIGHT + (_LINE if third else 0)


def _heading(box: Box) -> str:
    return box.short if box.count == 1 or box.scopes else f"{box.short} ×{box.count}"


def _frame_title(name: str, boxes: Iterable[Box]) -> str:
    count = max((box.count for box in boxes if box.name.startswith(f"{name}.")), default=1)
    short = name.split(".")[-1]
    return f"{short}  ×{count}" if count > 1 else short


def _box(box: Box, x: float, y: float, width: float, height: float) -> str:
    left, top = x - width / 2, y - height / 2
    lines = [("gp-name", _heading(box)), ("gp-type", box.type)]
    if box.third:
        lines.append(("gp-note", box.third))
    first = y - (len(lines) - 1) * _LINE / 2 + 4
    texts = [
        f'<text class="{kind}" x="{x + 2:.1f}" y="{first + index * _LINE:.1f}">{escape(text)}</text>'
        for index, (kind, text) in enumerate(lines)
    ]
    hover = [f"{box.name}  {box.type}", *([_STATES.get(box.state, box.state)] if box.state else []), *box.hover]
    return (
        f'<g class="gp-box {escape(box.state)}" data-name="{escape(box.name, quote=True)}">'
        f"<title>{escape(chr(10).join(hover))}</title>"
        f'<rect class="gp-body" x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}" rx="7"/>'
        f'<path class="gp-stripe" d="M{left + 5:.1f} {top + 8:.1f}v{height - 16:.1f}"/>{"".join(texts)}</g>'
    )


def _wire(piece: Piece, states: Mapping[tuple[str, str], str]) -> str:
    distinct = {states.get((piece.source, target), "") for target in piece.to}
    state = distinct.pop() if len(distinct) == 1 else ""
    end = piece.y1 - (6 if piece.arrow else 0)
    if piece.x0 == piece.x1:
        path = f"M{piece.x0:.1f} {piece.y0:.1f}V{end:.1f}"
    else:
        half = (piece.y0 + end) / 2
        path = f"M{piece.x0:.1f} {piece.y0:.1f}C{piece.x0:.1f} {half:.1f} {piece.x1:.1f} {half:.1f} "
        path += f"{piece.x1:.1f} {end:.1f}"
    head = f'<path class="gp-head" d="M{piece.x1 - 3.5:.1f} {end:.1f}h7l-3.5 6z"/>' if piece.arrow else ""
    to = escape(" ".join(sorted(piece.to) if len(piece.to) <= NAMED else ()), quote=True)
    data = f'data-from="{escape(piece.source, quote=True)}" data-to="{to}"'
    return f'<g class="gp-wire {escape(state)}" {data}><path d="{path}"/>{head}</g>'


def _loop(a: str, b: str, layout: Layout, sizes: Mapping[str, tuple[float, float]]) -> str:
    """The dashed wire from the end of a round to the start of the next, along the right side of the frame."""
    (x0, y0), (x1, y1) = layout.boxes[a], layout.boxes[b]
    inside = [
        f
        for f in layout.frames
        if f.x <= min(x0, x1) and max(x0, x1) <= f.x + f.width and f.y <= y1 and y0 <= f.y + f.height
    ]
    frame = min(inside, key=lambda frame: frame.width) if inside else None
    right = (frame.x + frame.width - 7) if frame else max(x0, x1) + 90
    start, end = x0 + sizes[a][0] / 2, x1 + sizes[b][0] / 2
    path = f"M{start:.1f} {y0:.1f}H{right - 6:.1f}q6 0 6 -6V{y1 + 6:.1f}q0 -6 -6 -6H{end + 6:.1f}"
    head = f'<path class="gp-head" d="M{end + 6:.1f} {y1 - 3.5:.1f}v7l-6 -3.5z"/>'
    return f'<g class="gp-wire gp-loop"><title>to the next round</title><path d="{path}"/>{head}</g>'


def _legend_items(items: Sequence[tuple[str, str]], x: float, y: float) -> list[str]:
    parts = []
    for state, words in items:
        parts.append(
            f'<g class="gp-box {state}">'
            f'<rect class="gp-body" x="{x:.1f}" y="{y - 11:.1f}" width="14" height="12" rx="3"/>'
            f'<text class="gp-legend" x="{x + 20:.1f}" y="{y:.1f}">{escape(words)}</text></g>'
        )
        x += 20 + 6.6 * len(words) + 22
    return parts
