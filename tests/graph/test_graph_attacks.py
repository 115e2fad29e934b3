"""Nodes, writers and files that try to have a wrong result served or recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.checkpoint import Checkpoints
from exmesh_graph.graph.job import execute, job_of
from exmesh_graph.graph.memory import Memory
from exmesh_graph.graph.plan import plan
from exmesh_graph.graph.run import NodeFailed

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
    job = job_of(bound, graph.nodes, action.preimage, store, checkpoint_every=0.0)
    saved: list[Path] = []

    class Seen(Checkpoints):
        def save(self, step: int, state: Any) -> None:
            super().save(step, state)
            saved.append(self.root)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("exmesh_graph.graph.job.Checkpoints", Seen)
        assert execute(job, store, Memory(), bench.events.append).state == "done"
        assert set(saved) == {store.root}
        saved.clear()
        other = replace(job, code=["0" * 64])
        assert execute(other, store, Memory(), bench.events.append).state == "done"
    assert saved
    assert store.root not in saved
