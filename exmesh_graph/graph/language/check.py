"""Judging an expanded graph before anything runs: node types, ports, parameters, wires, facets, cycles, sources.

The result is a `Checked` graph: every node with its validated parameters and its wires, in an order in which they
can run. Facets that an output does not promise are left to the run (see `contracts`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

from exmesh_graph.errors import ExmeshError, MissingLibraryError
from exmesh_graph.graph.declare.components import MAX_NESTING, BoundComponent
from exmesh_graph.graph.declare.node import Component, NodeDef
from exmesh_graph.graph.declare.packs import Packs, current, library_version
from exmesh_graph.graph.declare.ports import RESERVED, Signature, link_form, signature
from exmesh_graph.graph.language.expand import Graph, NodeSpec, expand
from exmesh_graph.graph.language.links import Broken, Link
from exmesh_graph.graph.language.params import Declared
from exmesh_graph.graph.language.renamed import with_present_names
from exmesh_graph.graph.language.spec import Value, load_tree
from exmesh_graph.graph.language.wires import Wiring
from exmesh_graph.graph.problems import Problem, Problems, Where, nearest
from exmesh_graph.params import Auto, Params


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


def check(graph: Graph, packs: Packs, problems: Problems | None = None) -> Checked:
    """Check an expanded graph against the installed node types."""
    with packs:
        return _Check(graph, packs, Problems() if problems is None else problems).run()


def check_part(
    graph: Graph, name: str, packs: Packs, *, whole: bool = False, nested: Mapping[str, Component] | None = None,
    plugs: Iterable[BoundComponent] = (),
) -> tuple[Params | None, Problems]:  # fmt: skip
    """The parameters of one node of a graph still being written, and what is wrong with its type, wires and values.

    What it lacks counts only if it is `whole`. Wires may only lead to nodes of `graph`; what is wired elsewhere is
    Broken, and for components given as `nested` (of a component) or `plugs` (of a node).
    """
    problems = Problems()
    graph, _ = with_present_names(graph, packs, problems)
    work, spec = _Check(graph, packs, problems, whole=whole), graph.nodes[name]
    for other in graph.nodes.values():
        work._type(other)
    work.wiring = Wiring(graph, work.signatures, work.problems)
    if name not in work.signatures:
        return None, work.problems
    found, (_, params) = work.signatures[name], work._fields(spec)
    model = work._params(spec, found, params, nested or {})
    if whole and model is not None and found.component is None:
        work._decided(spec, found, model, params, plugs)
    return model, work.problems


@dataclass
class _Check:
    graph: Graph
    packs: Packs
    problems: Problems
    whole: bool = True  # else what is missing is no fault yet
    signatures: dict[str, Signature] = field(default_factory=dict)
    nodes: dict[str, Bound] = field(default_factory=dict)
    components: dict[str, BoundComponent] = field(default_factory=dict)

    def run(self) -> Checked:
        self.graph, notes = with_present_names(self.graph, self.packs, self.problems)
        for spec in self.graph.nodes.values():
            self._type(spec)
        self.wiring = Wiring(self.graph, self.signatures, self.problems)
        judged = {name: self._fields(self.graph.nodes[name]) for name in self.signatures}
        for user, port, link, where in self.graph.given:
            end = f"{user}.{port.name}"
            source = self.wiring.source(link, where, end, port, user)
            if source is not None:
                self.wiring.judge(link, source, port, end, where, user)
        outputs = self._outputs()
        for name in dict.fromkeys([*self.wiring.order(), *judged]):  # components before what they plug into
            if name in judged:
                self._bind(self.graph.nodes[name], *judged[name])
        self.problems.raise_if_any()
        return Checked(
            self.graph.name, self.graph.file, self.nodes, outputs, self.graph.params, components=self.components,
            declared=self.graph.declared, packs=self.packs, notes=notes,
        )  # fmt: skip

    def _type(self, spec: NodeSpec) -> None:
        definition = self.packs.types.get(spec.type)
        if definition is None:
            self.problems.add(
                "node-type", spec.where, f"{spec.name}: there is no node type {spec.type!r}",
                nearest=nearest(spec.type, self.packs.types), fix="exmesh nodes lists all types",
            )  # fmt: skip
            for module, why in self.packs.broken.items():
                what = f"the node module {module} cannot be imported: {why}"
                self.problems.found["node-module", module] = Problem("node-module", spec.where, what)
            return
        try:
            self.signatures[spec.name] = signature(definition)
        except (TypeError, NameError) as error:
            self.problems.add("declaration", spec.where, f"{spec.type} is declared wrongly: {error}")

    def _fields(self, spec: NodeSpec) -> tuple[dict[str, Link], dict[str, Value]]:
        """The entries of a node, sorted into wires and parameters."""
        found = self.signatures[spec.name]
        if found.component is not None and spec.seeded is not None:
            self.problems.add("seed", spec.seeded, f"{spec.name} is a component, which has no seed")
        links: dict[str, Link] = {}
        params: dict[str, Value] = {}
        for key, value in spec.fields.items():
            if key in found.inputs:
                link = self.wiring.connect(spec, found.inputs[key], value)
                if link is not None:
                    links[key] = link
            elif key in found.params.model_fields:
                params[key] = value
            elif not value.inherited:
                self._unknown(spec, found, key, value)
        for name, port in found.inputs.items():
            if self.whole and not port.optional and name not in spec.fields:
                self.problems.add(
                    "missing-port", spec.where, f"{spec.name}: the input {name} is not connected", expected=str(port),
                    nearest=self.wiring.suitable(port, spec.name), fix=f"{name}: {link_form(port)}",
                )  # fmt: skip
        return links, params

    def _bind(self, spec: NodeSpec, links: Mapping[str, Link], params: Mapping[str, Value]) -> None:
        """Validate the parameters and make the node or component."""
        found, definition = self.signatures[spec.name], self.packs.types[spec.type]
        plugs = {port: self.components.get(link.node) for port, link in links.items() if not link.port}
        usable = {port: plug for port, plug in plugs.items() if plug is not None}
        self._libraries(spec, definition)
        nested = usable if found.component is not None else {}
        model = self._params(spec, found, params, {field: plug.value for field, plug in nested.items()})
        if model is not None and found.component is None:
            self._decided(spec, found, model, params, usable.values())
        if isinstance(model, Component):
            made = BoundComponent(spec.name, definition, model, usable, spec.where)
            if made.depth > MAX_NESTING:
                self.problems.add("link", spec.where, f"{spec.name}: components nest deeper than {MAX_NESTING}")
            else:
                self.components[spec.name] = made
            return
        paths = [params[key].where for key in found.path_fields() & set(params)]
        sources = {} if model is None else self._sources(spec, definition, model, paths[0] if paths else spec.where)
        wires = {port: link for port, link in links.items() if port not in plugs}
        if found.component is None:
            self.nodes[spec.name] = Bound(
                spec.name, definition, found, model or Params(), wires, sources, spec.seed, spec.where, usable
            )

    def _decided(self, spec: NodeSpec, found: Signature, own: Params, given: Mapping[str, Value], plugs: Any) -> None:
        """Parameters of a node and its components that are `auto` need what decides them, wired to the node."""
        asked = [(spec.name, found, own, spec.where)]
        asked += [(c.name, signature(c.definition), c.value, c.where) for plug in plugs for c in plug.all()]
        auto = [(*of, name, port) for of in asked for name, port in of[1].decided_by().items()]
        for owner, _, model, where, name, port in auto:
            if getattr(model, name) != Auto.word or (port in spec.fields and spec.fields[port].value is not None):
                continue
            judge, end = found.inputs.get(port), port if owner == spec.name else f"{spec.name}.{port}"
            self.problems.add(
                "auto", given[name].where if owner == spec.name and name in given else where,
                f"{owner}: {name} is auto, but nothing is wired to {end}, which decides it",
                expected=str(judge or f"{spec.type} has no port {port}"),
                nearest=() if judge is None else self.wiring.suitable(judge, spec.name),
                fix=f'{f"{end}: {link_form(judge)}, or " if judge else ""}give {name} a value',
            )  # fmt: skip

    def _unknown(self, spec: NodeSpec, found: Signature, key: str, value: Value) -> None:
        kind = "input port" if isinstance(value.value, Link | Broken) else "parameter"
        first, second = (
            (found.inputs, found.params.model_fields)
            if kind == "input port"
            else (found.params.model_fields, found.inputs)
        )
        names = nearest(key, [*first, *second]) or list(first)
        reserved = f"; {key!r} is a word of the framework" if key in RESERVED else ""
        self.problems.add(
            "unknown-port" if kind == "input port" else "unknown-parameter", value.where,
            f"{spec.name}: {spec.type} has no {kind} {key!r}{reserved}",
            nearest=names, fix=f"exmesh nodes {spec.type}",
        )  # fmt: skip

    def _params(
        self, spec: NodeSpec, found: Signature, given: Mapping[str, Value], nested: Mapping[str, Component]
    ) -> Params | None:
        from pydantic import ValidationError

        raw: dict[str, Any] = dict(nested)
        failed = False
        for key, value in given.items():
            if isinstance(value.value, Link | Broken):
                self.problems.add("link", value.where, f"{spec.name}: {key} is a parameter, not an input port")
                failed = True
            elif isinstance(value.value, bool) and found.params.model_fields[key].annotation in (int, float):
                message = "Input should be a number, not true or false"  # pydantic would take true for 1
                self._bad_value(spec, found, given, {"loc": (key,), "type": "number", "msg": message})
                failed = True
            raw[key] = value.value
        if failed:
            return None
        try:
            model = found.params.model_validate(raw)
        except ValidationError as error:
            for details in error.errors(include_url=False):
                if details["loc"][:1] not in [(port,) for port in found.inputs]:  # told of as a wire
                    self._bad_value(spec, found, given, details)
            return None
        moved = {}
        for key in found.path_fields() & set(given):
            moved[key] = _absolute(getattr(model, key), given[key].base)
        return model.model_copy(update=moved)

    def _bad_value(self, spec: NodeSpec, found: Signature, given: Mapping[str, Value], item: Any) -> None:
        path = [str(part) for part in item["loc"]]
        key = path[0] if path else ""
        where = given[key].where if key in given else spec.where
        if item["type"] == "missing":
            if not self.whole:
                return
            what = f"{spec.name}: the parameter {key} must be given"
        else:
            what = f"{spec.name}: {'.'.join(path) or spec.type}: {item['msg']}"
        doc, unit = "", ""
        if key in found.params.model_fields:
            doc = found.params.model_fields[key].description or ""
            unit = str(found.extra(key).get("unit") or "")
        expected = " ".join(part for part in (doc, f"[{unit}]" if unit else "") if part)
        shown = repr(given[key].value) if key in given else ""
        self.problems.add("parameter", where, what, expected=expected, found=shown)

    def _libraries(self, spec: NodeSpec, definition: NodeDef) -> None:
        for library in definition.libraries:
            try:
                library_version(library)
            except MissingLibraryError as error:
                what = f"{spec.name}: {spec.type} needs the library {library}"
                self.problems.add("missing-library", spec.where, what, fix=error.fix)

    def _sources(self, spec: NodeSpec, definition: NodeDef, model: Params, where: Where) -> Mapping[str, Path]:
        if definition.sources is None:
            return {}
        try:
            files = {str(name): Path(path) for name, path in definition.sources(model).items()}
        except ExmeshError as error:
            self.problems.add(
                "source", where, f"{spec.name}: {error.what}", found=error.where,
                expected=error.expected, fix=error.fix,
            )  # fmt: skip
            return {}
        except Exception as error:  # an unreadable folder, or data that the listing was not made for
            self.problems.add(
                "source", where, f"{spec.name}: its source files cannot be listed: {type(error).__name__}: {error}",
                fix="mend the data; if it is right, this is a fault of the node",
            )  # fmt: skip
            return {}
        for name, path in files.items():
            if PurePath(name).is_absolute():
                what = f"{spec.type}: the source name {name!r} is an absolute path; keys must not hold any"
                self.problems.add("declaration", spec.where, what)
            elif not path.is_file():
                self.problems.add("source", where, f"{spec.name}: no such file: {path}")
        return files

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


def _absolute(value: Any, base: Path) -> Any:
    if isinstance(value, PurePath):
        path = Path(value).expanduser()
        return path if path.is_absolute() else Path(_normal(base / path))
    if isinstance(value, list | tuple):
        return type(value)(_absolute(item, base) for item in value)
    if isinstance(value, dict):
        return {key: _absolute(item, base) for key, item in value.items()}
    return value


def _normal(path: Path) -> str:
    """Without `..`, but with symbolic links left as the user wrote them where that is possible."""
    import os.path

    return os.path.normpath(path) if not any(p.is_symlink() for p in path.parents) else str(path)
