"""What must hold while a node runs: facets of its inputs, types and facets of its outputs, untouched inputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.declare.ports import Port
from exmesh_graph.graph.language.check import Bound
from exmesh_graph.graph.run.memory import mark_of
from exmesh_graph.types import Artifact


def check_input(bound: Bound, port: str, value: Artifact, promised: Mapping[str, Any]) -> None:
    """Facets that the port asks for and the wire does not promise, measured on the value itself."""
    wanted = bound.signature.inputs[port].wanted(type(value))
    open_facets = {k: v for k, v in wanted.items() if k not in promised}
    if not open_facets:
        return
    measured = {**value.conventions, **value.facets()}
    for name, asked in open_facets.items():
        if measured.get(name) != asked:
            found = f"{name}={measured[name]!r}" if name in measured else f"no facet {name!r}"
            what = f"the wire {bound.wire(port)} carries {value.type_name} with {found}"
            expected = f"{bound.signature.inputs[port]}, {name}={asked!r}"
            fix = f"put a node before {bound.name} whose output has {name}={asked!r}"
            raise GraphError(what, where=str(bound.where), expected=expected, fix=fix)


def outputs_of(bound: Bound, result: Any) -> dict[str, Artifact | None]:
    """The values a node returned, by port; refuses wrong types and facets it promised but does not keep."""
    ports = bound.signature.outputs
    if not isinstance(result, tuple) or len(result) != len(ports):
        raise GraphError(f"{bound.definition.type} returned {type(result).__name__}", expected=", ".join(ports))
    values = dict(zip(ports, result, strict=True))
    for name, value in values.items():
        if value is None and ports[name].optional:
            continue
        if not isinstance(value, ports[name].type):
            what = f"{bound.definition.type} returned {type(value).__name__} for its output {name}"
            raise GraphError(what, expected=str(ports[name]))
        _check_promise(bound, ports[name], value)
    return values


def _check_promise(bound: Bound, port: Port, value: Artifact) -> None:
    measured = {**value.conventions, **(value.facets() if port.facets else {})}
    for name, promised in port.promises.items():
        if name in measured and measured[name] != promised:
            raise GraphError(
                f"{bound.definition.type} promises {port.name} with {name}={promised!r} "
                f"but made one with {name}={measured[name]!r}",
                fix="a fault of the node: mend it, or drop the promise from its annotation",
            )


def check_untouched(bound: Bound, inputs: Mapping[str, Artifact], before: Mapping[str, int]) -> None:
    """Raise when a node changed an input in place: what it was keyed by is not what others would read."""
    for port, value in inputs.items():
        if mark_of(value) != before[port]:
            what = f"{bound.definition.type} changed its input {port} in place"
            fix = "copy before changing: np.array, torch.tensor, shutil.copytree into ctx.scratch"
            raise GraphError(what, where=bound.wire(port), fix=fix)
