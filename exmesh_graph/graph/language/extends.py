"""A graph file over those that it extends: entries are merged by name, `null` takes one away.

Nodes, blocks and the settings of single rounds are merged key by key; an entry with a type of its own (or a `repeat` or
`graph` that the base has not) replaces the base's. Parameters keep their declaration (see `params`).
"""

from __future__ import annotations

import os.path
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.graph.language.params import forget, given, is_declaration
from exmesh_graph.graph.language.yamlfile import Map, files_like, load_yaml
from exmesh_graph.graph.problems import Problems, Where, fail, nearest

MAX_EXTENDS = 32
_GONE = object()


def load_merged(path: Path, problems: Problems, chain: tuple[Path, ...] = ()) -> Map:
    """The mapping of the file `path` over those it extends; `chain` holds the files that led here.

    Raises GraphErrors where a file cannot be read.
    """
    if path in chain:
        names = " -> ".join(p.name for p in [*chain, path])
        fail("extends", Where(chain[-1], 1), f"the files extend each other: {names}")
    if len(chain) > MAX_EXTENDS:
        fail("extends", Where(chain[-1], 1), f"more than {MAX_EXTENDS} files extend one another")
    return over_base(load_yaml(path), path, problems, chain)


def over_base(child: Map, path: Path, problems: Problems, chain: tuple[Path, ...] = ()) -> Map:
    """A graph's own mapping over what it extends; `path` is its file, or stands for one that was never written."""
    if "extends" not in child:
        return child
    where = child.lines["extends"]
    if not isinstance(child["extends"], str):
        fail("extends", where, "extends names one graph file", expected="extends: other.yaml")
    base_path = named_file(path.parent, child["extends"], where)
    if not base_path.is_file():
        fail("extends", where, f"no such graph file: {child['extends']}", nearest=files_like(base_path))
    base = load_merged(base_path.resolve(), problems, (*chain, path))
    if isinstance(base.get("params"), Map) and isinstance(child.get("params"), Map):
        forget(base["params"], child["params"])  # before any is merged: the child's own choices count
    result = _merged(base, child, _top, problems)
    if "name" not in child:
        result.put("name", path.stem, where)
    return result


def named_file(folder: Path, name: str, where: Where) -> Path:
    """The file that a graph names. Only names of graph files are opened: messages show what they say."""
    path = folder / Path(name).expanduser()
    if path.is_file() and not {path.suffix, os.path.splitext(os.path.realpath(path))[1]} <= {".yaml", ".yml"}:
        fail("file", where, f"{name} is not the name of a graph file", expected="a name that ends in .yaml")
    return path


def merge_nodes(base: Map, child: Map, problems: Problems) -> Map:
    """Nodes over the nodes of a base file, or of a sub-graph."""
    return _merged(base, child, _node, problems)


Rule = Callable[[Map, Any, Any, Where, Problems], Any]
"""(base, key, value of the child, where it stands, problems) -> the merged value, or _GONE"""


def _merged(base: Map, child: Map, rule: Rule, problems: Problems) -> Map:
    result = base.copy()
    for key, value in child.items():
        merged = rule(base, key, value, child.lines[key], problems)
        if merged is _GONE:
            result.pop(key, None)
        else:
            result.put(key, merged, child.lines[key])
    return result


def _by_key(rules: Mapping[Any, Rule]) -> Rule:
    """The rule of a mapping in which the mappings under some keys have rules of their own; the rest is replaced."""

    def rule(base: Map, key: Any, value: Any, where: Where, problems: Problems) -> Any:
        old = base.get(key)
        if key in rules and isinstance(value, Map) and isinstance(old, Map):
            return _merged(old, value, rules[key], problems)
        return value

    return rule


_plain = _by_key({})


def _param(base: Map, key: Any, value: Any, where: Where, problems: Problems) -> Any:
    """A declaration with a type replaces the base's, one without changes it; a plain value is a new default."""
    if is_declaration(value) and is_declaration(base.get(key)) and "type" not in value:
        return _merged(base[key], value, _by_key({"choices": _round}), problems)
    return given(base.get(key), value, where)


def _node(base: Map, name: Any, entry: Any, where: Where, problems: Problems) -> Any:
    if entry is None:
        what = "" if name in base else f"cannot remove {name!r}: the base has no such node"
    elif _patches(entry, base.get(name)):
        return _merged(base[name], entry, _setting, problems)
    elif name not in base and isinstance(entry, Map) and not {"type", "repeat", "graph"} & set(entry):
        what = f"{name!r} has no type, and the base has no such node"
    else:
        return entry
    if what:
        problems.add("extends", where, what, nearest=nearest(str(name), map(str, base)))
    return _GONE


def _patches(entry: Any, old: Any) -> bool:
    """Whether an entry changes the one it stands over, and does not replace it."""
    both = isinstance(entry, Map) and isinstance(old, Map)
    return both and "type" not in entry and all(key not in entry or key in old for key in ("repeat", "graph"))


def _setting(base: Map, key: Any, value: Any, where: Where, problems: Problems) -> Any:
    """One key of a node or block."""
    if key in ("every", "at") and value is None:
        return _taken_away(base, key, where, problems)
    rules = {"every": _round, "at": _round, "carry": _plain, "next": _plain}
    return _by_key({**rules, "nodes": _part_node if "graph" in base else _node})(base, key, value, where, problems)


def _part_node(base: Map, name: Any, value: Any, where: Where, problems: Problems) -> Any:
    """Changes to a node of a sub-graph over other changes to it; what they change is not looked at yet."""
    return _merged(base[name], value, _setting, problems) if _patches(value, base.get(name)) else value


def _round(base: Map, number: Any, value: Any, where: Where, problems: Problems) -> Any:
    """The settings of one round of a node."""
    old = base.get(number)
    if value is None:
        return _taken_away(base, number, where, problems)
    if isinstance(value, Map) and isinstance(old, Map) and "type" not in value:
        return _merged(old, value, _plain, problems)
    return value


def _taken_away(base: Map, key: Any, where: Where, problems: Problems) -> Any:
    if key not in base:
        problems.add("extends", where, f"cannot remove {key!r}: the base has no such entry here")
    return _GONE


_top = _by_key({"nodes": _node, "params": _param, "inputs": _plain, "outputs": _plain, "variants": _plain})
