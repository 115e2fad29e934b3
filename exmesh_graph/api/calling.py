"""One node as a function: `call("init.visual_hull", views=views, resolution=96).mesh`. No graph, store or context."""

from __future__ import annotations

import atexit
import os
import tempfile
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from exmesh_graph.api.arguments import by_name, path_of, wrong
from exmesh_graph.api.judge import declared, plug_of
from exmesh_graph.api.values import Node, Place, Plug, Wire, here, plain
from exmesh_graph.errors import GraphError
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Port, signature, type_name
from exmesh_graph.graph.language.check import Bound, check
from exmesh_graph.graph.language.expand import NodeSpec, Unrolled
from exmesh_graph.graph.language.links import Broken, Link
from exmesh_graph.graph.language.spec import Value
from exmesh_graph.graph.problems import Problems, fail
from exmesh_graph.graph.run.execute import check_input, check_untouched, outputs_of
from exmesh_graph.graph.run.lists import arguments
from exmesh_graph.graph.session import Session, current_session
from exmesh_graph.types import Artifact
from exmesh_graph.types.contents import mark_of


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
    packs, where = (session or current_session()).packs(), here()
    definition = declared(type, packs, where)
    kind, known = definition.type, signature(definition)
    if known.component is not None:
        fail("node-type", where, f"{kind} is a component, which is not called",
             fix=f'give it to a node: component("{kind}")')  # fmt: skip
    by_name(given, kind, [*known.inputs, *known.params.model_fields])
    if isinstance(seed, bool) or not isinstance(seed, int):
        wrong("seed", seed, "a whole number")
    work = _Written(packs, where)
    work.add(kind, type if isinstance(type, str) else kind, values, seed)
    checked = check(Unrolled(kind, Path.cwd(), work.specs, {}, {}), packs, work.problems)
    for note in checked.notes:
        warnings.warn(note, stacklevel=2)
    inputs = work.artifacts
    bound = replace(checked.nodes[kind], inputs={name: Link("argument", name) for name in inputs})
    for name, value in inputs.items():
        _check_facets(bound, name, value)
    marks = {name: mark_of(value) for name, value in inputs.items()}
    words: dict[str, Any] = {name: plug.value for name, plug in bound.components.items()}
    if known.params_name:
        words[known.params_name] = bound.params
    result = definition.function(
        CallContext(kind, seed, _folder(folder), progress), **arguments(known, inputs), **words
    )
    check_untouched(bound, inputs, marks)
    outputs_of(bound, result)
    return result


class _Written:
    """The graph of one node that a call stands for: `specs` of it and its components, `artifacts` for its inputs."""

    def __init__(self, packs: Packs, where: Place) -> None:
        self.packs, self.where, self.problems = packs, where, Problems()
        self.specs: dict[str, NodeSpec] = {}
        self.artifacts: dict[str, Artifact] = {}

    def add(self, name: str, kind: str, values: Mapping[str, Any], seed: int = 0) -> None:
        """Write a node or component with what it was given, and the components in that."""
        known, where = signature(declared(kind, self.packs, self.where)), self.where
        given: dict[str, Any] = {}
        for key, value in values.items():
            own, what = known.renamed.get(key, key), f"{name}.{key}"
            port = known.inputs.get(own)
            if port is None:
                given[key] = plain(value, what, where, self.problems)
            elif value is not None:
                given[key] = self._plugged(what, value, port) or Broken()
                items = enumerate(value, 1) if port.many and isinstance(value, list | tuple) else ()
                table = {f"{own}[{number}]": item for number, item in items} if port.many else {own: value}
                if port.many and not isinstance(value, list | tuple):
                    self.problems.add("wrong-type", where, f"{what} takes a list", expected=str(port))
                for name_, item in table.items() if isinstance(given[key], Broken) else ():
                    if self._fits(f"{name}.{name_}", item, port):
                        self.artifacts[name_] = item
        present = {known.renamed.get(key, key) for key in given}
        for own, port in known.inputs.items():
            if not port.optional and own not in present:
                self.problems.add("missing-port", where, f"{name}: the input {own} is not given", expected=str(port),
                                  fix=f"{own}=...")  # fmt: skip
                given[own] = Broken()
        fields = {key: Value(value, where, where.base) for key, value in given.items()}
        self.specs[name] = NodeSpec(name, kind, fields, where, seed)

    def _plugged(self, what: str, value: Any, port: Port) -> Link | None:
        """A link to the component that `value` describes, where the port takes it: by name, as Plug or as an object."""
        if not (port.plugged or port.mixed):
            return None
        plug = Plug(value, {}) if isinstance(value, str) else plug_of(value, self.packs, self.where)
        if plug is None:
            return None
        made = declared(plug.type, self.packs, self.where).function
        if not (isinstance(made, type) and issubclass(made, port.types)):
            return None
        self.add(what, plug.type, plug.fields)
        return Link(what, "")

    def _fits(self, what: str, value: Any, port: Port) -> bool:
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
        self.problems.add("wrong-type", self.where, f"{what} cannot be {told}", expected=str(port), found=told, fix=fix)
        return False


def _check_facets(bound: Bound, port: str, value: Artifact) -> None:
    """What the port asks of the value, where a graph would have it promised by a wire. Raises GraphError."""
    try:
        check_input(bound, port, value, {})
    except GraphError as error:
        what = error.what.replace(f"the wire {bound.wire(port)} carries", f"{bound.name}.{port} cannot be")
        fix = "bring it into that form first (docs/conventions.md); units are normalised inside the unit sphere"
        raise GraphError(what, where=error.where, expected=error.expected, fix=fix) from None


def _folder(given: str | os.PathLike[str] | None) -> Path:
    """Where a node may write: `given`, or a folder that is removed when Python ends."""
    if given is not None:
        return path_of(given, "folder", "the path of a folder").absolute()
    kept = tempfile.TemporaryDirectory(prefix="exmesh-call-", ignore_cleanup_errors=True)
    atexit.register(kept.cleanup)
    return Path(kept.name)
