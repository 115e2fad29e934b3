"""Declaring nodes and components. A node is a function, its ports from the annotations, its parameters from one frozen
model:

    class HullParams(Params):
        resolution: int = param(128, ge=16, le=512, unit="voxels", doc="Grid points along the longest side.")

    class HullOut(NamedTuple):
        mesh: Annotated[Mesh, facets(manifold=True)]

    @node("init.visual_hull", version="1")
    def visual_hull(ctx: Context, views: Annotated[Views, facets(split="train")], *, p: HullParams) -> HullOut:
        \"\"\"One line for `exmesh nodes`.\"\"\"

Input ports are the positional parameters after `ctx` (a default of None makes one optional); output ports are the
fields of the NamedTuple that the function returns (`Mesh | None` may be absent, and then what needs it is not run).
Heavy imports belong inside the function.

A component is a small spec that plugs into a node, such as a loss: a class whose fields are parameters.

    class Loss(Component):
        \"\"\"Base of what a port of type Loss takes.\"\"\"

    @component("loss.smooth", version="1")
    class Smooth(Loss):
        \"\"\"One line for `exmesh nodes`.\"\"\"

        weight: float = param(0.1, ge=0, doc="...")
        inner: Loss | None = None              # components nest

        def value(self, x): ...

    @node("stage9.fit", version="1")
    def fit(ctx: Context, carrier: Carrier, loss: Loss, *, p: FitParams) -> FitOut: ...
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

from exmesh_graph.graph.declare.packs import declare
from exmesh_graph.params import Params

F = TypeVar("F", bound=Callable[..., Any])
C = TypeVar("C", bound="type[Component]")


@dataclass(frozen=True)
class Note:
    """What stands in `Annotated` beside a port's type: properties it promises (outputs) or asks for (inputs), names it
    had before.
    """

    facets: Mapping[str, Any] = field(default_factory=dict)
    was: tuple[str, ...] = ()

    def __hash__(self) -> int:  # typing hashes the notes of `Annotated[...] | None`
        return hash((tuple(sorted(self.facets)), self.was))


def facets(**values: Any) -> Note:
    """Used inside `Annotated[Type, facets(closed=True)]`."""
    return Note(values)


def was(*names: str) -> Note:
    """Used inside `Annotated[Type, was("old")]`: graph files may use the port's old name for one release."""
    return Note(was=names)


@runtime_checkable
class Context(Protocol):
    """What a running node may ask of the framework."""

    @property
    def node(self) -> str:
        """What messages may call the node: its type. (Its name in the graph is in no key and must change no result.)"""

    @property
    def key(self) -> str:
        """The node's key: a hash of its inputs, parameters, code and libraries. For provenance."""

    @property
    def seed(self) -> int:
        """The seed of this node; part of the key."""

    @property
    def scratch(self) -> Path:
        """An empty folder of this attempt, removed afterwards; outputs of type Files may lie here."""

    @property
    def threads(self) -> int:
        """CPU threads that this node may use; they must not change the result."""

    def checkpoint(self, step: int, state: Mapping[str, Any]) -> None:
        """Offer the state after `step` steps, for a run that is cut off to go on from.

        Cheap to call every step: it is written at most every half minute and on the first Ctrl-C. `state` holds numpy
        arrays, torch tensors, numbers, strings, None, and nested dicts and lists of these; it must be enough to end
        with the same result as an uninterrupted run. Only in nodes declared `resumable=True`.
        """

    def resume(self) -> tuple[int, dict[str, Any]] | None:
        """(step, state) of the last checkpoint of an earlier attempt at this very key, or None: start afresh."""

    def progress(self, step: int, total: int, **figures: float) -> None:
        """Report progress: `loss=`, `psnr=` and the like are shown live and logged. Cheap to call often."""

    def log(self, message: str) -> None:
        """A line for the node's log."""

    def warn(self, message: str) -> None:
        """A warning for the user: shown, logged and kept in the run's report."""


@dataclass(frozen=True)
class NodeDef:
    """A registered node type, or a component type, whose `function` is its class."""

    type: str
    function: Callable[..., Any]
    version: str
    deterministic: bool = True
    libraries: tuple[str, ...] = ()
    code: tuple[str, ...] = ()
    sources: Callable[[Any], Mapping[str, Path]] | None = None
    resources: Mapping[str, float] = field(default_factory=dict)
    resumable: bool = False
    was: tuple[str, ...] = ()

    @property
    def origin(self) -> str:
        """Module and name of the function or class."""
        return f"{self.function.__module__}.{self.function.__qualname__}"


def node(
    type: str,
    *,
    version: str,
    deterministic: bool = True,
    libraries: tuple[str, ...] = (),
    code: tuple[str, ...] = (),
    sources: Callable[[Any], Mapping[str, Path]] | None = None,
    resources: Mapping[str, float] | None = None,
    resumable: bool = False,
    was: str | tuple[str, ...] = (),
) -> Callable[[F], F]:
    """Register a function as the node `type`.

    version    raise it when the meaning changes in a way the code fingerprint cannot see
    libraries  distributions whose version belongs in the key (xatlas, warp-lang, ...)
    code       extra modules whose source belongs in the fingerprint, beside those the function imports
    sources    params -> {name: file} of every file the node reads; their contents belong in the key and the
               path parameters do not. It raises DataError for a missing file, so that `check` can say so.
    resources  what one execution takes: {"cpu": 1, "gpu": 0, "vram_gb": 0, "ram_gb": 0, any other name: n}; these are
               the defaults, and "cpu": 0 takes all cores. "gpu?": 1 takes one where there is any (`device: auto`). They
               never change a key.
    resumable  whether the node uses ctx.checkpoint and ctx.resume
    was        names that the type had before: graph files may use them for one release
    """
    taken = {"cpu": 1.0, **(resources or {})}
    if any(isinstance(n, bool) or not isinstance(n, int | float) or n < 0 for n in taken.values()):
        raise ValueError(f"node type {type!r}: resources are numbers >= 0, not {dict(taken)!r}")

    def add(function: F) -> F:
        declare(
            NodeDef(type, function, version, deterministic, libraries, code, sources, taken, resumable, _names(was))
        )
        return function

    return add


class Component(Params):
    """Base of all components: a frozen model whose fields are parameters and nested components."""


def component(
    type: str,
    *,
    version: str,
    libraries: tuple[str, ...] = (),
    code: tuple[str, ...] = (),
    was: str | tuple[str, ...] = (),
) -> Callable[[C], C]:
    """Register a class as the component `type`; the words mean what they mean for `node`."""

    def add(cls: C) -> C:
        declare(NodeDef(type, cls, version, libraries=libraries, code=code, was=_names(was)))
        return cls

    return add


def _names(was: str | tuple[str, ...]) -> tuple[str, ...]:
    return (was,) if isinstance(was, str) else was


def wanted_of(definition: NodeDef, most: Mapping[str, float]) -> dict[str, float]:
    """What one execution takes on a machine that has `most`: cpus cut to its own, `name?` only where it has any."""
    wanted = {"cpu": 1.0}
    for name, count in definition.resources.items():
        if not name.endswith("?"):
            wanted[name] = count
        elif most.get(name[:-1], 0.0) > 0:
            wanted[name[:-1]] = min(count, most[name[:-1]])
    cpus = most.get("cpu", 1.0)
    return {**wanted, "cpu": min(wanted["cpu"] or cpus, cpus)}
