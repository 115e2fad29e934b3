"""A picture of a graph as a file: SVG, a self-contained page with pan and zoom, or Mermaid text."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from exmesh_graph.report.drawing.svg import Box, GraphPicture, draw
from exmesh_graph.report.templates import page_of

FORMATS = (".svg", ".html", ".mmd")
_MERMAID = {"added": "stroke:#2e7d32,stroke-width:3px", "removed": "stroke:#b3261e,stroke-dasharray:5 3",
            "changed": "stroke:#b7791f,stroke-width:3px", "hit": "stroke:#7fa9b8", "done": "stroke:#1f6f8b",
            "run": "stroke:#1f6f8b", "failed": "stroke:#b3261e,stroke-width:3px"}  # fmt: skip


def render(picture: GraphPicture, suffix: str) -> str:
    """The text of a file with the suffix .svg, .html or .mmd."""
    if suffix == ".mmd":
        return mermaid(picture)
    svg = draw(picture)
    return svg + "\n" if suffix == ".svg" else page(svg, picture.title)


def write(picture: GraphPicture, path: Path) -> None:
    """Write the picture in the form its suffix says."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(render(picture, path.suffix), encoding="utf-8")


def mermaid(picture: GraphPicture) -> str:
    """Mermaid text of a flowchart, for Markdown files."""
    lines = ["flowchart TD"]
    ids: dict[str, str] = {}
    for box in picture.boxes:
        name = _id(box.name)
        ids[box.name] = name if name not in ids.values() else f"{name}_{len(ids)}"
    inside: dict[tuple[str, ...], list[Box]] = {}
    for box in picture.boxes:
        inside.setdefault(box.scopes, []).append(box)
    _mermaid_scope((), inside, ids, lines, "  ")
    lines += [f"  {ids[a]} --> {ids[b]}" for a, b in dict.fromkeys(picture.edges) if a in ids and b in ids]
    lines += [f"  {ids[a]} -. next round .-> {ids[b]}" for a, b in picture.loops if a in ids and b in ids]
    used = {box.state for box in picture.boxes}
    lines += [f"  classDef {state} {style}" for state, style in _MERMAID.items() if state in used]
    lines += [f"  class {ids[box.name]} {box.state}" for box in picture.boxes if box.state in _MERMAID]
    return "\n".join(lines) + "\n"


def _mermaid_scope(
    scope: tuple[str, ...],
    inside: Mapping[tuple[str, ...], Sequence[Box]],
    ids: Mapping[str, str],
    lines: list[str],
    indent: str,
) -> None:
    for box in inside.get(scope, ()):
        words = [f"<b>{escape(box.short)}</b>", escape(box.type), escape(box.third)]
        lines.append(f'{indent}{ids[box.name]}["{"<br>".join(word for word in words if word)}"]')
    for deeper in dict.fromkeys(path[: len(scope) + 1] for path in inside if len(path) > len(scope)):
        if deeper[:-1] != scope:
            continue
        count = max((box.count for path, boxes in inside.items() if path[: len(deeper)] == deeper for box in boxes))
        title = f"{deeper[-1]} ×{count}" if count > 1 else deeper[-1]
        lines.append(f'{indent}subgraph {re.sub(r"[^0-9A-Za-z]", "_", "_".join(deeper))}_block ["{escape(title)}"]')
        _mermaid_scope(deeper, inside, ids, lines, indent + "  ")
        lines.append(f"{indent}end")


def _id(name: str) -> str:
    """A name that Mermaid takes; `end` and the like are words of its own."""
    plain = re.sub(r"\W", "_", name)
    return f"{plain}_" if plain in ("end", "graph", "subgraph", "class", "style", "click", "default") else plain


def page(svg: str, title: str) -> str:
    """A page that holds the picture: drag to move, wheel to zoom, a double click shows all of it."""
    from markupsafe import Markup

    return page_of(__package__, "page.html", svg=Markup(svg), title=title)
