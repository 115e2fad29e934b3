"""Disks that are full, read-only or failing: a clear message, nothing half-written, hits that still serve."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph import files
from exmesh_graph.errors import StoreError
from exmesh_graph.graph.cache.keys import Stored
from exmesh_graph.graph.cache.lease import Lease, Leases
from exmesh_graph.graph.cache.store import Store, writable
from exmesh_graph.graph.declare.ports import artifact_types
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import Runner
from exmesh_graph.types import Metrics

GRAPH = """
nodes:
  one: {type: toy.const, value: 1}
  sum: {type: toy.add, a: "@one.number", b: "@one.number"}
outputs: {sum: "@sum.number"}
"""
MORE = GRAPH.replace("outputs", '  more: {type: toy.add, a: "@sum.number"}\noutputs')


def failing(code: int) -> Callable[..., Any]:
    def fail(*_: Any, **__: Any) -> Any:
        raise OSError(code, os.strerror(code))

    return fail


def run(bench: Any, text: str, store: Store) -> dict[str, Any]:
    folder = RunFolder(bench.root / "runs", "g")
    try:
        return Runner(bench.check(text).with_idle(), store, folder, bench.events.append).run()
    finally:
        folder.close()


def keep(store: Store) -> str:
    with store.attempt() as attempt:
        return store.record({"type": "t"}, {"m": store.put(Metrics({"x": 1}), attempt)}, {})


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EDQUOT, errno.EIO])
@pytest.mark.parametrize("where", ["sync", "own_folder", "os.rename", "os.replace"])
def test_a_write_that_fails_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, where: str
) -> None:
    store = Store(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(f"exmesh_graph.files.{where}", failing(code))
        with pytest.raises(StoreError, match="cannot be written") as caught:
            keep(store)
    assert os.strerror(code) in str(caught.value)
    assert "--store" in caught.value.fix
    assert list((tmp_path / "actions").glob("*/*")) == []
    assert store.look_up(keep(store)) is not None
    assert list(store.verify()) == []
    assert list(store.work.iterdir()) == []


def test_hits_need_no_room(bench: Any, monkeypatch: pytest.MonkeyPatch, states: Any) -> None:
    bench.run(GRAPH)
    for path in (bench.root / "store" / "roots").iterdir():
        path.unlink()
    monkeypatch.setattr(files, "own_folder", failing(errno.ENOSPC))
    assert states(run(bench, GRAPH, bench.store)) == {"one": "hit", "sum": "hit"}


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 256 KiB."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(place)]
    try:
        done = subprocess.run(command, capture_output=True, check=False)
    except OSError:
        pytest.skip("there is no mount command")
    if done.returncode:
        pytest.skip("this user may not mount a file system")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def test_a_disk_that_is_full(small_disk: Path) -> None:
    store = Store(small_disk / "store")
    key = keep(store)
    with pytest.raises(StoreError, match="No space left on device"), store.attempt() as attempt:
        store.put(Metrics({"x": "y" * 400_000}), attempt)
    assert store.look_up(key) is not None
    (small_disk / "filler").write_bytes(b"x" * (os.statvfs(small_disk).f_bavail * os.statvfs(small_disk).f_bsize))
    assert store.look_up(key) is not None
    lease = Leases(store.root).acquire("ab" * 32)
    assert isinstance(lease, Lease)
    lease.beat()
    lease.release()
    (small_disk / "filler").unlink()
    assert list(store.verify()) == []
    assert list(store.work.iterdir()) == []


def test_a_disk_mounted_read_only(bench: Any, small_disk: Path, states: Any) -> None:
    run(bench, GRAPH, Store(small_disk / "store"))
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    check_layer(bench, Store(small_disk / "store"), states)


def test_a_store_that_may_only_be_read(bench: Any, monkeypatch: pytest.MonkeyPatch, states: Any) -> None:
    """The same where nothing can be mounted: the folder is made to look read-only and then really is watched."""
    bench.run(GRAPH)
    real = os.access
    root = bench.root / "store"
    monkeypatch.setattr(os, "access", lambda path, mode, **k: Path(path) != root and real(path, mode, **k))
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*")}
    check_layer(bench, Store(root), states)
    assert {path: path.stat().st_mtime_ns for path in root.rglob("*")} == before


def check_layer(bench: Any, store: Store, states: Any) -> None:
    """Hits are served, new results are used, published and gone; workers see the same."""
    with writable(store) as layer:
        record = run(bench, MORE, layer)
        assert states(record) == {"one": "hit", "sum": "hit", "more": "done"}
        (row,) = [row for row in record["nodes"] if row["name"] == "more"]
        stored = Stored(**row["outputs"]["number"])
        value = Store(layer.root).load(artifact_types()[stored.type], stored.digest)
        assert value is not None
        assert value.value == 2
        assert (bench.root / "runs" / record["id"] / "sum").is_dir()
        (note,) = layer.notes
        assert "new results are not kept" in note
        assert states(run(bench, MORE, layer))["more"] == "hit"
        temporary = layer.root
    assert not temporary.exists()
    assert store.look_up(row["key"]) is None


def test_what_is_broken_below_is_made_again_on_top(bench: Any, monkeypatch: pytest.MonkeyPatch, states: Any) -> None:
    first = bench.run(GRAPH)
    root = bench.root / "store"
    digest = first["nodes"][1]["outputs"]["number"]["digest"]
    (path,) = (root / "objects" / digest[:2] / digest / "data").iterdir()
    path.chmod(stat.S_IRUSR | stat.S_IWUSR)
    path.write_bytes(path.read_bytes()[:-1] + b"!")
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    with writable(Store(root)) as layer:
        record = run(bench, GRAPH, layer)
        assert states(record) == {"one": "hit", "sum": "done"}
        assert any("is not used" in note for note in layer.notes)
        assert layer.sound(digest)
    assert path.exists()


def test_a_writable_store_is_itself(tmp_path: Path) -> None:
    for root in (tmp_path, tmp_path / "new"):
        store = Store(root)
        with writable(store) as same:
            assert same is store
