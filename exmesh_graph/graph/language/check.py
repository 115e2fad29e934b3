"""Judging an expanded graph before anything runs: node types, ports, parameters, wires, facets, cycles, sources.

The result is a `Checked` graph: every node with its validated parameters and its wires, in an order in which they
can run. Facets that an output does not promise are left to the run (see `contracts`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exmesh_graph.graph.declare.components import MAX_NESTING, BoundComponent
from exmesh_graph.graph.declare.node import Component, NodeDef
from exmesh_graph.graph.declare.packs import Packs, current
from exmesh_graph.graph.declare.ports import Signature, signature
from exmesh_graph.graph.language.expand import NodeSpec, Unrolled, expand
from exmesh_graph.graph.language.links import Broken, Link
from exmesh_graph.graph.language.nodecheck import NodeCheck
from exmesh_graph.graph.language.params import Declared
from exmesh_graph.graph.language.renamed import with_present_names
from exmesh_graph.graph.language.spec import load_tree
from exmesh_graph.graph.language.wires import Wiring
from exmesh_graph.graph.problems import Problem, Problems, Where, nearest
from exmesh_graph.params import Params


@dataclass(frozen=True)
class Bound:
    """A node ready to run: definition, signature, parameters, wires and components by input port, sources by name."""

    name: str
    definition: NodeDef
    signature: Signature
    params: Params
    inputs: Mapping[str, Link]
    sources: Mapping[str, Path]
    seed: int
    where: Where
    components: Mapping[str, BoundComponent] = field(default_factory=dict)

    def plugged(self) -> list[BoundComponent]:
        """All components plugged into it and into these."""
        return [inner for plug in self.components.values() for inner in plug.all()]

    def definitions(self) -> list[NodeDef]:
        """The node's definition and those of all its components, whose code the key covers."""
        return [self.definition, *(plug.definition for plug in self.plugged())]

    def wire(self, port: str) -> str:
        """`views.train -> start.views`, for messages."""
        link = self.inputs[port]
        return f"{link.node}.{link.port} -> {self.name}.{port}"


@dataclass(frozen=True)
class Checked:
    """A graph without faults; `nodes` are in an order in which they can run. `notes` tell of old names it uses."""

    name: str
    file: Path
    nodes: Mapping[str, Bound]
    outputs: Mapping[str, Link]
    params: Mapping[str, Any]
    variant: str = ""
    components: Mapping[str, BoundComponent] = field(default_factory=dict)
    declared: Mapping[str, Declared] = field(default_factory=dict)
    packs: Packs = field(default_factory=current, repr=False, compare=False)
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<checked graph {self.name}: {len(self.nodes)} nodes>"

    def resolved(self) -> dict[str, Any]:
        """The graph as plain JSON-like data, for the run record."""
        nodes = {
            name: {
                "type": bound.definition.type,
                "seed": bound.seed,
                "params": bound.params.model_dump(mode="json"),
                "inputs": {port: str(link) for port, link in bound.inputs.items()},
                **({"components": {p: f"@{c.name}" for p, c in bound.components.items()}} if bound.components else {}),
            }
            for name, bound in self.nodes.items()
        }
        outputs = {name: str(link) for name, link in self.outputs.items()}
        graph = {"name": self.name, "variant": self.variant, "params": dict(self.params)}
        components = {name: plug.describe() for name, plug in self.components.items()}
        return {**graph, "nodes": nodes, "components": components, "outputs": outputs}

    def needed_for(self, targets: Iterable[str]) -> set[str]:
        """The names of `targets` and of everything upstream of them."""
        needed = set(targets)
        for name in reversed(list(self.nodes)):
            if name in needed:
                needed |= {link.node for link in self.nodes[name].inputs.values()}
        return needed


def check_file(path: Path, overrides: Iterable[str], packs: Packs) -> Checked:
    """Load, expand and check a graph file. Raises GraphErrors with everything that is wrong at once."""
    problems = Problems()
    tree = load_tree(path, overrides, problems)
    return check(expand(tree, problems), packs, problems)


def check(graph: Unrolled, packs: Packs, problems: Problems | None = None) -> Checked:
    """Check an expanded graph against the installed node types."""
    with packs:
        told = Problems() if problems is None else problems
        present, notes = with_present_names(graph, packs, told)
        return _Check(present, packs, told).run(notes)


def check_part(graph: Unrolled, name: str, packs: Packs) -> Problems:
    """What is wrong with the type, wires and values of one node of a graph still being written; what it lacks is not.

    Wires may only lead to nodes of `graph`; what is wired elsewhere is Broken.
    """
    problems = Problems()
    graph, _ = with_present_names(graph, packs, problems)
    work = _Check(graph, packs, problems)
    if name in work.wiring.signatures:
        NodeCheck(graph.nodes[name], packs.types[graph.nodes[name].type], work.wiring, whole=False).params({})
    return problems


class _Check:
    def __init__(self, graph: Unrolled, packs: Packs, problems: Problems) -> None:
        self.graph, self.packs, self.problems = graph, packs, problems
        self.nodes: dict[str, Bound] = {}
        self.components: dict[str, BoundComponent] = {}
        signatures = {name: self._signature(spec) for name, spec in graph.nodes.items()}
        self.wiring = Wiring(graph, {name: kind for name, kind in signatures.items() if kind is not None}, problems)

    def run(self, notes: tuple[str, ...]) -> Checked:
        graph, wiring = self.graph, self.wiring
        judged = {}
        for name in wiring.signatures:
            judged[name] = NodeCheck(graph.nodes[name], self.packs.types[graph.nodes[name].type], wiring)
        for user, port, link, where in graph.given:
            end = f"{user}.{port.name}"
            source = wiring.source(link, where, end, port, user)
            if source is not None:
                wiring.judge(link, source, port, end, where, user)
        outputs = self._outputs()
        for name in dict.fromkeys([*wiring.order(), *judged]):  # components before what they plug into
            if name in judged:
                self._bind(judged[name])
        self.problems.raise_if_any()
        return Checked(
            graph.name, graph.file, self.nodes, outputs, graph.params, components=self.components,
            declared=graph.declared, packs=self.packs, notes=notes,
        )  # fmt: skip

    def _signature(self, spec: NodeSpec) -> Signature | None:
        """The ports and parameters of a node's type; None after a problem was noted."""
        definition = self.packs.types.get(spec.type)
        if definition is None:
            self.problems.add(
                "node-type", spec.where, f"{spec.name}: there is no node type {spec.type!r}",
                nearest=nearest(spec.type, self.packs.types), fix="exmesh nodes lists all types",
            )  # fmt: skip
            for module, why in self.packs.broken.items():
                what = f"the node module {module} cannot be imported: {why}"
                self.problems.noted["node-module", module] = Problem("node-module", spec.where, what)
            return None
        try:
            return signature(definition)
        except (TypeError, NameError) as error:
            self.problems.add("declaration", spec.where, f"{spec.type} is declared wrongly: {error}")
            return None

    def _bind(self, node: NodeCheck) -> None:
        """Validate the parameters and make the node or component."""
        spec, kind = node.spec, node.kind
        plugged = {port: link.node for port, link in node.links.items() if not link.port}
        plugs = {port: self.components[name] for port, name in plugged.items() if name in self.components}
        node.check_libraries()
        nested = {} if kind.component is None else {field: plug.value for field, plug in plugs.items()}
        model = node.params(nested)
        if isinstance(model, Component):
            made = BoundComponent(spec.name, node.definition, model, plugs, spec.where)
            if made.depth > MAX_NESTING:
                node.add_problem("link", spec.where, f"components nest deeper than {MAX_NESTING}")
            else:
                self.components[spec.name] = made
        elif model is not None:
            node.check_decided(model, plugs.values())
            wires = {port: link for port, link in node.links.items() if link.port}
            self.nodes[spec.name] = Bound(
                spec.name, node.definition, kind, model, wires, node.sources(model), spec.seed, spec.where, plugs
            )

    def _outputs(self) -> dict[str, Link]:
        result = {}
        for name, value in self.graph.outputs.items():
            if isinstance(value.value, Link):
                source = self.wiring.source(value.value, value.where, f"outputs.{name}")
                if source is not None and source.plugged:
                    what = f"outputs.{name}: {value.value} is a component, which has nothing to publish"
                    self.problems.add("link", value.where, what, expected='"@node.port"')
                elif source is not None:
                    result[name] = value.value
            elif value.value is not None and not isinstance(value.value, Broken):
                what = f"outputs.{name} must be a link"
                self.problems.add("link", value.where, what, expected='"@node.port"', found=repr(value.value))
        return result
