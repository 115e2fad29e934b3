"""gc and pins: what a run, a pin or a record that stays needs is never removed, also beside a run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.api.upkeep import key_of_prefix
from exmesh_graph.errors import StoreError
from exmesh_graph.files import own_folder
from exmesh_graph.graph.cache import store as store_module
from exmesh_graph.graph.cache.keys import Stored
from exmesh_graph.graph.cache.lease import Lease, Leases
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run.checkpoint import Checkpoints
from exmesh_graph.graph.upkeep import collect
from exmesh_graph.graph.upkeep import pins as pins_module
from exmesh_graph.graph.upkeep.collect import DAY, Survey, delete, survey
from exmesh_graph.graph.upkeep.pins import pin, pins, unpin
from exmesh_graph.types import Metrics


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collect, "SETTLE", 0.0)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def result(store: Store, number: float, *, of: str = "t", days: float = 10) -> tuple[str, str]:
    """A record with one object, both last used `days` ago: (key, digest)."""
    with store.attempt() as attempt:
        stored = store.put(Metrics({"x": number, "pad": "x" * 1000}), attempt)
    key = store.record({"type": of, "params": {"number": number}}, {"m": stored}, {})
    age(store.root / "actions" / key[:2] / f"{key}.json", days)
    age(store.root / "objects" / stored.digest[:2] / stored.digest, days)
    return key, stored.digest


def age(path: Path, days: float) -> None:
    then = time.time() - days * DAY
    os.utime(path, (then, then))


def shown_by_a_run(runs: Path, *keys: str) -> Path:
    folder = runs / f"run-{len(list(runs.glob('*')))}"
    folder.mkdir(parents=True)
    rows = ", ".join(f'{{"key": "{key}"}}' for key in keys)
    (folder / "run.json").write_text(f'{{"nodes": [{rows}, {{"key": null}}]}}')
    return folder


def names(surveyed: Survey) -> set[str]:
    return {item.name for item in surveyed.items}


def test_only_what_nothing_shows_goes(store: Store, tmp_path: Path) -> None:
    shown, loose, pinned, new = (result(store, n, days=0 if n == 3 else 10) for n in range(4))
    pin(store, "best", "a key", [pinned[0]])
    shown_by_a_run(tmp_path / "runs", shown[0])
    surveyed = survey(store, [tmp_path / "runs"])
    assert names(surveyed) == set(loose)
    assert store.look_up(loose[0]) is not None
    age(store.root / "actions" / loose[0][:2] / f"{loose[0]}.json", 10)
    removed, spared = delete(store, survey(store, [tmp_path / "runs"]))
    assert {item.name for item in removed} == set(loose)
    assert spared == []
    assert store.look_up(loose[0]) is None
    assert all(store.look_up(key) is not None and store.sound(digest) for key, digest in (shown, pinned, new))
    assert not store.holds(loose[1])
    assert list((store.root / "trash").iterdir()) == []
    assert store.notes == []


def test_many_are_taken_off_the_disk_by_a_process_of_their_own(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Removing 10 000 objects waits 7 s for their folders; out of the store they are at once."""
    monkeypatch.setattr(collect, "PATIENCE", 0.0)
    digests = [result(store, n)[1] for n in range(50)]
    surveyed = survey(store)
    removed, _ = delete(store, surveyed)
    assert len(removed) == 100
    assert not any(store.holds(digest) for digest in digests)
    assert "is still taking what was removed off the disk" in surveyed.notes[-1]
    end = time.monotonic() + 20
    while list((store.root / "trash").iterdir()) and time.monotonic() < end:
        time.sleep(0.01)
    assert list((store.root / "trash").iterdir()) == []
    left = store.root / "trash" / "gone-1"  # such a process was killed
    (left / "things").mkdir(parents=True)
    age(left, 1)
    delete(store, survey(store))
    assert not left.exists()


def test_an_object_of_two_records_stays_with_either(store: Store, tmp_path: Path) -> None:
    """Meshroom lost a day of work of its users by deleting shared results through one of their nodes."""
    first, digest = result(store, 1, of="a")
    second, same = result(store, 1, of="b")
    assert digest == same
    runs = shown_by_a_run(tmp_path / "runs", second).parent
    found = survey(store, [runs])
    assert [item.name for item in found.items] == [first]
    delete(store, found)
    assert store.look_up(first) is None
    assert store.look_up(second) is not None
    assert store.sound(digest)


def test_folders_of_runs_note_themselves(bench: Any) -> None:
    bench.run("nodes: {one: {type: toy.const, value: 1}}")
    record = bench.run("nodes: {one: {type: toy.const, value: 2}}")
    store = bench.store
    for path in [*store.root.glob("actions/*/*"), *store.root.glob("objects/*/*")]:
        age(path, 10)
    assert names(survey(store)) == set()
    shutil.rmtree(bench.root / "runs" / record["id"])
    (row,) = record["nodes"]
    assert names(survey(store)) == {row["key"], row["outputs"]["number"]["digest"]}


def test_runs_of_other_machines_are_named(store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store.note_runs(tmp_path / "gone")
    assert survey(store).notes == []
    monkeypatch.setattr(store_module.platform, "node", lambda: "elsewhere")
    store.note_runs(Path("/there"))
    monkeypatch.undo()
    monkeypatch.setattr(collect, "SETTLE", 0.0)
    (note,) = survey(store).notes
    assert "/there of elsewhere cannot be seen from here" in note


def test_a_spoilt_note_of_runs_is_told(store: Store, tmp_path: Path) -> None:
    for look in (lambda: survey(store), lambda: dict(store.verify())):
        store.note_runs(tmp_path / "there")
        (path,) = (store.root / "roots").iterdir()
        path.write_text(path.read_text().replace("there", "where"))
        try:
            surveyed = look()
        except StoreError as error:
            surveyed = {"note of runs": str(error)}
        assert any("note of runs" in what and "checksum does not fit" in why for what, why in surveyed.items())
        assert not path.exists()


def test_an_unreadable_run_stops_gc(store: Store, tmp_path: Path) -> None:
    run = shown_by_a_run(tmp_path / "runs", "ab")
    (run / "run.json").write_text("{")
    with pytest.raises(StoreError, match="what it needs is not known"):
        survey(store, [tmp_path / "runs"])


def test_leased_keys_and_live_attempts_protect(store: Store) -> None:
    key, digest = result(store, 1)
    lease = Leases(store.root).acquire(key)
    assert isinstance(lease, Lease)
    assert names(survey(store)) == set()
    lease.release()
    with own_folder(store.work) as attempt:
        age(attempt / "lock", 20)
        assert names(survey(store)) == set()
    assert names(survey(store)) == {key, digest}


def test_budget_takes_the_oldest_first(store: Store, tmp_path: Path) -> None:
    made = [result(store, n, days=20 - n) for n in range(5)]
    runs = shown_by_a_run(tmp_path / "runs", *(key for key, _ in made)).parent
    pin(store, "first", "a key", [made[0][0]])
    age(store.root / "actions" / made[0][0][:2] / f"{made[0][0]}.json", 20)
    everything = survey(store, [runs])
    assert everything.items == []
    one = everything.kept_bytes // 5
    surveyed = survey(store, [runs], budget=3 * one + one // 2)
    assert names(surveyed) == {*made[1], *made[2]}
    assert surveyed.kept_bytes <= 3 * one + one // 2
    assert "used longest ago" in surveyed.items[0].why
    surveyed = survey(store, [runs], budget=0)
    assert names(surveyed) == {name for pair in made[1:] for name in pair}
    assert "more than the budget" in surveyed.notes[0]


def test_a_record_used_after_the_survey_stays(store: Store) -> None:
    used, other = result(store, 1), result(store, 2)
    surveyed = survey(store)
    assert names(surveyed) == {*used, *other}
    assert store.look_up(used[0]) is not None
    removed, spared = delete(store, surveyed)
    assert {item.name for item in removed} == set(other)
    assert {item.name for item in spared} == set(used)
    assert store.look_up(used[0]) is not None
    assert store.sound(used[1])


def test_a_record_used_while_it_is_in_the_trash_comes_back(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the rename and the check a reader that had opened the record notes its use on the moved file."""
    key, digest = result(store, 1)
    path = store.root / "actions" / key[:2] / f"{key}.json"
    surveyed = survey(store)
    with path.open() as opened:
        monkeypatch.setattr(collect.time, "sleep", lambda _: os.utime(opened.fileno()))
        removed, _ = delete(store, surveyed)
    assert removed == []
    assert store.look_up(key) is not None
    assert store.sound(digest)


def test_an_object_that_a_new_record_needs_comes_back(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    _, digest = result(store, 1)
    surveyed = survey(store)
    stored = Stored("Metrics", digest, 1)
    keys: list[str] = []

    def recorded(_: float) -> None:
        keys.append(store.record({"type": "new"}, {"m": stored}, {}))

    monkeypatch.setattr(collect.time, "sleep", recorded)
    delete(store, surveyed)
    assert store.look_up(keys[0]) is not None
    assert store.sound(digest)


def test_writing_the_same_object_again_protects_it(store: Store) -> None:
    key, digest = result(store, 1)
    (store.root / "actions" / key[:2] / f"{key}.json").unlink()
    surveyed = survey(store)
    assert names(surveyed) == {digest}
    with store.attempt() as attempt:
        store.put(Metrics({"x": 1, "pad": "x" * 1000}), attempt)
    removed, _ = delete(store, surveyed)
    assert removed == []
    assert store.sound(digest)


def test_checkpoints_and_quarantine(store: Store) -> None:
    key, _ = result(store, 1, days=0)
    Checkpoints(store.root, key).save(1, {})
    Checkpoints(store.root, "cd" * 32).save(1, {})
    Checkpoints(store.root, "ef" * 32).save(1, {})
    age(store.root / "checkpoints" / ("ef" * 32), 40)
    old = time.time_ns() - int(10 * DAY * 1e9)
    (store.root / "quarantine").mkdir()
    (store.root / "quarantine" / f"x.json.{old}").write_text("x")
    (store.root / "quarantine" / f"x.json.{time.time_ns()}").write_text("x")
    removed, _ = delete(store, survey(store))
    assert {(item.kind, item.name[:4]) for item in removed} == {
        ("checkpoint", key[:4]), ("checkpoint", "efef"), ("quarantine", "x.js")
    }  # fmt: skip
    assert Checkpoints(store.root, "cd" * 32).load() == (1, {})
    assert len(list((store.root / "quarantine").iterdir())) == 1


@pytest.mark.reliability(
    "gc: killed half-way, or beside a runner",
    "no record without its object, nothing in use removed",
)
def test_a_killed_gc_leaves_no_dangling_record(store: Store) -> None:
    made = [result(store, n) for n in range(6)]
    code = (
        "import os, sys\nfrom pathlib import Path\nfrom exmesh_graph.graph.cache.store import Store\n"
        "from exmesh_graph.graph.upkeep import collect\n"
        "real, count = collect._rename, int(sys.argv[2])\n"
        "def rename(path, target):\n"
        "    global count\n    count -= 1\n    if count < 0: os._exit(9)\n    return real(path, target)\n"
        "collect._rename = rename\n"
        "store = Store(Path(sys.argv[1]))\ncollect.delete(store, collect.survey(store))\n"
    )
    for step in (4, 3):
        done = subprocess.run([sys.executable, "-c", code, str(store.root), str(step)], check=False)
        assert done.returncode == 9
        assert all(store.read(store.root / "actions" / k[:2] / f"{k}.json") is None or store.sound(d) for k, d in made)
    delete(store, survey(store))
    assert list((store.root / "trash").iterdir()) == []
    assert list(store.verify()) == []
    assert store.notes == []


def test_pins(store: Store) -> None:
    key, _ = result(store, 1)
    entry = pin(store, "best", "run x", [key, "0" * 64])
    assert entry.keys == (key,)
    assert pins(store) == [entry]
    assert "best  run x, 1 results" in str(entry)
    for name, words in (("best", "already"), ("a/b", "cannot name a pin"), (".x", "cannot name")):
        with pytest.raises(StoreError, match=words):
            pin(store, name, "x", [key])
    with pytest.raises(StoreError, match="no results in this store"):
        pin(store, "none", "x", ["0" * 64])
    assert unpin(store, "best") == entry
    with pytest.raises(StoreError, match="no pin 'best'"):
        unpin(store, "best")


def test_a_spoilt_pin_stops_gc(store: Store) -> None:
    key, _ = result(store, 1)
    pin(store, "best", "x", [key])
    path = store.root / "pins" / "best.json"
    path.write_text(path.read_text().replace(key[:8], "00000000"))
    with pytest.raises(StoreError, match="the pin best cannot be read"):
        survey(store)


def test_keys_by_their_beginning(store: Store) -> None:
    key, _ = result(store, 1)
    assert key_of_prefix(store, key[:6]) == key
    assert key_of_prefix(store, key) == key
    assert key_of_prefix(store, key[:5]) is None
    assert key_of_prefix(store, "runs/latest") is None


def test_a_run_removed_while_gc_lists_it_needs_nothing(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A user may remove runs at any time; only a run that is there and cannot be read stops gc."""
    (kept, _), (lost, _) = result(store, 1), result(store, 2)
    shown_by_a_run(tmp_path / "runs", kept)
    going = shown_by_a_run(tmp_path / "runs", lost)
    read = Path.read_text

    def removed_first(path: Path, *args: Any, **options: Any) -> str:
        if path.parent == going:
            shutil.rmtree(going)
        return read(path, *args, **options)

    monkeypatch.setattr(Path, "read_text", removed_first)
    surveyed = survey(store, [tmp_path / "runs"])
    assert surveyed.runs == 1
    assert kept not in names(surveyed)
    assert lost in names(surveyed)


def test_a_pin_removed_while_pins_are_listed_is_none(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, name in enumerate(("best", "other")):
        pin(store, name, "a test", [result(store, number)[0]])
    read = pins_module.read_pin

    def removed_first(path: Path) -> Any:
        if path.stem == "best":
            path.unlink()
        return read(path)

    monkeypatch.setattr(pins_module, "read_pin", removed_first)
    assert [entry.name for entry in pins(store)] == ["other"]


@pytest.mark.slow
@pytest.mark.reliability(
    "gc: killed half-way, or beside a runner",
    "no record without its object, nothing in use removed",
)
def test_gc_beside_a_runner(bench: Any) -> None:
    """Runs and gc with no grace at all, at once, with no folder of runs known: no run fails, no record dangles."""
    graph = bench.write("\n".join(["nodes:"] + [f"  n{n}: {{type: toy.const, value: {n}}}" for n in range(30)]))
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom exmesh_graph.graph.cache.store import Store\n"
        "from exmesh_graph.graph.upkeep.collect import delete, survey\n"
        "store, end = Store(Path(sys.argv[1])), time.monotonic() + 3\n"
        "while time.monotonic() < end:\n    delete(store, survey(store, age=-1))\n"
    )
    collector = subprocess.Popen([sys.executable, "-c", code, str(bench.root / "store")])
    try:
        while collector.poll() is None:
            record = bench.run(graph.read_text())
            assert record["state"] == "done"
            shutil.rmtree(bench.root / "runs")
    finally:
        collector.kill()
        assert collector.wait() == 0
    for what, why in bench.store.verify():
        assert what.startswith("action"), (what, why)
    assert bench.run(graph.read_text())["state"] == "done"
    assert list(bench.store.verify()) == []
