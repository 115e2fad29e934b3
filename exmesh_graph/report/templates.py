"""The files that pages are made of, and pages as files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from exmesh_graph.report.text import number, seconds, signed, size


def replace_text(path: Path, text: str) -> None:
    """A reader sees the old file or the new one, never half of it."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


def page_of(package: str, name: str, **values: Any) -> str:
    """The template `name` in the folder of `package`, filled in; strings are escaped, Markup is not."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
                              keep_trailing_newline=True)  # fmt: skip
    environment.filters.update(number=number, seconds=seconds, size=size, signed=signed)
    return environment.from_string(asset_text(package, name)).render(**values)


def asset_text(package: str, name: str) -> str:
    """A text file (template, style sheet, script) in the folder of `package`."""
    return (resources.files(package) / name).read_text(encoding="utf-8")


def marked_text(package: str, name: str, parts: Mapping[str, str]) -> str:
    """A text file in which each mark, say @DATA@, is exchanged for its part: for files that hold braces themselves."""
    text = asset_text(package, name)
    for mark, part in parts.items():
        text = text.replace(mark, part)
    return text


def json_in_page(data: Any) -> str:
    """JSON that may stand inside a <script>."""
    return json.dumps(data, ensure_ascii=False).replace("<", "\\u003c")
