"""The shared tier: what one machine made is a hit on another, and nothing half-sent or spoilt is believed."""

from __future__ import annotations

import os
import shutil
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.errors import MissingLibraryError, StoreError
from exmesh_graph.graph.cache.keys import NOTHING, Stored
from exmesh_graph.graph.cache.remote import Remote
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import Runner
from exmesh_graph.graph.sealed import seal_text, unseal
from exmesh_graph.report.reasons import explained as plan
from exmesh_graph.types import Metrics

fsspec = pytest.importorskip("fsspec")
PREIMAGE = {"type": "t", "params": {}, "code": "a"}
GRAPH = """
nodes:
  one: {type: toy.const, value: 1}
  sum: {type: toy.add, a: "@one.number", b: "@one.number"}
outputs: {sum: "@sum.number"}
"""


@pytest.fixture(params=["folder", "memory"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "folder":
        return str(tmp_path / "shared")
    fsspec.filesystem("memory").store.clear()
    return f"memory://shared-{tmp_path.name}"


def opened(tmp_path: Path, name: str, url: str) -> Store:
    return Store(tmp_path / name, url)


def made(store: Store, number: float = 1, preimage: Any = None) -> tuple[str, Stored]:
    with store.attempt() as attempt:
        stored = store.put(Metrics({"x": number}), attempt)
    key = store.record(preimage or PREIMAGE, {"m": stored, "none": NOTHING}, {"seconds": 2.0})
    store.share(key)
    store.close()
    return key, stored


def listing(url: str) -> list[str]:
    fs, root = fsspec.core.url_to_fs(url)
    return sorted(name.partition(root.rpartition("/")[2])[2] for name in fs.find(root))


def spoil(url: str, ending: str, change: Any) -> None:
    fs, root = fsspec.core.url_to_fs(url)
    (name,) = (name for name in fs.find(root) if name.endswith(ending))
    data = change(fs.cat_file(name))
    fs.rm_file(name)
    if data is not None:
        fs.pipe_file(name, data)


def test_what_one_machine_made_is_a_hit_on_another(tmp_path: Path, url: str) -> None:
    key, stored = made(opened(tmp_path, "a", url))
    other = opened(tmp_path, "b", url)
    assert other.look_up(key) is None
    shown = other.find(PREIMAGE, fetch=False)
    assert shown is not None
    assert shown.outputs["m"] == stored
    assert not other.holds(stored.digest)
    found = other.find(PREIMAGE)
    assert found == other.look_up(key) == shown
    value = other.load(Metrics, stored.digest)
    assert value is not None
    assert value.values == {"x": 1}
    assert list(other.verify()) == []
    assert other.notes == []
    assert not (other.data(stored.digest) / "metrics.json").stat().st_mode & 0o222
    assert other.find({**PREIMAGE, "code": "b"}) is None
    assert not any("drafts" in name for name in listing(url))


def test_runs_share_results(bench: Any, url: str, states: Any) -> None:
    graph = bench.check(GRAPH)
    records = []
    for machine in ("a", "b"):
        store = Store(bench.root / machine, url)
        folder = RunFolder(bench.root / f"runs-{machine}", "g")
        records.append(Runner(graph, store, folder, bench.events.append).run())
        folder.close()
        assert store.notes == []
    assert states(records[0]) == {"one": "done", "sum": "done"}
    assert states(records[1]) == {"one": "hit", "sum": "hit"}
    steps = plan(graph, Store(bench.root / "c", url))
    assert [(step.state, step.reason) for step in steps] == [("hit", "in the shared store")] * 2
    assert not (bench.root / "c" / "objects").exists()


FAULTS = {
    "flipped bit": ("metrics.json", lambda data: data[:-3] + bytes([data[-3] ^ 1]) + data[-2:]),
    "cut file": ("metrics.json", lambda data: data[:-1]),
    "lost file": ("metrics.json", lambda data: None),
    "no note yet": ("artifact.json", lambda data: None),
    "spoilt note": ("artifact.json", lambda data: data.replace(b"Metrics", b"Matrics")),
    "spoilt record": ("{key}.json", lambda data: data.replace(b"2.0", b"3.0")),
    "half a record": ("{key}.json", lambda data: data[:100]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_doubt_is_a_miss_and_is_mended_by_the_next_push(tmp_path: Path, url: str, fault: str) -> None:
    key, stored = made(opened(tmp_path, "a", url))
    ending, change = FAULTS[fault]
    spoil(url, ending.format(key=key), change)
    other = opened(tmp_path, "b", url)
    assert other.find(PREIMAGE) is None
    assert other.look_up(key) is None
    assert not other.holds(stored.digest) or "record" in fault
    assert list((other.root / "work").glob("*")) == []
    made(other)
    assert other.notes == []
    assert opened(tmp_path, "c", url).find(PREIMAGE) is not None


def test_a_store_of_lies_writes_nothing_outside(tmp_path: Path) -> None:
    url = str(tmp_path / "shared")
    key, stored = made(opened(tmp_path, "a", url))
    path = tmp_path / "shared" / "objects" / stored.digest[:2] / stored.digest / "artifact.json"
    for name in ("../../../../outside", "/tmp/outside-exmesh"):
        head = unseal((tmp_path / "a" / path.relative_to(tmp_path / "shared")).read_text())
        head["files"][name] = head["files"]["metrics.json"]
        path.write_text(seal_text(head))
        other = opened(tmp_path, "b", url)
        assert other.find(PREIMAGE) is None
    assert not list(tmp_path.rglob("outside"))
    assert not Path("/tmp/outside-exmesh").exists()
    assert key


def test_the_record_comes_last(tmp_path: Path, url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut off after any number of files: nothing is visible until all is there."""
    real = Remote._send
    for limit in range(3):
        sent: list[str] = []

        def send(self: Remote, path: Path, name: str, limit: int = limit, sent: list[str] = sent) -> None:
            if len(sent) == limit:
                raise ConnectionError("cut off")
            sent.append(name)
            real(self, path, name)

        monkeypatch.setattr(Remote, "_send", send)
        store = opened(tmp_path, f"a{limit}", url)
        made(store)
        assert "going on without it (ConnectionError: cut off)" in store.notes[0]
        assert opened(tmp_path, f"b{limit}", url).find(PREIMAGE) is None
    monkeypatch.setattr(Remote, "_send", real)
    made(opened(tmp_path, "a9", url))
    assert opened(tmp_path, "b9", url).find(PREIMAGE) is not None


def test_many_push_the_same_at_once(tmp_path: Path, url: str) -> None:
    stores = [opened(tmp_path, f"m{n}", url) for n in range(6)]
    with ThreadPoolExecutor(6) as pool:
        keys = {key for key, _ in pool.map(made, stores)}
    assert len(keys) == 1
    assert all(store.notes == [] for store in stores)
    assert opened(tmp_path, "reader", url).find(PREIMAGE) is not None


def test_out_of_reach_is_one_warning_and_the_run_goes_on(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (bench.root / "file").write_text("x")
    store = Store(bench.root / "a", str(bench.root / "file" / "shared"))
    folder = RunFolder(bench.root / "runs", "g")
    record = Runner(bench.check(GRAPH), store, folder, bench.events.append).run()
    folder.close()
    assert record["state"] == "done"
    (note,) = store.notes
    assert "cannot be used; going on without it" in note


def test_secrets_in_addresses_are_not_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = opened(tmp_path, "a", f"memory://{tmp_path.name}")
    assert store.remote is not None
    store.remote.url = "sftp://me:secret@host/x"

    def refuse(name: str) -> str:
        raise ConnectionError("no route to sftp://me:secret@host")

    monkeypatch.setattr(store.remote, "_read", refuse)
    assert store.find(PREIMAGE) is None
    assert store.find(PREIMAGE) is None
    (note,) = store.notes
    assert "secret" not in note
    assert "sftp://***@host/x" in note


def test_what_is_missing_is_said_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(StoreError, match="cannot be opened"):
        opened(tmp_path, "a", "nosuchprotocol://x")
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(MissingLibraryError, match="exmesh-graph\\[shared\\]"):
        opened(tmp_path, "a", str(tmp_path))


def test_a_store_copied_to_another_place_serves_hits(bench: Any, states: Any, tmp_path: Path) -> None:
    bench.run(GRAPH)
    copy, moved = tmp_path / "elsewhere" / "store", tmp_path / "moved"
    shutil.copytree(bench.root / "store", copy)
    shutil.rmtree(bench.root / "store")
    for place in (copy, moved):
        if place == moved:
            copy.rename(moved)
        folder = RunFolder(tmp_path / "other-runs", "g")
        record = Runner(bench.check(GRAPH), Store(place), folder, bench.events.append).run()
        folder.close()
        assert states(record) == {"one": "hit", "sum": "hit"}
        assert list(Store(place).verify()) == []


def test_a_shared_folder_is_a_store_itself(tmp_path: Path) -> None:
    """verify and gc work on it; what a machine left half-sent goes after a day."""
    from exmesh_graph.graph.upkeep.collect import DAY, delete, survey

    url = str(tmp_path / "shared")
    key, stored = made(opened(tmp_path, "a", url))
    shared = Store(tmp_path / "shared")
    assert list(shared.verify()) == []
    for name, days in (("old", 2), ("new", 0)):
        path = shared.root / "drafts" / name
        path.write_text("x")
        os.utime(path, (time.time() - days * DAY,) * 2)
    removed, _ = delete(shared, survey(shared))
    assert [item.name for item in removed] == ["old"]
    removed, _ = delete(shared, survey(shared, age=-1))
    assert {item.name for item in removed} == {key, stored.digest}
    assert opened(tmp_path, "b", url).find(PREIMAGE) is None


@pytest.mark.parametrize("kind", ["absolute", "upward"])
def test_a_hostile_record_cannot_name_a_folder_as_its_object(tmp_path: Path, kind: str) -> None:
    """The digest in a record becomes a path: what is none writes nothing and moves nothing."""
    shared, target = tmp_path / "shared", tmp_path / "victim"
    key, stored = made(opened(tmp_path, "a", str(shared)))
    digest = str(target) if kind == "absolute" else "../../../victim"
    path = shared / "actions" / key[:2] / f"{key}.json"
    record = unseal(path.read_text())
    record["outputs"]["m"]["digest"] = digest
    path.write_text(seal_text(record))
    there = Path(f"{shared}/objects/{digest[:2]}/{digest}")
    shutil.copytree(shared / "objects" / stored.digest[:2] / stored.digest, there, dirs_exist_ok=True)
    before = sorted(target.rglob("*")) if target.exists() else []
    store = opened(tmp_path, "b", str(shared))
    assert store.find(PREIMAGE) is None
    assert store.find(PREIMAGE, fetch=False) is None
    assert (sorted(target.rglob("*")) if target.exists() else []) == before
