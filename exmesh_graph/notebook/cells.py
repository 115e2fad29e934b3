"""The pieces of an output: a framed cell, pictures as data addresses, contact sheets, tables, tiles."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np


def cell(*parts: str) -> str:
    """The parts as one output. Its style reaches no other output and takes colours from the notebook's theme."""
    from exmesh_graph.report.templates import asset_text

    style = asset_text(__package__, "cell.css")
    return f'<div class="exmesh"><style>{style}</style>{"".join(parts)}</div>'


def said(text: str, kind: str = "") -> str:
    """A sentence; `kind`: soft, warn or bad."""
    return f'<p class="{kind}">{escape(text)}</p>'


def picture(pixels: np.ndarray, height: int = 0) -> str:
    """An image of display values in [0, 1], [H, W], [H, W, 3] or with alpha [H, W, 4], shown `height` pixels high."""
    import numpy as np
    from PIL import Image

    codes = np.round(255 * np.clip(np.nan_to_num(np.asarray(pixels, np.float32)), 0, 1)).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(codes).save(buffer, "WEBP", quality=82, method=2)
    size = f' height="{height}"' if height else ""
    return f'<img src="data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode("ascii")}"{size} alt="">'


def sheet(pictures: Iterable[tuple[str, str]], kind: str = "") -> str:
    """(image, caption) side by side, in as many rows as it takes; `mask`: transparent parts are chequered."""
    figures = (f"<figure>{image}<figcaption>{escape(words)}</figcaption></figure>" for image, words in pictures)
    return f'<div class="sheet {kind}">{"".join(figures)}</div>'


def tiles(figures: Iterable[tuple[str, str, str]]) -> str:
    """(label, figure, note) as tiles."""
    made = (
        f'<div class="tile"><span>{escape(label)}</span><b>{escape(figure)}</b><span>{escape(note)}</span></div>'
        for label, figure, note in figures
    )
    return f'<div class="tiles">{"".join(made)}</div>'


def table(rows: Iterable[Sequence[Any]], head: Sequence[str] = ()) -> str:
    """Rows of texts; all but the first column of a row without words are set as figures."""
    top = f"<tr>{''.join(f'<th>{escape(word)}</th>' for word in head)}</tr>" if head else ""
    lines = []
    for row in rows:
        cells = (f"<td{_figure(text, index)}>{escape(str(text))}</td>" for index, text in enumerate(row))
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return f"<table>{top}{''.join(lines)}</table>" if lines else ""


def folded(title: str, inside: str) -> str:
    """What is shown after a click."""
    return f"<details><summary>{escape(title)}</summary>{inside}</details>" if inside else ""


def frame(page: str, height: int = 460) -> str:
    """A whole page inside the output, apart from it: its scripts, ids and styles meet no others."""
    return f'<iframe srcdoc="{escape(page, quote=True)}" style="height:{height}px" title="model"></iframe>'


def _figure(text: Any, index: int) -> str:
    return ' class="figure"' if index and str(text)[:1].isdigit() else ""
