"""Leases: one holder at a time, none that outlives its process, no trust in wall clocks."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph import machine
from exmesh_graph.graph.cache.lease import Holder, Lease, Leases
from exmesh_graph.graph.machine import Process
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


def taken(found: Lease | Holder) -> Lease:
    assert isinstance(found, Lease)
    return found


def rewrite(root: Path, **facts: Any) -> None:
    """Make the lease look as if another owner had written it."""
    path = root / "leases" / f"{KEY}.json"
    head, _, count = path.read_text().partition("\n")
    path.write_text(json.dumps({**json.loads(head), **facts}) + "\n" + count)


def test_one_holder_at_a_time(tmp_path: Path) -> None:
    mine, other = Leases(tmp_path), Leases(tmp_path)
    lease = taken(mine.acquire(KEY))
    held = other.acquire(KEY)
    assert isinstance(held, Holder)
    assert held.pid == os.getpid()
    assert str(held).startswith(f"process {os.getpid()} on ")
    assert isinstance(other.acquire("cd" * 32), Lease)
    assert len(list(other.holders())) == 2
    assert lease.beat()
    lease.release()
    assert taken(other.acquire(KEY)).notice == ""


@pytest.mark.reliability(
    "a stale lease: another boot, a process that is gone, no heartbeat",
    "free again, with a notice",
)
def test_a_lease_ends_with_its_process(tmp_path: Path) -> None:
    process = hold(tmp_path)
    try:
        waiter = Leases(tmp_path, clock=Clock())
        held = waiter.acquire(KEY)
        assert isinstance(held, Holder)
        assert held.pid == process.pid
    finally:
        process.kill()
        process.wait()
    assert "outlived its process; taken over" in taken(waiter.acquire(KEY)).notice


def test_a_process_id_used_again_does_not_count(tmp_path: Path) -> None:
    taken(Leases(tmp_path).acquire(KEY))
    rewrite(tmp_path, started=Process.here().started - 1)
    assert "outlived its process" in taken(Leases(tmp_path).acquire(KEY)).notice


@pytest.mark.reliability(
    "a stale lease: another boot, a process that is gone, no heartbeat",
    "free again, with a notice",
)
def test_another_boot_of_this_machine(tmp_path: Path) -> None:
    taken(Leases(tmp_path).acquire(KEY))
    rewrite(tmp_path, boot="another")
    assert "before the last start of that machine; taken over" in taken(Leases(tmp_path).acquire(KEY)).notice


@pytest.mark.parametrize("facts", [{"host": "elsewhere", "boot": "another"}, {"space": "pid:[1]", "pid": 999999}])
@pytest.mark.reliability(
    "a stale lease: another boot, a process that is gone, no heartbeat",
    "free again, with a notice",
)
def test_elsewhere_only_the_heartbeat_counts(tmp_path: Path, facts: dict[str, Any]) -> None:
    lease, clock = taken(Leases(tmp_path).acquire(KEY)), Clock()
    rewrite(tmp_path, **facts)
    waiter = Leases(tmp_path, limit=30, clock=clock)
    assert isinstance(waiter.acquire(KEY), Holder)
    clock.now = 29
    assert isinstance(waiter.acquire(KEY), Holder)
    assert lease.beat()
    clock.now = 58
    assert isinstance(waiter.acquire(KEY), Holder)
    clock.now = 80
    held = waiter.acquire(KEY)
    assert isinstance(held, Holder)
    assert held.age == 22
    clock.now = 100
    assert "no heartbeat for 42 s; taken over" in taken(waiter.acquire(KEY)).notice
    assert not lease.beat()
    lease.release()
    assert isinstance(Leases(tmp_path).acquire(KEY), Holder)


def test_a_living_process_has_ten_times_as_long(tmp_path: Path) -> None:
    taken(Leases(tmp_path).acquire(KEY))
    clock = Clock()
    waiter = Leases(tmp_path, limit=30, clock=clock)
    waiter.acquire(KEY)
    clock.now = 299
    assert isinstance(waiter.acquire(KEY), Holder)
    clock.now = 301
    assert isinstance(waiter.acquire(KEY), Lease)


@pytest.mark.reliability("the clock jumps while a lease is held", "it stays held")
def test_wall_clocks_may_jump(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken(Leases(tmp_path).acquire(KEY))
    rewrite(tmp_path, host="elsewhere")
    waiter = Leases(tmp_path, clock=Clock())
    for jump in (-4e8, 4e8):
        monkeypatch.setattr(time, "time", lambda jump=jump: jump)
        os.utime(tmp_path / "leases" / f"{KEY}.json", (abs(jump), abs(jump)))
        assert isinstance(waiter.acquire(KEY), Holder)


@pytest.mark.parametrize("text", ["", "{", "[]\n1\n", '{"nonce": 1}\n', "\0\0"])
@pytest.mark.reliability(
    "a stale lease: another boot, a process that is gone, no heartbeat",
    "free again, with a notice",
)
def test_an_unreadable_lease_is_free_after_the_limit(tmp_path: Path, text: str) -> None:
    path, clock = tmp_path / "leases" / f"{KEY}.json", Clock()
    path.parent.mkdir()
    path.write_text(text)
    waiter = Leases(tmp_path, limit=30, clock=clock)
    assert isinstance(waiter.acquire(KEY), Holder)
    clock.now = 31
    assert isinstance(waiter.acquire(KEY), Lease)


def test_many_waiters_one_successor(tmp_path: Path) -> None:
    for round_ in range(20):
        taken(Leases(tmp_path).acquire(KEY))
        rewrite(tmp_path, boot=f"boot {round_}")
        start = threading.Barrier(8)

        def wait(start: threading.Barrier = start) -> Lease | Holder:
            start.wait()
            return Leases(tmp_path).acquire(KEY)

        with ThreadPoolExecutor(8) as pool:
            found = [future.result() for future in [pool.submit(wait) for _ in range(8)]]
        winners = [item for item in found if isinstance(item, Lease)]
        assert len(winners) == 1
        assert winners[0].beat()
        winners[0].release()
    assert {path.name for path in (tmp_path / "leases").iterdir()} == {".lock"}


def test_without_hard_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    lease = taken(Leases(tmp_path).acquire(KEY))
    assert lease.path is not None
    assert isinstance(Leases(tmp_path).acquire(KEY), Holder)
    assert lease.beat()
    lease.release()
    assert isinstance(Leases(tmp_path).acquire(KEY), Lease)


def test_no_lease_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "leases").write_text("a file")
    lease = taken(Leases(tmp_path).acquire(KEY))
    assert lease.path is None
    assert "no lease can be written" in lease.notice
    assert lease.beat()
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


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_a_stopped_process_is_not_called_alive(tmp_path: Path) -> None:
    process = hold(tmp_path)
    try:
        owner = Process(**{**dataclasses.asdict(Process.here()), "pid": process.pid, "started": 0})
        owner = dataclasses.replace(owner, started=machine._state(process.pid)[1])
        assert owner.liveness(Process.here()) == "alive"
        os.kill(process.pid, signal.SIGSTOP)
        deadline = time.monotonic() + 10
        while owner.liveness(Process.here()) != "unknown" and time.monotonic() < deadline:
            time.sleep(0.01)
        assert owner.liveness(Process.here()) == "unknown"
    finally:
        process.kill()
        process.wait()
    assert owner.liveness(Process.here()) == "gone"


def test_sweep_removes_what_is_free(tmp_path: Path) -> None:
    leases = Leases(tmp_path)
    lease = taken(leases.acquire(KEY))
    process = hold(tmp_path, "cd" * 32)
    process.kill()
    process.wait()
    (tmp_path / "leases" / ".torn").write_text("")
    (swept,) = leases.sweep()
    assert str(process.pid) in swept
    assert sorted(path.name for path in (tmp_path / "leases").iterdir()) == [".lock", f"{KEY}.json"]
    assert lease.beat()
