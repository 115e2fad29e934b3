"""Edits as text: the patch, the file as it would be saved with comments and order kept, variants and child files."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

from exmesh_graph.studio.edits import Op

WIDTH = 100


def ops_text(ops: Sequence[Op]) -> str:
    """Patches as a graph file would hold them, one a line."""
    if not ops:
        return ""
    out = io.StringIO()
    _writer().dump(_flowing(list(ops)), out)
    return out.getvalue()


def _writer() -> Any:
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.width, yaml.allow_unicode = 10_000, True
    yaml.indent(mapping=2, sequence=4, offset=2)
    return yaml


def _flowing(ops: Sequence[Op]) -> Any:
    from ruamel.yaml.comments import CommentedSeq

    return CommentedSeq(_flow(op) for op in ops)


def _flow(value: Any) -> Any:
    """A value in one line."""
    from ruamel.yaml.comments import CommentedMap, CommentedSeq

    if isinstance(value, Mapping):
        made = CommentedMap((key, _flow(item)) for key, item in value.items())
        made.fa.set_flow_style()
        return made
    if isinstance(value, list | tuple):
        items = CommentedSeq(_flow(item) for item in value)
        items.fa.set_flow_style()
        return items
    return value
