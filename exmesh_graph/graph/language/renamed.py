"""Old names of node types, ports and parameters: for one release they do what the new ones do, and a note names both.

`@node(..., was=("old.type",))`, `param(..., was="old")` and `Annotated[Mesh, was("old")]` declare them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Signature, signature
from exmesh_graph.graph.language.expand import NodeSpec, Unrolled
from exmesh_graph.graph.language.links import Link
from exmesh_graph.graph.language.spec import Value
from exmesh_graph.graph.problems import Problems, Where


def with_present_names(graph: Unrolled, packs: Packs, problems: Problems) -> tuple[Unrolled, tuple[str, ...]]:
    """The graph in the names that types, ports and parameters have now, and a note on each old one.

    Two values for one parameter or port are a problem, unless one of them stands closer to the run: in the file that
    extends another, in the settings of a round, on the command line.
    """
    work = _Renaming(graph, packs, problems)
    for spec in graph.nodes.values():
        work.type(spec)
    if not work.notes and not any(kind.renamed or kind.renamed_outputs for kind in work.kinds.values()):
        return graph, ()
    nodes = {name: replace(spec, fields=work.fields(spec)) for name, spec in work.nodes.items()}
    outputs = {name: work.link(value) for name, value in graph.outputs.items()}
    given = tuple((user, port, work.port(link, where), where) for user, port, link, where in graph.given)
    return replace(graph, nodes=nodes, outputs=outputs, given=given), tuple(dict.fromkeys(work.notes))


@dataclass
class _Renaming:
    graph: Unrolled
    packs: Packs
    problems: Problems
    notes: list[str] = field(default_factory=list)
    nodes: dict[str, NodeSpec] = field(default_factory=dict)
    kinds: dict[str, Signature] = field(default_factory=dict)

    def note(self, where: Where, what: str, old: str, new: str) -> None:
        text = f"{where}: {what} {old!r} is now called {new!r}; the old name goes with the next release"
        self.notes.append(text)

    def type(self, spec: NodeSpec) -> None:
        definition = self.packs.find(spec.type)
        if definition is not None and definition.type != spec.type:
            self.note(spec.where, "the node type", spec.type, definition.type)
            spec = replace(spec, type=definition.type)
        self.nodes[spec.name] = spec
        try:
            if definition is not None:
                self.kinds[spec.name] = signature(definition)
        except (TypeError, NameError):
            return  # told of by the check

    def fields(self, spec: NodeSpec) -> Mapping[str, Value]:
        kind = self.kinds.get(spec.name)
        fields: dict[str, Value] = {}
        written: dict[str, str] = {}
        for key, value in spec.fields.items():
            name = key if kind is None else kind.renamed.get(key, key)
            if name != key:
                self.note(value.where, f"{spec.type}:", key, name)
            other = fields.get(name)
            if other is not None:
                ranks = [(v.layer, v.where.file == self.graph.file) for v in (other, value)]
                if ranks[0] == ranks[1] and other.where.file == value.where.file:
                    what = f"{spec.name}: {name} is given twice, as {written[name]!r} and as {key!r}"
                    self.problems.add("renamed", value.where, what, found=f"the other one: {other.where}",
                                      fix=f"keep {name!r}")  # fmt: skip
                if ranks[0] > ranks[1]:
                    continue
            fields[name], written[name] = self.link(value), key
        return fields

    def link(self, value: Value) -> Value:
        return replace(value, value=self.port(value.value, value.where)) if isinstance(value.value, Link) else value

    def port(self, link: Link, where: Where) -> Link:
        kind = self.kinds.get(link.node)
        if kind is None or link.port not in kind.renamed_outputs:
            return link
        name = kind.renamed_outputs[link.port]
        self.note(where, f"the output of {self.nodes[link.node].type}", link.port, name)
        return replace(link, port=name)
