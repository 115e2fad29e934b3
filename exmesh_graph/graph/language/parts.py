"""Sub-graphs: a graph file with named inputs, used in another like a node.

    # part.yaml
    inputs: {views: Views, start: "Mesh | Carrier", prior: {type: DepthMaps, optional: true}}
    params: {faces: 20000}
    nodes: {refine: {type: ..., views: "@inputs.views", ...}}
    outputs: {state: "@refine.state"}

    # the graph that uses it
    stage1: {graph: part.yaml, views: "@views.train", start: "@hull.mesh", faces: 5000, nodes: {refine: {...}}}
    light: {type: transport.direct, mesh: "@stage1.state"}

Its nodes are called `stage1.refine`. Inside, only the part's own names and `@inputs` are seen. It takes the seed of the
graph that uses it. `nodes:` patches single nodes of the file, as `extends` does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exmesh_graph.graph.declare.ports import Port, link_form, types_by_name
from exmesh_graph.graph.language.spec import Tree, Value, _mapping, _merge_nodes, load_merged, substitute, tree_of
from exmesh_graph.graph.language.yamlfile import Map, files_like
from exmesh_graph.graph.problems import Problems, Where, fail, nearest

if TYPE_CHECKING:
    from exmesh_graph.graph.language.expand import Link, _Expansion, _Scope

MAX_DEPTH = 16
MAX_COPIED = 1_000_000
_KEYS = {"type", "optional", "facets", "doc"}


@dataclass
class Part:
    """One use of a sub-graph: the links it was given, in the scope of its user, and its own scope."""

    name: str
    tree: Tree
    given: Mapping[str, tuple[Any, Where]]
    outer: _Scope
    work: _Expansion
    where: Where
    scope: _Scope = field(init=False)
    known: dict[str, Link | None] = field(default_factory=dict)
    busy: set[str] = field(default_factory=set)

    def input(self, name: str, where: Where) -> Link | None:
        """What `@inputs.name` means: a link, ABSENT where it was not given, None after a problem."""
        if name not in self.tree.inputs:
            names = nearest(name, self.tree.inputs) or list(self.tree.inputs)
            self.work.problems.add("link", where, f"{self.tree.file.name} has no input {name!r}", nearest=names)
            return None
        if name not in self.given:
            from exmesh_graph.graph.language.expand import ABSENT

            return ABSENT
        return self._resolved(f"inputs.{name}", *self.given[name], self.outer)

    def value(self, port: str, where: Where) -> Link | None:
        """What `@part.port` means outside."""
        if port not in self.tree.outputs:
            names = [f"@{self.name}.{name}" for name in nearest(port, self.tree.outputs) or self.tree.outputs]
            what = f"the sub-graph {self.name} ({self.tree.file.name}) has no output {port!r}"
            self.work.problems.add("unknown-port", where, what, nearest=names)
            return None
        return self._resolved(port, self.tree.outputs[port], self.tree.outputs.lines[port], self.scope)

    def _resolved(self, key: str, text: Any, where: Where, scope: _Scope) -> Link | None:
        if key not in self.known:
            self.known[key] = None
            self.busy.add(key)
            self.known[key] = self.work.link(text, scope, where)
            self.busy.discard(key)
        elif key in self.busy:
            self.work.problems.add("cycle", where, f"{self.name}: {key} is defined by itself")
        return self.known[key]


class Lost:
    """Stands for a sub-graph whose file cannot be used; the problem was noted."""

    def value(self, port: str, where: Where) -> None:
        """Nothing comes out of it."""


def declare_part(work: _Expansion, name: str, entry: Map, scope: _Scope) -> None:
    """Load the file that `graph:` names and declare its nodes below `name`."""
    full, where = scope.prefix + name, entry.lines["graph"]
    work.count_block(where)
    work.names.add(full)
    raw: dict[str, tuple[Any, Where]] = {}
    for layer in (entry, *work.round_patches(full, entry, scope)):
        raw |= {str(key): (value, layer.lines[key]) for key, value in layer.items() if key not in ("every", "at")}
    for key, value in work.overrides_of(full):
        raw[key] = value, Where(None)
    source = substitute(raw["graph"][0], scope.params, raw["graph"][1], work.problems)
    path = _part_file(source.value, source.base, raw["graph"][1], scope.files, work.problems)
    if path is None:
        scope.nodes[name] = Lost()
        return
    if path not in work.files:
        work.files[path] = load_merged(path, [], work.problems)
    if (path, where) not in work.copies:
        work.copies[path, where] = _used_at(work.files[path], where, work.budget)
    merged = work.copies[path, where].copy()
    nodes, patches = merged.get("nodes"), raw.get("nodes", (None, where))[0]
    if isinstance(nodes, Map) and isinstance(patches, Map):
        merged["nodes"] = _merge_nodes(nodes, patches, work.problems)
    inputs, known = _mapping(merged, "inputs", work.problems), _mapping(merged, "params", work.problems)
    links: dict[str, tuple[Any, Where]] = {}
    given: dict[str, Value] = {}
    seed = scope.seed
    for key, (value, place) in raw.items():
        if key in inputs:
            links |= {} if value is None else {key: (value, place)}
        elif key in known:
            given[key] = _param(work, f"{full}: {key}", substitute(value, scope.params, place, work.problems))
        elif key == "seed":
            seed = work.seed_given(full, substitute(value, scope.params, place, work.problems))
        elif key not in ("graph", "nodes", "doc"):
            near = nearest(key, [*inputs, *known]) or [*inputs, *known]
            what = f"{full}: {path.name} has no input or parameter {key!r}"
            work.problems.add("unknown-parameter", place, what, nearest=near)
    tree = tree_of(merged, path, (), work.problems, given)
    part = Part(full, tree, links, scope, work, entry.where)
    part.scope = replace(
        scope, params=tree.params, seed=seed, prefix=f"{full}.", parent=None, rounds=(), nodes={}, block=None,
        part=part, root=f"{full}.", outer=(*scope.outer, *scope.rounds), files=(*scope.files, path),
    )  # fmt: skip
    ports = _input_ports(tree, work.problems)
    for port in ports.values():
        if not port.optional and port.name not in links:
            work.problems.add(
                "missing-port", entry.where, f"{full}: the input {port.name} of {path.name} is not connected",
                expected=str(port), fix=f"{port.name}: {link_form(port)}",
            )  # fmt: skip
    work.parts.append((part, ports))
    scope.nodes[name] = part
    work.declare(tree.nodes, part.scope)


def _param(work: _Expansion, what: str, found: Value) -> Value:
    """A parameter's value; `@@` stands for a literal `@`, as in nodes."""
    if isinstance(found.value, str) and found.value.startswith("@"):
        if not found.value.startswith("@@"):
            work.problems.add("link", found.where, f"{what} is a parameter of the sub-graph, not an input")
        return replace(found, value=found.value[1:])
    return found


def _input_ports(tree: Tree, problems: Problems) -> dict[str, Port]:
    """The inputs that a graph file declares, as ports."""
    ports, kinds = {}, types_by_name()
    expected = 'views: Views, or "Mesh | Carrier", or {type: Views, optional: true, facets: {split: train}, doc: ...}'
    for name, raw in tree.inputs.items():
        where = tree.inputs.lines[name]
        long: Mapping[str, Any] = raw if isinstance(raw, Map) else {"type": raw}
        text, facets, optional = long.get("type"), long.get("facets", {}), long.get("optional", False)
        words = [word.strip() for word in text.split("|")] if isinstance(text, str) else []
        unknown = [word for word in words if word not in kinds]
        if unknown:
            what, near = f"inputs.{name}: there is no type {unknown[0]!r}", nearest(unknown[0], kinds)
            problems.add("input", where, what, nearest=near, fix="exmesh nodes TYPE shows the types of its ports")
        elif not words or not isinstance(facets, Map | dict) or not isinstance(optional, bool) or set(long) - _KEYS:
            problems.add("input", where, f"inputs.{name} is not declared as an input is", expected=expected)
        elif name in tree.params:
            problems.add("input", where, f"{name!r} is both an input and a parameter")
        else:
            ports[str(name)] = Port(str(name), tuple(kinds[word] for word in words), facets, optional)
    return ports


def _used_at(value: Any, via: Where, budget: list[int]) -> Any:
    """A copy of a file's values whose places also tell where the file is used."""
    budget[0] -= 1
    if budget[0] < 0:
        fail("graph", via, f"the sub-graphs of this graph hold more than {MAX_COPIED} values")
    if isinstance(value, list):
        return [_used_at(item, via, budget) for item in value]
    if not isinstance(value, Map):
        return value
    result = Map(replace(value.where, via=via))
    for key, item in value.items():
        result.put(key, _used_at(item, via, budget), replace(value.lines[key], via=via))
    return result


def _part_file(raw: Any, base: Path, where: Where, chain: tuple[Path, ...], problems: Problems) -> Path | None:
    """The file that `graph:` names; None, with a problem, for what is no file and for files that use each other."""
    if not isinstance(raw, str):
        problems.add("graph", where, "graph: names one graph file", expected="{graph: part.yaml, ...}")
        return None
    path = Path(raw).expanduser()
    path = path if path.is_absolute() else base / path
    if not path.is_file():
        problems.add("graph", where, f"no such graph file: {raw}", nearest=files_like(path))
        return None
    path = path.resolve()
    if path in chain:
        names = " -> ".join(p.name for p in [*chain[chain.index(path) :], path])
        problems.add("graph", where, f"the graph files use each other: {names}")
    elif len(chain) >= MAX_DEPTH:
        problems.add("graph", where, f"sub-graphs nest deeper than {MAX_DEPTH} files")
    else:
        return path
    return None
