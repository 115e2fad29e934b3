"""Leases: who computes a key right now, so that two processes in need of one result do not both compute it.

    leases/<key>.json   a line of JSON {host, boot, space, pid, started, nonce}, then a line with the heartbeat counter

A lease saves work and guards nothing: two holders of one key would both write the same sound result. It appears
complete (a draft is hard-linked to its name, which fails where the name is taken; a file system without hard links gets
an exclusive create) and it is taken over by renaming it away. Both are atomic on local file systems and on NFS.
What it says is never believed for long. It is free when

- its process is gone: same host, boot and process namespace, and no process with that id and start time,
- its host was started anew since, or
- its counter stood still for `limit` seconds of the waiter's own monotonic clock (ten times as long while its process
  is seen alive, since native code may hold up the heartbeat). Wall clocks and file times play no part.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from exmesh_graph.graph.machine import Process

LIMIT = 90.0  # seconds; above the 60 s for which an NFS client may show old file contents
BEAT = 5.0
_DIGITS = 12


@dataclass(frozen=True)
class Holder:
    """Who holds a lease; `age` is for how many seconds this process has seen its heartbeat stand still."""

    key: str
    host: str
    boot: str
    pid: int
    age: float

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


@dataclass
class Lease:
    """A held lease. `notice` says whose stale lease was taken over, or why none could be written; else empty."""

    key: str
    path: Path | None
    nonce: str = ""
    notice: str = ""
    _count: int = field(default=0, repr=False)

    def beat(self) -> bool:
        """Say that the work goes on; every BEAT seconds will do. False when the lease was taken over."""
        if self.path is None:
            return True
        try:
            with self.path.open("r+b", buffering=0) as file:
                line = file.readline()
                if json.loads(line)["nonce"] != self.nonce:
                    return False
                self._count += 1
                os.pwrite(file.fileno(), b"%0*d\n" % (_DIGITS, self._count), len(line))
        except (OSError, ValueError, KeyError):
            return False
        return True

    def release(self) -> None:
        """Give the lease back; one that was taken over stays with its new holder."""
        if self.path is not None:
            with contextlib.suppress(OSError):
                if _nonce(self.path) == self.nonce:
                    self.path.unlink()
        self.path = None


class Leases:
    """The leases of a store. Waiting is asking again: a waiter has to keep its `Leases` for heartbeats to be seen."""

    def __init__(self, root: Path, limit: float = LIMIT, clock: Callable[[], float] = time.monotonic) -> None:
        self.folder, self.limit, self.clock = root / "leases", limit, clock
        self.seen: dict[str, tuple[str, str, float]] = {}

    def acquire(self, key: str) -> Lease | Holder:
        """The lease of `key`, or who holds it. Where none can be written, an unguarded lease with a notice."""
        path, notice = self._path(key), ""
        lease = Lease(key, path, uuid.uuid4().hex)
        try:
            for _ in range(8):
                if self._create(lease):
                    lease.notice = notice
                    self.seen.pop(key, None)
                    return lease
                holder, reason = self._judge(key)
                if holder is not None:
                    return holder
                if reason and self._remove(path, reason[0]):
                    notice = f"{reason[1]}; taken over"
        except OSError as error:
            return Lease(key, None, notice=f"no lease can be written ({error.strerror}): others may do the same work")
        return Holder(key, "unknown", "", 0, 0.0)  # it changes hands all the time; ask again

    def holders(self) -> Iterator[Holder]:
        """All leases that are held, as far as can be told."""
        for path in sorted(self.folder.glob("*.json")):
            holder, _ = self._judge(path.stem)
            if holder is not None:
                yield holder

    def sweep(self) -> list[str]:
        """Remove leases that are free, and drafts of processes that died; says which."""
        gone = []
        for path in sorted(self.folder.glob("*.json")):
            _, reason = self._judge(path.stem)
            if reason and self._remove(path, reason[0]):
                gone.append(reason[1])
        for path in self.folder.glob(".*"):
            with contextlib.suppress(OSError):
                told = _read(path)
                if path.name != ".lock" and (told is None or told[0].liveness(Process.here()) in ("gone", "rebooted")):
                    path.unlink()
        return gone

    def _judge(self, key: str) -> tuple[Holder | None, tuple[str, str] | None]:
        """(holder, None) of a held lease, (None, (nonce, why)) of a free one, (None, None) of none."""
        try:
            told = _read(self._path(key))
        except OSError:
            return None, None
        owner, nonce, count = told or (Process("unknown", "", "", 0, 0), "", "")
        last = self.seen.get(key)
        if last is None or last[:2] != (nonce, count):
            last = self.seen[key] = (nonce, count, self.clock())
        age = self.clock() - last[2]
        who, life = f"the lease of process {owner.pid} on {owner.host}", owner.liveness(Process.here())
        if life == "gone":
            return None, (nonce, f"{who} outlived its process")
        if life == "rebooted":
            return None, (nonce, f"{who} is from before the last start of that machine")
        if age > self.limit * (10 if life == "alive" else 1):
            return None, (nonce, f"{who} has had no heartbeat for {age:.0f} s")
        return Holder(key, owner.host, owner.boot, owner.pid, age), None

    def _create(self, lease: Lease) -> bool:
        """Make the lease's file; False when there is one."""
        assert lease.path is not None
        self.folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps({**asdict(Process.here()), "nonce": lease.nonce}) + f"\n{0:0{_DIGITS}d}\n"
        draft = self.folder / f".{lease.nonce}"
        draft.write_text(text, encoding="utf-8")
        try:
            os.link(draft, lease.path)
        except FileExistsError:
            return False
        except OSError:
            return _create_exclusively(lease.path, text)
        finally:
            draft.unlink(missing_ok=True)
        return True

    def _remove(self, path: Path, nonce: str) -> bool:
        """Take away the lease that was judged; False when it changed hands meanwhile."""
        aside = self.folder / f".{uuid.uuid4().hex}"
        with (self.folder / ".lock").open("a") as lock:
            with contextlib.suppress(OSError):  # without locks the check below is all there is
                fcntl.flock(lock, fcntl.LOCK_EX)
            try:
                if _nonce(path) != nonce:  # another waiter was quicker
                    return False
                os.rename(path, aside)
            except OSError:
                return False
            same = True
            with contextlib.suppress(OSError):
                same = _nonce(aside) == nonce
            if not same:  # the same without locks; give it back, and where that one has a successor too, both go on
                with contextlib.suppress(OSError):
                    os.link(aside, path)
            aside.unlink(missing_ok=True)
        return same

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.json"


def _create_exclusively(path: Path, text: str) -> bool:
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        return False
    return True


def _read(path: Path) -> tuple[Process, str, str] | None:
    """(owner, nonce, counter), None where it is not (yet) readable. Raises OSError where there is no file."""
    head, _, count = path.read_text(encoding="utf-8", errors="replace").partition("\n")
    try:
        facts = json.loads(head)
        nonce = str(facts.pop("nonce"))
        return Process(**facts), nonce, count
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def _nonce(path: Path) -> str:
    told = _read(path)
    return told[1] if told else ""
