"""Changing single values in the text of a YAML file: all other characters stay, comments and line breaks among them.

The parser of ruamel.yaml says where each value stands; the text between is cut and pasted. What comes out is parsed
again by the caller and compared with what was meant: aliases and merge keys can make one place stand for several.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from typing import Any

from exmesh_graph.errors import GraphError

Path = Sequence[Any]


def with_value(text: str, path: Path, value: Any) -> str:
    """The text with a value at a path of keys; mappings on the way are made where there are none."""
    root = composed(text)
    if root is None:
        return f"{text.rstrip()}\n{_line(path, value)}\n".lstrip("\n")
    node, depth = _deepest(root, path)
    rest = path[depth:]
    if not rest:
        return _replaced(text, root, path, one_line(value))
    if depth == 0 and not root.flow_style:
        return _inserted(text, root, _line(path, value))
    if type(node).__name__ != "MappingNode":
        return _replaced(text, root, path[:depth], one_line(_nested(rest, value)))
    return _inserted(text, node, f"{one_line(rest[0])}: {one_line(_nested(rest[1:], value))}")


def with_block(text: str, path: Path, lines: Sequence[str]) -> str:
    """The text with a list at a path of two keys, an item a line: `variants:`, `  name:`, `    - item`."""
    root = composed(text)
    node, depth = (root, 0) if root is None else _deepest(root, path)
    if node is None or depth == 0:
        body = "".join(f"    - {line}\n" for line in lines)
        return f"{text.rstrip()}\n{one_line(path[0])}:\n  {one_line(path[1])}:\n{body}".lstrip("\n")
    if depth == len(path):
        return with_block(without(text, path), path, lines)
    if type(node).__name__ != "MappingNode" or node.flow_style or not node.value:
        return with_value(text, path, [_parsed(line) for line in lines])
    indent = " " * node.value[0][0].start_mark.column
    body = "".join(f"\n{indent}  - {line}" for line in lines)
    return _inserted(text, node, f"{one_line(path[1])}:{body}")


def without(text: str, path: Path) -> str:
    """The text without the entry at a path; a mapping that would become empty goes with it."""
    root = composed(text)
    holder, depth = _deepest(root, path[:-1])
    if depth < len(path) - 1 or type(holder).__name__ != "MappingNode":
        return text
    entries = [(key, value) for key, value in holder.value if _key(key) == path[-1]]
    if not entries:
        return text
    if len(holder.value) == 1 and len(path) > 1:
        return without(text, path[:-1])
    key, value = entries[0]
    begin, end = key.start_mark.index, _end(value)
    if holder.flow_style:
        after = len(text[end:]) - len(text[end:].lstrip())
        if text[end + after : end + after + 1] == ",":
            end += after + 1
            end += len(text[end:]) - len(text[end:].lstrip(" "))
            if text[end : end + 1] == "\n":
                begin -= len(text[:begin]) - len(text[:begin].rstrip(" "))
        else:
            begin = text.rindex(",", 0, begin)
        return text[:begin] + text[end:]
    begin = text.rfind("\n", 0, begin) + 1
    stop = text.find("\n", end)
    return text[:begin] + (text[stop + 1 :] if stop >= 0 else "")


def renamed(text: str, path: Path, name: str) -> str:
    """The text with another key at a path; what stands under it stays."""
    holder, depth = _deepest(composed(text), path[:-1])
    for key, _ in _entries(holder) if depth == len(path) - 1 else ():
        if _key(key) == path[-1]:
            return text[: key.start_mark.index] + one_line(name) + text[key.end_mark.index :]
    return text


def one_line(value: Any) -> str:
    """A value as it stands in a graph file, in one line."""
    out = io.StringIO()
    _writer().dump(_flow([value]), out)
    return out.getvalue().strip()[1:-1]


def composed(text: str) -> Any:
    """The tree of nodes with their places in the text; None for an empty one."""
    from ruamel.yaml import YAML

    return YAML(typ="safe", pure=True).compose(text)


def _writer() -> Any:
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.width, yaml.allow_unicode = 1_000_000, True
    yaml.brace_single_entry_mapping_in_flow_sequence = True
    return yaml


def _flow(value: Any) -> Any:
    """A value in flow style; links and texts with references in double quotes, as graph files have them."""
    from ruamel.yaml.comments import CommentedMap, CommentedSeq
    from ruamel.yaml.scalarstring import DoubleQuotedScalarString

    if isinstance(value, dict):
        made = CommentedMap((_flow(key), _flow(item)) for key, item in value.items())
        made.fa.set_flow_style()
        return made
    if isinstance(value, list | tuple):
        items = CommentedSeq(_flow(item) for item in value)
        items.fa.set_flow_style()
        return items
    if isinstance(value, str) and (value.startswith(("@", "*", "&", "!", "%")) or "${" in value or "\n" in value):
        return DoubleQuotedScalarString(value)
    return value


def _parsed(text: str) -> Any:
    from exmesh_graph.graph.language.yamlfile import parse_yaml

    return parse_yaml(text, None)


def _key(node: Any) -> Any:
    """A key as graph files read it: whole numbers are numbers."""
    value = node.value
    return int(value) if isinstance(value, str) and str(node.tag).endswith(":int") else value


def _deepest(root: Any, path: Path) -> tuple[Any, int]:
    """The node furthest along a path, and how many keys lead to it."""
    node, depth = root, 0
    for key in path:
        found = next((value for name, value in _entries(node) if _key(name) == key), None)
        if found is None:
            break
        node, depth = found, depth + 1
    return node, depth


def _entries(node: Any) -> Iterator[tuple[Any, Any]]:
    return iter(node.value if type(node).__name__ == "MappingNode" else ())


def _end(node: Any) -> int:
    """Where the last character of a value stands; block collections end with their last value."""
    kind = type(node).__name__
    if kind == "MappingNode" and not node.flow_style and node.value:
        return max(_end(node.value[-1][1]), int(node.value[-1][0].end_mark.index) + 1)
    if kind == "SequenceNode" and not node.flow_style and node.value:
        return _end(node.value[-1])
    return int(node.end_mark.index)


def _replaced(text: str, root: Any, path: Path, value: str) -> str:
    """The text with another value at a path that there is; an empty one stands behind its colon."""
    holder, _ = _deepest(root, path[:-1])
    key, node = next((name, item) for name, item in _entries(holder) if _key(name) == path[-1])
    begin, end = int(node.start_mark.index), _end(node)
    if begin >= end:
        at = text.index(":", int(key.end_mark.index)) + 1
        return f"{text[:at]} {value}{text[at:]}"
    return text[:begin] + value + text[end:]


def _inserted(text: str, node: Any, entry: str) -> str:
    """The text with one more entry at the end of a mapping."""
    if node.flow_style:
        close = int(node.end_mark.index) - 1
        if text[close] != "}":
            raise GraphError("the file cannot be changed at this place", fix="save the edits as a variant")
        if not node.value:
            return f"{text[:close]}{entry}{text[close:]}"
        at = _end(node.value[-1][1])
        return f"{text[:at]}, {entry}{text[at:]}"
    at = text.find("\n", _end(node))
    at = len(text) if at < 0 else at
    indent = " " * (node.value[0][0].start_mark.column if node.value else 0)
    return f"{text[:at]}\n{indent}{entry}{text[at:]}"


def _line(path: Path, value: Any) -> str:
    """A new entry of the whole file; what it holds stands below it."""
    if len(path) == 1:
        return f"{one_line(path[0])}: {one_line(value)}"
    return f"{one_line(path[0])}:\n  {one_line(path[1])}: {one_line(_nested(path[2:], value))}"


def _nested(keys: Path, value: Any) -> Any:
    for key in reversed(keys):
        value = {key: value}
    return value
