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
        tree, extended, nothing = self.graph.tree, self.graph.extended, Map(self.graph.tree.where)
        result = tree.copy()
        if "extends" in tree:
            result["extends"] = self._moved(tree["extends"], tree.lines["extends"].base)
        if "nodes" in tree:
            result["nodes"] = self._nodes(tree["nodes"], self.graph.base)
        self._nodes(self.graph.base, nothing)  # which graph parameters are paths there
        for key in ("variants", "matrix"):
            if key in tree:
                result[key] = self._nodes(tree[key], nothing)
        params = map_or_empty(tree.get("params"), tree.where).copy()
        for name in params.keys() & (self.path_params | _paths_in(params) | _paths_in(extended.get("params"))):
            value = params[name]
            if not isinstance(value, Map):
                params[name] = self._moved(value, params.lines[name].base)
            elif "default" in value:
                params[name] = value.copy()
                params[name]["default"] = self._moved(value["default"], value.lines["default"].base)
        if params:
            result["params"] = params
        return _ordered(result, ("name", "doc", "extends", "seed", "inputs", "params", "nodes", "outputs"))

    def _nodes(self, value: Any, base: Map, kind: str = "") -> Any:
        """A copy of nodes, of one node, or of patches that hold some; `base` is what it stands over.

        `kind` is the type of the node that it belongs to, as the settings of a round do.
        """
        if isinstance(value, list):
            return [self._nodes(item, base, kind) for item in value]
        if not isinstance(value, Map):
            return value
        kind = str(value.get("type", base.get("type", kind)))
        known, paths, result = self.graph.signature(kind), self._path_keys(kind), value.copy()
        for holder in (base, value):
            if isinstance(holder.get("graph"), str):
                paths = {"graph", *self._path_params_of(holder.lines["graph"].base / holder["graph"])}
        for key, item in value.items():
            if key in paths:
                result[key] = self._moved(item, value.lines[key].base)
            elif known is None or key not in known.params.model_fields:
                result[key] = self._nodes(item, map_or_empty(base.get(key), base.where), kind)
        target = value.get("set")
        if isinstance(target, Map):
            for key in filter(self._sets_path, target):
                result["set"][key] = self._moved(target[key], target.lines[key].base)
        elif isinstance(target, str) and "to" in value and self._sets_path(target):
            result["to"] = self._moved(value["to"], value.lines["to"].base)
        return result

    def _sets_path(self, target: str) -> bool:
        node, _, key = re.sub(r"\[\d+\]", "", target).rpartition(".")
        if not node:
            return key in self.path_params
        try:
            scope, name = self.graph.at(node)
        except GraphErrors:
            return False
        return key in self._path_keys(scope.type_of(name))

    def _path_keys(self, kind: str) -> set[str]:
        known = self.graph.signature(kind)
        return set() if known is None else {old for name in known.path_fields for old in known.names_of(name)}

    def _path_params_of(self, file: Path) -> set[str]:
        """The path parameters of the file that a sub-graph is made from."""
        try:
            return _paths_in(load_merged(file.resolve(), Problems()).get("params"))
        except GraphErrors:
            return set()

    def _moved(self, value: Any, base: Path) -> Any:
        """The value of a path parameter: a path, a graph parameter that leads one, or several."""
        if isinstance(value, list):
            return [self._moved(item, base) for item in value]
        if isinstance(value, Map):
            result = value.copy()
            result.update({key: self._moved(item, base) for key, item in value.items()})
            return result
        if not isinstance(value, str) or not value:
            return value
        if leading := _LEADING.match(value):
            self.path_params.add(leading[1])
        if base == self.folder or value.startswith(("~", "@", "${")) or PurePath(value).is_absolute():
            return value
        path = normal_path(base / value)
        if ".." in PurePath(path).parts:  # through a symbolic link: as it was written
            return path
        near = os.path.relpath(path, self.folder)
        return path if near.startswith(os.path.join("..", "..", "..")) else near


def _paths_in(params: Any) -> set[str]:
    """The graph parameters that are declared to be paths."""
    items = params.items() if isinstance(params, Map) else ()
    return {str(name) for name, value in items if isinstance(value, Map) and value.get("type") == "path"}


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
