"""Faults of processes, disks, files and clocks: the store serves no wrong result, loses none, and nothing gets stuck.

`python -m benchmarks.reliability` runs these and prints the table; with EXMESH_TRIALS=full they try many more faults.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from faults import why_not

CAMPAIGNS = Path(__file__).parent / "campaigns.py"
NOTICED = "noticed and told; never served; made again"
ROOMS = {"objects", "actions", "leases", "checkpoints", "pins"}
NOTHING_LOST = "verify clean, all that was recorded served, the next run completes with the right values"


@pytest.fixture
def campaign(tmp_path: Path, record_property: Callable[[str, object], None]) -> Callable[..., dict[str, Any]]:
    """`campaign(name, few, full)` runs that many trials, asserts that there is no miss, and returns its facts."""

    def run(name: str, few: int, full: int) -> dict[str, Any]:
        trials = full if os.environ.get("EXMESH_TRIALS") == "full" else few
        command = [sys.executable, str(CAMPAIGNS), name, str(tmp_path / "trials"), str(trials), "1"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60 + 3 * trials, check=False)
        assert "REPORT" in done.stdout, done.stdout + done.stderr
        report = json.loads(done.stdout.partition("REPORT")[2])
        assert report["misses"] == [], "\n".join([*report["misses"][:20], done.stderr[-3000:]])
        assert report["trials"] > 0
        record_property("trials", report["trials"])
        return dict(report["facts"])

    return run


traced = pytest.mark.skipif(why_not() is not None, reason=why_not() or "")


@pytest.mark.thorough
@traced
@pytest.mark.reliability("kill -9 before each system call that changes a file; each write torn in half", NOTHING_LOST)
def test_kill_at_every_step(campaign: Any) -> None:
    facts = campaign("kill_every_step", 16, 100_000)
    assert {"write", "rename", "fsync", "mkdir", "unlinkat"} <= set(facts)


@pytest.mark.slow
@pytest.mark.reliability("kill -9 at random times in runs of random graphs", NOTHING_LOST)
def test_kill_at_random(campaign: Any) -> None:
    facts = campaign("kill_at_random", 20, 600)
    assert facts["killed"] > 0


@pytest.mark.slow
@pytest.mark.reliability("kill -9 of a runner or of one of its worker processes", "workers end too; " + NOTHING_LOST)
def test_kill_workers(campaign: Any) -> None:
    facts = campaign("kill_workers", 3, 40)
    assert facts["runners killed"] + facts["workers killed"] > 0


@pytest.mark.slow
@pytest.mark.reliability("two runners at once on one store", "both complete; " + NOTHING_LOST)
def test_two_runners(campaign: Any) -> None:
    campaign("two_runners", 3, 100)


@pytest.mark.slow
@pytest.mark.reliability("three runners at once, one or two killed at random times", "no deadlock; " + NOTHING_LOST)
def test_three_runners_with_kills(campaign: Any) -> None:
    facts = campaign("three_runners_with_kills", 4, 100)
    assert facts["killed"] > 0


@pytest.mark.thorough
@pytest.mark.reliability("one flipped bit in an object, record, checkpoint, lease, pin or memo", NOTICED)
def test_flipped_bits(campaign: Any) -> None:
    facts = campaign("flipped_bits", 10, 200)
    assert set(facts) >= ROOMS


@pytest.mark.thorough
@pytest.mark.reliability("any of these files truncated", NOTICED)
def test_truncated_files(campaign: Any) -> None:
    facts = campaign("truncated_files", 10, 200)
    assert set(facts) >= ROOMS


@pytest.mark.thorough
@traced
@pytest.mark.reliability("disk full from each step on", "a message names the folder; " + NOTHING_LOST)
def test_full_disk(campaign: Any) -> None:
    campaign("full_disk", 6, 100_000)


@pytest.mark.thorough
@traced
@pytest.mark.reliability("input/output error at each step", "a message names folder or node; " + NOTHING_LOST)
def test_failing_disk(campaign: Any) -> None:
    campaign("failing_disk", 6, 100_000)


@pytest.mark.thorough
@pytest.mark.reliability("store may only be read", "hits are served; a miss is an error that names the folder")
def test_read_only_store(campaign: Any) -> None:
    campaign("read_only_store", 2, 40)


@pytest.mark.thorough
@pytest.mark.reliability("wall clock stands still or jumps by up to a year", "no deadlock; " + NOTHING_LOST)
def test_jumping_clock(campaign: Any) -> None:
    campaign("jumping_clock", 3, 100)
