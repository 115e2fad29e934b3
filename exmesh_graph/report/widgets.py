"""What a reader moves in a page: pictures laid over each other, and models turned with the mouse.

The first two panels of a comparison, ours and the truth, lie over each other with a slider, the others beside. The
picture is in the page once; each panel shows its part of it by the background's position. three.js and the models are
in the page once too, compressed (gzip, base64); the browser unpacks them when the viewer first comes into view.
"""

from __future__ import annotations

import base64
import gzip
import struct
from collections.abc import Sequence
from html import escape
from importlib import resources

from exmesh_graph.report.contents import GalleryItem
from exmesh_graph.report.templates import page_of
from exmesh_graph.report.text import size

MODULES = {"three": "vendor/three.module.min.js", "orbit": "vendor/OrbitControls.js", "viewer": "viewer.js"}
GAP = 6
"""White columns between the panels of a strip (gallery.pictures.strip)."""


def comparison(picture: GalleryItem) -> str:
    """HTML of a picture whose `panels` are of one size, the first two ours and the truth; "" for other pictures."""
    shape = panel_size(picture)
    if shape is None:
        return ""
    count, (panel, height) = picture.panels, shape
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


def panel_size(picture: GalleryItem) -> tuple[int, int] | None:
    """(width, height) of a panel where the picture is a comparison, from the PNG's header."""
    count = picture.panels
    if count < 2 or picture.data[:4] != b"\x89PNG":
        return None
    width, height = struct.unpack(">II", picture.data[16:24])
    panel, rest = divmod(width - (count - 1) * GAP, count)
    return (panel, height) if panel >= 1 and rest == 0 else None


def viewer_section(models: Sequence[tuple[str, GalleryItem]]) -> str:
    """HTML of one viewer with a choice among (label, model); "" without models. Once per page."""
    if not models:
        return ""
    view = resources.files("exmesh_graph.report.view")
    data = {
        "modules": {name: _packed((view / file).read_bytes()) for name, file in MODULES.items()},
        "models": [
            {"label": label, "caption": f"{model.caption} {size(len(model.data))}.",
             "glb": _packed(model.data)}
            for label, model in models
        ],
    }  # fmt: skip
    return page_of(__package__, "viewer.html", data=data)


def _packed(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, 6, mtime=0)).decode("ascii")
