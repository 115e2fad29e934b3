"""Lists on wires: what a list input is given, a node for each element of a list (`each`), what these make, gathered.

The elements of the list `objects` are called `objects[1]`, `objects[2]`, ... wherever ports are named: in keys, records
and jobs. A node with `each` stands for the nodes `fit[1]`, `fit[2]`, ... which are keyed and run like any other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache.keys import NOTHING, Stored, elements, listed
from exmesh_graph.graph.declare.ports import Signature, base_name
from exmesh_graph.graph.language.check import Bound
from exmesh_graph.graph.language.links import Link

Outputs = Mapping[str, Mapping[str, Stored]]
"""{node: {output: what is stored}} of the nodes that are known."""


def fed(bound: Bound, outputs: Outputs) -> dict[str, tuple[Link, Stored]]:
    """{input: (its wire, what lies there)}, of known nodes. A list has an entry for each element that is there."""
    table: dict[str, tuple[Link, Stored]] = {}
    counts: Counter[str] = Counter()
    for port, link in bound.inputs.items():
        name = base_name(port)
        many = bound.signature.inputs[name].many
        for source in elements(outputs[link.node], link.port) if link.node in outputs else ():
            stored = outputs[link.node][source]
            if many and stored == NOTHING:
                continue
            counts[name] += 1
            key = f"{name}[{counts[name]}]" if many or source != link.port else port
            table[key] = replace(link, port=source), stored
    return table


def lacking(bound: Bound, outputs: Outputs) -> str:
    """The wire that switches a node off: an input that it cannot do without carries nothing; empty where none does."""
    for name, port in bound.signature.inputs.items():
        wired = [key for key in bound.inputs if base_name(key) == name]
        there = [outputs[bound.inputs[key].node].get(bound.inputs[key].port) != NOTHING for key in wired]
        if wired and not any(there) and (not port.optional or name in bound.each):
            return bound.wire(wired[0])
    return ""


def mapped(bound: Bound, outputs: Outputs) -> list[Bound]:
    """The nodes that one with `each` stands for, in order. Raises GraphError where its lists differ in length."""
    lists = {port: elements(outputs[bound.inputs[port].node], bound.inputs[port].port) for port in bound.each}
    if len({len(names) for names in lists.values()}) > 1:
        told = ", ".join(f"{port} has {len(names)}" for port, names in lists.items())
        raise GraphError(f"{bound.name}: its lists differ in length: {told}", where=str(bound.where),
                         expected="one element of each list for each node")  # fmt: skip
    nodes = []
    for number, names in enumerate(zip(*lists.values(), strict=True), 1):
        own = {port: replace(bound.inputs[port], port=name) for port, name in zip(lists, names, strict=True)}
        nodes.append(replace(bound, name=f"{bound.name}[{number}]", each=(), inputs={**bound.inputs, **own}))
    return nodes


def gathered(bound: Bound, made: Sequence[Mapping[str, Stored]]) -> dict[str, Stored]:
    """The outputs of a node with `each`: lists of what its nodes made."""
    table = {port: listed(len(made)) for port in bound.signature.outputs}
    for number, outputs in enumerate(made, 1):
        table |= {f"{port}[{number}]": stored for port, stored in outputs.items()}
    return table


def whole(outputs: Iterable[str], signature: Signature) -> bool:
    """Whether a record has the outputs that a node type has now."""
    return {base_name(port) for port in outputs} == set(signature.outputs)


def arguments(signature: Signature, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """What the node's function is called with: the elements of a list input as one tuple."""
    words = {port: value for port, value in inputs.items() if port in signature.inputs}
    for name in [name for name, port in signature.inputs.items() if port.many]:
        count = sum(base_name(port) == name for port in inputs)
        if count or not signature.inputs[name].optional:
            words[name] = tuple(inputs[f"{name}[{number}]"] for number in range(1, count + 1))
    return words
