"""What a run leaves: runs/<id>/ with run.json, events.jsonl, logs/, published outputs, and after failures failure.json
(the first) and failures/ (all).

A published artifact is a copy, so that editing it cannot touch the store. A Files artifact published under the name
`asset` lies directly in runs/<id>/; anything else in runs/<id>/<name>/.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.errors import StoreError
from exmesh_graph.files import copy_files, is_locked, writing
from exmesh_graph.graph.cache.keys import NOTHING, Stored, elements
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.language.check import OWN_FOLDERS, Bound, Checked
from exmesh_graph.graph.run.job import Job, Outcome
from exmesh_graph.resources import machine_facts
from exmesh_graph.types import Files

OWN_FILES = (*OWN_FOLDERS, "run.json", "graph.yaml", "events.jsonl", "failure.json", "report.json", "report.html")


class RunFolder:
    """A new folder below `runs`; `latest` points to it."""

    def __init__(self, runs: Path, graph_name: str) -> None:
        with writing("the run folder", runs, "--runs"):
            self._open(runs, graph_name)

    def _open(self, runs: Path, graph_name: str) -> None:
        runs.mkdir(parents=True, exist_ok=True)
        self._tail = "-" + "".join(c if c.isalnum() else "-" for c in graph_name)
        stem = time.strftime("%Y%m%d-%H%M%S") + self._tail
        for number in range(1, 1000):
            self.path = runs.absolute() / (stem if number == 1 else f"{stem}-{number}")
            try:
                self.path.mkdir()
                break
            except FileExistsError:
                continue
        self.id = self.path.name
        self._events = (self.path / "events.jsonl").open("a", encoding="utf-8")
        fcntl.flock(self._events, fcntl.LOCK_EX | fcntl.LOCK_NB)  # held while the run lives; see is_alive
        pointer = runs / f".latest-{os.getpid()}"
        pointer.unlink(missing_ok=True)
        pointer.symlink_to(self.id)
        os.replace(pointer, runs / "latest")

    def event(self, event: Mapping[str, Any]) -> None:
        """Append one line to events.jsonl."""
        with writing("the run folder", self.path, "--runs"):
            self._events.write(json.dumps(event, default=str) + "\n")
            self._events.flush()

    def write(self, name: str, value: Mapping[str, Any], indent: int | None = 1) -> None:
        """Replace a JSON file of the run."""
        target = self.path / name
        draft = target.with_name(f".{target.name}.draft")
        with writing("the run folder", self.path, "--runs"):
            target.parent.mkdir(exist_ok=True)
            draft.write_text(json.dumps(value, indent=indent, default=str) + "\n", encoding="utf-8")
            os.replace(draft, target)

    def publish(self, name: str, stored: Stored, store: Store) -> Path:
        """Copy an artifact into the run's folder; returns the path a user opens."""
        source, main = store.data(stored.digest), ""
        if (source / "main.json").is_file() and (source / "files").is_dir():
            main = Files.load(source).main
            source = source / "files"
        target = self.path if name == "asset" and source.name == "files" else self.path / name
        names = {path.name for path in source.iterdir()} if target == self.path else {name}
        taken = names & ({path.name for path in self.path.iterdir()} | set(OWN_FILES))
        if taken:
            raise StoreError(f"the output {name} would overwrite {', '.join(sorted(taken))} in {self.path}")
        with writing("the run folder", target, "--runs"):
            copy_files(source, target)
        return target / main if main else target

    def log(self, node: str) -> Path:
        """The file for what a node prints."""
        return log_file(self.path, node)

    def past(self, figure: str) -> dict[str, float]:
        """{node: its `seconds` or `peak_rss`} in the latest earlier runs of the graph beside this one."""
        figures: dict[str, float] = {}
        earlier = [path for path in self.path.parent.iterdir() if self._tail in path.name and not path.is_symlink()]
        for path in sorted(set(earlier) - {self.path}, reverse=True)[:3]:
            with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
                for row in json.loads((path / "run.json").read_text(encoding="utf-8"))["nodes"]:
                    if row["state"] in ("hit", "done"):
                        figures.setdefault(row["name"], float(row[figure]))
        return figures

    def close(self) -> None:
        """Let go of the events file."""
        with contextlib.suppress(OSError):  # what could not be written was reported by then
            self._events.close()


def log_file(run: Path, node: str) -> Path:
    """The file for what a node prints."""
    return run / "logs" / f"{_plain(node)}.log"


def failure_file(node: str) -> str:
    """The name of a failed node's record inside the run folder."""
    return f"failures/{_plain(node)}.json"


def _plain(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_.[]" else "-" for c in name)


def is_alive(run: Path) -> bool:
    """Whether the process that writes this run folder still lives."""
    return is_locked(run / "events.jsonl")


def _row(bound: Bound) -> dict[str, Any]:
    return {"name": bound.name, "type": bound.definition.type, "state": WAITING, "key": None, "seconds": 0.0,
            "spent": 0.0, "outputs": {}, "warnings": []}  # fmt: skip


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
        self.rows: dict[str, dict[str, Any]] = {name: _row(bound) for name, bound in nodes.items()}
        self.record: dict[str, Any] = {
            "id": folder.id, "graph": graph.name, "file": str(graph.file), "command": command,
            "overrides": list(overrides), "state": "unfinished", "started": time.time(), "machine": machine_facts(),
            "store": str(store.below or store.root), "resolved": graph.resolved(), "nodes": list(self.rows.values()),
            "published": {}, "idle": list(graph.idle),
        }  # fmt: skip

    def add(self, parts: Iterable[Bound], name: str) -> None:
        """Note the nodes that one with `each` stands for, before it."""
        own, rows = self.rows[name], self.record["nodes"]
        place = next(index for index, row in enumerate(rows) if row is own)
        own["inputs"] = {}
        for part in parts:
            self.rows[part.name] = {**_row(part), "inputs": {port: str(link) for port, link in part.inputs.items()}}
            own["inputs"][part.name] = f"@{part.name}.{next(iter(part.signature.outputs), '')}"
        rows[place:place] = [self.rows[part] for part in own["inputs"]]
        self.emit("nodes_added", nodes=[*own["inputs"]], of=name)

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
            for port in elements(outputs, link.port) if link.node == node else ():
                label = name + port.removeprefix(link.port).replace("[", "-").rstrip("]")  # meshes-1, meshes-2, ...
                if outputs[port] != NOTHING and label not in published:
                    path = self.folder.publish(label, outputs[port], self.store)
                    published[label] = str(path.relative_to(self.folder.path))

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
