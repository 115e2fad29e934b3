"""What may be connected to what, and why not: the answers while a wire is dragged, and the types a node can become."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.declare.ports import Port, Signature, signature_of, type_name
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.variants.draft import home_of, is_block, is_part, within
from exmesh_graph.studio.reading import Reading, is_wired
from exmesh_graph.studio.typefacts import port_facts


@dataclass(frozen=True)
class End:
    """One end of a possible wire: `side` is "" outside of a block, "carry" or "next" inside it.

    What a sub-graph is given stands in its file at the side "inputs" of no node. `port` is None for a component's only
    end and for what carries whatever it is given.
    """

    node: str
    name: str
    side: str
    port: Port | None
    component: type | None = None

    @property
    def shown(self) -> str:
        word = f".{self.side}" if self.side else ""
        return f"{self.node}{word}.{self.name}".lstrip(".") if self.name else self.node


class Ends:
    """The ends in one file: of the graph, or of a sub-graph, whose nodes are asked for by their whole names."""

    def __init__(self, reading: Reading) -> None:
        self.reading, self.draft = reading, reading.draft
        self.wires = [((self._own(a), b, c), (self._own(d), e, f)) for (a, b, c), (d, e, f) in reading.ends()]
        self.after: dict[str, set[str]] = {}
        for (start, _, side), (end, _, other) in self.wires:
            self.after.setdefault(_place(start, side, source=True), set()).add(_place(end, other, source=False))
        for path, entry in reading.entries.items():
            if isinstance(entry, Map):
                self.after.setdefault(f"{path}#in", set()).add(f"{path}#out")
        self.before: dict[str, set[str]] = {}
        for start, ends in self.after.items():
            for end in ends:
                self.before.setdefault(end, set()).add(start)

    def target_name(self, node: str, port: str, side: str) -> str:
        """What a patch calls an input."""
        return self.reading.prefix + _named(End(node, port, side, None), is_block(self.reading.entries.get(node)))

    def for_input(self, node: str, port: str, side: str) -> dict[str, Any]:
        """What may lead into an input. Raises GraphError where there is no such input."""
        whole, node = node, self._own(node)
        target = self._input(node, port, side)
        used = {start for start, end in self.wires if end == (node, port, side)}
        behind = self._reached(_place(node, side, source=False), self.after)
        rows = []
        for source in self.sources():
            loop = _place(source.node, source.side, source=True) in behind
            why = self.why_not(source, target, loop)
            rows.append({"node": self._whole(source.node), "port": source.name, "side": source.side,
                         "link": self.link(source, target), "ok": not why, "why": why,
                         "in_use": (source.node, source.name, source.side) in used})  # fmt: skip
        return {"port": _facts(target), "target": self.target_name(node, port, side),
                "ends": _best_first(rows, whole), "types": self._types_for(target)}  # fmt: skip

    def for_output(self, node: str, port: str, side: str) -> dict[str, Any]:
        """Where an output may lead. Raises GraphError where there is no such output."""
        whole, node = node, self._own(node)
        source = next((s for s in self.sources() if (s.node, s.name, s.side) == (node, port, side)), None)
        if source is None:
            raise GraphError(f"there is no output {node}.{port}".rstrip("."))
        before, rows = self._reached(_place(node, side, source=True), self.before), []
        for target in self.targets():
            block = is_block(self.reading.entries.get(target.node))
            loop = _place(target.node, target.side, source=False) in before
            why = self.why_not(source, target, loop)
            rows.append({
                "node": self._whole(target.node), "port": target.name, "side": target.side,
                "target": self.reading.prefix + _named(target, block),
                "link": self.link(source, target), "ok": not why, "why": why,
            })  # fmt: skip
        return {"port": _facts(source), "ends": _best_first(rows, whole), "types": self._types_taking(source)}

    def sources(self) -> Iterator[End]:
        """All outputs: of nodes, components, blocks and sub-graphs, what blocks carry into their rounds, own inputs."""
        for name, port in self.reading.ports.items():
            yield End("", name, "inputs", port)
        for path, entry in self.reading.entries.items():
            if is_block(entry):
                for name in entry.get("carry") or ():
                    inner = self.reading.port_behind(f"@{path.rpartition('.')[2]}.{name}", home_of(path))
                    yield End(path, str(name), "", inner)
                    yield End(path, str(name), "carry", inner)
            elif is_part(entry):
                part = self.reading.parts.get(path)
                for name, link in part.tree.outputs.items() if part is not None else ():
                    yield End(path, str(name), "", part.reading.port_behind(str(link), "") if part else None)
            else:
                kind = self.reading.kinds.get(path)
                if kind is not None and kind.component is not None:
                    yield End(path, "", "", None, kind.component)
                elif kind is not None:
                    yield from (End(path, name, "", port) for name, port in kind.outputs.items())

    def targets(self) -> Iterator[End]:
        """All inputs of nodes, components, blocks and sub-graphs."""
        for path, entry in self.reading.entries.items():
            if is_block(entry):
                for name in entry.get("carry") or ():
                    inner = self.reading.port_behind(f"@{path.rpartition('.')[2]}.{name}", home_of(path))
                    yield End(path, str(name), "", inner)
                    yield End(path, str(name), "next", inner)
            elif is_part(entry):
                part = self.reading.parts.get(path)
                yield from (End(path, n, "", port) for n, port in (part.ports.items() if part is not None else ()))
            else:
                kind = self.reading.kinds.get(path)
                yield from (End(path, n, "", port) for n, port in (kind.inputs.items() if kind is not None else ()))

    def why_not(self, source: End, target: End, loop: bool) -> str:
        """Why a wire is impossible; empty where it is not. `loop`: the source waits for the target."""
        home = target.node if target.side == "next" else home_of(target.node)
        seen_in = source.node if source.side == "carry" else home_of(source.node)
        if not within(home, seen_in):
            return f"{source.shown} is inside {seen_in}, which hands on only what its `next` names"
        wanted, given = target.port, source.port
        if wanted is None or target.side == "next" or is_block(self.reading.entries.get(target.node)):
            if source.component is not None:
                return f"{source.shown} is a component, and {target.shown} takes what a node makes"
            if wanted is not None and given is not None and not issubclass(given.type, wanted.type):
                return f"{source.shown} is {given}, and {target.shown} carries {wanted}"
        elif source.component is not None:
            if not issubclass(source.component, wanted.types):
                return (
                    f"{source.shown} is a component ({type_name(source.component)}), and {target.shown} takes {wanted}"
                )
        elif given is None:
            return "" if not wanted.plugged else f"{target.shown} takes a component, {wanted}"
        elif not issubclass(given.type, wanted.types):
            return f"{source.shown} is {given}, and {target.shown} takes {wanted}"
        else:
            for name, (asked, promised) in wanted.clashes(given).items():
                return f"{source.shown} has {name}={promised!r}, but {target.shown} takes {name}={asked!r}"
            many, walked = given.many or bool(self._each(source.node)), target.name in self._each(target.node)
            if many and not (wanted.many or walked):
                return f"{source.shown} is a list, and {target.shown} takes one: `each: {target.name}` in the file"
            if walked and not many:
                return f"{target.shown} takes a list (`each`), and {source.shown} is one"
        if loop:
            return f"{source.shown} waits for {target.node} itself"
        return ""

    def link(self, source: End, target: End) -> str:
        """How a link from the one end to the other is written."""
        if source.side:
            return f"@{source.side}.{source.name}"
        return f"@{source.node.rpartition('.')[2]}" + (f".{source.name}" if source.name else "")

    def swaps(self, node: str) -> list[dict[str, Any]]:
        """The types that a node can become, those first that fit all its wires; `ports` renames those that differ."""
        node = self._own(node)
        entry = self.reading.entries.get(node)
        old = self.reading.kinds.get(node)
        if not isinstance(entry, Map) or old is None:
            raise GraphError(f"there is no node {node!r} that can be another one")
        wired = [str(key) for key, value in entry.items() if is_wired(value) and key in old.inputs]
        used = {start[1] for start, _ in self.wires if start[0] == node}
        used |= {out["port"] for out in self.reading.outputs() if self._own(out["node"]) == node}
        rows = []
        for name in self.draft.packs.types:
            new = signature_of(self.draft.packs, name)
            if new is None or name == self.draft.read(entry, "type") or bool(new.component) != bool(old.component):
                continue
            why, ports = _swapped(old, new, wired, used)
            near = len({*new.inputs} & {*old.inputs}) + len({*new.outputs} & {*old.outputs})
            rows.append({"type": name, "ok": not why, "why": why, "ports": ports, "near": near})
        family = str(self.draft.read(entry, "type")).partition(".")[0]
        return sorted(rows, key=lambda r: (not r["ok"], r["type"].partition(".")[0] != family, -r["near"], r["type"]))

    def _each(self, node: str) -> list[str]:
        """The inputs of a node that take lists, with a node for each element."""
        entry = self.reading.entries.get(node)
        each = entry.get("each") if isinstance(entry, Map) and not is_block(entry) else None
        return [str(one) for one in each] if isinstance(each, list) else [] if each is None else [str(each)]

    def _own(self, node: str) -> str:
        """The name of a node in this file; none for the sub-graph itself."""
        prefix = self.reading.prefix
        return "" if prefix and node == prefix[:-1] else node.removeprefix(prefix)

    def _whole(self, node: str) -> str:
        return f"{self.reading.prefix}{node}".rstrip(".")

    def _input(self, node: str, port: str, side: str) -> End:
        found = next((t for t in self.targets() if (t.node, t.name, t.side) == (node, port, side)), None)
        if found is None:
            raise GraphError(f"there is no input {node}.{port}")
        return found

    def _reached(self, place: str, arrows: Mapping[str, set[str]]) -> set[str]:
        """All places that arrows lead to from one, itself included."""
        seen, todo = {place}, [place]
        while todo:
            for following in arrows.get(todo.pop(), ()):
                if following not in seen:
                    seen.add(following)
                    todo.append(following)
        return seen

    def _types_for(self, target: End) -> list[str]:
        """Node types with an output, and components, that fit an input."""
        wanted, fits = target.port, []
        for name in self.draft.packs.types if wanted is not None else ():
            kind = signature_of(self.draft.packs, name)
            if kind is None or wanted is None:
                continue
            plug = kind.component is not None and issubclass(kind.component, wanted.types)
            if plug or any(wanted.takes(output) for output in kind.outputs.values()):
                fits.append(name)
        return fits

    def _types_taking(self, source: End) -> list[str]:
        """Node types with an input that an output fits."""
        fits = []
        for name in self.draft.packs.types:
            kind = signature_of(self.draft.packs, name)
            for port in kind.inputs.values() if kind is not None else ():
                plug = source.component is not None and issubclass(source.component, port.types)
                if plug or (source.port is not None and port.takes(source.port)):
                    fits.append(name)
                    break
        return fits


def _swapped(old: Signature, new: Signature, wired: list[str], used: set[str]) -> tuple[str, dict[str, str]]:
    """Why a type cannot take a node's place (empty where it can), and the ports that need another name."""
    ports: dict[str, str] = {}
    for name in wired:
        port = old.inputs[name]
        if name in new.inputs and set(new.inputs[name].types) & {b for k in port.types for b in k.__mro__}:
            continue
        fits = [other for other, one in new.inputs.items() if set(one.types) & {*port.types} and other not in wired]
        if len(fits) != 1:
            return f"has no input for {name} ({port})", {}
        ports[name] = fits[0]
    for name in sorted(used):
        if name == "" and new.component is not None and old.component is not None:
            if not set(old.component.__mro__[1:2]) <= set(new.component.__mro__):
                return f"is no {old.component.__mro__[1].__name__}", {}
            continue
        port = old.outputs[name]
        if name in new.outputs and issubclass(new.outputs[name].type, port.type):
            continue
        fits = [other for other, one in new.outputs.items() if issubclass(one.type, port.type)]
        if len(fits) != 1:
            return f"has no output for {name} ({port})", {}
        ports[name] = fits[0]
    missing = [n for n, p in new.inputs.items() if not p.optional and n not in wired and n not in ports.values()]
    return (f"needs {', '.join(missing)}, which is not wired here" if missing else ""), ports


def _place(node: str, side: str, *, source: bool) -> str:
    """A node in the order of waiting; a block begins with what it carries in and ends with what it hands on."""
    begins = side in ("carry", "inputs") if side else not source
    return f"{node}#in" if begins else f"{node}#out"


def _named(target: End, block: bool) -> str:
    """What a patch calls an input."""
    word = ".next" if target.side == "next" else ".carry" if block else ""
    return f"{target.node}{word}.{target.name}"


def _facts(end: End) -> dict[str, Any]:
    if end.port is not None:
        return {**port_facts(end.port), "port": end.name}
    types = [] if end.component is None else [type_name(end.component)]
    return {"port": end.name, "types": types, "label": " | ".join(types), "optional": False,
            "component": end.component is not None, "mixed": False, "facets": {}}  # fmt: skip


def _best_first(rows: list[dict[str, Any]], node: str) -> list[dict[str, Any]]:
    """What fits first, and of this what is near."""
    home = home_of(node)
    return sorted(rows, key=lambda row: (not row["ok"], home_of(row["node"]) != home))
