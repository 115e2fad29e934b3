"""The shared tier: what one machine made is a hit on another, and nothing half-sent or spoilt is believed."""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
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


@pytest.fixture(scope="session")
def s3() -> Iterator[str]:
    """The address of a server that speaks S3, in this process."""
    pytest.importorskip("s3fs", reason="s3fs is not installed (pip install 'exmesh-graph[s3]')")
    server = pytest.importorskip(
        "moto.server", reason="moto is not installed (pip install 'moto[s3]' flask flask-cors)"
    )
    own = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_DEFAULT_REGION": "us-east-1"}
    running = server.ThreadedMotoServer(port=0, verbose=False)
    running.start()
    own["AWS_ENDPOINT_URL"] = "http://{}:{}".format(*running.get_host_and_port())
    with pytest.MonkeyPatch.context() as patch:
        for name, value in own.items():
            patch.setenv(name, value)
        yield own["AWS_ENDPOINT_URL"]
    running.stop()


def bucket(name: str) -> str:
    fsspec.filesystem("s3").mkdir(name)
    return f"s3://{name}/results"


@pytest.fixture(params=["folder", "memory", "s3"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "folder":
        return str(tmp_path / "shared")
    if request.param == "s3":
        request.getfixturevalue("s3")
        return bucket(f"bucket-{time.monotonic_ns()}")
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


@pytest.mark.thorough
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


@pytest.mark.thorough
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
    real = Remote.send_file
    for limit in range(3):
        sent: list[str] = []

        def send(self: Remote, path: Path, name: str, limit: int = limit, sent: list[str] = sent) -> None:
            if len(sent) == limit:
                raise ConnectionError("cut off")
            sent.append(name)
            real(self, path, name)

        monkeypatch.setattr(Remote, "send_file", send)
        store = opened(tmp_path, f"a{limit}", url)
        made(store)
        assert "going on without it (ConnectionError: cut off)" in store.notes[0]
        assert opened(tmp_path, f"b{limit}", url).find(PREIMAGE) is None
    monkeypatch.setattr(Remote, "send_file", real)
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

    monkeypatch.setattr(store.remote, "read", refuse)
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


# --- limits, mirrors, several machines


class Hanging:
    """A file system whose files never come."""

    def __init__(self, fs: Any) -> None:
        self.fs = fs

    def __getattr__(self, name: str) -> Any:
        return getattr(self.fs, name)

    def cat_file(self, name: str) -> bytes:
        time.sleep(60)
        return b""


@pytest.mark.reliability("a shared store that hangs, or offers more than may be taken", "left alone, with a note")
def test_a_tier_that_hangs_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXMESH_SHARED_LIMITS", "seconds=0.3")
    store = opened(tmp_path, "a", f"memory://{tmp_path.name}")
    assert store.remote is not None
    store.remote.fs = Hanging(store.remote.fs)
    began = time.monotonic()
    assert store.find(PREIMAGE) is None
    assert store.find(PREIMAGE) is None
    assert time.monotonic() - began < 5
    (note,) = store.notes
    assert "going on without it (TimeoutError: no answer within 0.3 s)" in note


def test_more_than_the_limit_is_left_there(tmp_path: Path, url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made(opened(tmp_path, "a", url))
    monkeypatch.setenv("EXMESH_SHARED_LIMITS", "gb=0.000000001")
    store = opened(tmp_path, "b", url)
    assert store.find(PREIMAGE) is None
    assert "EXMESH_SHARED_LIMITS=gb=NUMBER takes it" in store.notes[0]
    monkeypatch.setenv("EXMESH_SHARED_LIMITS", "gb=1 seconds=30")
    assert opened(tmp_path, "c", url).find(PREIMAGE) is not None
    monkeypatch.setenv("EXMESH_SHARED_LIMITS", "1GB")
    with pytest.raises(StoreError, match=r"cannot read EXMESH_SHARED_LIMITS"):
        opened(tmp_path, "d", url)


def test_a_file_longer_than_its_note_says_is_not_read_to_its_end(tmp_path: Path, url: str) -> None:
    """What a server sends beyond the size in the note would fill the disk."""
    made(opened(tmp_path, "a", url))
    spoil(url, "metrics.json", lambda data: data + bytes(30 << 20))
    store = opened(tmp_path, "b", url)
    assert store.remote is not None
    written: list[int] = []
    real = store.remote._bring

    def watched(name: str, target: Path, size: int) -> None:
        real(name, target, size)
        written.append(target.stat().st_size - size)

    store.remote._bring = watched  # type: ignore[method-assign]
    assert store.find(PREIMAGE) is None
    assert written == [1]


@pytest.fixture
def mirror(tmp_path: Path) -> Iterator[str]:
    """The address of a web server that shows a folder and takes nothing."""
    pytest.importorskip("aiohttp", reason="aiohttp is not installed (pip install aiohttp)")

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *words: Any) -> None:
            return

    (tmp_path / "shared").mkdir()
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(tmp_path / "shared")))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()


def test_a_mirror_that_may_only_be_read_serves_and_is_told_once(tmp_path: Path, mirror: str) -> None:
    key, _ = made(opened(tmp_path, "a", str(tmp_path / "shared")))
    store = opened(tmp_path, "b", mirror)
    assert store.find(PREIMAGE) is not None
    own = [made(store, number, {**PREIMAGE, "code": str(number)})[0] for number in (5, 6)]
    (note,) = store.notes
    assert "cannot be written; its results are used, none are sent" in note
    assert [path.stem for path in (tmp_path / "shared" / "actions").glob("*/*.json")] == [key]
    assert all(store.look_up(one) is not None for one in own)
    shutil.rmtree(tmp_path / "b")
    assert opened(tmp_path, "b", mirror).find(PREIMAGE) is not None  # still serves


MACHINE = """
import sys
sys.path.insert(0, {toy!r})
import exmesh_graph as ex
done = ex.run({graph!r}, store={store!r}, shared={url!r}, runs={runs!r}, workers=0, progress=False, report=False)
print(*(f"{{name}}={{row['state']}}" for name, row in done.rows.items()), *done.store.notes)
"""
TRACED = """
run: all
nodes:
  a: {type: toy.const, value: 1}
  b: {type: toy.count, number: "@a.number", steps: 3, trace: "%s"}
"""


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["folder", "s3"])
def test_two_machines_never_compute_what_the_other_has(bench: Any, request: Any, kind: str) -> None:
    """Two processes with stores of their own and one shared store, in turn: each result is made once."""
    url = str(bench.root / "shared")
    if kind == "s3":
        request.getfixturevalue("s3")
        url = bucket(f"machines-{time.monotonic_ns()}")
    trace = bench.root / "trace"
    toy = str(Path(__file__).parent / "toy")

    def machine(name: str, more: str) -> dict[str, str]:
        graph = bench.write(TRACED % trace + more, f"{name}.yaml")
        places = {word: str(bench.root / f"{word}-{name}") for word in ("store", "runs")}
        code = MACHINE.format(toy=toy, graph=str(graph), url=url, **places)
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return dict(word.partition("=")[::2] for word in done.stdout.split())

    more = '  c: {type: toy.sign, number: "@a.number"}\n'
    last = '  d: {type: toy.add, a: "@c.number", b: "@a.number"}\n'
    assert set(machine("one", "").values()) == {"done"}
    assert machine("two", more) == {"a": "hit", "b": "hit", "c": "done"}
    assert machine("one", more + last) == {"a": "hit", "b": "hit", "c": "hit", "d": "done"}
    assert machine("two", more + last) == {"a": "hit", "b": "hit", "c": "hit", "d": "hit"}
    assert len(trace.read_text().splitlines()) == 3  # the steps of one execution
