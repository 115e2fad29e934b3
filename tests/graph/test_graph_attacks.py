"""Nodes, writers and files that try to have a wrong result served or recorded."""

from __future__ import annotations

import gc
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph import files
from exmesh_graph.errors import StoreError
from exmesh_graph.graph import sealed
from exmesh_graph.graph.cache.keys import key_of, preimage_of
from exmesh_graph.graph.declare.packs import declare
from exmesh_graph.graph.declare.ports import artifact_types
from exmesh_graph.graph.run.checkpoint import Checkpoints
from exmesh_graph.graph.run.execute import execute
from exmesh_graph.graph.run.job import job_of
from exmesh_graph.graph.run.memory import Memory
from exmesh_graph.graph.run.runner import NodeFailed
from exmesh_graph.report.reasons import explained as plan
from exmesh_graph.types import Artifact, Metrics

ARRAYS = """
nodes:
  n: {type: toy.const, value: 1}
  s: {type: toy.large, number: "@n.number"}
  a: {type: toy.spot, series: "@s.series", %s}
  b: {type: toy.total, series: "@s.series"}
"""


@pytest.mark.parametrize("spot", ["index: 0, fail: true", "index: 12345, fail: true", "index: 0", "index: 12345"])
def test_what_a_node_did_to_an_array_never_reaches_the_next(bench: Any, spot: str) -> None:
    """Whether it then fails or returns, and whichever element it writes into."""
    with pytest.raises(NodeFailed):
        bench.run(ARRAYS % spot, keep_going=True)
    record = bench.run(ARRAYS.replace("  a: ", "  # ") % spot)
    assert bench.value(record, "b") == 100_000


def test_a_buffer_that_a_node_gave_away_and_uses_again(bench: Any) -> None:
    text = """
nodes:
  n: {type: toy.const, value: 1}
  a: {type: toy.reuse, number: "@n.number", value: 1}
  b: {type: toy.reuse, number: "@n.number", value: 2}
  x: {type: toy.total, series: "@a.series"}
  y: {type: toy.total, series: "@b.series"}
"""
    record = bench.run(text)
    assert (bench.value(record, "x"), bench.value(record, "y")) == (100_000, 200_000)


def test_files_of_an_input_that_a_node_changed(bench: Any) -> None:
    text = """
nodes:
  n: {type: toy.const, value: 1}
  f: {type: toy.folder, number: "@n.number"}
  w: {type: toy.read_folder, files: "@f.files"}
  a: {type: toy.deface, files: "@f.files"}
  b: {type: toy.read_folder, files: "@f.files"}
"""
    first = text.replace("  a: ", "  # ").replace("  w: ", "  # ").replace("  b: ", "  # ")
    bench.run(first)
    with pytest.raises(NodeFailed, match="changed its input files in place"):
        bench.run(text.replace("  w: ", "  # "), keep_going=True)
    record = bench.run(text.replace("  a: ", "  # "))
    assert bench.value(record, "b") == 1


def test_a_validator_that_is_not_idempotent_is_refused(bench: Any) -> None:
    """Parameters are validated again where the node runs: what it computes with must be what it is keyed by."""
    with pytest.raises(NodeFailed, match="angle"):
        bench.run("nodes: {a: {type: toy.degrees, angle: 90}}")


def test_a_folder_that_grows_while_its_node_runs(bench: Any) -> None:
    folder = Path(bench.root, "numbers")
    folder.mkdir()
    (folder / "one.txt").write_text("1")
    (folder / "grow").touch()
    text = f"nodes: {{a: {{type: toy.sum_folder, path: {folder}}}}}"
    with pytest.raises(NodeFailed, match="changed while a ran"):
        bench.run(text)
    (folder / "grow").unlink()
    assert bench.value(bench.run(text), "a") == 101
    (folder / "late.txt").unlink()
    assert bench.value(bench.run(text), "a") == 1


def test_a_source_that_vanishes_after_the_check(bench: Any) -> None:
    path = Path(bench.root, "number.txt")
    path.write_text("1")
    graph = bench.check(f"nodes: {{a: {{type: toy.file, path: {path}}}}}")
    path.unlink()
    (step,) = plan(graph, bench.store)
    assert "a source file cannot be read" in step.reason


def test_an_object_is_not_read_as_another_type(bench: Any) -> None:
    """A record that says another type than its object has: both are stored alike, and they are not alike."""
    from toy_pack.nodes import Number, Whole

    store = bench.store
    with store.attempt() as attempt:
        stored = store.put(Number(1.5), attempt)
    assert store.load(Number, stored.digest) is not None
    assert store.load(Whole, stored.digest) is None
    assert store.sound(stored.digest)


def test_code_edited_before_a_worker_ran_it_leaves_no_checkpoint(bench: Any) -> None:
    """A checkpoint is for its key: states that other code computed must not be gone on from when the edit is undone."""
    text = """
nodes:
  a: {type: toy.const, value: 5}
  c: {type: toy.count, number: "@a.number", steps: 5}
"""
    graph = bench.check(text)
    record = bench.run(text)
    store = bench.store
    bound = graph.nodes["c"]
    row = next(row for row in record["nodes"] if row["name"] == "c")
    action = store.look_up(row["key"])
    assert action is not None
    job = job_of(bound, graph, action.preimage, store, {}, checkpoint_every=0.0)
    saved: list[Path] = []

    class Seen(Checkpoints):
        def save(self, step: int, state: Any) -> None:
            super().save(step, state)
            saved.append(self.root)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("exmesh_graph.graph.run.execute.Checkpoints", Seen)
        assert execute(job, store, Memory(), bench.events.append).state == "done"
        assert set(saved) == {store.root}
        saved.clear()
        other = replace(job, preimage={**job.preimage, "code": "0" * 64})
        assert execute(other, store, Memory(), bench.events.append).state == "done"
    assert saved
    assert store.root not in saved


def test_what_a_path_parameter_holds_beside_paths_is_in_the_key(bench: Any, tmp_path: Path) -> None:
    """A name of something built in, or a number for each file: no contents of files tell these apart."""
    path = tmp_path / "one.txt"
    path.write_text("1")

    def key(value: Any) -> str:
        bound = bench.check(f"nodes: {{a: {{type: toy.paths, what: {value}}}}}").nodes["a"]
        return key_of(preimage_of(bound, "code", {}, {}))

    keys = [key(value) for value in ("null", "studio", "sunset", f"[[{path}, 1.0]]", f"[[{path}, 2.0]]")]
    assert len(set(keys)) == 5
    (tmp_path / "two.txt").write_text("1")
    assert key(f"[[{tmp_path}/two.txt, 2.0]]") == keys[4]


def test_a_type_of_two_packs_is_refused_though_the_functions_share_a_name(bench: Any) -> None:
    known = bench.packs.types["toy.const"]

    def const() -> None:
        pass

    const.__qualname__, const.__module__ = known.function.__qualname__, "other_pack.nodes"
    with pytest.raises(ValueError, match=r"registered twice: toy_pack\.nodes\.const, other_pack\.nodes\.const"):
        declare(replace(known, function=const))


def test_an_artifact_name_of_two_packs_is_refused_though_the_classes_share_theirs(packs: Any) -> None:
    from toy_pack.nodes import Number

    space = {"__module__": "other_pack.nodes", "__qualname__": "Number", "type_name": "Number"}
    other = type("Number", (Artifact,), space)
    with pytest.raises(StoreError, match=r"in .*_pack.nodes and .*_pack.nodes"):
        artifact_types()
    del other
    gc.collect()
    assert artifact_types()["Number"] is Number


def test_an_object_whose_table_was_made_to_fit_other_bytes(bench: Any) -> None:
    """Bytes, table and seal agree; the digest that others name it by is of other bytes."""
    store = bench.store
    with store.attempt() as attempt:
        stored = store.put(Metrics({"x": 1.0}), attempt)
    (file,) = (path for _, path in files.walk_files(store.data(stored.digest)))
    note = store.data(stored.digest).parent / "artifact.json"
    head = sealed.read_sealed(note)
    file.chmod(0o644)
    file.write_text(file.read_text().replace("1.0", "2.0"))
    head["files"][file.name] = [file.stat().st_size, files.sha256_file(file)]
    note.write_text(sealed.seal_text(head))
    assert store.load(Metrics, stored.digest) is None
    assert "does not belong to this object" in store.notes[-1]


def test_a_record_whose_preimage_is_that_of_another_key(bench: Any) -> None:
    store = bench.store
    with store.attempt() as attempt:
        stored = store.put(Metrics({"x": 1.0}), attempt)
    key = store.record({"type": "t", "params": {"x": 1}}, {"m": stored}, {})
    path = store.root / "actions" / key[:2] / f"{key}.json"
    record = sealed.read_sealed(path)
    record["preimage"]["params"]["x"] = 2
    path.write_text(sealed.seal_text(record))
    assert store.look_up(key) is None
    assert "does not belong to the pre-image" in store.notes[-1]


def test_a_source_that_keeps_inode_size_and_time(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file changed just now is read each time; later the time that no one can set tells an edit."""
    path = bench.root / "source.txt"
    path.write_text("1")
    store = bench.store
    first = store.sources.digest(path)
    assert store.sources.known == {}
    monkeypatch.setattr(sealed, "_RACY", 0)
    assert store.sources.digest(path) == first
    assert len(store.sources.known) == 1
    times = path.stat().st_mtime_ns
    time.sleep(0.02)
    path.write_text("2")
    os.utime(path, ns=(times, times))
    assert store.sources.digest(path) != first


def test_a_source_edited_before_its_node_ran_is_not_recorded(bench: Any) -> None:
    path = bench.root / "number.txt"
    path.write_text("1")
    graph = bench.check(f"nodes: {{a: {{type: toy.file, path: {path}}}}}")
    (step,) = plan(graph, bench.store)
    assert step.preimage is not None
    path.write_text("22")
    job = job_of(graph.nodes["a"], graph, step.preimage, bench.store, {})
    outcome = execute(job, bench.store, Memory(), bench.events.append)
    assert "the source file number changed while a ran" in outcome.info["message"]
    assert bench.store.look_up(job.key) is None
