"""The store: equal bytes once, any doubt is a miss, and it can be moved."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.files import own_folder, sweep_abandoned
from exmesh_graph.graph.cache.keys import Stored
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.sealed import SourceDigests, seal_text, unseal
from exmesh_graph.types import Files, Metrics

PREIMAGE = {"type": "t", "params": {}}


def put(store: Store, value: Any) -> Stored:
    with store.attempt() as attempt:
        return store.put(value, attempt)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def test_round_trip_and_layout(store: Store, tmp_path: Path) -> None:
    stored = put(store, Metrics({"x": 1.5}))
    folder = tmp_path / "store" / "objects" / stored.digest[:2] / stored.digest
    assert sorted(p.name for p in folder.iterdir()) == ["artifact.json", "data"]
    assert not (folder / "data" / "metrics.json").stat().st_mode & 0o222
    loaded = store.load(Metrics, stored.digest)
    assert loaded is not None
    assert loaded.values == {"x": 1.5}
    assert put(store, Metrics({"x": 1.5})) == stored
    assert put(store, Metrics({"x": 1.6})).digest != stored.digest
    assert list((tmp_path / "store" / "work").iterdir()) == []


def test_files_refer_to_the_object(store: Store, tmp_path: Path) -> None:
    source = tmp_path / "source"
    (source / "sub").mkdir(parents=True)
    (source / "sub" / "a.bin").write_bytes(b"\0\1")
    stored = put(store, Files(source, main="sub/a.bin"))
    shutil.rmtree(source)
    loaded = store.load(Files, stored.digest)
    assert loaded is not None
    assert (loaded.root / loaded.main).read_bytes() == b"\0\1"
    assert loaded.root.is_relative_to(store.root / "objects")


def test_empty_folders_which_no_digest_holds_are_in_no_object(store: Store, tmp_path: Path) -> None:
    """Of two sets of equal files, one with such a folder, the first that came decided what both consumers saw."""
    (tmp_path / "source" / "empty" / "more").mkdir(parents=True)
    (tmp_path / "source" / "a.bin").write_bytes(b"1")
    stored = put(store, Files(tmp_path / "source"))
    loaded = store.load(Files, stored.digest)
    assert loaded is not None
    assert [path.name for path in loaded.root.rglob("*")] == ["a.bin"]
    (tmp_path / "nothing").mkdir()
    none = store.load(Files, put(store, Files(tmp_path / "nothing")).digest)
    assert none is not None
    assert list(none.root.iterdir()) == []


@settings(max_examples=20, deadline=None)
@given(st.dictionaries(st.text(max_size=4), st.floats(allow_nan=False, allow_infinity=False), max_size=4))
def test_equal_values_have_equal_digests(tmp_path_factory: pytest.TempPathFactory, values: dict[str, float]) -> None:
    store = Store(tmp_path_factory.mktemp("s"))
    stored = put(store, Metrics(values))
    loaded = store.load(Metrics, stored.digest)
    assert loaded is not None
    assert loaded.values == values
    assert put(store, loaded) == stored


def test_a_record_is_read_back(store: Store) -> None:
    stored = put(store, Metrics({}))
    key = store.record(PREIMAGE, {"metrics": stored}, {"seconds": 1.0})
    action = store.look_up(key)
    assert action is not None
    assert action.outputs == {"metrics": stored}
    assert action.preimage == PREIMAGE
    assert store.look_up("0" * 64) is None
    assert [a.key for a in store.actions("t")] == [key]
    assert list(store.actions("other")) == []


def spoil_missing(path: Path) -> None:
    path.unlink()


def spoil_short(path: Path) -> None:
    path.chmod(0o644)
    path.write_bytes(path.read_bytes()[:-1])


def spoil_extra(path: Path) -> None:
    (path.parent / "extra.txt").write_text("x")


def spoil_note(path: Path) -> None:
    note = path.parent.parent / "artifact.json"
    note.write_text(note.read_text().replace("Metrics", "Matrics"))


def spoil_no_note(path: Path) -> None:
    (path.parent.parent / "artifact.json").unlink()


@pytest.mark.parametrize("spoil", [spoil_missing, spoil_short, spoil_extra, spoil_note, spoil_no_note])
def test_a_broken_object_is_a_miss(store: Store, spoil: Any) -> None:
    stored = put(store, Metrics({"x": 1}))
    key = store.record(PREIMAGE, {"metrics": stored}, {})
    spoil(store.data(stored.digest) / "metrics.json")
    assert store.look_up(key) is None
    assert store.load(Metrics, stored.digest) is None
    assert "quarantine" in store.notes[0]
    assert not store.holds(stored.digest)
    assert put(store, Metrics({"x": 1})) == stored
    assert store.holds(stored.digest)


def test_flipped_bytes_are_never_loaded(store: Store) -> None:
    stored = put(store, Metrics({"x": 1}))
    path = store.data(stored.digest) / "metrics.json"
    path.chmod(0o644)
    path.write_text(path.read_text().replace("1", "2"))
    assert store.load(Metrics, stored.digest) is None
    assert not store.holds(stored.digest)


def test_verify_finds_flipped_bytes(store: Store) -> None:
    good, bad = put(store, Metrics({"x": 1})), put(store, Metrics({"x": 3}))
    store.record(PREIMAGE, {"m": good}, {})
    lost = store.record({"type": "t", "params": {"a": 1}}, {"m": bad}, {})
    path = store.data(bad.digest) / "metrics.json"
    path.chmod(0o644)
    path.write_text(path.read_text().replace("3", "4"))
    found = [what for what, _ in store.verify()]
    assert found == [f"object {bad.digest}", f"action {lost}"]
    assert list(store.verify()) == []
    assert store.holds(good.digest)


@pytest.mark.parametrize(
    "change", [lambda t: t.replace('"seconds": 1.0', '"seconds": 2.0'), lambda t: t[:-20], lambda t: "", lambda t: "[]"]
)
def test_a_changed_record_is_a_miss(store: Store, change: Any) -> None:
    key = store.record(PREIMAGE, {"m": put(store, Metrics({}))}, {"seconds": 1.0})
    path = store.root / "actions" / key[:2] / f"{key}.json"
    path.write_text(change(path.read_text()))
    assert store.look_up(key) is None
    assert not path.exists()
    assert list((store.root / "quarantine").iterdir())


def test_a_record_under_a_wrong_name_is_a_miss(store: Store) -> None:
    key = store.record(PREIMAGE, {"m": put(store, Metrics({}))}, {})
    other = "ab" + key[2:]
    target = store.root / "actions" / "ab" / f"{other}.json"
    target.parent.mkdir(exist_ok=True)
    shutil.copy(store.root / "actions" / key[:2] / f"{key}.json", target)
    assert store.look_up(other) is None


def test_a_broken_object_is_replaced_by_the_next_put(store: Store) -> None:
    stored = put(store, Metrics({"x": 1}))
    (store.data(stored.digest) / "metrics.json").unlink()
    assert put(store, Metrics({"x": 1})) == stored
    assert store.load(Metrics, stored.digest) is not None


def test_the_store_can_be_moved(store: Store, tmp_path: Path) -> None:
    stored = put(store, Metrics({"x": 1}))
    key = store.record(PREIMAGE, {"m": stored}, {})
    store.root.rename(tmp_path / "elsewhere")
    moved = Store(tmp_path / "elsewhere")
    assert moved.look_up(key) is not None
    assert moved.load(Metrics, stored.digest) is not None
    for path in (tmp_path / "elsewhere").rglob("*.json"):
        assert str(tmp_path) not in path.read_text()


def test_sealed_records_notice_any_change() -> None:
    text = seal_text({"a": 1, "b": [1.5, "x"]})
    assert unseal(text) == {"a": 1, "b": [1.5, "x"]}
    for position in range(len(text)):
        if text[position] in "ab1.5x":
            with pytest.raises((ValueError, KeyError)):
                unseal(text[:position] + "7" + text[position + 1 :])


def test_source_digests_follow_the_contents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import os
    import time

    from exmesh_graph.graph import sealed

    monkeypatch.setattr(sealed, "_RACY", -1)  # else nothing of so new a file would be remembered
    file, memo = tmp_path / "f", tmp_path / "memo.json"
    file.write_text("one")
    old = time.time() - 100
    os.utime(file, (old, old))
    first = SourceDigests(memo, tmp_path)
    one = first.digest(file)
    assert len(first.known) == 1
    time.sleep(0.02)
    file.write_text("two")
    os.utime(file, (old, old))  # same size, same mtime: the change time still tells
    assert first.digest(file) != one
    first.save()
    memo_text = memo.read_text() if memo.exists() else seal_text({"digests": {}})
    memo.write_text(memo_text.replace('"', "'"))
    assert SourceDigests(memo, tmp_path).known == {}


def test_sources_are_hashed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from exmesh_graph.graph import sealed

    file, memo = tmp_path / "f", tmp_path / "memo.json"
    file.write_text("one")
    monkeypatch.setattr(sealed, "_RACY", -1)
    digests = SourceDigests(memo, tmp_path)
    one = digests.digest(file)
    digests.save()
    monkeypatch.setattr(sealed, "sha256_file", lambda path: pytest.fail("hashed again"))
    assert SourceDigests(memo, tmp_path).digest(file) == one


def test_sweep_spares_the_living(tmp_path: Path) -> None:
    work = tmp_path / "work"
    with own_folder(work) as mine:
        dead = work / "1-1"
        dead.mkdir()
        (dead / "lock").touch()
        sweep_abandoned(work)
        assert mine.exists()
        assert not dead.exists()
    assert not mine.exists()


def test_a_folder_swept_between_open_and_lock_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sweep may come between opening the lock and locking it: the lock of a removed file protects nothing."""
    from exmesh_graph import files

    work, real = tmp_path / "work", files.fcntl.flock
    swept = []

    def flock(handle: int, how: int) -> None:
        if not swept:
            swept.append(next(work.iterdir()))
            shutil.rmtree(swept[0])
        real(handle, how)

    monkeypatch.setattr(files.fcntl, "flock", flock)
    with own_folder(work) as mine:
        (mine / "draft").write_text("x")
        assert mine != swept[0]


def test_records_hold_no_pickle(store: Store) -> None:
    stored = put(store, Metrics({"x": 1}))
    note = json.loads((store.data(stored.digest).parent / "artifact.json").read_text())
    assert set(note) == {"format", "type", "digest", "files", "checksum"}
