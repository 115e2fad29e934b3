"""What must hold while a node runs: facets of its inputs, types and facets of its outputs, untouched inputs."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.declare.ports import Port
from exmesh_graph.graph.files import walk_files
from exmesh_graph.graph.language.check import Bound
from exmesh_graph.graph.language.links import Link
from exmesh_graph.types import Artifact, Files

_SAMPLES = 4096
_BLOCK = 4096  # bytes


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
            raise GraphError(
                f"the wire {bound.wire(port)} carries {value.type_name} with {found}",
                where=str(bound.where),
                expected=f"{bound.signature.inputs[port]}, {name}={asked!r}",
                fix=f"put a node before {bound.name} whose output has {name}={asked!r}",
            )


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
            raise GraphError(
                f"{bound.definition.type} returned {type(value).__name__} for its output {name}",
                expected=str(ports[name]),
            )
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


def frozen(value: Any) -> Any:
    """Make the arrays of a dataclass read-only, so that no node changes what another will read."""
    for array in _arrays(value):
        array.flags.writeable = False
    return value


def array_bytes(value: Any) -> int:
    """Bytes that the arrays of a dataclass take in memory."""
    return sum(int(array.nbytes) for array in _arrays(value))


def mark_of(value: Artifact) -> int:
    """A fingerprint at memory speed, to notice what is changed behind numpy's back: all bytes of the arrays count.

    Of the files of an artifact of type Files it sees inodes, sizes and times.
    """
    stamps: list[Any] = []
    if isinstance(value, Files):
        with contextlib.suppress(OSError):
            for name, path in walk_files(value.root):
                status = path.stat()
                stamps.append((name, status.st_ino, status.st_size, status.st_mtime_ns))
    return hash((*stamps, *(_summed(array) for array in _arrays(value))))


def check_untouched(bound: Bound, inputs: Mapping[str, Artifact], before: Mapping[str, int]) -> None:
    """Raise when a node changed an input in place: what it was keyed by is not what others would read."""
    for port, value in inputs.items():
        if mark_of(value) != before[port]:
            raise GraphError(
                f"{bound.definition.type} changed its input {port} in place",
                where=bound.wire(port),
                fix="copy before changing: np.array, torch.tensor, shutil.copytree into ctx.scratch",
            )


def promised_by(link: Link, nodes: Mapping[str, Bound]) -> Mapping[str, Any]:
    """The facets that the output at the far end of a wire promises."""
    return nodes[link.node].signature.outputs[link.port].promises


def _arrays(value: Any) -> list[Any]:
    if not dataclasses.is_dataclass(value):
        return []
    found: list[Any] = []
    todo = [getattr(value, field.name) for field in dataclasses.fields(value)]
    while todo:
        item = todo.pop()
        if hasattr(item, "flags") and hasattr(item, "tobytes"):
            found.append(item)
        elif isinstance(item, list | tuple):
            todo += item
        elif isinstance(item, dict):
            todo += item.values()
        elif dataclasses.is_dataclass(item) and not isinstance(item, type):
            todo += [getattr(item, field.name) for field in dataclasses.fields(item)]
    return found


def _summed(array: Any) -> bytes:
    """Sums over blocks of 4 KiB and across them, the bytes of the last part block, and some elements as they are."""
    flat = array.reshape(-1)
    flat = flat if flat.flags.c_contiguous else flat.copy()
    data = flat.view("u1")
    whole = data.size // _BLOCK * _BLOCK
    blocks = data[:whole].view("u8").reshape(-1, _BLOCK // 8)
    sums = blocks.sum(axis=1).tobytes() + blocks.sum(axis=0).tobytes()
    return bytes(sums + data[whole:].tobytes() + flat[:: max(1, flat.size // _SAMPLES)].tobytes())
