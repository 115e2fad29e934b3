"""A graph file as one tree: `extends` merged, command-line overrides sorted, `${name}` values at hand.

Pipeline of a graph: `load_tree` (here) -> `expand` (unroll repeats, resolve links) -> `check` (types, parameters).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

from exmesh_graph.graph.language.extends import load_merged
from exmesh_graph.graph.language.params import ENV, Declared, declare
from exmesh_graph.graph.language.yamlfile import Map, every, is_whole, parse_yaml
from exmesh_graph.graph.problems import GraphErrors, Problems, Where, closest, fail, nearest

VARIANT_KEYS = ("variants", "matrix", "repeats")  # read by the room `variants`
TOP_KEYS = ("name", "doc", "extends", "params", "seed", "run", "limits", "inputs", "nodes", "outputs", *VARIANT_KEYS)
BLOCK_KEYS = ("repeat", "carry", "nodes", "next", "doc")
MAX_SIZE = 20_000
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*\Z")
_REFERENCE = re.compile(r"\$\$\{|\$\{([^{}]*)\}")


@dataclass(frozen=True)
class Value:
    """A value of a graph file, where it was written, and the folder its relative paths start from.

    `inherited` marks what a round took over from the entry whose type it replaced; `layer` tells settings of the entry
    (0) from those of single rounds and of the command line, which count more.
    """

    value: Any
    where: Where
    base: Path
    inherited: bool = False
    layer: int = 0


@dataclass
class Override:
    """One `--set target=value`; `target` is a graph parameter, `seed`, `node.key` or `block.repeat`."""

    target: str
    value: Any
    used: bool = False


@dataclass
class Tree:
    """A merged graph file before expansion. `run_all`: also nodes that nothing needs run; `limits`: of each node."""

    name: str
    file: Path
    nodes: Map
    outputs: Map
    seed: int
    params: dict[str, Value]
    overrides: list[Override] = field(default_factory=list)
    inputs: Map = field(default_factory=lambda: Map(Where(None)))
    declared: Mapping[str, Declared] = field(default_factory=dict)
    run_all: bool = False
    limits: Map = field(default_factory=lambda: Map(Where(None)))


def load_tree(path: Path, overrides: Iterable[str], problems: Problems) -> Tree:
    """Read `path` with everything it extends, and apply the overrides that concern graph-level values."""
    path = path.absolute()
    return tree_of(load_merged(path, problems), path, overrides, problems)


def tree_of(
    merged: Map, path: Path, overrides: Iterable[str], problems: Problems, given: Mapping[str, Value] | None = None
) -> Tree:
    """The tree of a merged file; what `variants` changes, it changes in `merged` before this.

    `given` holds the parameters that the user of a sub-graph sets.
    """
    root = replace(merged.where, line=1)
    check_keys(merged, TOP_KEYS, "the graph", problems)
    nodes = mapping_in(merged, "nodes", problems)
    if not nodes and not problems:
        fail("graph", root, "the graph has no nodes", expected="nodes: {name: {type: ...}, ...}")
    sets = [_override(text) for text in overrides]
    declared, here = declare(mapping_in(merged, "params", problems), problems), Where(None)
    seed, seeded, said = merged.get("seed", 0), merged.lines.get("seed", root), dict[str, Value]()
    for name, param in declared.items():
        if param.env.startswith(ENV) and (text := os.environ.get(param.env)) is not None:
            text = text if param.kind in ("str", "path") else parse_yaml(text, None)
            said[name] = Value(text, param.declared_at or here, here.base)
    for override in sets:
        target, override.used = override.target, "." not in override.target
        if target in declared:
            said[target] = Value(override.value, here, here.base)
        elif target == "seed":
            seed, seeded = override.value, here
        elif override.used:
            _unknown_target(target, declared, nodes, problems)
    if not is_whole(seed, 0, 2**31 - 1):
        problems.add("seed", seeded, f"seed must be a whole number from 0 to {2**31 - 1}, not {seed!r}")
        seed = 0
    run = merged.get("run", "needed")
    if run not in ("needed", "all"):
        problems.add("graph", merged.lines["run"], f"run cannot be {run!r}", expected="needed, or all")
    name = str(merged.get("name", path.stem))
    outputs = mapping_in(merged, "outputs", problems)
    values = resolve_params(declared, problems, said, given or {})
    for key, param in declared.items():
        for choice, other, value, where in param.settings():
            if other not in declared:
                what = f"the choice {choice} of {key} sets {other!r}, which is no parameter of the graph"
                problems.add(
                    "param", where, what, nearest=closest(other, declared), fix=f"declare {other} under params:"
                )
            elif not _names_in(value):  # with references, only what is chosen can be judged
                declared[other].judge(value, where, problems)
        if param.required and values[key].value is None and key not in {**said, **(given or {})}:
            problems.add("param", param.where, f"the graph parameter {key} must be given", expected=str(param),
                         fix=f"--set {key}=VALUE")  # fmt: skip
        else:
            values[key] = replace(values[key], value=param.judge(values[key].value, values[key].where, problems))
    inputs = mapping_in(merged, "inputs", problems)
    limits = mapping_in(merged, "limits", problems)
    return Tree(name, path, nodes, outputs, seed, values, sets, inputs, declared, run == "all", limits)


def substitute(value: Any, scope: Mapping[str, Value], where: Where, problems: Problems) -> Value:
    """Replace `${name}` in strings, lists and mappings; a string that is nothing but `${name}` keeps the type.

    Relative paths start where the leading `${name}` was written, otherwise at the file of the string itself.
    `$${` stands for a literal `${`.
    """
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        replaced = {key: substitute(item, scope, where, problems).value for key, item in items}
        made = replaced if isinstance(value, dict) else list(replaced.values())
        _check_size(made, where)
        return Value(made, where, where.base)
    if not isinstance(value, str) or "${" not in value:
        return Value(value, where, where.base)

    def look_up(name: str) -> Value:
        if name not in scope:
            problems.add("param", where, f"${{{name}}} is not a parameter here", nearest=nearest(name, scope))
        return scope.get(name, Value("", where, where.base))

    first, size = _REFERENCE.match(value), 0
    if first and first[1] is not None and first[0] == value:
        return replace(look_up(first[1]), where=where)

    def replacement(match: re.Match[str]) -> str:
        nonlocal size
        if match[1] is None:
            return "${"
        inner = look_up(match[1]).value
        if isinstance(inner, list | dict):
            what = f"${{{match[1]}}} is {'a list' if isinstance(inner, list) else 'a mapping'}"
            problems.add("param", where, f"{what}, which cannot be a part of a text")
            return ""
        text = str(inner).lower() if isinstance(inner, bool) else str(inner)
        size += len(text)
        _check_size(None, where, size)
        return text

    base = scope[first[1]].base if first and first[1] in scope else where.base
    return Value(_REFERENCE.sub(replacement, value), where, base)


def _check_size(value: Any, where: Where, size: int = 0) -> None:
    """Refuse more than MAX_SIZE values and characters, with `size` before: lists that repeat each other grow fast."""
    for item in every(value):
        size += 1 + (len(item) if isinstance(item, str) else 0)
        if size > MAX_SIZE:
            fail("param", where, f"with its parameters, this value grows beyond {MAX_SIZE} values and characters")


def _override(text: str) -> Override:
    expected = "--set name=value or --set node.param=value"
    target, equals, value = text.partition("=")
    if not equals or not target.strip():
        fail("set", Where(None), f"cannot read --set {text!r}", expected=expected)
    try:
        return Override(target.strip(), value if value.startswith("@") else parse_yaml(value, None))
    except GraphErrors as error:
        fail("set", Where(None), f"cannot read the value of --set {text!r}: {error.problems[0].what}",
             expected=f"{expected}, the value as in a graph file; quote it where it holds signs of YAML")  # fmt: skip


def _unknown_target(target: str, params: Iterable[str], nodes: Map, problems: Problems) -> None:
    """`--set target=...` where `target` is no graph parameter."""
    names, fix = [*params, "seed"], ""
    if target in nodes:
        what = "repeat" if isinstance(nodes[target], Map) and "repeat" in nodes[target] else "PARAMETER"
        fix = f"a node's parameter is set by --set {target}.{what}=VALUE"
    problems.add("set", Where(None), f"the graph has no parameter {target!r}", expected=", ".join(names),
                 nearest=nearest(target, names), fix=fix)  # fmt: skip


def resolve_params(
    declared: Mapping[str, Declared], problems: Problems, said: Mapping[str, Value], given: Mapping[str, Value]
) -> dict[str, Value]:
    """The values of parameters, which may refer to each other, and whose choices may set others.

    `said` are values that count more than defaults and choices, `given` are finished ones.
    """
    raw = {name: Value(param.default, param.where, param.where.base) for name, param in declared.items()} | dict(said)
    offers: dict[str, list[tuple[str, Any, Any, Where]]] = {name: [] for name in raw if name not in given}
    for setter, param in declared.items():
        for choice, name, value, where in param.settings():
            if name in offers and name not in said:
                offers[name].append((setter, choice, value, where))
    uses = {name: [setter for setter, *_ in offered] for name, offered in offers.items()}
    for name, offered in offers.items():  # all choices: whether they refer to each other does not depend on the chosen
        uses[name] += _names_in([raw[name].value, *(value for _, _, value, _ in offered)])
    try:
        order = [name for name in TopologicalSorter(uses).static_order() if name in offers]
    except CycleError as error:
        cycle = error.args[1][::-1]
        what = f"the parameters refer to each other, or set each other by choices: {' -> '.join(cycle)}"
        fail("param", raw[cycle[0]].where, what, fix="take one of these references or settings away")
    done = dict(given)
    for name in order:
        chosen = [offer for offer in offers[name] if done[offer[0]].value == offer[1]]
        if len(chosen) > 1:
            names = " and ".join(f"{setter}: {choice}" for setter, choice, *_ in chosen)
            problems.add("param", chosen[1][3], f"{name} is set twice, by {names}", fix=f"--set {name}=VALUE")
        value, where = chosen[0][2:] if chosen else (raw[name].value, raw[name].where)
        done[name] = substitute(value, done, where, problems)
    return {name: done[name] for name in raw}


def _names_in(value: Any) -> list[str]:
    return [name for text in every(value) if isinstance(text, str) for name in _REFERENCE.findall(text) if name]


def mapping_in(tree: Map, key: str, problems: Problems) -> Map:
    """The mapping of names under a key, an empty one where there is none."""
    value = tree.get(key)
    where = tree.lines.get(key, tree.where)
    if value is None:
        return Map(where)
    if not isinstance(value, Map):
        problems.add("graph", where, f"{key}: must be a mapping", found=repr(value))
        return Map(where)
    for name in value:
        if not isinstance(name, str) or not NAME.match(name):
            problems.add("name", value.lines[name], f"{name!r} is not a name", expected="letters, digits, _ and -")
    return value


def check_keys(tree: Map, known: tuple[str, ...], what: str, problems: Problems) -> None:
    """Note the keys of a mapping that mean nothing there."""
    for key in tree:
        if key not in known:
            problems.add("key", tree.lines[key], f"{what} has no key {key!r}", nearest=closest(key, known))
