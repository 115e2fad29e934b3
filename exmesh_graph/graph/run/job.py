"""One execution of one node as plain JSON, and `execute`, which carries it out in whatever process it is called.

A job names its inputs by digest and its result is in the store when `execute` returns: backends move jobs and
outcomes, never data. Whoever executes also writes the record, after the objects.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from exmesh_graph.errors import ExmeshError, GraphError, StoreError
from exmesh_graph.graph.cache.fingerprint import fingerprint, remember_in, sources_changed
from exmesh_graph.graph.cache.keys import key_of
from exmesh_graph.graph.cache.records import NOTHING, Stored
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.components import rebuild, validated_otherwise
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.declare.ports import artifact_types, signature
from exmesh_graph.graph.language.check import Bound
from exmesh_graph.graph.language.links import Link
from exmesh_graph.graph.machine import machine_facts, peak_memory, reset_peak_memory
from exmesh_graph.graph.problems import Where
from exmesh_graph.graph.run import contracts
from exmesh_graph.graph.run.checkpoint import Checkpoints
from exmesh_graph.graph.run.memory import Memory
from exmesh_graph.graph.run.plan import preimage_for
from exmesh_graph.types import Artifact, Files

Emit = Callable[[Mapping[str, Any]], None]
DONE, FAILED, BROKEN, STOPPED = "done", "failed", "broken", "stopped"
_CHECKPOINT_SHARE = 20  # checkpoints may cost a twentieth of a node's time
FIGURES = ("seconds", "store_seconds", "peak_rss", "warnings")  # of a record, those that a run shows


@dataclass(frozen=True)
class Job:
    """What to run and what it is keyed by. Everything is plain JSON.

    inputs: {port: [type, digest]}; components: {port: BoundComponent.describe()};
    wires: {port: "node.port"} for messages; promised: facets that need no measuring;
    threads and devices: CPU threads and GPU numbers granted; log: the file for what the node prints;
    checkpoint_every: seconds, 0 for each step; packs: the session's, for a process that has none yet (none: the
    installed ones).
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

    @property
    def key(self) -> str:
        return key_of(self.preimage)

    def bound(self) -> Bound:
        """The node, its parameters validated again. Raises GraphError where no pack defines the type."""
        definition = current().find(self.type)
        if definition is None:
            raise GraphError(f"there is no node type {self.type!r}", where=self.name, fix="exmesh nodes lists all")
        kind = signature(definition)
        links = {port: Link(*wire.rpartition(".")[::2]) for port, wire in self.wires.items()}
        paths = {name: Path(path) for name, path in self.sources.items()}
        file, line = self.where
        place = Where(None if file is None else Path(file), line)
        params = kind.params.model_validate(dict(self.params))
        if params.model_dump(mode="json") != dict(self.params):
            raise validated_otherwise(self.type, params.model_dump(mode="json"), self.params, place)
        plugs = {port: rebuild(port, told, place) for port, told in self.components.items()}
        return Bound(self.name, definition, kind, params, links, paths, self.seed, place, plugs)

    def to_json(self) -> dict[str, Any]:
        return dict(vars(self))

    @classmethod
    def from_json(cls, raw: Mapping[str, Any]) -> Job:
        known = {field.name: raw[field.name] for field in fields(cls) if field.name in raw}
        tuples = {name: tuple(raw[name]) for name in ("where", "devices", "packs") if name in raw}
        return cls(**{**known, **tuples})


def job_of(
    bound: Bound, nodes: Mapping[str, Bound], preimage: Mapping[str, Any], store: Store, **more: Any
) -> Job:  # fmt: skip
    """The job of a node whose inputs are all known. `more`: graph, run, threads, devices, log, packs."""
    file = bound.where.file
    return Job(
        bound.name,
        bound.definition.type,
        bound.params.model_dump(mode="json"),
        bound.seed,
        preimage["inputs"],
        {port: f"{link.node}.{link.port}" for port, link in bound.inputs.items()},
        {port: dict(contracts.promised_by(link, nodes)) for port, link in bound.inputs.items()},
        {name: str(path) for name, path in bound.sources.items()},
        preimage,
        str(store.root),
        (None if file is None else str(file), bound.where.line),
        components={port: plug.describe() for port, plug in bound.components.items()},
        **more,
    )


def rekeyed(job: Job, store: Store) -> Job:
    """The job with the key that it has now, on `store`: code, libraries or source files may have changed since."""
    bound = job.bound()
    known = {job.wires[port]: Stored(kind, digest, 0) for port, (kind, digest) in job.inputs.items()}
    preimage = preimage_for(bound, store, lambda node, port: known.get(f"{node}.{port}", NOTHING))
    return replace(job, preimage=preimage, store=str(store.root))


@dataclass(frozen=True)
class Outcome:
    """How a job ended.

    done: `outputs` are those of the record, `info` its FIGURES. failed: `info` holds error, what, message, at and
    traceback; `cause` is the error where it happened in this process. broken: the input info["port"] cannot be read
    from the store (info["note"]). stopped: interrupted; what it had check-pointed is kept.
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


class NodeContext:
    """The `Context` that a running node sees. `stopping` makes the next checkpoint the last step."""

    def __init__(self, job: Job, scratch: Path, checkpoints: Checkpoints | None, emit: Emit) -> None:
        self._job, self._scratch, self._checkpoints, self._emit = job, scratch, checkpoints, emit
        self._next = 0.0
        self._due = time.monotonic() + job.checkpoint_every
        self.stopping = False
        self.warnings: list[str] = []

    @property
    def node(self) -> str:
        return self._job.name

    @property
    def key(self) -> str:
        return self._job.key

    @property
    def seed(self) -> int:
        return self._job.seed

    @property
    def threads(self) -> int:
        return self._job.threads

    @property
    def scratch(self) -> Path:
        self._scratch.mkdir(exist_ok=True)
        return self._scratch

    def checkpoint(self, step: int, state: Mapping[str, Any]) -> None:
        kept, began = self._kept(), time.monotonic()
        if began < self._due and not self.stopping:
            return
        try:
            kept.save(step, state)
        except StoreError as error:  # the work itself may still come through
            self.warn(f"no checkpoint at step {step}: {error.what}")
        now = time.monotonic()
        every = self._job.checkpoint_every
        self._due = now + (max(every, _CHECKPOINT_SHARE * (now - began)) if every else 0.0)
        if self.stopping:
            self.log(f"stopped at step {step}; the same command goes on from there")
            raise KeyboardInterrupt

    def resume(self) -> tuple[int, dict[str, Any]] | None:
        kept = self._kept()
        kept_state = kept.load()
        for note in kept.notes:
            self.log(note)
        if kept_state is not None:
            self.log(f"goes on from the checkpoint at step {kept_state[0]}")
        return kept_state

    def _kept(self) -> Checkpoints:
        if self._checkpoints is None:
            what = f"{self._job.type} uses checkpoints, which its declaration does not say"
            raise GraphError(what, where=self.node, fix="@node(..., resumable=True)")
        return self._checkpoints

    def progress(self, step: int, total: int, **figures: float) -> None:
        now = time.monotonic()
        if now >= self._next or step >= total:
            self._next = now + 0.2
            plain = {name: float(value) for name, value in figures.items()}
            self._emit({"event": "progress", "node": self.node, "step": step, "total": total, **plain})

    def log(self, message: str) -> None:
        self._emit({"event": "log", "node": self.node, "message": message})

    def warn(self, message: str) -> None:
        self.warnings.append(message)
        self._emit({"event": "warning", "node": self.node, "message": message})


class _BrokenInput(Exception):
    """An input whose bytes in the store cannot be used."""


def execute(job: Job, store: Store, memory: Memory, emit: Emit) -> Outcome:
    """Run a job to its outcome: inputs from memory or the store, contracts checked, outputs and record stored.

    Errors of the node become an outcome; KeyboardInterrupt passes through with the attempt's folder removed.
    """
    try:
        return _execute(job, store, memory, emit)
    except _BrokenInput as broken:
        return Outcome(job.name, BROKEN, info={"port": broken.args[0], "note": broken.args[1]})
    except (Exception, SystemExit) as error:
        return failure(job.name, error)


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
    }
    return Outcome(name, FAILED, info=info, cause=error)


def _execute(job: Job, store: Store, memory: Memory, emit: Emit) -> Outcome:
    bound = job.bound()
    remember_in(store.code)
    loaded = {port: _value(job, port, store, memory) for port in job.inputs}
    inputs = {port: value for port, (value, _) in loaded.items()}
    marks = {port: mark for port, (_, mark) in loaded.items()}
    for port, given in inputs.items():
        contracts.check_input(bound, port, given, job.promised.get(port, {}))
    with store.attempt() as attempt:
        kept = attempt if _changed(bound, job) else store.root  # what other code computes is none of this key's states
        checkpoints = Checkpoints(kept, job.key) if bound.definition.resumable else None
        context = NodeContext(job, attempt / "scratch", checkpoints, emit)
        reset_peak_memory()
        started, began = time.time(), time.perf_counter()
        with _stoppable(context, bound.definition.resumable):
            result = _call(bound, context, inputs)
        seconds, peak = time.perf_counter() - began, peak_memory()
        contracts.check_untouched(bound, inputs, marks)
        values = contracts.outputs_of(bound, result)
        del result
        stored = {port: NOTHING if v is None else store.put(v, attempt) for port, v in values.items()}
        for port, value in values.items():
            if value is not None and not isinstance(value, Files):  # files are read back: the work folder goes away
                memory.put(stored[port].digest, value)
    info = {
        "node": job.name, "graph": job.graph, "run": job.run, "seconds": seconds,
        "store_seconds": time.perf_counter() - began - seconds, "peak_rss": peak, "started": started,
        "finished": time.time(), "warnings": context.warnings, "machine": machine_facts(),
        "code_parts": fingerprint(bound.definition).parts,
    }  # fmt: skip
    _record(job, bound, store, stored, info, context)
    if checkpoints is not None:
        checkpoints.clear()
    if context.stopping:  # it ended without another checkpoint
        raise KeyboardInterrupt
    return Outcome(job.name, DONE, stored, {name: info[name] for name in FIGURES})


def _value(job: Job, port: str, store: Store, memory: Memory) -> tuple[Artifact, int]:
    """An input and its mark."""
    type_name, digest = job.inputs[port]
    remembered = memory.get(digest)
    if remembered is None:
        kinds = artifact_types()
        if type_name not in kinds:
            raise GraphError(f"no node pack defines the artifact type {type_name!r}", where=job.wires[port])
        loaded = store.load(kinds[type_name], digest)
        if loaded is None:
            raise _BrokenInput(port, store.notes[-1] if store.notes else f"object {digest} is gone")
        return loaded, memory.put(digest, loaded)
    return remembered


def _call(bound: Bound, context: NodeContext, inputs: Mapping[str, Artifact]) -> Any:
    """Call the node's function; Python warnings go to its log."""
    name = bound.signature.params_name
    extra: dict[str, Any] = {port: plug.value for port, plug in bound.components.items()}
    if name:
        extra[name] = bound.params
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.showwarning = lambda message, category, *_, **__: context.log(f"{category.__name__}: {message}")
        return bound.definition.function(context, **inputs, **extra)


@contextlib.contextmanager
def _stoppable(context: NodeContext, resumable: bool) -> Iterator[None]:
    """While a resumable node runs, the first SIGINT or SIGTERM asks it to stop at its next checkpoint."""
    if not resumable or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def ask(number: int, frame: Any) -> None:
        if context.stopping:
            raise KeyboardInterrupt
        context.stopping = True

    for number in before:
        signal.signal(number, ask)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _record(
    job: Job, bound: Bound, store: Store, stored: Mapping[str, Stored], info: Mapping[str, Any], context: NodeContext
) -> None:
    """Record the action, unless what it was keyed by changed under its hands."""
    listed = {} if bound.definition.sources is None else bound.definition.sources(bound.params)
    if {str(name): Path(path) for name, path in listed.items()} != dict(bound.sources):
        raise GraphError(f"the list of source files changed while {bound.name} ran", where=str(bound.where))
    for name, path in bound.sources.items():
        if store.sources.digest(path) != job.preimage["sources"][name]:
            raise GraphError(f"the source file {name} changed while {bound.name} ran", where=str(path))
    changed = _changed(bound, job)
    if changed:
        context.warn(f"not remembered: its code changed during the run ({', '.join(changed)})")
        return
    store.record(job.preimage, stored, info)


def _changed(bound: Bound, job: Job) -> list[str]:
    """What of the code is not as it was when the job was keyed."""
    changed = [name for definition in bound.definitions() for name in sources_changed(definition)]
    keyed = {"": job.preimage["code"]} | dict(_codes(job.preimage.get("components", {})))
    now = {"": fingerprint(bound.definition).digest}
    now |= {plug.name: fingerprint(plug.definition).digest for plug in bound.plugged()}
    return changed or (["since the run was planned"] if now != keyed else [])


def _codes(plugs: Mapping[str, Any], place: str = "") -> Iterator[tuple[str, str]]:
    """(name as `rebuild` gives it, code) of all components of a pre-image."""
    for port, plug in plugs.items():
        yield place + port, plug["code"]
        yield from _codes(plug["components"], f"{place}{port}.")
