"""Judging an expanded graph before anything runs: node types, ports, parameters, wires, facets, cycles, sources.

The result is a `Checked` graph: every node with its validated parameters and its wires, in an order in which they
can run. Facets that an output does not promise are left to the run (see `execute`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from exmesh_graph.graph.declare.components import MAX_NESTING, BoundComponent
from exmesh_graph.graph.declare.node import Component, NodeDef
from exmesh_graph.graph.declare.packs import Packs, current
from exmesh_graph.graph.declare.ports import Signature
from exmesh_graph.graph.language.expand import Unrolled, expand
from exmesh_graph.graph.language.links import Broken, Link
from exmesh_graph.graph.language.nodecheck import NodeCheck
from exmesh_graph.graph.language.params import Declared
from exmesh_graph.graph.language.spec import load_tree, tree_of
from exmesh_graph.graph.language.wires import Wiring
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Problems, Where
from exmesh_graph.params import Params
from exmesh_graph.types import Gallery, Metrics

REPORTED = (Metrics, Gallery)  # what a report shows

OWN_FOLDERS = ("failures", "logs")  # of a run


@dataclass(frozen=True)
class Bound:
    """A node ready to run: definition, signature, parameters, wires and components by input port, sources by name.

    `each` names inputs that are lists: the node stands for one node for each element, and gathers what they make.
    `limits`: the seconds, ram_gb, disk_gb and retries that it may take.
    """

    name: str
    definition: NodeDef
    signature: Signature
    params: Params
    inputs: Mapping[str, Link]
    sources: Mapping[str, Path]
    seed: int
    where: Where
    components: Mapping[str, BoundComponent] = field(default_factory=dict)
    each: tuple[str, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)

    def plugged(self) -> list[BoundComponent]:
        """All components plugged into it and into these."""
        return [inner for plug in self.components.values() for inner in plug.all()]

    def definitions(self) -> list[NodeDef]:
        """The node's definition and those of all its components, whose code the key covers."""
        return [self.definition, *(plug.definition for plug in self.plugged())]

    def reports(self) -> bool:
        """Whether it is there for the report: its first output, what a node is for, is figures or pictures."""
        first = next(iter(self.signature.outputs.values()), None)
        return first is not None and issubclass(first.type, REPORTED)

    def wire(self, port: str) -> str:
        """`views.train -> start.views`, for messages."""
        link = self.inputs[port]
        return f"{link.node}.{link.port} -> {self.name}.{port}"


@dataclass(frozen=True)
class Checked:
    """A graph without faults; `nodes` are in an order in which they can run. `notes` tell of old names it uses.

    `idle` are nodes that nothing published and no report needs: they run only if they are named, or with `run: all`.
    """

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
    idle: Mapping[str, Bound] = field(default_factory=dict)

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
                **({"each": list(bound.each)} if bound.each else {}),
                **({"limits": dict(bound.limits)} if bound.limits else {}),
            }
            for name, bound in {**self.nodes, **self.idle}.items()
        }
        outputs = {name: str(link) for name, link in self.outputs.items()}
        graph = {"name": self.name, "variant": self.variant, "params": dict(self.params)}
        components = {name: plug.describe() for name, plug in self.components.items()}
        return {**graph, "nodes": nodes, "components": components, "outputs": outputs}

    def node(self, name: str) -> Bound:
        """A node by its name; for an element of one with `each`, `fit[2]`, that one."""
        known = {**self.nodes, **self.idle}
        return known[name] if name in known else known[name.rpartition("[")[0]]

    def needed_for(self, targets: Iterable[str]) -> set[str]:
        """The names of `targets` and of everything upstream of them."""
        needed = set(targets)
        for name in reversed(list(self.nodes)):
            if name in needed:
                needed |= {link.node for link in self.nodes[name].inputs.values()}
        return needed

    def with_idle(self) -> Checked:
        """The graph with all of its nodes."""
        return replace(self, nodes={**self.nodes, **self.idle}, idle={})

    def without_idle(self) -> Checked:
        """The graph without the nodes that nothing needs; as it is where it neither publishes nor reports anything."""
        ends = {link.node for link in self.outputs.values()} | {n for n, bound in self.nodes.items() if bound.reports()}
        needed = self.needed_for(ends) if ends else set(self.nodes)
        nodes = {name: bound for name, bound in self.nodes.items() if name in needed}
        return replace(self, nodes=nodes, idle={n: bound for n, bound in self.nodes.items() if n not in needed})


def check_file(path: Path, overrides: Iterable[str], packs: Packs, top: Map | None = None) -> Checked:
    """Load, expand and check a graph file; `top` is its merged mapping, where it is no file.

    Raises GraphErrors with everything that is wrong at once.
    """
    problems = Problems()
    tree = load_tree(path, overrides, problems) if top is None else tree_of(top, path, overrides, problems)
    return check(expand(tree, problems), packs, problems)


def check(graph: Unrolled, packs: Packs, problems: Problems | None = None) -> Checked:
    """Check an expanded graph against the installed node types."""
    nodes: dict[str, Bound] = {}
    components: dict[str, BoundComponent] = {}
    told = Problems() if problems is None else problems
    with packs:
        wiring = Wiring(graph, packs, told)
        judged = {name: NodeCheck(name, wiring) for name in wiring.signatures}
        for user, port, link, where in graph.given:
            wiring.connect(link, where, f"{user}.{port.name}", port, user)
        outputs = _outputs(wiring)
        order = wiring.order({name: {link.node for link in node.links.values()} for name, node in judged.items()})
        for name in dict.fromkeys([*order, *judged]):  # components before what they plug into
            made = _bound(judged[name], components)
            if isinstance(made, BoundComponent):
                components[name] = made
            elif made is not None:
                nodes[name] = made
        told.raise_if_any()
    whole = Checked(
        graph.name, graph.file, nodes, outputs, graph.params, components=components, declared=graph.declared,
        packs=packs, notes=tuple(wiring.notes),
    )  # fmt: skip
    return whole if graph.run_all else whole.without_idle()


def _bound(node: NodeCheck, components: Mapping[str, BoundComponent]) -> Bound | BoundComponent | None:
    """The node or component with validated parameters; None after a problem was noted."""
    spec, where = node.spec, node.spec.where
    plugs = {port: components[link.node] for port, link in node.links.items() if link.node in components}
    node.check_libraries()
    model = node.params({} if node.kind.component is None else {field: plug.value for field, plug in plugs.items()})
    if isinstance(model, Component):
        made = BoundComponent(spec.name, node.definition, model, plugs, where)
        if made.depth <= MAX_NESTING:
            return made
        node.add_problem("link", where, f"components nest deeper than {MAX_NESTING}")
    elif model is not None:
        node.check_decided(model, plugs.values())
        wires = {port: link for port, link in node.links.items() if link.port}
        fixed = spec.name, node.definition, node.kind, model, wires, node.sources(model), spec.seed, where, plugs
        return Bound(*fixed, node.each, node.limits())
    return None


def _outputs(wiring: Wiring) -> dict[str, Link]:
    result = {}
    for name, value in wiring.graph.outputs.items():
        what, more = "", {}
        if name in OWN_FOLDERS:
            what = f"an output cannot be called {name!r}: a run keeps its own files there"
        elif isinstance(value.value, Link):
            wire = wiring.connect(value.value, value.where, f"outputs.{name}")
            if wire is not None and wire[1].plugged:
                what = f"outputs.{name}: {value.value} is a component, which has nothing to publish"
            elif wire is not None:
                result[name] = wire[0]
        elif value.value is not None and not isinstance(value.value, Broken):
            what, more = f"outputs.{name} must be a link", {"found": repr(value.value)}
        if what:
            wiring.problems.add("link", value.where, what, expected='"@node.port"', **more)
    return result
