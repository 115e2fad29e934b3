"""A merged graph file as the page shows it: nodes with rounds folded, blocks and sub-graphs with what they hold.

Read from the file and not from the checked graph, so that a faulty graph is shown as well. What a node has from its
type is told once for each type, and what is empty or as usual is left out: `page/src/state/whole.ts` fills it in.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exmesh_graph.graph.declare.ports import Port, Signature
from exmesh_graph.graph.language.parts import PartFiles, input_ports
from exmesh_graph.graph.language.spec import Tree, Value, substitute, tree_of
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import GraphErrors, Problems
from exmesh_graph.graph.variants.draft import Draft, LinkPlace, is_block, is_link, is_part, layers_of
from exmesh_graph.studio.parameters import graph_parameters, text_of
from exmesh_graph.studio.typefacts import TypeFacts, port_facts
from exmesh_graph.studio.values import plain, shown_path

End = tuple[str, str, str]
"""Node, port, side of a block or sub-graph."""
_DEEPEST = 4  # sub-graphs in sub-graphs


@dataclass
class Reading:
    """One file of a graph read once: the graph itself, or with a `prefix` the file of a sub-graph."""

    draft: Draft
    facts: TypeFacts
    folder: Path
    file: Path
    params: Mapping[str, Value] = field(default_factory=dict)
    prefix: str = ""
    depth: int = 0
    ports: Mapping[str, Port] = field(default_factory=dict)  # that the file declares as inputs

    def __post_init__(self) -> None:
        self.entries = self.draft.entries
        self.kinds: dict[str, Signature | None] = {
            path: None if is_block(entry) or is_part(entry) else self.draft.kind(entry)
            for path, entry in self.entries.items()
        }
        self.parts: dict[str, Part | None] = {}
        if self.depth < _DEEPEST:
            self.parts = {path: self._part(path, entry) for path, entry in self.entries.items() if is_part(entry)}
        self._ends: dict[tuple[str, str], Port | None] = {}

    def around(self, node: str) -> Reading:
        """The file that a node stands in: this one, or that of a sub-graph."""
        parts = (part.reading for part in self.parts.values() if part is not None)
        inner = next((reading for reading in parts if node.startswith(reading.prefix)), None)
        return self if inner is None else inner.around(node)

    # --- nodes

    def nodes(self) -> Iterator[dict[str, Any]]:
        """NODE of the contract, in the order of the file, those inside sub-graphs behind these."""
        for path, entry in self.entries.items():
            if not isinstance(entry, Map):
                continue
            if is_block(entry):
                yield self._block(path, entry)
            elif is_part(entry):
                yield self._part_node(path, entry)
                part = self.parts.get(path)
                if part is not None:
                    yield from part.reading.nodes()
            else:
                yield self._node(path, entry)

    def _node(self, path: str, entry: Map) -> dict[str, Any]:
        kind = self.draft.read(entry, "type")
        facts = self.facts.of(str(kind)) or {}
        layers = [self._layer(layer, word, number) for layer, word, number in layers_of(entry)]
        differ = {name for layer in layers for name in layer["set"]}
        known = [one["name"] for one in facts.get("parameters", ())]
        return {
            **self._common(path, entry, facts.get("kind", "node")),
            "type": str(kind or ""),
            **told(
                wired=[port["port"] for port in facts.get("inputs", ()) if is_wired(entry.get(port["port"]))],
                given={name: self._given(entry, name) for name in known if name in entry},
                differ=[name for name in known if name in differ], layers=layers,
            ),
        }  # fmt: skip

    def _block(self, path: str, entry: Map) -> dict[str, Any]:
        carry = entry.get("carry") if isinstance(entry.get("carry"), Map) else {}
        given = self._given(entry, "repeat")
        return {
            **self._common(path, entry, "block"),
            "repeat": given["value"], "repeat_text": str(entry.get("repeat", "")),
            "outputs": [self._carried(path, str(name)) for name in carry or ()], "given": {"repeat": given},
        }  # fmt: skip

    def _part_node(self, path: str, entry: Map) -> dict[str, Any]:
        part = self.parts.get(path)
        ports = part.ports if part is not None else {}
        outputs = [] if part is None else [self._part_output(path, part, str(name)) for name in part.tree.outputs]
        declared = () if part is None else graph_parameters(part.tree, f"{self.prefix}{path}.")
        return {
            **self._common(path, entry, "part"),
            "type": _file_of(entry), "graph": _file_of(entry),
            "inputs": [port_facts(port) for port in ports.values()], "outputs": outputs,
            "parameters": [{**one, "set": one["name"] in entry} for one in declared],
            **told(wired=[name for name in ports if is_wired(entry.get(name))]),
        }  # fmt: skip

    def _common(self, path: str, entry: Map, kind: str) -> dict[str, Any]:
        scope = path.rpartition(".")[0]
        return {
            "id": f"{self.prefix}{path}", "kind": kind, "line": entry.where.line,
            **told(
                parent=f"{self.prefix}{scope}" if scope else self.prefix.rstrip("."),
                comment=str(entry.get("doc") or "").strip(),
                file="" if entry.where.file == self.file else shown_path(entry.where.file, self.folder),
                inside=bool(self.prefix), bypassed=entry.get("bypass") is not None,
            ),
        }  # fmt: skip

    def _given(self, entry: Map, name: str) -> dict[str, Any]:
        """A parameter that the file gives: its value, and how it is written where that is not the value itself."""
        raw, value = entry.get(name), plain(self._resolved(entry, name))
        text, reference = text_of(raw), raw if isinstance(raw, str) and "${" in raw else ""
        return {"value": value, **told(text="" if text == text_of(value) else text, reference=reference)}

    def _layer(self, layer: Map, word: str, number: Any) -> dict[str, Any]:
        given = {str(key): plain(value) for key, value in layer.items() if key != "type"}
        return {"when": word, "round": number, "type": str(layer.get("type", "")), "set": given}

    def _resolved(self, entry: Map, key: str) -> Any:
        value = entry.get(key)
        if not isinstance(value, str | list | dict):
            return value
        problems = Problems()
        try:
            made = substitute(value, self.params, entry.lines[key], problems).value
        except GraphErrors:
            return value
        return value if problems else made  # `${round}` has a value in each round

    # --- wires

    def wires(self) -> Iterator[dict[str, Any]]:
        """WIRE of the contract, as written; what the graph publishes is told of by `outputs`."""
        for place in self.draft.link_places():
            if place.owner == "outputs":
                continue
            start = self._start(place.text, place.scope)
            side, when, target = "", None, f"{self.prefix}{place.label}"
            entry, port = self.entries[place.owner], port_of(place)
            if is_block(entry):
                side = "" if place.label.split(".")[-2] == "carry" else "next"
            else:
                listed = isinstance(place.holder, list)
                for layer, word, number in layers_of(entry):
                    if (layer.get(port) if listed else layer) is place.holder:
                        when = f"{word} {number}"
                        scope, _, name = place.owner.rpartition(".")
                        inner = f"{scope}[{number}].{name}" if word == "at" and scope else place.owner
                        target = f"{self.prefix}{inner}.{port}"
            end = f"{self.prefix}{place.owner}", port, side
            yield _wire(start, end, place.text, target, when, self.port_behind(place.text, place.scope))
        for part in self.parts.values():
            if part is not None:
                yield from part.reading.wires()
                yield from part.reading.published()

    def ends(self) -> Iterator[tuple[End, End]]:
        """Both ends of each wire."""
        return ((wire["from"], wire["to"]) for wire in self.wires())

    def published(self) -> Iterator[dict[str, Any]]:
        """The wires of a sub-graph from its nodes to its outputs."""
        owner = self.prefix.rstrip(".")
        for name, text in (self.draft.top.get("outputs") or {}).items():
            if is_link(text):
                end = owner, str(name), "outputs"
                yield _wire(self._start(text, ""), end, text, "", None, self.port_behind(text, ""))

    def outputs(self) -> list[dict[str, str]]:
        """What the graph publishes."""
        published = self.draft.top.get("outputs")
        found = []
        for name, text in published.items() if isinstance(published, Map) else ():
            node, port, _ = self._start(str(text), "")
            found.append({"name": str(name), "node": node, "port": port, "text": str(text)})
        return found

    def _start(self, text: str, scope: str) -> End:
        """Where a link written in a scope comes from; no node where it leads nowhere."""
        name, _, port = text.removeprefix("@").rpartition(".")
        if name == "inputs" and self.prefix:
            return self.prefix.rstrip("."), port, "inputs"
        source = self.draft.source(text, scope)
        if source is None:
            return "", port, ""
        if not source.path:
            return f"{self.prefix}{scope}".rstrip("."), source.port, "carry"
        return f"{self.prefix}{source.path}", source.port, ""

    def port_behind(self, text: str, scope: str) -> Port | None:
        """The output port behind a link written in a scope; None for components and what cannot be told."""
        if (text, scope) not in self._ends:
            self._ends[text, scope] = None  # what leads back to itself carries nothing
            self._ends[text, scope] = self._port_of(text, scope)
        return self._ends[text, scope]

    def _port_of(self, text: str, scope: str) -> Port | None:
        if text.startswith("@inputs.") and self.prefix:
            return None
        source = self.draft.source(text, scope)
        if source is None:
            return None
        path = source.path or scope
        entry: Any = self.entries.get(path)
        if isinstance(entry, Map) and is_block(entry):
            carry = entry.get("carry")
            link = carry.get(source.port) if isinstance(carry, Map) else None
            return self.port_behind(str(link), path.rpartition(".")[0]) if link is not None else None
        if is_part(entry):
            part = self.parts.get(path)
            link = None if part is None else part.tree.outputs.get(source.port)
            return None if part is None or link is None else part.reading.port_behind(str(link), "")
        kind = self.kinds.get(path)
        return kind.outputs.get(source.port) if kind is not None else None

    def _carried(self, path: str, name: str) -> dict[str, Any]:
        return _port_like(name, self.port_behind(f"@{path.rpartition('.')[2]}.{name}", path.rpartition(".")[0]))

    def _part_output(self, path: str, part: Part, name: str) -> dict[str, Any]:
        return _port_like(name, part.reading.port_behind(str(part.tree.outputs[name]), ""))

    # --- sub-graphs

    def _part(self, path: str, entry: Map) -> Part | None:
        """The file of a sub-graph; None where it cannot be used, which the checks tell."""
        problems = Problems()
        files = PartFiles(problems)
        where = entry.lines["graph"]
        try:
            if isinstance(entry["graph"], Map):  # a copy of a file, which patches changed
                merged = entry["graph"]
                file = merged.where.file or self.file
            else:
                name = substitute(entry["graph"], self.params, where, problems)
                found = files.path(name, where, (self.file.resolve(),))
                if found is None:
                    return None
                file, merged = found, files.merged(found, where, entry.get("nodes"))
            known = merged.get("params") or {}
            given = {
                str(key): Value(self._resolved(entry, key), entry.lines[key], where.base)
                for key in entry
                if key in known
            }
            tree = tree_of(merged, file, (), problems, given)
        except GraphErrors:
            return None
        inner, ports = Draft(merged, self.draft.packs), input_ports(tree, problems)
        prefix = f"{self.prefix}{path}."
        reading = Reading(inner, self.facts, self.folder, self.file, tree.params, prefix, self.depth + 1, ports)
        return Part(tree, ports, reading)


@dataclass(frozen=True)
class Part:
    """The file of a sub-graph: its tree, the inputs that it declares, and what stands in it."""

    tree: Tree
    ports: Mapping[str, Port]
    reading: Reading


def told(**facts: Any) -> dict[str, Any]:
    """What is not empty of some facts."""
    return {name: value for name, value in facts.items() if value}


def is_wired(value: Any) -> bool:
    """Whether an input is given links: one, or some in a list."""
    return is_link(value) or (isinstance(value, list) and any(map(is_link, value)))


def port_of(place: LinkPlace) -> str:
    """The input (or what else) that a link is given to, also as one of a list."""
    return place.label.rpartition(".")[2]


def _wire(start: End, end: End, text: str, target: str, when: str | None, port: Port | None) -> dict[str, Any]:
    usual = f"{end[0]}.{end[1]}"
    return {
        "from": start, "to": end, "text": text, "label": "" if port is None else str(port),
        **told(target="" if target == usual else target, rounds=when),
    }  # fmt: skip


def _file_of(entry: Map) -> str:
    """What a sub-graph is called by: its file, of a changed copy as well."""
    graph = entry.get("graph")
    return f"{graph.where.file.name if graph.where.file else ''} (changed)" if isinstance(graph, Map) else str(graph)


def _port_like(name: str, port: Port | None) -> dict[str, Any]:
    """An end of a block or sub-graph that carries what an output port gives."""
    if port is None:
        return {"port": name, "types": [], "label": "", "optional": False, "component": False, "mixed": False,
                "facets": {}}  # fmt: skip
    return {**port_facts(port), "port": name, "optional": False}
