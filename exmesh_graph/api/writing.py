"""A graph that was built in Python as the text of a graph file. Relative paths start from the folder it goes to."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from exmesh_graph.api.scope import map_or_empty
from exmesh_graph.errors import GraphError
from exmesh_graph.graph.language.extends import load_merged
from exmesh_graph.graph.language.nodecheck import normal_path
from exmesh_graph.graph.language.yamlfile import Map, parse_yaml
from exmesh_graph.graph.problems import GraphErrors, Problems

if TYPE_CHECKING:
    from exmesh_graph.api.builder import Graph

_WIDTH = 116
_LEADING = re.compile(r"\$\{([^{}]*)\}")


def yaml_text(graph: Graph, folder: Path) -> str:
    """The text of a graph file that lies in `folder` and means what `graph` means."""
    from ruamel.yaml import YAML

    moved = _Mover(graph, folder).tree()
    writer = YAML()
    writer.width, writer.allow_unicode = 10 * _WIDTH, True
    writer.indent(mapping=2, sequence=4, offset=2)
    out = io.StringIO()
    writer.dump(_laid_out(moved, 0), out)
    text = out.getvalue()
    if parse_yaml(text, None) != moved:  # what was written must be what is read
        raise GraphError("the graph cannot be written as YAML", where=graph.name,
                         expected="values without control characters")  # fmt: skip
    return text


class _Mover:
    """A copy of a graph's tree whose relative paths start from another folder."""

    def __init__(self, graph: Graph, folder: Path) -> None:
        self.graph, self.folder = graph, folder
        self.path_params: set[str] = set()  # graph parameters that hold paths

    def tree(self) -> Map:
        tree = self.graph.tree
        result = tree.copy()
        if "extends" in tree:
            result["extends"] = self._moved(tree["extends"], tree.lines["extends"].base)
        if isinstance(tree.get("nodes"), Map):
            result["nodes"] = self._nodes(tree["nodes"], self.graph.base)
        self._nodes(self.graph.base, Map(tree.where))  # which graph parameters are paths there
        for key in ("variants", "matrix"):
            if key in tree:
                result[key] = self._patches(tree[key])
        if isinstance(tree.get("params"), Map):
            result["params"] = self._params(tree["params"])
        order = ("name", "doc", "extends", "seed", "inputs", "params", "nodes", "outputs")
        return _ordered(result, order)

    def _nodes(self, nodes: Map, base: Map) -> Map:
        result = nodes.copy()
        for name, entry in nodes.items():
            if isinstance(entry, Map):
                result[name] = self._entry(entry, map_or_empty(base.get(name), entry.where))
        return result

    def _entry(self, entry: Map, base: Map) -> Map:
        result = entry.copy()
        if isinstance(entry.get("nodes"), Map):
            result["nodes"] = self._nodes(entry["nodes"], map_or_empty(base.get("nodes"), entry.where))
        paths = self._path_keys(str(entry.get("type", base.get("type", ""))))
        if "graph" in entry or "graph" in base:
            paths = {"graph", *self._path_params_of_part(entry, base)}
        for key in paths & set(entry):
            result[key] = self._value(entry[key], entry.lines[key].base)
        for key in ("at", "every"):
            if isinstance(entry.get(key), Map):
                rounds = entry[key].copy()
                for number, patch in entry[key].items():
                    if isinstance(patch, Map):
                        rounds[number] = self._entry(patch, entry if "type" in entry else base)
                result[key] = rounds
        return result

    def _patches(self, value: Any) -> Any:
        """Patches of variants: new nodes and sub-graphs hold paths where others do, `set` where its target does."""
        if isinstance(value, list):
            return [self._patches(item) for item in value]
        if not isinstance(value, Map):
            return value
        if isinstance(value.get("type", value.get("graph")), str):
            return self._entry(value, Map(value.where))
        result = value.copy()
        for key, item in value.items():
            result[key] = self._patches(item)
        target = value.get("set")
        if isinstance(target, Map):
            for key in filter(self._sets_path, target):
                result["set"][key] = self._value(target[key], target.lines[key].base)
        elif isinstance(target, str) and "to" in value and self._sets_path(target):
            result["to"] = self._value(value["to"], value.lines["to"].base)
        return result

    def _sets_path(self, target: str) -> bool:
        node, _, key = re.sub(r"\[\d+\]", "", target).rpartition(".")
        if not node:
            return key in self.path_params
        try:
            scope, name = self.graph.at(node, self.graph.tree.where)
        except GraphErrors:
            return False
        return key in self._path_keys(scope.type_of(name))

    def _params(self, params: Map) -> Map:
        result = params.copy()
        for name, value in params.items():
            if isinstance(value, Map) and "default" in value:
                if value.get("type") == "path" or name in self.path_params:
                    result[name] = value.copy()
                    result[name]["default"] = self._moved(value["default"], value.lines["default"].base)
            elif name in self.path_params or self._is_path_in_base(name):
                result[name] = self._moved(value, params.lines[name].base)
        return result

    def _is_path_in_base(self, name: str) -> bool:
        params = self.graph.extended.get("params")
        declared = params.get(name) if isinstance(params, Map) else None
        return isinstance(declared, Map) and declared.get("type") == "path"

    def _path_keys(self, kind: str) -> set[str]:
        known = self.graph.signature(kind)
        return set() if known is None else {old for name in known.path_fields() for old in known.names_of(name)}

    def _path_params_of_part(self, entry: Map, base: Map) -> set[str]:
        """The path parameters of the file that a sub-graph is made from."""
        holder = entry if "graph" in entry else base
        file = holder.lines["graph"].base / str(holder["graph"])
        try:
            params = load_merged(file.resolve(), Problems()).get("params")
        except GraphErrors:
            return set()
        items = params.items() if isinstance(params, Map) else ()
        return {str(name) for name, value in items if isinstance(value, Map) and value.get("type") == "path"}

    def _value(self, value: Any, base: Path) -> Any:
        """The value of a path parameter: a path, a graph parameter that leads one, or several."""
        if isinstance(value, list):
            return [self._value(item, base) for item in value]
        if isinstance(value, Map):
            result = value.copy()
            for key, item in value.items():
                result[key] = self._value(item, base)
            return result
        leading = _LEADING.match(value) if isinstance(value, str) else None
        if leading:
            self.path_params.add(leading[1])
            return value
        return self._moved(value, base)

    def _moved(self, value: Any, base: Path) -> Any:
        if not isinstance(value, str) or not value or base == self.folder:
            return value
        if value.startswith(("~", "@", "${")) or PurePath(value).is_absolute():
            return value
        path = normal_path(base / value)
        if ".." in PurePath(path).parts:  # through a symbolic link: as it was written
            return path
        near = os.path.relpath(path, self.folder)
        return path if near.startswith(os.path.join("..", "..", "..")) else near


def _ordered(tree: Map, first: tuple[str, ...]) -> Map:
    result = Map(tree.where)
    for key in dict.fromkeys([*(key for key in first if key in tree), *tree]):
        if not (isinstance(tree[key], Map) and not tree[key]):  # an empty mapping says nothing
            result.put(key, tree[key], tree.lines[key])
    return result


def _laid_out(value: Any, depth: int) -> Any:
    """The tree for the writer: what is small or a node's entry in one line, the rest in blocks."""
    from ruamel.yaml.comments import CommentedMap, CommentedSeq

    if isinstance(value, dict):
        result = CommentedMap((key, _laid_out(item, depth + 1)) for key, item in value.items())
        if depth and not any(map(_is_block, _mappings(value))) and not _is_group(value) and len(repr(value)) < _WIDTH:
            result.fa.set_flow_style()
        return result
    if isinstance(value, list):
        items = CommentedSeq(_laid_out(item, depth + 1) for item in value)
        if depth and len(repr(value)) < _WIDTH:
            items.fa.set_flow_style()
        return items
    return value


def _is_block(value: dict[Any, Any]) -> bool:
    return "repeat" in value or isinstance(value.get("nodes"), dict)


def _is_group(value: dict[Any, Any]) -> bool:
    """Several entries, as in `nodes:` and `params:`."""
    return any(isinstance(item, dict) for item in value.values()) and "type" not in value


def _mappings(value: Any) -> Iterator[dict[Any, Any]]:
    if isinstance(value, dict):
        yield value
        for item in value.values():
            yield from _mappings(item)
    elif isinstance(value, list):
        for item in value:
            yield from _mappings(item)
