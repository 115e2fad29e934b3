"""Sphinx builds the documentation's site from the Markdown pages: see CONTRIBUTING.md. Every link is checked (-W)."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))

from exmesh_graph.version import __version__

project = "exmesh-graph"
author = "the exmesh-graph maintainers"
copyright = "the exmesh-graph maintainers, Apache License 2.0"
version = release = __version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "README"
exclude_patterns = ["_build", "**/.ipynb_checkpoints"]
html_theme = "furo"
html_title = f"exmesh-graph {version}"
myst_enable_extensions = ["dollarmath", "attrs_inline"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # the tutorial is run by its test
suppress_warnings = ["misc.highlighting_failure"]  # JSON with dots for what is left out


def setup(app: Any) -> None:
    """The site's menu comes from the links of docs/README.md, so that a page which it does not name is an error."""
    app.connect("source-read", _add_menu)
    app.connect("build-finished", _add_index)


def _add_menu(app: Any, name: str, source: list[str]) -> None:
    if not name.endswith("README"):
        return
    if "/" in name:
        folder = Path(app.srcdir, name).parent
        groups = {"": sorted(path.stem for path in folder.glob("*.md") if path.stem != "README")}
    else:
        groups = {}
        for part in re.split(r"\n(?=[A-Z][^\n]*\n- )", source[0])[1:]:
            groups[part.partition("\n")[0]] = re.findall(r"\]\(([\w/]+)\.(?:md|ipynb)\)", part)
    for caption, pages in groups.items():
        lines = [":hidden:", *([f":caption: {caption}"] if caption else []), "", *pages]
        source[0] += "\n```{toctree}\n" + "\n".join(lines) + "\n```\n"


def _add_index(app: Any, failure: Exception | None) -> None:
    if failure is None and app.builder.name == "html":
        page = '<!doctype html><meta http-equiv="refresh" content="0; url=README.html">'
        Path(app.outdir, "index.html").write_text(page, encoding="utf-8")
