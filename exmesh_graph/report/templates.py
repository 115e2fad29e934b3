"""The files that pages are made of, and pages as files."""

from __future__ import annotations

import base64
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
    """The template `name` in the folder of `package`, filled in; strings are escaped, Markup is not.

    In it `asset(file)` is the text of a style sheet or script beside it, and `tojson` makes data for a <script>.
    """
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
                              keep_trailing_newline=True)  # fmt: skip
    environment.filters.update(number=number, seconds=seconds, size=size, signed=signed)
    environment.globals["asset"] = lambda file, folder=package: Markup(asset_text(folder, file))
    environment.policies["json.dumps_kwargs"] = {"ensure_ascii": False}
    return environment.from_string(asset_text(package, name)).render(**values)


def data_uri(kind: str, data: bytes) -> str:
    """A file as it stands in a page; `kind` as image/png."""
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


def asset_text(package: str, name: str) -> str:
    """A text file (template, style sheet, script) in the folder of `package`."""
    return (resources.files(package) / name).read_text(encoding="utf-8")
