"""The part of a page in which models are turned with the mouse.

three.js and the models are in the page once, compressed (gzip, base64); the browser unpacks them when the viewer first
comes into view.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Sequence
from importlib import resources

from exmesh_graph.report.collect import Model
from exmesh_graph.report.text import size

_MODULES = {"three": "vendor/three.module.min.js", "orbit": "vendor/OrbitControls.js", "viewer": "viewer.js"}


def viewer_section(models: Sequence[tuple[str, Model]]) -> str:
    """HTML of one viewer with a choice among (label, model); "" without models. Once per page."""
    if not models:
        return ""
    view = resources.files("exmesh_graph.report.view")
    data = {
        "modules": {name: _packed((view / file).read_bytes()) for name, file in _MODULES.items()},
        "models": [
            {"label": label, "caption": f"{model.caption} {size(len(model.data))}.",
             "glb": _packed(model.data)}
            for label, model in models
        ],
    }  # fmt: skip
    here = resources.files(__package__)
    parts = {
        "@DATA@": json.dumps(data, ensure_ascii=False).replace("<", "\\u003c"),
        "@SCRIPT@": (here / "viewer.js").read_text(encoding="utf-8"),
    }
    html = (here / "viewer.html").read_text(encoding="utf-8")
    for mark, text in parts.items():
        html = html.replace(mark, text)
    return html


def _packed(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, 6, mtime=0)).decode("ascii")
