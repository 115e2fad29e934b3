"""Jobs on a Ray cluster. Ray only places them: `num_cpus`, `num_gpus`, `memory` and custom resources, no retries.

A Ray task holds one warm worker process of the `local` backend, so a crash of a native library costs one node here as
there. Data moves through the store, which must lie on a disk that all machines share, under the same path; events come
back as lines of a file in its work folder. When Ray loses a task's worker or machine, the job is placed again and goes
on from its last checkpoint. Usage statistics are switched off (on a cluster started by hand, its head decides:
`ray start --head --disable-usage-stats`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
import os
import platform
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from exmesh_graph import files
from exmesh_graph.errors import ExmeshError, GraphError, MissingLibraryError
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.node import wanted_of
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.run.backends import Backend
from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.run.job import STOPPED, Emit, Job, Outcome, failure

_RESTARTS = 3  # of one job whose worker or machine was lost
_LOOK = 0.2  # seconds between looks at events, and whether to stop
_OBJECT_STORE = 80 * 2**20  # bytes; nothing of ours lies there
_NAMES = {"cpu": "CPU", "gpu": "GPU", "ram_gb": "memory"}  # ours: Ray's; all others are custom resources
_GB = 1e9


class RayCluster(Backend):
    """The backend of a Ray cluster: the one at `address`, or a new one on this machine that ends with the run."""

    def __init__(self, store: Store, address: str | None = None) -> None:
        self.ray = _ray()
        self.own = not self.ray.is_initialized()
        if self.own:
            self._connect(address)
        self.remote = self.ray.remote(max_retries=0)(work)
        self.running: dict[str, _Placed] = {}
        self.ended: list[Outcome] = []
        self.stack = contextlib.ExitStack()
        with files.writing("the store", store.root, "--store"):
            self.home = self.stack.enter_context(files.own_folder(store.work))
        self.count = 0

    def _connect(self, address: str | None) -> None:
        quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
        try:
            if address is None:
                self.ray.init("local", include_dashboard=False, object_store_memory=_OBJECT_STORE, **quiet)
            else:
                self.ray.init(address, **quiet)
        except (ConnectionError, RuntimeError) as error:
            fix = "start one with `ray start --head --disable-usage-stats`, or leave out --address for one of its own"
            what = f"no Ray cluster can be reached: {error}"
            raise ExmeshError(what, where=f"--address {address}", fix=fix) from error

    def capacity(self) -> Mapping[str, float]:
        total = _tokens(self.ray.cluster_resources())
        return {**total, "jobs": max(1.0, total.get("cpu", 1.0))}

    def largest(self) -> Mapping[str, float]:
        machines = self._machines()
        return {name: max(m.get(name, 0.0) for m in machines) for name in {name for m in machines for name in m}}

    def submit(self, job: Job) -> None:
        self.count += 1
        self._place(_Placed(job, self.home / f"{self.count}.jsonl"))

    def poll(self, timeout: float, emit: Emit) -> list[Outcome]:
        end = time.monotonic() + timeout
        while True:
            done, self.ended = self.ended, []
            by_task = {placed.task: placed for placed in self.running.values()}
            ready: list[Any] = []
            if by_task and not done:
                wait = max(0.0, min(_LOOK, end - time.monotonic()))
                ready, _ = self.ray.wait(list(by_task), timeout=wait)
            for placed in self.running.values():
                placed.forward(emit)
            for placed in [by_task[task] for task in ready]:
                outcome = self._outcome(placed, emit)
                if outcome is not None:
                    del self.running[placed.job.name]
                    done.append(outcome)
            if done or not self.running or time.monotonic() >= end:
                return done

    def stop(self) -> None:
        for placed in self.running.values():
            placed.stop_mark.touch()

    def cancel(self, name: str) -> None:
        placed = self.running.pop(name, None)
        if placed is not None:
            self.ray.cancel(placed.task, force=True)

    def close(self) -> None:
        for name in list(self.running):
            self.cancel(name)
        if self.own:
            self.ray.shutdown()
        self.stack.close()

    def _place(self, placed: _Placed) -> None:
        """Hand a job to Ray; one that no machine can take is a failed one."""
        job = placed.job
        machines = self._machines()
        wanted = wanted_of(current().types[job.type], self.largest())
        known = {name: count for name, count in wanted.items() if name in _NAMES or any(name in m for m in machines)}
        if not any(all(machine.get(n, 0.0) >= c for n, c in known.items()) for machine in machines):
            words = ", ".join(f"{name}={count:g}" for name, count in known.items())
            error = GraphError(f"{job.type} asks for {words}, which no machine of the Ray cluster has", where=job.name)
            self.ended.append(failure(job.name, error))
            return
        others = {name: count for name, count in known.items() if name not in _NAMES}
        options = {"num_cpus": known["cpu"], "num_gpus": known.get("gpu", 0), "resources": others}
        if "ram_gb" in known:
            options["memory"] = known["ram_gb"] * _GB
        there = dataclasses.replace(job, threads=max(1, int(known["cpu"])), devices=())  # Ray picks the GPUs
        placed.task = self.remote.options(**options).remote(json.dumps(there.to_json()), str(placed.events))
        self.running[job.name] = placed

    def _outcome(self, placed: _Placed, emit: Emit) -> Outcome | None:
        """How a task ended; None when its worker was lost and it was placed again."""
        name, errors = placed.job.name, self.ray.exceptions
        try:
            return Outcome.from_json(json.loads(self.ray.get(placed.task)))
        except errors.TaskCancelledError:
            return Outcome(name, STOPPED)
        except errors.RayTaskError as error:
            return failure(name, error.cause if isinstance(error.cause, ExmeshError) else error)
        except errors.RayError as error:
            reason = f"{type(error).__name__}: {str(error).splitlines()[0]}"
            placed.restarts += 1
            if placed.restarts > _RESTARTS:
                what = f"Ray lost its worker {placed.restarts} times ({reason})"
                return failure(name, ExmeshError(what, fix="look for the reason in Ray's logs (/tmp/ray)"))
        emit({"event": "log", "node": name, "message": f"Ray lost its worker ({reason}); placed again"})
        del self.running[name]
        self._place(placed)
        return None

    def _machines(self) -> list[dict[str, float]]:
        return [_tokens(node["Resources"]) for node in self.ray.nodes() if node["Alive"]]


class _Placed:
    """A job that Ray has, and the file in which its events arrive."""

    def __init__(self, job: Job, events: Path) -> None:
        self.job, self.events, self.restarts = job, events, 0
        self.stop_mark = _stop_mark(events)
        self.task: Any = None
        self.events.touch()
        self.tail = files.Tail(events)

    def forward(self, emit: Emit) -> None:
        """Emit what has come in since. A line that a lost worker cut off is left out."""
        for line in filter(None, self.tail.lines()):
            with contextlib.suppress(ValueError):
                emit(json.loads(line))


_LOCAL: dict[tuple[str, str], Local] = {}  # of the one run that this Ray worker works for: {(store, run): backend}


def work(text: str, events: str) -> str:
    """What a Ray task does: a job, in a worker process that stays for the next one of its run; the outcome as JSON."""
    job, place = Job.from_json(json.loads(text)), Path(events)
    if not place.is_file():
        what = f"the store {job.store} cannot be reached from {platform.node()}"
        fix = "keep it on a disk that all machines of the cluster share, under the same path (--store)"
        raise GraphError(what, where=job.name, fix=fix)
    if not Path(job.log).parent.parent.is_dir():
        job = dataclasses.replace(job, log="")  # the run folder is on another machine; the end of it still gets there
    local = _local_of(job)
    asked = False
    with place.open("a", encoding="utf-8", buffering=1) as file:
        file.write("\n")  # ends a line that an earlier worker cut off

        def emit(event: Mapping[str, Any]) -> None:
            file.write(json.dumps(event, default=str) + "\n")

        local.submit(job)
        while True:
            for outcome in local.poll(_LOOK, emit):
                return json.dumps(outcome.to_json())
            if not asked and _stop_mark(place).exists():
                asked = True
                local.stop()


def _local_of(job: Job) -> Local:
    """The warm worker process of this run; that of an earlier one, whose memory is of another store, is ended."""
    place = job.store, job.run
    if place not in _LOCAL:
        for other in list(_LOCAL):
            _LOCAL.pop(other).close()
        _LOCAL[place] = Local(1)
        _LOCAL[place].budget //= os.cpu_count() or 1
    return _LOCAL[place]


def _stop_mark(events: Path) -> Path:
    return events.with_suffix(".stop")


def _tokens(resources: Mapping[str, float]) -> dict[str, float]:
    """Ray's resources under our names."""
    ours = {theirs: name for name, theirs in _NAMES.items()}
    tokens = {ours.get(name, name): float(count) for name, count in resources.items() if not name.startswith("node:")}
    tokens.pop("object_store_memory", None)
    return {name: count / _GB if name == "ram_gb" else count for name, count in tokens.items()}


def _ray() -> Any:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    try:
        import ray
    except ImportError as error:
        raise MissingLibraryError("the Ray backend needs Ray", fix="pip install 'exmesh-graph[ray]'") from error
    return ray
