"""Building a graph in Python: the same tree that a graph file gives, through the same checks, and back into a file.

    g = Graph("mine")
    faces = g.param("faces", 20_000, doc="Cap of the mesh.")
    views = g.add("views", "data.blender", path="samples/spot")
    hull = g.nodes.init.visual_hull(views=views.train, resolution=96)
    start = g.add("start", "stage1.init", carrier=..., appearance=component("appearance.uv_texture"))
    with g.repeat("rounds", 4, state=start.state) as rounds:
        refine = rounds.add("refine", "stage1.refine", state=rounds.carry.state, views=views.train)
        split = rounds.add("split", "mesh.split", state=refine.state, max_faces=faces)
        rounds.next(state=split.state)
    g.output("state", rounds.state)

What can be known at once (types, ports, parameters, the two ends of a wire) is judged where it is added; what a graph
lacks, and its files, when it is checked or run.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.api.arguments import file_of, path_of, wrong
from exmesh_graph.api.scope import NodeScope, map_or_empty
from exmesh_graph.api.values import Node, Parameter, Wire, here, plain
from exmesh_graph.files import writing
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Signature, signature, type_name
from exmesh_graph.graph.language.extends import over_base
from exmesh_graph.graph.language.params import declare
from exmesh_graph.graph.language.yamlfile import Map, load_yaml
from exmesh_graph.graph.problems import Problems
from exmesh_graph.graph.session import Session, current_session


class Graph(NodeScope):
    """A graph in Python. `extends` names a graph file that it changes; see the top of this module.

    `name` is what run folders are called by; `run_all` also runs nodes that no output and no report needs. Relative
    paths start from the working folder, in a loaded graph those of the file from its folder.
    """

    def __init__(
        self, name: str, *, extends: str | os.PathLike[str] | None = None, seed: int | None = None, doc: str = "",
        run_all: bool = False,
    ) -> None:  # fmt: skip
        where = here()
        if not isinstance(name, str):
            wrong("the name of a graph", name, "a text", "ex.Graph.load(file) reads a graph file")
        self.graph, self.tree = self, Map(where)
        self.file = Path.cwd() / f"<{name}>"
        for key, value in (("name", name), ("doc", doc or None), ("seed", seed), ("run", "all" if run_all else None)):
            if value is not None:
                self.tree.put(key, value, where)
        if extends is not None:
            self.tree.put("extends", os.fspath(file_of(extends)), where)
        self._begin()

    def _begin(self) -> None:
        self.name = str(self.tree["name"])
        self._packs: tuple[Session, Packs] | None = None
        self.extended = Map(self.tree.where)
        if "extends" in self.tree:
            problems, only = Problems(), Map(self.tree.where)
            only.put("extends", self.tree["extends"], self.tree.lines["extends"])
            self.extended = over_base(only, self.file, problems)
            problems.raise_if_any()

    @classmethod
    def load(cls, file: str | os.PathLike[str]) -> Graph:
        """The graph of a file, to be changed or run. Raises GraphErrors."""
        path = file_of(file).absolute()
        graph = cls.__new__(cls)
        graph.graph, graph.tree, graph.file = graph, load_yaml(path), path
        if "name" not in graph.tree:
            graph.tree.put("name", path.stem, graph.tree.where)
        graph._begin()
        return graph

    @property
    def own(self) -> Map:
        return self.tree.inner("nodes", self.tree.where)

    @property
    def base(self) -> Map:
        return map_or_empty(self.extended.get("nodes"), self.tree.where)

    @property
    def packs(self) -> Packs:
        """The node types at hand."""
        session = current_session()
        if self._packs is None or self._packs[0] is not session:
            self._packs = session, session.packs()  # what is declared later comes into the same object
        return self._packs[1]

    def signature(self, kind: str) -> Signature | None:
        """Ports and parameters of a node type; None for one that is not known."""
        definition = self.packs.find(kind)
        try:
            return None if definition is None else signature(definition)
        except (TypeError, NameError):
            return None

    def is_component(self, kind: str) -> bool:
        known = self.signature(kind)
        return known is not None and known.component is not None

    def param(self, name: str, default: Any = ..., *, type: str = "", doc: str = "", **limits: Any) -> Parameter:
        """Declare a graph parameter, which `--set` and ex.run change; `limits`: ge, gt, le, lt, choices, unit.

        Types: int, float, number, bool, str, path, list, map, any.
        """
        entry: Any = default
        if default is ... or type or doc or limits:
            words = {"type": type or _kind_of(default), "default": default, **limits, "doc": doc}
            entry = {key: word for key, word in words.items() if word is not ... and (key, word) != ("doc", "")}
        self._declare(self.tree.inner("params", self.tree.where), name, entry)
        return Parameter(name)

    def input(self, name: str, type: Any, *, optional: bool = False, doc: str = "", **facets: Any) -> Wire[Any]:
        """Declare an input, for a graph that others use; `type` is a wire type or its name."""
        if not isinstance(type, str) and not hasattr(type, "type_name"):
            wrong("the type of an input", type, "a wire type or its name: Views, Mesh, Carrier, ...")
        words = {"optional": optional, "facets": facets, "doc": doc}
        entry: dict[str, Any] = {"type": type if isinstance(type, str) else type_name(type)}
        entry |= {key: value for key, value in words.items() if value}
        self._declare(self.tree.inner("inputs", self.tree.where), name, entry)
        return Wire(self, "inputs", name)

    def output(self, name: str, wire: Any) -> None:
        """Publish an output of a node in the run folder; `asset` lies directly in it. None takes one back."""
        where, problems = here(), Problems()
        value = self._value(f"outputs.{name}", wire, None, where, problems)
        problems.raise_if_any()
        self.tree.inner("outputs", where).put(name, value, where)

    def variant(self, name: str, *patches: Mapping[str, Any], extends: Any = (), doc: str = "") -> None:
        """Declare a variant by its patches: `{"bypass": "rounds.merge"}`, `{"set": "pbr.iterations", "to": 100}`."""
        words = {"extends": extends, "doc": doc, "patches": patches}
        entry = {key: value for key, value in words.items() if value}
        self._declare(self.tree.inner("variants", self.tree.where), name, entry)

    def matrix(self, **axes: Any) -> None:
        """Combinations for a sweep: `faces=[2000, 8000]`, `variant=["base", "direct"]`, include, exclude."""
        self._declare(self.tree, "matrix", axes)

    def repeats(self, count: int, *, of: Any = ()) -> None:
        """Run every variant of a sweep with so many seeds; `of` names the nodes whose seed changes."""
        self._declare(self.tree, "repeats", {"count": count, "of": list(of)} if of else count)

    def merged(self) -> Map:
        """The graph over what it extends, as the checks take it."""
        problems = Problems()
        merged = over_base(self.tree, self.file, problems)
        problems.raise_if_any()
        return merged

    def to_yaml(self, file: str | os.PathLike[str] | None = None) -> str:
        """The graph as the text of a graph file, written to `file` where one is named; paths lead to the same files."""
        from exmesh_graph.api.writing import yaml_text

        path = None if file is None else path_of(file, "the file of a graph").absolute()
        text = yaml_text(self, Path.cwd() if path is None else path.parent)
        local = [kind for kind, known in self.packs.types.items() if known.function.__module__ == "__main__"]
        if used := [kind for kind in local if re.search(rf"type: {re.escape(kind)}\s*[,}}\n]", text)]:
            text = f"# {', '.join(used)}: declared in a script or notebook; for commands, put it in a pack" \
                   f" (exmesh new-node)\n{text}"  # fmt: skip
        if path is not None:
            if path.is_dir():
                wrong("the file of a graph", str(path), "the path of a file; this is a folder")
            with writing("the graph file", path, "to_yaml"):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
        return text

    def __repr__(self) -> str:
        return f"<graph {self.name}: {', '.join(self)}>"

    def _declare(self, section: Map, name: str, value: Any) -> None:
        """Put a value under a name of a section, judged where it is a parameter."""
        where, problems = here(), Problems()
        made = Map(where)
        made.put(name, plain(_named(value), name, where, problems), where)
        if section is self.tree.get("params"):
            declare(made, problems)
        problems.raise_if_any()
        section.put(name, made[name], where)


def _named(value: Any) -> Any:
    """A value of patches with the names of nodes in the place of nodes."""
    if isinstance(value, Mapping):
        return {key: _named(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_named(item) for item in value]
    return value._name if isinstance(value, Node) else value


def _kind_of(default: Any) -> str:
    if isinstance(default, os.PathLike):
        return "path"
    kinds = {bool: "bool", int: "int", float: "float", str: "str", list: "list", tuple: "list", dict: "map"}
    return kinds.get(type(default), "any")
