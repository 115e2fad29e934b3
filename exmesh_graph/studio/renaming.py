"""The other name of a node in what a file says beside its graph: the patches of its variants and of its matrix, and the
nodes whose seed its repeats change. Only the names themselves are replaced, as in `textedit`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.variants.declared import rows_of
from exmesh_graph.graph.variants.patches import OPERATIONS, apply_patches
from exmesh_graph.studio.textedit import composed, one_line

_BESIDE = ("variants", "matrix", "repeats")
_ROUND = r"(?:\[\d+\])?"


def with_name(text: str, path: Sequence[Any], name: str) -> str:
    """The text with the patches that name the node at a path of keys, `nodes rounds nodes step`, naming it `name`."""
    words = [str(word) for word in path[1::2]]
    for scalar, new in sorted(_found(composed(text), words, name), key=lambda one: -one[0].start_mark.index):
        text = text[: scalar.start_mark.index] + one_line(new) + text[scalar.end_mark.index :]
    return text


def check_rows(before: Map, after: Map, packs: Packs) -> None:
    """Raise GraphError where a variant could be made of `before` and can no longer be made of `after`."""
    old = {row.name: row.patches for row in rows_of(before)}
    for row in rows_of(after):
        try:
            apply_patches(after, row.patches, packs)
        except GraphErrors as error:
            try:
                apply_patches(before, old.get(row.name, ()), packs)
            except GraphErrors:
                continue  # it could not be made before either
            what = f"the variant {row.name} does not fit the other name: {error.problems[0].what}"
            raise GraphError(what, fix="save the edits as a variant, or change the text by hand") from error


def _found(root: Any, words: list[str], name: str) -> Iterator[tuple[Any, str]]:
    for key, value in _entries(root):
        if key.value in _BESIDE:
            yield from _walk(value, words, name, key.value == "repeats")


def _walk(node: Any, words: list[str], name: str, names: bool) -> Iterator[tuple[Any, str]]:
    """The scalars below a value that name the node; with `names` each text is the name of a node."""
    if type(node).__name__ == "SequenceNode":
        for item in node.value:
            yield from _walk(item, words, name, names)
        return
    if type(node).__name__ == "ScalarNode":
        yield from _target(node, words, name) if names else ()
        return
    operation = next((key.value for key, _ in _entries(node) if key.value in OPERATIONS), "")
    for key, value in _entries(node):
        if not operation:
            yield from _walk(value, words, name, names)
        elif key.value == operation and type(value).__name__ == "MappingNode" and operation == "set":
            for target, _ in _entries(value):  # {set: {one.value: 1, two.value: 2}}
                yield from _target(target, words, name)
        elif key.value in (operation, "on") and type(value).__name__ != "MappingNode":
            for one in value.value if type(value).__name__ == "SequenceNode" else [value]:
                yield from _target(one, words, name)
    if operation not in ("", "set"):
        yield from _links(node, words, name, _text_of(node, operation))


def _target(node: Any, words: list[str], name: str) -> Iterator[tuple[Any, str]]:
    pattern = rf"@?(?:{''.join(f'{re.escape(word)}{_ROUND}[.]' for word in words[:-1])})"
    match = re.match(rf"({pattern}){re.escape(words[-1])}(?=$|\.)", str(node.value))
    if match:
        yield node, f"{match[1]}{name}{node.value[match.end() :]}"


def _links(node: Any, words: list[str], name: str, target: str) -> Iterator[tuple[Any, str]]:
    """The links of a patch, which are read where its target stands: from there or from outside of it."""
    scope = ".".join(words[:-1])
    if scope and not re.sub(r"\[\d+\]", "", target).startswith(f"{scope}."):
        return
    for key, value in _entries(node):
        if type(value).__name__ == "MappingNode":
            yield from _links(value, words, name, target)
        elif key.value != "on" and type(value).__name__ == "ScalarNode" and value.value.startswith("@"):
            yield from _target(value, words[-1:], name)


def _text_of(node: Any, operation: str) -> str:
    """What a patch is about: its target, or the name of the node that it adds."""
    value = next(value for key, value in _entries(node) if key.value == operation)
    if type(value).__name__ == "MappingNode":
        return next((str(inner.value) for key, inner in _entries(value) if key.value == "name"), "")
    return str(value.value) if type(value).__name__ == "ScalarNode" else ""


def _entries(node: Any) -> Iterator[tuple[Any, Any]]:
    return iter(node.value if type(node).__name__ == "MappingNode" else ())
