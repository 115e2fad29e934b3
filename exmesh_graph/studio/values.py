"""Values between JSON and graph files: what a page sends becomes mappings that know where they were written."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Where

EDIT = "(edit)"
"""Stands for a file where an edit of the page was written; relative paths start from its folder."""
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")
_MOST_DEEP, _LONGEST = 20, 20_000


def edit_place(folder: Path, number: int) -> Where:
    """Where the edit of this number stands, counted from 1."""
    return Where(folder / EDIT, number)


def mapped(value: Any, where: Where, depth: int = 0) -> Any:
    """A JSON value as a graph file would hold it. Raises GraphError for what no graph file can hold."""
    if depth > _MOST_DEEP:
        raise GraphError(f"values nest deeper than {_MOST_DEEP} levels", where=str(where))
    if isinstance(value, Mapping):
        result = Map(where)
        for key, item in value.items():
            result.put(_key(key, where), mapped(item, where, depth + 1), where)
        return result
    if isinstance(value, list | tuple):
        return [mapped(item, where, depth + 1) for item in value]
    if isinstance(value, str):
        _check_text(value, where)
    elif isinstance(value, int) and value.bit_length() > 64:
        raise GraphError("a number needs more than 64 bits", where=str(where))
    elif value is not None and not isinstance(value, bool | int | float):
        raise GraphError(f"{type(value).__name__} is no value of a graph file", where=str(where))
    return value


def plain(value: Any) -> Any:
    """A value of a graph file, or of a parameter, as JSON: paths as text, numbers that JSON lacks as `.inf`."""
    if isinstance(value, Mapping):
        return {str(key) if not isinstance(key, int) else key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, PurePath):
        return os.fspath(value)
    return str(value)


def shown_path(path: Path | None, folder: Path) -> str:
    """A file as messages call it: relative to the graph's folder where that is near."""
    if path is None or path.name == EDIT:
        return ""
    near = os.path.relpath(path, folder)
    return str(path) if near.startswith(os.path.join("..", "..", "..")) else near


def _key(key: Any, where: Where) -> str | int:
    if isinstance(key, int) and not isinstance(key, bool):
        return key
    if not isinstance(key, str):
        raise GraphError(f"{key!r} is no key of a graph file", where=str(where))
    _check_text(key, where)
    return int(key) if re.fullmatch(r"[1-9]\d{0,3}", key) else key  # JSON has texts alone: {at: {"3": ...}}


def _check_text(text: str, where: Where) -> None:
    if len(text) > _LONGEST:
        raise GraphError(f"a text has {len(text)} characters", where=str(where), expected=f"at most {_LONGEST}")
    if _CONTROL.search(text):
        raise GraphError(f"control characters in the text {text[:40]!r}", where=str(where), fix="remove them")
