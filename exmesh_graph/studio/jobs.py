"""Runs that the page starts: processes of their own, found again by the files that they leave in the store.

A job's folder is `STORE/studio/jobs/ID`: `job.json` says what runs, `started.json` which run folder and process it is,
`ended.json` how it ended, `log.txt` what it printed.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.errors import ExmeshError, GraphError, StoreError
from exmesh_graph.files import writing
from exmesh_graph.studio.runner import write

MOST = 4
"""Runs of ours at once."""
_KEPT_DAYS = 30.0
Job = Mapping[str, Any]


class TooMany(ExmeshError):
    """More runs at once than the page may start."""

    code = "busy"


class Jobs:
    """The jobs of a store."""

    def __init__(self, store: Path, runs: Path) -> None:
        self.folder, self.runs = store / "studio" / "jobs", runs
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._stopped: dict[str, int] = {}

    def start(self, job: Job) -> str:
        """Start a run or a sweep in a process of its own; the job's name. Raises TooMany, StoreError."""
        if len(self.alive()) >= MOST:
            raise TooMany(f"{MOST} runs are going on", fix="wait for one of them, or stop one")
        name = f"{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(4)}"
        folder = self.folder / name
        with writing("the job of a run", folder, "--store"):
            folder.mkdir(parents=True)
            write(folder / "job.json", {**job, "runs": str(self.runs)})
            with (folder / "log.txt").open("wb") as log:
                self._processes[name] = subprocess.Popen(
                    [sys.executable, "-m", "exmesh_graph.studio.runner", str(folder / "job.json")],
                    stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
                )  # fmt: skip
        return name

    def run_of(self, name: str, wait: float) -> str:
        """The run folder's name once there is one; empty after `wait` seconds. Raises what kept it from starting."""
        folder, end = self.folder / name, time.monotonic() + wait
        while True:
            started = _read(folder / "started.json")
            if started:
                return str(started.get("run", ""))
            ended = _read(folder / "ended.json")
            if ended and ended.get("state") != "done":
                told = ended.get("error") or {}
                raise GraphError(str(told.get("what", ended["state"])), where=str(told.get("where", "")),
                                 expected=str(told.get("expected", "")), fix=str(told.get("fix", "")))  # fmt: skip
            process = self._processes.get(name)
            if process is not None and process.poll() is not None and not ended:
                raise StoreError(
                    "the run could not be started", where=str(folder / "log.txt"), expected=self._said(name)
                )
            if time.monotonic() >= end:
                return ""
            time.sleep(0.05)

    def alive(self) -> dict[str, Job]:
        """The jobs whose process lives, also those that an earlier server started."""
        found: dict[str, Job] = {}
        for name, process in list(self._processes.items()):
            if process.poll() is not None:  # also lets go of the ended process
                del self._processes[name]
        for path in self.folder.glob("*/job.json"):
            folder = path.parent
            if (folder / "ended.json").exists():
                continue
            pid = (_read(folder / "started.json") or {}).get("pid", 0)
            if folder.name in self._processes or (pid and _is_runner(int(pid), path)):
                found[folder.name] = _read(path) or {}
        return found

    def ours(self) -> dict[str, str]:
        """{run: job} of all jobs that are known."""
        pairs = ((_read(path), path.parent.name) for path in self.folder.glob("*/started.json"))
        return {str(started["run"]): name for started, name in pairs if started and "run" in started}

    def job(self, run: str) -> Job | None:
        """What a run of ours was asked to do."""
        name = self.ours().get(run)
        return None if name is None else _read(self.folder / name / "job.json")

    def stop(self, run: Path) -> None:
        """Ask the process that writes a run folder to stop, as Ctrl-C does; a third time it is killed.

        Raises ExmeshError where there is no such process of this user.
        """
        pid = writer_of(run)
        if pid is None:
            raise ExmeshError(f"no process of yours on this machine writes {run.name}", where=str(run),
                              fix="stop it where it was started")  # fmt: skip
        times = self._stopped[run.name] = self._stopped.get(run.name, 0) + 1
        with contextlib.suppress(ProcessLookupError):
            if times >= 3 and run.name in self.ours() and os.getpgid(pid) == pid:
                os.killpg(pid, signal.SIGKILL)  # its workers with it: the group is its own
            else:
                os.kill(pid, signal.SIGINT)

    def sweep(self) -> None:
        """Remove what ended long ago."""
        for path in self.folder.glob("*/ended.json"):
            with contextlib.suppress(OSError):
                if time.time() - path.stat().st_mtime > _KEPT_DAYS * 86400:
                    for file in path.parent.iterdir():
                        file.unlink()
                    path.parent.rmdir()

    def _said(self, name: str) -> str:
        with contextlib.suppress(OSError):
            return (self.folder / name / "log.txt").read_text(encoding="utf-8", errors="replace")[-400:].strip()
        return ""


def writer_of(run: Path) -> int | None:
    """The process of this user that holds the lock of a run's events, as Linux tells; None where there is none."""
    try:
        status = (run / "events.jsonl").stat()
        lines = Path("/proc/locks").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    for line in lines:
        words = line.split()  # `1: FLOCK ADVISORY WRITE 1234 08:01:567 0 EOF`
        if len(words) >= 6 and words[1] == "FLOCK" and words[3] == "WRITE":
            *device, inode = words[5].split(":")
            same = int(inode) == status.st_ino and [int(part, 16) for part in device] == [
                os.major(status.st_dev), os.minor(status.st_dev)
            ]  # fmt: skip
            pid = int(words[4])
            if same and pid > 0 and pid != os.getpid() and _owner(pid) == os.getuid():
                return pid
    return None


def _owner(pid: int) -> int | None:
    with contextlib.suppress(OSError):
        return os.stat(f"/proc/{pid}").st_uid
    return None


def _is_runner(pid: int, job: Path) -> bool:
    """Whether a process is the one that a job started; numbers of processes are used again."""
    with contextlib.suppress(OSError):
        return str(job).encode() in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    return False


def _read(path: Path) -> dict[str, Any] | None:
    with contextlib.suppress(OSError, ValueError):
        told = json.loads(path.read_text(encoding="utf-8"))
        return told if isinstance(told, dict) else None
    return None
