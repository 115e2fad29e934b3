"""One node as a function: `call("init.visual_hull", views=views, resolution=96).mesh`. No graph, store or context."""

from __future__ import annotations

import atexit
import os
import tempfile
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.api.arguments import by_name, path_of, wrong
from exmesh_graph.api.judge import declared
from exmesh_graph.api.values import Node, Place, Plug, Wire, here, plain
from exmesh_graph.errors import GraphError
from exmesh_graph.graph.declare.components import BoundComponent, Component
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Port, signature, type_name
from exmesh_graph.graph.language.check import Bound, check_part
from exmesh_graph.graph.language.expand import NodeSpec, Unrolled
from exmesh_graph.graph.language.links import Broken, Link
from exmesh_graph.graph.language.spec import Value
from exmesh_graph.graph.problems import Problems, fail
from exmesh_graph.graph.run import contracts
from exmesh_graph.graph.run.memory import mark_of
from exmesh_graph.graph.session import Session, current_session
from exmesh_graph.types import Artifact


class CallContext:
    """What a node that is called as a function sees: warnings become Python's, checkpoints are not kept."""

    def __init__(self, node: str, seed: int, scratch: Path, progress: Callable[..., Any] | None) -> None:
        self.node, self.seed, self.key, self.threads = node, seed, "0" * 64, os.cpu_count() or 1
        self._scratch, self._progress = scratch, progress

    @property
    def scratch(self) -> Path:
        self._scratch.mkdir(parents=True, exist_ok=True)
        return self._scratch

    def checkpoint(self, step: int, state: Mapping[str, Any]) -> None:
        """Nothing is kept."""

    def resume(self) -> None:
        return None

    def progress(self, step: int, total: int, **figures: float) -> None:
        if self._progress is not None:
            self._progress(step, total, **figures)

    def log(self, message: str) -> None:
        """Nobody listens."""

    def warn(self, message: str) -> None:
        warnings.warn(f"{self.node}: {message}", stacklevel=3)


def call(
    type: str | Callable[..., Any],
    /,
    *given: Any,
    seed: int = 0,
    folder: str | os.PathLike[str] | None = None,
    progress: Callable[..., Any] | None = None,
    session: Session | None = None,
    **values: Any,
) -> Any:
    """Call a node: artifacts and components for its inputs, plain values for its parameters; gives its outputs by name.

    A component is one of `component(...)`, the name of its type, or the object itself. `folder` is where files that the
    node makes go (default: a temporary one, until Python ends); `progress(step, total, **figures)` is called as it goes
    on. Raises GraphErrors for what the node does not take, and what the node itself raises.
    """
    packs, where, problems = (session or current_session()).packs(), here(), Problems()
    definition = declared(type, packs, where)
    kind, known = definition.type, signature(definition)
    if known.component is not None:
        fail(
            "node-type",
            where,
            f"{kind} is a component, which is not called",
            fix=f'give it to a node: component("{kind}")',
        )
    by_name(given, kind, [*known.inputs, *known.params.model_fields])
    if isinstance(seed, bool) or not isinstance(seed, int):
        wrong("seed", seed, "a whole number")
    values = {known.renamed.get(name, name): value for name, value in values.items()}
    inputs, plugs, fields = {}, {}, {}
    for name, port in known.inputs.items():
        value = values.pop(name, None)
        fields[name] = Value(Broken() if value is not None or not port.optional else None, where, where.base)
        if value is None and not port.optional:
            problems.add("missing-port", where, f"{kind}: the input {name} is not given", expected=str(port),
                         fix=f"{name}=...")  # fmt: skip
        elif value is not None:
            plug = _plug(f"{kind}.{name}", value, port, packs, where, problems)
            if plug is not None:
                plugs[name] = plug
            elif _fits(f"{kind}.{name}", value, port, where, problems):
                inputs[name] = value
    for name, value in values.items():
        fields[name] = Value(plain(value, f"{kind}.{name}", where, problems), where, where.base)
    spec = NodeSpec(kind, kind, fields, where, seed)
    params, told = check_part(_alone(spec), kind, packs, whole=True, plugs=plugs.values())
    problems.noted.update(told.noted)
    problems.raise_if_any()
    assert params is not None
    links = {name: Link("argument", name) for name in inputs}
    bound = Bound(kind, definition, known, params, links, {}, seed, where, plugs)
    for name, value in inputs.items():
        _check_facets(bound, name, value)
    marks = {name: mark_of(value) for name, value in inputs.items()}
    context = CallContext(kind, seed, _folder(folder), progress)
    words: dict[str, Any] = {known.params_name: params} if known.params_name else {}
    result = definition.function(context, **inputs, **{name: plug.value for name, plug in plugs.items()}, **words)
    contracts.check_untouched(bound, inputs, marks)
    contracts.outputs_of(bound, result)
    return result


def _check_facets(bound: Bound, port: str, value: Artifact) -> None:
    """What the port asks of the value, where a graph would have it promised by a wire. Raises GraphError."""
    try:
        contracts.check_input(bound, port, value, {})
    except GraphError as error:
        what = error.what.replace(f"the wire {bound.wire(port)} carries", f"{bound.name}.{port} cannot be")
        fix = "bring it into that form first (docs/conventions.md); units are normalised inside the unit sphere"
        raise GraphError(what, where=error.where, expected=error.expected, fix=fix) from None


def _fits(what: str, value: Any, port: Port, where: Place, problems: Problems) -> bool:
    """Whether a value is an artifact of a type that the port takes; else notes what it is instead."""
    if isinstance(value, port.types):
        return True
    shape, dtype, fix = getattr(value, "shape", None), getattr(value, "dtype", None), ""
    told = type_name(type(value)) if isinstance(value, Artifact) else f"a {type(value).__name__}"
    if shape is not None:
        told += f" of shape {tuple(shape)} and type {dtype}"
        fix = f"make one of it: {port.types[0].__name__}(...)"
    elif isinstance(value, Wire | Node):
        fix = "ex.call takes values; an output of a graph's node is known when the graph has run: run[node].port"
    elif isinstance(value, tuple) and hasattr(value, "_fields"):
        names = [name for name in value._fields if isinstance(getattr(value, name), port.types)]
        fix = f"give one of its outputs: .{names[0]}" if names else ""
    problems.add("wrong-type", where, f"{what} cannot be {told}", expected=str(port), found=told, fix=fix)
    return False


def _plug(what: str, value: Any, port: Port, packs: Packs, where: Place, problems: Problems) -> BoundComponent | None:
    """The component in `value`, where it is one that the port takes: an object, a Plug, or the name of a type."""
    if not any(issubclass(kind, Component) for kind in port.types):
        return None
    if isinstance(value, str):
        value = Plug(value, {})
    made: Any = _made(what, value, packs, where, problems) if isinstance(value, Plug) else value
    if not isinstance(made, Component):
        return None
    definition = next((one for one in packs.types.values() if one.function is type(made)), None)
    if definition is None or not _fits(what, made, port, where, problems):
        return None
    return BoundComponent(what, definition, made, {}, where)


def _made(what: str, plug: Plug[Any], packs: Packs, where: Place, problems: Problems) -> Component | None:
    """The object that a Plug describes; faults are noted."""
    known = signature(declared(plug.type, packs, where))
    fields: dict[str, Value] = {}
    nested: dict[str, Component] = {}
    for name, value in plug.fields.items():
        inner = (
            _plug(f"{what}.{name}", value, known.inputs[name], packs, where, problems) if name in known.inputs else None
        )
        if inner is not None:
            nested[name] = inner.value
            fields[name] = Value(Broken(), where, where.base)
        else:
            fields[name] = Value(plain(value, f"{what}.{name}", where, problems), where, where.base)
    spec = NodeSpec(plug.type, plug.type, fields, where, 0)
    model, told = check_part(_alone(spec), plug.type, packs, whole=True, nested=nested)
    problems.noted.update(told.noted)
    return model if isinstance(model, Component) else None


def _alone(spec: NodeSpec) -> Unrolled:
    return Unrolled(spec.name, Path.cwd(), {spec.name: spec}, {}, {})


def _folder(given: str | os.PathLike[str] | None) -> Path:
    """Where a node may write: `given`, or a folder that is removed when Python ends."""
    if given is not None:
        return path_of(given, "folder", "the path of a folder").absolute()
    kept = tempfile.TemporaryDirectory(prefix="exmesh-call-", ignore_cleanup_errors=True)
    atexit.register(kept.cleanup)
    return Path(kept.name)
