"""Jobs in warm worker processes of this machine. A worker that dies is one failed node, and is replaced.

Workers live for one run and are started when a job finds none idle. A job goes to the idle worker that holds most of
its inputs in memory, whatever its number of threads: a worker sets that anew for each job. It has the GPUs of the job
it was started for, since CUDA reads them only once; a job that is granted others gets another worker.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph import files
from exmesh_graph.errors import LimitError
from exmesh_graph.graph.run.backends import Backend
from exmesh_graph.graph.run.job import FAILED, Emit, Job, Outcome, failure
from exmesh_graph.resources import confine, machine_tokens, memory_of, was_overdrawn

_START = "import sys; sys.path[:] = {path!r}; from exmesh_graph.graph.run.backends.worker import main; main({budget})"
_WAITING = {"OMP_WAIT_POLICY": "passive"}  # threads that spin at barriers starve one another beside other processes
_MEMORY_SHARE = 0.3  # of the machine's memory, for artifacts kept by all workers together
_LOOK = 1.0  # seconds; a child that a node left behind may keep a dead worker's pipe open
_TAIL = 12  # lines of a dead worker's output that are shown,
_OWN_FRAME = str(Path("run", "execute.py"))  # up to where the traceback of a fault leaves the node


class Local(Backend):
    """The backend of worker processes."""

    def __init__(self, workers: int | None = None) -> None:
        tokens = machine_tokens()
        self.count = workers or max(1, int(min(tokens["cpu"], tokens["ram_gb"] // 4)))
        self.budget = int(_MEMORY_SHARE * tokens["ram_gb"] * 1e9 / self.count)
        self.workers: list[_Worker] = []
        self.sizes: dict[str, int] = {}
        self.selector = selectors.DefaultSelector()

    def capacity(self) -> Mapping[str, float]:
        return {**machine_tokens(), "jobs": self.count}

    def submit(self, job: Job) -> None:
        idle = [w for w in self.workers if w.job is None]
        fitting = [w for w in idle if w.devices == job.devices]
        if fitting and "ram_gb" not in job.limits:  # what others left in memory is not this node's
            digests = {digest for _, digest in job.inputs.values()}
            worker = max(fitting, key=lambda w: sum(self.sizes.get(d, 1) for d in digests & w.holds))
        else:
            if len(self.workers) >= self.count and idle:
                self._drop(idle[0])
            worker = _Worker(job, self.budget)
            self.workers.append(worker)
            self.selector.register(worker.output, selectors.EVENT_READ, worker)
        worker.job, worker.began = job, time.monotonic()
        worker.send(job=job.to_json())

    def grant(self, name: str, cores: int) -> None:
        for worker in [w for w in self.workers if w.job is not None and w.job.name == name]:
            worker.send(cores=cores)

    def poll(self, timeout: float, emit: Emit) -> list[Outcome]:
        end = time.monotonic() + timeout
        done: list[Outcome] = []
        for worker in self.workers:
            worker.send()
        while not done:
            wait = min(max(0.0, end - time.monotonic()), _LOOK)
            heard: list[_Worker] = [key.data for key, _ in self.selector.select(wait)]
            for worker in heard or [w for w in self.workers if w.process.poll() is not None]:
                for message in worker.messages():
                    if "outcome" in message:
                        done.append(self._ended(worker, Outcome.from_json(message["outcome"])))
                    elif "event" in message:
                        emit(message)
                if worker.closed:
                    if worker.job is not None:
                        done.append(worker.obituary(worker.job))
                    self._drop(worker)
            for worker in [w for w in self.workers if w.job is not None and w.job.limits]:
                assert worker.job is not None
                if error := worker.beyond(worker.job):
                    done.append(failure(worker.job.name, error))
                    self._drop(worker, kill=True)
            if time.monotonic() >= end:
                break
        return done

    def _ended(self, worker: _Worker, outcome: Outcome) -> Outcome:
        if worker.job is not None:
            worker.holds.update(digest for _, digest in worker.job.inputs.values())
        for stored in outcome.outputs.values():
            worker.holds.add(stored.digest)
            self.sizes[stored.digest] = stored.bytes
        if worker.job is not None and "ram_gb" in worker.job.limits:
            if outcome.state == FAILED and (error := worker.overdrawn(worker.job)):  # a process below it was ended
                outcome = failure(outcome.name, error)
            self._drop(worker)
        worker.job = None
        return outcome

    def forget(self, digests: Iterable[str]) -> None:
        gone = set(digests)
        for worker in self.workers:
            worker.gone |= worker.holds & gone
            worker.holds -= gone

    def stop(self) -> None:
        for worker in self.workers:
            if worker.job is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(worker.process.pid, signal.SIGINT)

    def cancel(self, name: str) -> None:
        for worker in [w for w in self.workers if w.job is not None and w.job.name == name]:
            worker.job = None
            self._drop(worker, kill=True)

    def close(self) -> None:
        for worker in list(self.workers):
            self._drop(worker, kill=worker.job is not None)
        self.selector.close()

    def _drop(self, worker: _Worker, kill: bool = False) -> None:
        self.workers.remove(worker)
        self.selector.unregister(worker.output)
        worker.end(kill)


class _Worker:
    """The run's end of a worker process. It has its own session: a Ctrl-C at the terminal is not for it."""

    def __init__(self, job: Job, budget: int) -> None:
        self.devices = job.devices
        self.job: Job | None = None
        self.holds: set[str] = set()
        self.gone: set[str] = set()
        self.closed = False
        self.began = 0.0
        self._rest = b""
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (what it prints outside of nodes; closed in `end`)
        environment = {**_WAITING, **os.environ}
        if job.devices:
            visible = [word.strip() for word in os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",") if word.strip()]
            names = [visible[number] if number < len(visible) else str(number) for number in job.devices]
            environment["CUDA_VISIBLE_DEVICES"] = ",".join(names)
        code = _START.format(path=[entry or os.getcwd() for entry in sys.path], budget=budget)
        self.process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors,
            env=environment, start_new_session=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        self.output = self.process.stdout
        os.set_blocking(self.output.fileno(), False)
        most = job.limits.get("ram_gb")
        self.group = None if most is None else confine(self.process.pid, int(most * 1e9))

    def send(self, **message: Any) -> None:
        """A message, and what it need not keep; nothing where there is neither."""
        assert self.process.stdin is not None
        if message or self.gone:
            with contextlib.suppress(BrokenPipeError):  # its death is noticed on the other pipe
                self.process.stdin.write(json.dumps({**message, "forget": sorted(self.gone)}).encode() + b"\n")
                self.process.stdin.flush()
            self.gone.clear()

    def messages(self) -> list[dict[str, Any]]:
        """What has come in. A line that was cut off by an interrupt is left out."""
        data = b""
        with contextlib.suppress(BlockingIOError):
            while part := os.read(self.output.fileno(), 1 << 16):
                data += part
            self.closed = True
        self.closed = self.closed or self.process.poll() is not None
        *lines, self._rest = (self._rest + data).split(b"\n")
        messages = []
        for line in filter(None, lines):
            with contextlib.suppress(ValueError):
                messages.append(json.loads(line))
        return messages

    def beyond(self, job: Job) -> LimitError | None:
        """The limit that a job is past, if any: seconds since it was handed over, memory of all its processes, disk."""
        taken, home, pid = {"seconds": time.monotonic() - self.began}, Path(job.store, "work"), self.process.pid
        if "ram_gb" in job.limits:
            taken["ram_gb"] = memory_of(pid) / 1e9
        if "disk_gb" in job.limits:
            with contextlib.suppress(FileNotFoundError):  # removed while it is measured
                taken["disk_gb"] = sum(map(files.allocated, home.glob(f"{pid}-*"))) / 1e9
        past = [(name, took) for name, took in taken.items() if took > job.limits.get(name, math.inf)]
        return self._past(job, *past[0]) if past else None

    def overdrawn(self, job: Job) -> LimitError | None:
        """The limit of memory, where the kernel ended one of the job's processes for it."""
        killed = self.group is not None and was_overdrawn(self.group)
        return self._past(job, "ram_gb", job.limits["ram_gb"]) if killed else None

    def _past(self, job: Job, name: str, took: float) -> LimitError:
        most, place = job.limits[name], ":".join(map(str, job.where)) if job.where[0] else job.name
        fix = f"give it more, limits: {{{name}: {2 * most:g}}}, or less to do; one that keeps checkpoints goes on there"
        return LimitError(f"{job.name} took {took:.3g} {name}, past its limit of {most:g}", where=place, fix=fix)

    def obituary(self, job: Job) -> Outcome:
        """The outcome of a job whose process died under it."""
        code = self.process.wait()
        if error := self.overdrawn(job):
            return failure(job.name, error)
        if code < 0:
            name = signal.Signals(-code).name
            hint = {"SIGKILL": ", most often for want of memory", "SIGSEGV": ", a fault in a native library"}
            what = f"its process was ended by {name}{hint.get(name, '')}"
        else:
            what = f"its process ended itself with exit status {code}"
        lines = self._tail(Path(job.log)) if job.log else []
        if not lines:
            self._errors.seek(0)
            lines = self._errors.read().decode(errors="replace").splitlines()
        own = next((number for number, line in enumerate(lines) if _OWN_FRAME in line), len(lines))
        shown = lines[max(0, own - _TAIL) : own]
        message = "\n".join([what, *(f"  | {line}" for line in shown)])
        info = {"error": "ProcessDied", "what": what, "message": message, "at": "", "traceback": "\n".join(lines),
                "passes": code == -signal.SIGKILL}  # fmt: skip
        return Outcome(job.name, FAILED, info=info)

    def _tail(self, path: Path) -> list[str]:
        with contextlib.suppress(OSError), path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - 20_000))
            return file.read().decode(errors="replace").splitlines()
        return []

    def end(self, kill: bool) -> None:
        if kill:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        try:
            self.process.wait(2.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        if self.group is not None:
            with contextlib.suppress(OSError):
                self.group.rmdir()
        self.output.close()
        self._errors.close()
