"""Running a graph in this process: hits from the store, the rest computed in order, every result stored at once.

Neighbours hand values over in memory; a value is dropped when its last consumer is done. The key of each node is
taken from the recorded digests of its inputs just before it would run, so that equal outputs stop a cascade.
"""

from __future__ import annotations

import os
import shlex
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.errors import ExmeshError, GraphError, StoreError
from exmesh_graph.graph import contracts
from exmesh_graph.graph.check import Bound, Checked
from exmesh_graph.graph.fingerprint import fingerprint, sources_changed
from exmesh_graph.graph.keys import key_of
from exmesh_graph.graph.plan import preimage_for
from exmesh_graph.graph.rundir import RunFolder
from exmesh_graph.graph.store import NOTHING, Store, Stored
from exmesh_graph.machine import machine_facts, peak_memory, reset_peak_memory
from exmesh_graph.types import Artifact, Files

Listener = Callable[[Mapping[str, Any]], None]
HIT, DONE, FAILED, WAITING, RUNNING = "hit", "done", "failed", "waiting", "running"


class NodeFailed(ExmeshError):
    """A node raised an error; `cause` is the error, `record` what failure.json holds."""

    code = "node"

    def __init__(self, node: str, cause: BaseException, record: Mapping[str, Any]) -> None:
        self.node, self.cause, self.record = node, cause, record
        text = str(cause) if isinstance(cause, ExmeshError) else f"{type(cause).__name__}: {cause}"
        super().__init__(text, where=node)


class NodeContext:
    """The `Context` that a running node sees."""

    def __init__(self, bound: Bound, scratch: Path, emit: Listener) -> None:
        self._bound, self._scratch, self._emit = bound, scratch, emit
        self._next = 0.0
        self.warnings: list[str] = []

    @property
    def node(self) -> str:
        return self._bound.name

    @property
    def seed(self) -> int:
        return self._bound.seed

    @property
    def scratch(self) -> Path:
        self._scratch.mkdir(exist_ok=True)
        return self._scratch

    @property
    def threads(self) -> int:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

    def checkpoint(self, step: int, state: Mapping[str, Any]) -> None:
        """Not kept yet: an interrupted node starts again."""

    def resume(self) -> tuple[int, dict[str, Any]] | None:
        return None

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


class Run:
    """One run of a checked graph. `record` is what run.json holds; it is up to date at any time."""

    def __init__(
        self,
        graph: Checked,
        store: Store,
        folder: RunFolder,
        listener: Listener,
        *,
        targets: set[str] | None = None,
        force: set[str] | None = None,
        command: str = "",
        overrides: tuple[str, ...] = (),
    ) -> None:
        self.graph, self.store, self.folder, self.listener = graph, store, folder, listener
        self.force = force or set()
        self.nodes = {n: b for n, b in graph.nodes.items() if targets is None or n in targets}
        self.outputs: dict[str, dict[str, Stored]] = {}
        self.memory: dict[tuple[str, str], Artifact] = {}
        self.users: dict[tuple[str, str], int] = {}
        for bound in self.nodes.values():
            for link in bound.inputs.values():
                self.users[link.node, link.port] = self.users.get((link.node, link.port), 0) + 1
        self.rows: dict[str, dict[str, Any]] = {
            name: {"name": name, "type": bound.definition.type, "state": WAITING, "key": None, "seconds": 0.0,
                   "spent": 0.0, "outputs": {}, "warnings": []}
            for name, bound in self.nodes.items()
        }  # fmt: skip
        self.record: dict[str, Any] = {
            "id": folder.id, "graph": graph.name, "file": str(graph.file), "command": command,
            "overrides": list(overrides), "state": "unfinished", "started": time.time(), "machine": machine_facts(),
            "resolved": graph.resolved(), "nodes": list(self.rows.values()), "published": {},
        }  # fmt: skip

    def run(self) -> dict[str, Any]:
        """Run everything; returns the record. Raises NodeFailed or KeyboardInterrupt, with the record written."""
        started = time.perf_counter()
        self.store.sweep()
        self._save()
        self._emit({"event": "run_started", "run": self.folder.id, "nodes": list(self.nodes)})
        state = "failed"
        try:
            for bound in self.nodes.values():
                self._step(bound)
                self._release(bound)
            state = "done"
        except KeyboardInterrupt:
            state = "interrupted"
            raise
        finally:
            self.store.sources.save()
            self.record["store_notes"] = list(self.store.notes)
            self.record["machine"] = machine_facts()
            self.finish(state, time.perf_counter() - started)
        return self.record

    def finish(self, state: str, seconds: float) -> None:
        """Write the final state."""
        self.record.update(state=state, seconds=seconds, finished=time.time())
        self._save()
        self._emit({"event": "run_finished", "state": state, "seconds": round(seconds, 3)})

    def _step(self, bound: Bound) -> None:
        started = time.perf_counter()
        row = self.rows[bound.name]
        try:
            if not (bound.name not in self.force and self._hit(bound)):
                self._compute(bound)
            self._publish(bound.name)
        except KeyboardInterrupt:
            row["state"] = "interrupted"
            raise
        except Exception as error:
            self._fail(bound, error)
        finally:
            row["spent"] = time.perf_counter() - started
            self._save()
        figures = {"seconds": row["seconds"], "spent": row["spent"]}
        self._emit({"event": "node_finished", "node": bound.name, "state": row["state"], **figures})

    def _hit(self, bound: Bound) -> bool:
        preimage = self._preimage(bound)
        action = self.store.look_up(key_of(preimage))
        if action is None or set(action.outputs) != set(bound.signature.outputs):
            return False
        shown = [link.port for link in self.graph.outputs.values() if link.node == bound.name]
        if not all(self.store.sound(action.outputs[port].digest) for port in shown if action.outputs[port] != NOTHING):
            return False
        self.outputs[bound.name] = dict(action.outputs)
        info = {name: action.info[name] for name in ("seconds", "peak_rss", "warnings") if name in action.info}
        self._note(bound, HIT, action.key, info)
        return True

    def _compute(self, bound: Bound) -> None:
        self.rows[bound.name]["state"] = RUNNING
        self._emit({"event": "node_started", "node": bound.name})
        inputs = {port: self._value(link.node, link.port) for port, link in bound.inputs.items()}
        present = {port: value for port, value in inputs.items() if value is not None}
        preimage = self._preimage(bound)
        self.rows[bound.name]["key"] = key_of(preimage)
        for port, value in present.items():
            contracts.check_input(bound, port, value, contracts.promised_by(bound.inputs[port], self.graph.nodes))
        with self.store.attempt() as attempt:
            context = NodeContext(bound, attempt / "scratch", self._emit)
            marks = contracts.sample(present)
            reset_peak_memory()
            started, began = time.time(), time.perf_counter()
            result = self._call(bound, context, present)
            seconds, peak = time.perf_counter() - began, peak_memory()
            contracts.check_untouched(bound, present, marks)
            values = contracts.outputs_of(bound, result)
            del result
            stored = {port: NOTHING if v is None else self.store.put(v, attempt) for port, v in values.items()}
            self._keep(bound.name, values, stored)
        info = {
            "node": bound.name, "graph": self.graph.name, "run": self.folder.id, "seconds": seconds,
            "store_seconds": time.perf_counter() - began - seconds, "peak_rss": peak, "started": started,
            "finished": time.time(), "warnings": context.warnings, "machine": machine_facts(),
            "code_parts": fingerprint(bound.definition).parts,
        }  # fmt: skip
        self._store_record(bound, preimage, stored, info, context)
        self.outputs[bound.name] = stored
        self._note(bound, DONE, key_of(preimage), info)

    def _call(self, bound: Bound, context: NodeContext, inputs: Mapping[str, Artifact]) -> Any:
        """Call the node's function; Python warnings go to its log."""
        name = bound.signature.params_name
        extra = {name: bound.params} if name else {}
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            warnings.showwarning = lambda message, category, *_, **__: context.log(f"{category.__name__}: {message}")
            return bound.definition.function(context, **inputs, **extra)

    def _store_record(
        self, bound: Bound, preimage: Mapping[str, Any], stored: Mapping[str, Stored], info: Mapping[str, Any],
        context: NodeContext,
    ) -> None:  # fmt: skip
        """Record the action, unless what it was keyed by changed under its hands."""
        for name, path in bound.sources.items():
            if self.store.sources.digest(path) != preimage["sources"][name]:
                raise GraphError(f"the source file {name} changed while {bound.name} ran", where=str(path))
        changed = sources_changed(bound.definition)
        if changed:
            context.warn(f"not remembered: its code changed during the run ({', '.join(changed)})")
            return
        self.store.record(preimage, stored, info)

    def _value(self, node: str, port: str) -> Artifact | None:
        """An output's value: from memory, from the store, or, where the store's copy is broken, made again."""
        if (node, port) in self.memory:
            return self.memory[node, port]
        stored = self.outputs[node][port]
        if stored == NOTHING:
            return None
        bound = self.graph.nodes[node]
        value = self.store.load(bound.signature.outputs[port].type, stored.digest)
        if value is None:
            self._emit({"event": "log", "node": node, "message": f"made again: {self.store.notes[-1]}"})
            self._compute(bound)
            if (node, port) not in self.memory:
                raise StoreError(f"the output {port} of {node} is broken again", fix="check the disk")
            return self.memory[node, port]
        if self.users.get((node, port), 0) > 1:
            self.memory[node, port] = value
        return contracts.frozen(value)

    def _keep(self, name: str, values: Mapping[str, Artifact | None], stored: Mapping[str, Stored]) -> None:
        """Keep outputs that others wait for; files are read from the store, since the work folder goes away."""
        for port, value in values.items():
            if value is None or not self.users.get((name, port)):
                continue
            kept: Artifact | None = value
            if isinstance(value, Files):
                kept = self.store.load(type(value), stored[port].digest)
            if kept is not None:
                self.memory[name, port] = contracts.frozen(kept)

    def _release(self, bound: Bound) -> None:
        """Drop the values for which this node was the last consumer."""
        for link in bound.inputs.values():
            place = (link.node, link.port)
            self.users[place] -= 1
            if self.users[place] == 0:
                self.memory.pop(place, None)

    def _publish(self, node: str) -> None:
        for name, link in self.graph.outputs.items():
            if link.node == node and self.outputs[node][link.port] != NOTHING:
                path = self.folder.publish(name, self.outputs[node][link.port], self.store)
                self.record["published"][name] = str(path.relative_to(self.folder.path))

    def _preimage(self, bound: Bound) -> dict[str, Any]:
        return preimage_for(bound, self.store, lambda node, port: self.outputs[node][port])

    def _note(self, bound: Bound, state: str, key: str, info: Mapping[str, Any]) -> None:
        outputs = {port: vars(stored) for port, stored in self.outputs[bound.name].items()}
        row = self.rows[bound.name]
        row.update(state=state, key=key, outputs=outputs)
        row.update({n: info[n] for n in ("seconds", "store_seconds", "peak_rss", "warnings") if n in info})

    def _fail(self, bound: Bound, error: Exception) -> None:
        row = self.rows[bound.name]
        row["state"] = FAILED
        shown = error.what if isinstance(error, ExmeshError) else str(error)
        inputs = {port: str(link) for port, link in bound.inputs.items()}
        record = {
            "node": bound.name, "type": bound.definition.type, "error": type(error).__name__, "what": shown,
            "message": str(error), "traceback": traceback.format_exc(), "key": row["key"], "inputs": inputs,
            "input_digests": {p: vars(self.outputs[link.node][link.port]) for p, link in bound.inputs.items()},
            "params": bound.params.model_dump(mode="json"), "seed": bound.seed,
            "run_again": self.record["command"], "replay": f"{self.record['command']} --node {shlex.quote(bound.name)}",
            "argv": sys.argv,
        }  # fmt: skip
        self.folder.write("failure.json", record)
        self._emit({"event": "node_failed", "node": bound.name, "message": str(error)})
        raise NodeFailed(bound.name, error, record) from error

    def _emit(self, event: Mapping[str, Any]) -> None:
        stamped = {"time": round(time.time(), 3), **event}
        self.folder.event(stamped)
        self.listener(stamped)

    def _save(self) -> None:
        done = self.record["state"] != "unfinished"
        self.folder.write("run.json", self.record, 1 if done else None)  # compact is much faster
