"""The graph that a run ran, from its record: what its file holds meanwhile does not count.

The record names every round; here they are folded as in the open graph. A wire from one round to the next becomes what
the block carries (`Handed`); the name of the port that it has in the file is not recorded, so that of the output stands
for it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from exmesh_graph.graph.problems import without_rounds
from exmesh_graph.studio.reading import End, told
from exmesh_graph.studio.typefacts import TypeFacts

_ROUND = re.compile(r"\[(\d+)\]$")
Entry = Mapping[str, Any]


@dataclass(frozen=True)
class Handed:
    """A wire from one round of a block to the next: from an output to an input, both without rounds."""

    block: str
    source: tuple[str, str]
    target: tuple[str, str]


class RunGraph:
    """`resolved` is what a run's record tells of its graph."""

    def __init__(self, resolved: Entry, facts: TypeFacts) -> None:
        self.facts = facts
        self.nodes: dict[str, Entry] = _entries(resolved.get("nodes"))
        self.components: dict[str, Entry] = _entries(resolved.get("components"))
        self.published = {str(k): str(v) for k, v in dict(resolved.get("outputs") or {}).items()}
        self.links = list(self._links())
        self.handed = {found: None for link in self.links if (found := _handed(*link))}  # a set that keeps its order

    def answer(self) -> dict[str, Any]:
        """What `GET /api/runs/ID/graph` answers: types, nodes, wires and outputs as in the open graph."""
        nodes = [*self._groups(), *self._folded()]
        outputs = []
        for name, text in self.published.items():
            node, port, _ = self._start(*_split(text), "")
            outputs.append({"name": name, "node": node, "port": port, "text": text})
        return {
            "types": self.facts.used(node.get("type", "") for node in nodes), "nodes": nodes,
            "wires": list(self._wires()), "outputs": outputs,
        }  # fmt: skip

    # --- nodes

    def _folded(self) -> Iterator[dict[str, Any]]:
        names: dict[str, list[str]] = {}
        for name in (*self.components, *self.nodes):
            names.setdefault(without_rounds(name), []).append(name)
        for node, all_names in names.items():
            entry = self.nodes.get(all_names[-1]) or self.components[all_names[-1]]
            kind, params, plug = (
                str(entry.get("type", "")),
                dict(entry.get("params") or {}),
                all_names[0] in self.components,
            )
            facts = self.facts.of(kind)
            usual = {one["name"]: one["default"] for one in facts["parameters"]} if facts else {}
            wired = [*(entry.get("inputs") or {}), *(entry.get("components") or {})]
            used = {port for (source, port), _ in self.links if not facts and without_rounds(source) == node}
            ports = {} if facts else {"inputs": list(map(_port, wired)), "outputs": list(map(_port, sorted(used)))}
            yield {
                "id": node, "kind": "component" if plug else "node", "line": 0, "type": kind, **ports,
                **told(
                    parent=node.rpartition(".")[0], wired=wired, names=[] if all_names == [node] or plug else all_names,
                    given={name: {"value": value} for name, value in params.items() if usual.get(name, name) != value},
                    differ=[name for name in params if self._differs(all_names, name)],
                ),
            }  # fmt: skip

    def _differs(self, names: list[str], parameter: str) -> bool:
        entries = [self.nodes.get(name) or self.components.get(name) or {} for name in names]
        return any((one.get("params") or {}).get(parameter) != entries[-1]["params"][parameter] for one in entries)

    def _groups(self) -> Iterator[dict[str, Any]]:
        """Blocks and sub-graphs, the outer ones first."""
        rounds: dict[str, int] = {}
        for name in (*self.nodes, *self.components):
            words = name.split(".")[:-1]
            for depth, word in enumerate(words):
                group, match = without_rounds(".".join(words[: depth + 1])), _ROUND.search(word)
                rounds[group] = max(rounds.get(group, 0), int(match[1]) if match else 0)
        for group, count in sorted(rounds.items()):
            parent = told(parent=group.rpartition(".")[0])
            if count:
                ends = [self._carried(port, one) for port, one in self._ports(group).items()]
                yield {"id": group, "kind": "block", "line": 0, "repeat": count, "repeat_text": str(count), "names": [],
                       "outputs": ends, "given": {"repeat": {"value": count}}, **parent}  # fmt: skip
            else:
                yield {"id": group, "kind": "part", "line": 0, "type": "", "graph": "sub-graph", "names": [],
                       "inputs": [], "outputs": [], "parameters": [], **parent}  # fmt: skip

    def _ports(self, block: str) -> dict[str, tuple[str, str]]:
        """What a block hands from round to round: {port: output}."""
        found: dict[str, tuple[str, str]] = {}
        for one in self.handed:
            if one.block == block and one.source not in found.values():
                node, port = one.source
                found[port if port not in found else f"{node.rpartition('.')[2]}.{port}"] = one.source
        return found

    def _carried(self, port: str, source: tuple[str, str]) -> dict[str, Any]:
        return {**_port(port), **self._facts_of(*source), "port": port}

    def _facts_of(self, node: str, port: str) -> dict[str, Any]:
        entry = next((self.nodes[name] for name in self.nodes if without_rounds(name) == node), {})
        facts = self.facts.of(str(entry.get("type", ""))) or {"outputs": []}
        return next((one for one in facts["outputs"] if one["port"] == port), {})

    # --- wires

    def _links(self) -> Iterator[tuple[tuple[str, str], tuple[str, str]]]:
        """((node, output), (node, input)) of all wires, with rounds."""
        for name, entry in (*self.nodes.items(), *self.components.items()):
            for port, given in {**(entry.get("inputs") or {}), **(entry.get("components") or {})}.items():
                for text in given if isinstance(given, list) else [given]:
                    if isinstance(text, str) and text.startswith("@"):
                        bare = text[1:]
                        yield ((bare, "") if bare in self.components else _split(text)), (name, str(port))

    def _wires(self) -> Iterator[dict[str, Any]]:
        ends: dict[tuple[End, End], None] = {}
        for source, (name, port) in self.links:
            target, found = (without_rounds(name), port), _handed(source, (name, port))
            if found:  # through the frame of the block
                carried = self._port_of(found.block, found.source)
                ends[(*found.source, ""), (found.block, carried, "next")] = None
                ends[(found.block, carried, "carry"), (*target, "")] = None
                continue
            begins = next((one for one in self.handed if one.target == target and _first_of(name, one.block)), None)
            if begins:
                carried = self._port_of(begins.block, begins.source)
                ends[self._start(*source, begins.block), (begins.block, carried, "")] = None
                ends[(begins.block, carried, "carry"), (*target, "")] = None
            else:
                ends[self._start(*source, target[0]), (*target, "")] = None
        for start, end in ends:
            label = self._facts_of(*self._ports(start[0]).get(start[1], start[:2])).get("label", "")
            yield {"from": start, "to": end, "text": f"@{start[0]}.{start[1]}".rstrip("."), "label": label}

    def _start(self, name: str, port: str, user: str) -> End:
        """Where a wire to `user` begins: what the last round of a block hands on leaves by the block itself."""
        node = without_rounds(name)
        for one in self.handed:
            if one.source == (node, port) and not user.startswith(f"{one.block}."):
                return one.block, self._port_of(one.block, one.source), ""
        return node, port, ""

    def _port_of(self, block: str, source: tuple[str, str]) -> str:
        return next(port for port, one in self._ports(block).items() if one == source)


def _handed(source: tuple[str, str], target: tuple[str, str]) -> Handed | None:
    """The wire as one from a round to the next of the same block, where it is one."""
    path: list[str] = []
    for mine, theirs in zip(source[0].split("."), target[0].split("."), strict=False):
        one, two = _ROUND.search(mine), _ROUND.search(theirs)
        path.append(_ROUND.sub("", mine))
        if _ROUND.sub("", theirs) != path[-1] or bool(one) != bool(two):
            return None
        if one and two and one[1] != two[1]:
            block = ".".join(path)
            return Handed(block, (without_rounds(source[0]), source[1]), (without_rounds(target[0]), target[1]))
    return None


def _first_of(name: str, block: str) -> bool:
    """Whether a node stands in the first round of a block."""
    words = name.split(".")[: block.count(".") + 1]
    return without_rounds(".".join(words)) == block and words[-1].endswith("[1]")


def _split(text: str) -> tuple[str, str]:
    node, _, port = text.removeprefix("@").rpartition(".")
    return node, port


def _entries(value: Any) -> dict[str, Entry]:
    return {str(k): v for k, v in value.items() if isinstance(v, Mapping)} if isinstance(value, Mapping) else {}


def _port(name: str) -> dict[str, Any]:
    return {"port": name, "types": [], "label": "", "optional": False, "component": False, "mixed": False, "facets": {}}
