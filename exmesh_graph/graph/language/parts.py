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
from typing import Any

from exmesh_graph.graph.declare.ports import Port, types_by_name
from exmesh_graph.graph.language.extends import load_merged, merge_nodes, named_file
from exmesh_graph.graph.language.spec import Tree, Value
from exmesh_graph.graph.language.yamlfile import Map, copied, every, files_like
from exmesh_graph.graph.problems import Problems, Where, fail, nearest

MAX_DEPTH = 16
MAX_COPIED = 1_000_000
_KEYS = {"type", "optional", "facets", "doc"}


@dataclass
class PartFiles:
    """The files that the sub-graphs of a graph name, each read once; `left` bounds how much is copied."""

    problems: Problems
    files: dict[Path, Map] = field(default_factory=dict)
    copies: dict[tuple[Path, Where], Map] = field(default_factory=dict)
    left: int = MAX_COPIED

    def path(self, name: Value, where: Where, chain: tuple[Path, ...]) -> Path | None:
        """The file that `graph:` names; None, with a problem, for what is no file and for files that use each other."""
        if not isinstance(name.value, str):
            self.problems.add("graph", where, "graph: names one graph file", expected="{graph: part.yaml, ...}")
            return None
        path = named_file(name.base, name.value, where)
        if not path.is_file():
            self.problems.add("graph", where, f"no such graph file: {name.value}", nearest=files_like(path))
            return None
        path = path.resolve()
        if path in chain:
            names = " -> ".join(p.name for p in [*chain[chain.index(path) :], path])
            self.problems.add("graph", where, f"the graph files use each other: {names}")
        elif len(chain) >= MAX_DEPTH:
            self.problems.add("graph", where, f"sub-graphs nest deeper than {MAX_DEPTH} files")
        else:
            return path
        return None

    def merged(self, path: Path, where: Where, patches: Any) -> Map:
        """The merged file, used at `where`, with the changes of its use to single nodes."""
        if path not in self.files:
            self.files[path] = load_merged(path, self.problems)
        if (path, where) not in self.copies:
            self.left -= sum(1 for _ in every(self.files[path]))
            if self.left < 0:
                fail("graph", where, f"the sub-graphs of this graph hold more than {MAX_COPIED} values")
            self.copies[path, where] = copied(self.files[path], lambda here: replace(here, via=where))
        merged = self.copies[path, where].copy()
        if isinstance(merged.get("nodes"), Map) and isinstance(patches, Map):
            merged["nodes"] = merge_nodes(merged["nodes"], patches, self.problems)
        return merged


def input_ports(tree: Tree, problems: Problems) -> dict[str, Port]:
    """The inputs that a graph file declares, as ports."""
    ports, kinds = {}, types_by_name() if tree.inputs else {}
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
