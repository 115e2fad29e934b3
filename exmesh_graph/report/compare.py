"""A strip of panels as a comparison with a slider: ours over the truth, the other panels beside.

The picture is in the page once; each panel shows its part of it by the background's position.
"""

from __future__ import annotations

import struct
from html import escape

from exmesh_graph.report.collect import Picture

GAP = 6
"""White columns between the panels of a strip (report.pictures.strip)."""


def comparison(picture: Picture) -> str:
    """HTML of a picture whose `panels` are of one size, the first two ours and the truth; "" for other pictures."""
    size = panel_size(picture)
    if size is None:
        return ""
    count, (panel, height) = picture.panels, size
    width = count * panel + (count - 1) * GAP

    def part(index: int, name: str) -> str:
        style = (
            f"background-size:{100 * width / panel:.4f}% 100%;background-position:{100 * index / (count - 1):.4f}% 0"
        )
        return f'<div class="{name}" style="{style}"></div>'

    rest = "".join(f'<div class="side">{part(index, "panel")}</div>' for index in range(2, count))
    return (
        f'<div class="compare" style="--strip:url({picture.data_uri});--shape:{panel}/{height}" '
        f'role="img" aria-label="{escape(picture.title, quote=True)}">'
        f'<div class="side">{part(1, "panel")}{part(0, "panel over")}'
        '<input type="range" min="0" max="100" value="50" aria-label="left of the line ours, right of it the truth" '
        "oninput=\"this.parentNode.style.setProperty('--cut',this.value+'%')\"></div>"
        f"{rest}</div>"
    )


def panel_size(picture: Picture) -> tuple[int, int] | None:
    """(width, height) of a panel where the picture is a comparison, from the PNG's header."""
    count = picture.panels
    if count < 2 or picture.data[:4] != b"\x89PNG":
        return None
    width, height = struct.unpack(">II", picture.data[16:24])
    panel, rest = divmod(width - (count - 1) * GAP, count)
    return (panel, height) if panel >= 1 and rest == 0 else None
