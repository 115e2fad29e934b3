"""Leases: one holder at a time, none that outlives its process, no trust in wall clocks."""

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.cache.lease import Holder, Lease, Leases
from exmesh_graph.graph.run import schedule

KEY = "ab" * 32
HOLD = """
import sys, time
from pathlib import Path
from exmesh_graph.graph.cache.lease import Leases
lease = Leases(Path(sys.argv[1])).acquire(sys.argv[2])
print(type(lease).__name__, flush=True)
sys.stdin.readline()
"""


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def hold(root: Path, key: str = KEY) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(root), key], stdin=pipe, stdout=pipe, text=True)
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "Lease"
    return process


def killed(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate()


def taken(found: Lease | Holder) -> Lease:
    assert isinstance(found, Lease)
    return found


def test_one_holder_at_a_time(tmp_path: Path) -> None:
    mine, other = Leases(tmp_path), Leases(tmp_path)
    lease = taken(mine.acquire(KEY))
    held = other.acquire(KEY)
    assert isinstance(held, Holder)
    assert held.pid == os.getpid()
    assert str(held).startswith(f"process {os.getpid()} on ")
    assert isinstance(other.acquire("cd" * 32), Lease)
    assert len(list(other.holders())) == 2
    lease.release()
    assert taken(other.acquire(KEY)).notice == ""


@pytest.mark.reliability("a stale lease: its process is gone, no heartbeat", "free again, with a notice")
def test_a_lease_ends_with_its_process(tmp_path: Path) -> None:
    process = hold(tmp_path)
    try:
        waiter = Leases(tmp_path, clock=Clock())
        held = waiter.acquire(KEY)
        assert isinstance(held, Holder)
        assert held.pid == process.pid
    finally:
        killed(process)
    assert f"process {process.pid} on " in (notice := taken(waiter.acquire(KEY)).notice)
    assert "outlived its process; taken over" in notice


@pytest.mark.reliability("a stale lease: its process is gone, no heartbeat", "free again, with a notice")
def test_an_owner_without_a_heartbeat_is_not_waited_for(tmp_path: Path) -> None:
    lease, clock = taken(Leases(tmp_path).acquire(KEY)), Clock()
    waiter = Leases(tmp_path, limit=30, clock=clock)
    assert isinstance(waiter.acquire(KEY), Holder)
    clock.now = 29
    assert isinstance(waiter.acquire(KEY), Holder)
    lease.beat()
    clock.now = 58
    assert isinstance(waiter.acquire(KEY), Holder)
    clock.now = 80
    held = waiter.acquire(KEY)
    assert isinstance(held, Holder)
    assert held.age == 22
    clock.now = 100
    beside = taken(waiter.acquire(KEY))
    assert "no heartbeat for 42 s; not waited for" in beside.notice
    beside.release()
    assert isinstance(Leases(tmp_path).acquire(KEY), Holder)  # the owner's is still there
    lease.release()
    assert taken(waiter.acquire(KEY)).notice == ""


@pytest.mark.reliability("the clock jumps while a lease is held", "it stays held")
def test_wall_clocks_may_jump(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken(Leases(tmp_path).acquire(KEY))
    waiter = Leases(tmp_path, clock=Clock())
    for jump in (-4e8, 4e8):
        monkeypatch.setattr(time, "time", lambda jump=jump: jump)
        os.utime(tmp_path / "leases" / f"{KEY}.json", (abs(jump), abs(jump)))
        assert isinstance(waiter.acquire(KEY), Holder)


@pytest.mark.parametrize("text", ["", "{", "[]\n1\n", '{"nonce": 1}\n', "\0\0"])
@pytest.mark.reliability("a stale lease: its process is gone, no heartbeat", "free again, with a notice")
def test_an_unreadable_lease(tmp_path: Path, text: str) -> None:
    """Its lock counts, not its text."""
    path, clock = tmp_path / "leases" / f"{KEY}.json", Clock()
    path.parent.mkdir()
    path.write_text(text)
    lease = taken(Leases(tmp_path).acquire(KEY))
    assert ("taken over" in lease.notice) == bool(text)
    path.write_text(text)
    waiter = Leases(tmp_path, limit=30, clock=clock)
    assert isinstance(waiter.acquire(KEY), Holder)
    clock.now = 31
    assert isinstance(waiter.acquire(KEY), Lease)


def test_many_waiters_one_successor(tmp_path: Path) -> None:
    for _ in range(20):
        owner = taken(Leases(tmp_path).acquire(KEY))
        assert owner.handle is not None
        os.close(owner.handle)  # as when its process dies
        start = threading.Barrier(8)

        def wait(start: threading.Barrier = start) -> Lease | Holder:
            start.wait()
            return Leases(tmp_path).acquire(KEY)

        with ThreadPoolExecutor(8) as pool:
            found = [future.result() for future in [pool.submit(wait) for _ in range(8)]]
        winners = [item for item in found if isinstance(item, Lease)]
        assert len(winners) == 1
        winners[0].release()
    assert list((tmp_path / "leases").iterdir()) == []


def test_a_file_system_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    lease = taken(Leases(tmp_path).acquire(KEY))
    assert "No locks available" in lease.notice
    assert list(Leases(tmp_path).holders()) == []


def test_no_lease_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "leases").write_text("a file")
    lease = taken(Leases(tmp_path).acquire(KEY))
    assert lease.handle is None
    assert "no lease can be written" in lease.notice
    lease.beat()
    lease.release()


def test_a_thread_beats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schedule, "BEAT", 0.01)
    path = tmp_path / "leases" / f"{KEY}.json"
    leases = schedule.KeyLeases(tmp_path, lambda node, text: None)
    assert leases.take("node", KEY)
    first = path.read_text()
    deadline = time.monotonic() + 10
    while path.read_text() == first and time.monotonic() < deadline:
        time.sleep(0.01)
    assert path.read_text() != first
    leases.close()
    assert not path.exists()


def test_sweep_removes_what_is_free(tmp_path: Path) -> None:
    leases = Leases(tmp_path)
    lease = taken(leases.acquire(KEY))
    process = hold(tmp_path, "cd" * 32)
    killed(process)
    (swept,) = leases.sweep()
    assert str(process.pid) in swept
    assert [path.name for path in (tmp_path / "leases").iterdir()] == [f"{KEY}.json"]
    assert list(leases.holders()) == [KEY]
    lease.release()
