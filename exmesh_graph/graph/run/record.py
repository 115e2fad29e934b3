"""What a run says of itself while it goes on: run.json, events, published outputs, records of failed nodes."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from exmesh_graph.graph.cache.store import NOTHING, Store, Stored
from exmesh_graph.graph.language.check import Bound, Checked
from exmesh_graph.graph.machine import machine_facts
from exmesh_graph.graph.run.job import Job, Outcome
from exmesh_graph.graph.run.rundir import RunFolder, failure_file

Listener = Callable[[Mapping[str, Any]], None]
HIT, WAITING, RUNNING, BLOCKED, INTERRUPTED = "hit", "waiting", "running", "blocked", "interrupted"


class RunRecord:
    """`record` is what run.json holds, `rows` its nodes by name; both are up to date at any time."""

    def __init__(
        self, graph: Checked, nodes: Mapping[str, Bound], store: Store, folder: RunFolder, listener: Listener,
        command: str, overrides: Iterable[str],
    ) -> None:  # fmt: skip
        self.graph, self.store, self.folder, self.listener = graph, store, folder, listener
        self.saved, self.save_cost = 0.0, 0.0
        self.rows: dict[str, dict[str, Any]] = {
            name: {"name": name, "type": bound.definition.type, "state": WAITING, "key": None, "seconds": 0.0,
                   "spent": 0.0, "outputs": {}, "warnings": []}
            for name, bound in nodes.items()
        }  # fmt: skip
        self.record: dict[str, Any] = {
            "id": folder.id, "graph": graph.name, "file": str(graph.file), "command": command,
            "overrides": list(overrides), "state": "unfinished", "started": time.time(), "machine": machine_facts(),
            "store": str(store.below or store.root), "resolved": graph.resolved(), "nodes": list(self.rows.values()),
            "published": {},
        }  # fmt: skip

    def emit(self, event: str, **facts: Any) -> None:
        """Tell the listener, and events.jsonl."""
        self.forward({"event": event, **facts})

    def forward(self, event: Mapping[str, Any]) -> None:
        """Tell an event that a job emitted."""
        stamped = {"time": round(time.time(), 3), **event}
        self.folder.event(stamped)
        self.listener(stamped)

    def publish(self, node: str, outputs: Mapping[str, Stored]) -> None:
        """Copy what the graph publishes of a node into the run's folder, once."""
        published = self.record["published"]
        for name, link in self.graph.outputs.items():
            if link.node == node and outputs[link.port] != NOTHING and name not in published:
                path = self.folder.publish(name, outputs[link.port], self.store)
                published[name] = str(path.relative_to(self.folder.path))

    def failed(
        self, bound: Bound, outcome: Outcome, inputs: Mapping[str, Stored], job: Job | None, command: str, first: bool
    ) -> dict[str, Any]:
        """Write the record of a failed node, from which it can be run again; `command` runs the whole graph."""
        name = bound.name
        record = {
            "node": name, "type": bound.definition.type,
            **{field: value for field, value in outcome.info.items() if field != "warnings"},
            "key": self.rows[name]["key"], "inputs": {port: str(link) for port, link in bound.inputs.items()},
            "input_digests": {port: vars(stored) for port, stored in inputs.items()},
            "params": bound.params.model_dump(mode="json"), "seed": bound.seed,
            "run_again": self.record["command"], "replay": f"{command} --node {shlex.quote(name)}",
            "argv": sys.argv, "job": None if job is None else job.to_json(), "file": failure_file(name),
        }  # fmt: skip
        for file in (record["file"], *(["failure.json"] if first else [])):
            self.folder.write(file, record)
        return record

    def save(self, now: bool = False) -> None:
        """Write run.json, between start and end at most so often that it costs a twentieth of the time."""
        began = time.monotonic()
        if now or began - self.saved >= max(0.5, 20 * self.save_cost):
            readable = self.record["state"] != "unfinished" and len(self.rows) <= 200
            self.folder.write("run.json", self.record, 1 if readable else None)  # compact is much faster
            self.saved = time.monotonic()
            self.save_cost = self.saved - began

    def finish(self, state: str, seconds: float) -> None:
        """Write the final state."""
        facts = {"store_notes": list(self.store.notes), "machine": machine_facts()}
        self.record.update(state=state, seconds=seconds, finished=time.time(), **facts)
        self.save(now=True)
        self.emit("run_finished", state=state, seconds=round(seconds, 3))
