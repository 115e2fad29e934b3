"""One execution of one node as plain JSON, and how it ended.

A job names its inputs by digest and its result is in the store when `execute` returns: backends move jobs and
outcomes, never data. Whoever executes also writes the record, after the objects.
"""

from __future__ import annotations

import contextlib
import traceback
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from exmesh_graph.errors import ExmeshError, GraphError, may_pass
from exmesh_graph.graph.cache.keys import Stored, key_of
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.components import in_order, rebuild, validated_again
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.declare.ports import artifact_types, base_name, signature
from exmesh_graph.graph.language.check import Bound, Checked
from exmesh_graph.graph.language.links import Link
from exmesh_graph.graph.problems import Where

Emit = Callable[[Mapping[str, Any]], None]
DONE, FAILED, BROKEN, STOPPED = "done", "failed", "broken", "stopped"
FIGURES = ("seconds", "store_seconds", "peak_rss", "warnings")  # of a record, those that a run shows


@dataclass(frozen=True)
class Job:
    """What to run and what it is keyed by. Everything is plain JSON.

    inputs: {port: [type, digest]}; components: {port: BoundComponent.describe()};
    wires: {port: "node.port"} for messages; promised: facets that need no measuring;
    threads and devices: CPU threads and GPU numbers granted; log: the file for what the node prints;
    checkpoint_every: seconds, 0 for each step; limits: those of the node; packs: the session's, for a process that has
    none yet (none: the installed ones).
    """

    name: str
    type: str
    params: Mapping[str, Any]
    seed: int
    inputs: Mapping[str, list[str]]
    wires: Mapping[str, str]
    promised: Mapping[str, Mapping[str, Any]]
    sources: Mapping[str, str]
    preimage: Mapping[str, Any]
    store: str
    where: tuple[str | None, int] = (None, 0)
    graph: str = ""
    run: str = ""
    components: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    threads: int = 1
    devices: tuple[int, ...] = ()
    log: str = ""
    checkpoint_every: float = 30.0
    packs: tuple[str, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> str:
        return key_of(self.preimage)

    def bound(self) -> Bound:
        """The node, its parameters validated again. Raises GraphError where no pack defines the type."""
        definition = current().find(self.type)
        if definition is None:
            raise GraphError(f"there is no node type {self.type!r}", where=self.name, fix="exmesh nodes lists all")
        links = {port: Link(*wire.rpartition(".")[::2]) for port, wire in self.wires.items()}
        paths = {name: Path(path) for name, path in self.sources.items()}
        file, line = self.where
        place = Where(None if file is None else Path(file), line)
        params = validated_again(definition, self.params, {}, place)
        plugs = {port: rebuild(port, told, place) for port, told in self.components.items()}
        return Bound(self.name, definition, signature(definition), params, links, paths, self.seed, place, plugs)

    def is_of_main(self) -> bool:
        """Whether its code or an input is of `__main__`, a script or a notebook: no other process has it."""
        homes: list[str] = []
        with contextlib.suppress(ExmeshError):  # told of where it runs
            kinds = artifact_types()
            homes += [definition.function.__module__ for definition in self.bound().definitions()]
            homes += [kinds[name].__module__ for name, _ in self.inputs.values() if name in kinds]
        return "__main__" in homes

    def to_json(self) -> dict[str, Any]:
        return dict(vars(self))

    @classmethod
    def from_json(cls, raw: Mapping[str, Any]) -> Job:
        known = {field.name: raw[field.name] for field in fields(cls) if field.name in raw}
        tuples = {name: tuple(raw[name]) for name in ("where", "devices", "packs") if name in raw}
        return cls(**{**known, **tuples})


def job_of(
    bound: Bound, graph: Checked, preimage: Mapping[str, Any], store: Store, wires: Mapping[str, Link], **more: Any
) -> Job:  # fmt: skip
    """The job of a node whose inputs are all known, by `wires`. `more`: run, threads, devices, log, packs."""
    file, links = bound.where.file, wires.items()
    return Job(
        bound.name, bound.definition.type, in_order(bound.params.model_dump(mode="json")), bound.seed,
        preimage["inputs"], wires={port: f"{link.node}.{link.port}" for port, link in links},
        promised={port: graph.nodes[lk.node].signature.outputs[base_name(lk.port)].promises for port, lk in links},
        sources={name: str(path) for name, path in bound.sources.items()},
        preimage=preimage, graph=graph.name, store=str(store.root),
        where=(None if file is None else str(file), bound.where.line),
        components={port: plug.describe() for port, plug in bound.components.items()}, limits=bound.limits,
        **more,
    )  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """How a job ended.

    done: `outputs` are those of the record, `info` its FIGURES. failed: `info` holds error, what, message, at,
    traceback, and whether its cause `passes`; `cause` is the error where it happened in this process. broken: the input
    info["port"] cannot be read from the store (info["note"]). stopped: interrupted; what it had check-pointed is kept.
    """

    name: str
    state: str
    outputs: Mapping[str, Stored] = field(default_factory=dict)
    info: Mapping[str, Any] = field(default_factory=dict)
    cause: BaseException | None = None

    def to_json(self) -> dict[str, Any]:
        outputs = {port: asdict(stored) for port, stored in self.outputs.items()}
        return {"name": self.name, "state": self.state, "outputs": outputs, "info": dict(self.info)}

    @classmethod
    def from_json(cls, raw: Mapping[str, Any]) -> Outcome:
        return cls(**{**raw, "outputs": {port: Stored(**entry) for port, entry in raw["outputs"].items()}})


def failure(name: str, error: BaseException) -> Outcome:
    """The outcome of an error."""
    text = str(error) if isinstance(error, ExmeshError) else f"{type(error).__name__}: {error}"
    frames = traceback.extract_tb(error.__traceback__)
    own = isinstance(error, ExmeshError) or not frames
    info = {
        "error": type(error).__name__,
        "what": error.what if isinstance(error, ExmeshError) else str(error),
        "message": text,
        "at": "" if own else f"{frames[-1].filename}:{frames[-1].lineno} in {frames[-1].name}",
        "traceback": "".join(traceback.format_exception(error)),
        "passes": may_pass(error),
    }
    return Outcome(name, FAILED, info=info, cause=error)
