"""Graph files of a folder, told apart from other YAML files without reading them as graphs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

_HEAD = 64 << 10
_GRAPH = re.compile(r"^(nodes|extends):", re.MULTILINE)
_INPUTS = re.compile(r"^inputs:", re.MULTILINE)


def graph_file_facts(path: Path) -> dict[str, Any] | None:
    """The first comment of a graph file, and its variants; None for what is no graph file."""
    try:
        with path.open("rb") as file:
            text = file.read(_HEAD).decode("utf-8", "replace")
    except OSError:
        return None
    if not _GRAPH.search(text):
        return None
    comments = [line.lstrip("# ").strip() for line in text.splitlines() if line.startswith("#")]
    told = [line for line in comments if line and not line.startswith("yaml-language-server")]
    variants = re.search(r"^variants:\s*\n((?:(?:[ \t].*|#.*)?\n)*)", text, re.MULTILINE)
    names = re.findall(r"^( +)([A-Za-z_][\w-]*):", variants[1] if variants else "", re.MULTILINE)
    return {
        "doc": told[0] if told else "",
        "variants": [name for indent, name in names if indent == names[0][0]],
        "part": bool(_INPUTS.search(text)),
    }
