"""Carrying out a job in whatever process: inputs from memory or the store, contracts checked, the result recorded."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.errors import GraphError, StoreError
from exmesh_graph.graph.cache.fingerprint import fingerprint, remember_in, sources_changed
from exmesh_graph.graph.cache.keys import NOTHING, Stored, key_of, kinds_of, listed, preimage_of
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.ports import Port, artifact_types, base_name
from exmesh_graph.graph.language.check import Bound
from exmesh_graph.graph.problems import in_short
from exmesh_graph.graph.run.checkpoint import Checkpoints
from exmesh_graph.graph.run.hermetic import ALONE, apart
from exmesh_graph.graph.run.job import BROKEN, DONE, FIGURES, Emit, Job, Outcome, failure
from exmesh_graph.graph.run.lists import arguments
from exmesh_graph.graph.run.memory import Memory
from exmesh_graph.resources import machine_facts, peak_memory, reset_peak_memory, return_memory
from exmesh_graph.types import Artifact
from exmesh_graph.types.contents import losses, mark_of

_SMALL, _LARGE = 2**16, 256 * 2**20  # bytes
_read_back: set[tuple[str, str, str]] = set()
_MOST_SAID = 4 * 2**20  # letters of messages and warnings
_CHECKPOINT_SHARE = 20  # checkpoints may cost a twentieth of a node's time


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
    finally:
        return_memory()


class NodeContext:
    """The `Context` that a running node sees. `stopping` makes the next checkpoint the last step."""

    def __init__(self, job: Job, scratch: Path, checkpoints: Checkpoints | None, emit: Emit) -> None:
        self.node, self.key, self.seed, self.threads = job.type, job.key, job.seed, job.threads
        self._job, self._scratch, self._checkpoints, self._emit = job, scratch, checkpoints, emit
        self._next, self._said = 0.0, 0
        self._due = time.monotonic() + job.checkpoint_every
        self.stopping = False
        self.warnings: list[str] = []

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
        last = kept.load()
        for note in kept.notes:
            self.log(note)
        if last is not None:
            self.log(f"goes on from the checkpoint at step {last[0]}")
        return last

    def _kept(self) -> Checkpoints:
        if self._checkpoints is None:
            what = f"{self._job.type} uses checkpoints, which its declaration does not say"
            raise GraphError(what, where=self._job.name, fix="@node(..., resumable=True)")
        return self._checkpoints

    def progress(self, step: int, total: int, **figures: float) -> None:
        now = time.monotonic()
        if now >= self._next or step >= total:
            self._next = now + 0.2
            plain = {name: float(value) for name, value in figures.items()}
            self._emit({"event": "progress", "node": self._job.name, "step": step, "total": total, **plain})

    def log(self, message: str) -> None:
        self._say("log", message)

    def warn(self, message: str) -> None:
        if self._say("warning", message):
            self.warnings.append(message)

    def _say(self, event: str, message: str) -> bool:
        """Tell a message; False from where a node said too much."""
        if self._said > _MOST_SAID:
            return False
        self._said += 100 + len(message)
        more = " (it said too much: what it says from here on is left out)" if self._said > _MOST_SAID else ""
        self._emit({"event": event, "node": self._job.name, "message": message[:_MOST_SAID] + more})
        return True


def _execute(job: Job, store: Store, memory: Memory, emit: Emit) -> Outcome:
    bound = job.bound()
    remember_in(store.code)
    loaded = {port: _value(job, port, store, memory) for port in job.inputs}
    inputs = {port: value for port, (value, _) in loaded.items()}
    marks = {port: mark for port, (_, mark) in loaded.items()}
    for port, given in inputs.items():
        check_input(bound, port, given, job.promised.get(port, {}))
    with store.attempt() as attempt:
        kept = attempt if _changed(bound, job) else store.root  # what other code computes is none of this key's states
        checkpoints = Checkpoints(kept, job.key) if bound.definition.resumable else None
        context = NodeContext(job, attempt / "scratch", checkpoints, emit)
        reset_peak_memory()
        started, began, before = time.time(), time.perf_counter(), _stamps(bound)
        with ALONE, _stoppable(context, bound.definition.resumable), apart(job.seed):
            result = _call(bound, context, inputs)
        seconds, peak = time.perf_counter() - began, peak_memory()
        check_untouched(bound, inputs, marks)
        values = outputs_of(bound, result)
        del result
        stored = {port: store.put(v, attempt) if isinstance(v, Artifact) else v for port, v in values.items()}
        for port, value in values.items():
            if isinstance(value, Artifact) and not value.read_back:  # what lies in the work folder goes away with it
                memory.put(stored[port].digest, read_back(bound, port, value, stored[port], store))
    info = {
        "node": job.name, "graph": job.graph, "run": job.run, "seconds": seconds,
        "store_seconds": time.perf_counter() - began - seconds, "peak_rss": peak, "started": started,
        "finished": time.time(), "warnings": context.warnings, "machine": machine_facts(),
        "code_parts": fingerprint(bound.definition).parts,
    }  # fmt: skip
    _record(job, bound, store, stored, info, context, before)
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
        return bound.definition.function(context, **arguments(bound.signature, inputs), **extra)


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
    job: Job, bound: Bound, store: Store, stored: Mapping[str, Stored], info: Mapping[str, Any], context: NodeContext,
    before: Mapping[str, Any],
) -> None:  # fmt: skip
    """Record the action, unless what it was keyed by changed under its hands. `before`: its `_stamps`."""
    listed = {} if bound.definition.sources is None else bound.definition.sources(bound.params)
    if {str(name): Path(path) for name, path in listed.items()} != dict(bound.sources):
        raise GraphError(f"the list of source files changed while {bound.name} ran", where=str(bound.where))
    for name, path in bound.sources.items():
        if store.sources.digest(path) != job.preimage["sources"][name]:
            raise GraphError(f"the source file {name} changed while {bound.name} ran", where=str(path))
    changed = _changed(bound, job)
    touched = [name for name, stamp in _stamps(bound).items() if stamp != before[name]]  # there and back, say
    if changed or touched:
        what, names = ("code", dict.fromkeys(changed)) if changed else ("source files", dict.fromkeys(touched))
        context.warn(f"not remembered: its {what} changed during the run ({in_short(list(names), 4)})")
        return
    store.record(job.preimage, stored, info)


def _changed(bound: Bound, job: Job) -> list[str]:
    """What of the code is not as it was when the job was keyed."""
    changed = [name for definition in bound.definitions() for name in sources_changed(definition)]
    kinds = kinds_of(bound, job.inputs)
    changed += [name for kind in kinds for name in sources_changed(NodeDef(kind, artifact_types()[kind], ""))]
    now = preimage_of(bound, fingerprint(bound.definition).digest, job.preimage["sources"], job.inputs)
    return changed or (["since the run was planned"] if key_of(now) != job.key else [])


def _stamps(bound: Bound) -> dict[str, Any]:
    """What tells that source files were written, also where their contents are as before."""
    return {name: [(s := path.stat()).st_ino, s.st_size, s.st_mtime_ns] for name, path in bound.sources.items()}


def check_input(bound: Bound, port: str, value: Artifact, promised: Mapping[str, Any]) -> None:
    """Facets that the port asks for and the wire does not promise, measured on the value itself."""
    asked_by = bound.signature.inputs[base_name(port)]
    wanted = asked_by.wanted(type(value))
    open_facets = {k: v for k, v in wanted.items() if k not in promised}
    if not open_facets:
        return
    measured = {**value.conventions, **value.facets()}
    for name, asked in open_facets.items():
        if measured.get(name) != asked:
            found = f"{name}={measured[name]!r}" if name in measured else f"no facet {name!r}"
            what = f"the wire {bound.wire(port)} carries {value.type_name} with {found}"
            expected = f"{asked_by}, {name}={asked!r}"
            fix = f"put a node before {bound.name} whose output has {name}={asked!r}"
            raise GraphError(what, where=str(bound.where), expected=expected, fix=fix)


def outputs_of(bound: Bound, result: Any) -> dict[str, Artifact | Stored]:
    """The values a node returned, by port; refuses wrong types and facets it promised but does not keep.

    Lists have an entry for each element beside their own; NOTHING stands for what is absent.
    """
    ports = bound.signature.outputs
    if not isinstance(result, tuple) or len(result) != len(ports):
        raise GraphError(f"{bound.definition.type} returned {type(result).__name__}", expected=", ".join(ports))
    values: dict[str, Any] = {}
    for name, value in zip(ports, result, strict=True):
        if ports[name].many and isinstance(value, list | tuple):
            values[name] = listed(len(value))
            values |= {f"{name}[{number}]": item for number, item in enumerate(value, 1)}
        else:
            values[name] = NOTHING if value is None and ports[name].optional else value
    for name, value in values.items():
        port = ports[base_name(name)]
        if isinstance(value, Stored):
            continue
        if not isinstance(value, port.type) or port.many != (name != port.name):
            what = f"{bound.definition.type} returned {type(value).__name__} for its output {name}"
            raise GraphError(what, expected=str(port))
        _check_promise(bound, port, value)
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


def read_back(bound: Bound, port: str, value: Artifact, stored: Stored, store: Store) -> Artifact:
    """What others get of a value in memory: a small one as they would read it from the store, a large one itself.

    Raises when `save` lost something. Of large ones the first in a process is looked at for a type of each version of
    a node, and where `load` gives it otherwise, in another order say, all are read back; not above 256 MB.
    """
    pair = value.type_name, bound.definition.type, bound.definition.version
    if stored.bytes > _LARGE or (pair in _read_back and stored.bytes > _SMALL):
        return value
    again = store.load(type(value), stored.digest)
    lost, alike = (["what `load` can read"], False) if again is None else losses(value, again)
    if again is None or lost:
        what = f"{value.type_name} loses on the way to its files and back: {in_short(lost, 3)}"
        fix = f"mend save and load of {type(value).__name__}, or make the value in the types that they keep"
        raise GraphError(what, where=f"{bound.name}.{port}", fix=fix)
    if alike and stored.bytes > _SMALL:
        _read_back.add(pair)
    return again


def check_untouched(bound: Bound, inputs: Mapping[str, Artifact], before: Mapping[str, int]) -> None:
    """Raise when a node changed an input in place: what it was keyed by is not what others would read."""
    for port, value in inputs.items():
        if mark_of(value) != before[port]:
            what = f"{bound.definition.type} changed its input {port} in place"
            fix = "copy before changing: np.array, torch.tensor, shutil.copytree into ctx.scratch"
            raise GraphError(what, where=bound.wire(port), fix=fix)
