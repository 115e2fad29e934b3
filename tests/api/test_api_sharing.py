"""push and pull of a run: on another machine it opens, and its graph is all hits."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import exmesh_graph as ex
from exmesh_graph.api import sharing
from exmesh_graph.cli.app import app
from exmesh_graph.errors import ExmeshError, StoreError

pytest.importorskip("fsspec")
GRAPH = """
nodes:
  one: {type: toy.const, value: 1}
  sum: {type: toy.add, a: "@one.number", b: "@one.number"}
  shown: {type: toy.metrics, number: "@sum.number"}
outputs: {sum: "@sum.number"}
"""


@pytest.fixture
def sent(tmp_path: Path) -> Any:
    """A run on one machine, sent; what the other one calls its places."""
    (tmp_path / "graph.yaml").write_text(GRAPH)
    here = {"store": tmp_path / "store-a", "runs": tmp_path / "runs-a"}
    run = ex.run(tmp_path / "graph.yaml", **here, workers=0, progress=False)
    shared = str(tmp_path / "shared")
    told = sharing.push("latest", shared=shared, **here)
    assert (told.run, told.results, told.missing) == (run.id, 3, ())
    there = {"store": tmp_path / "store-b", "runs": tmp_path / "runs-b"}
    return run, shared, there


def test_a_run_is_brought_to_another_machine(sent: Any, tmp_path: Path) -> None:
    run, shared, there = sent
    shutil.rmtree(tmp_path / "store-a")
    (row,) = sharing.shared_runs(shared, there["store"])
    assert (row["id"], row["state"]) == (run.id, "done")
    told = sharing.pull(run.id, shared=shared, **there)
    assert (told.results, told.missing) == (3, ())
    other = ex.open_run(told.folder, store=there["store"])
    assert other["sum"].number.value == 2
    assert other.record["store"] == str(there["store"])
    assert (told.folder / "report.html").is_file()
    again = ex.run(tmp_path / "graph.yaml", **there, workers=0, progress=False, report=False)
    assert {row["state"] for row in again.rows.values()} == {"hit"}
    with pytest.raises(ExmeshError, match="there is a folder of this name already"):
        sharing.pull(run.id, shared=shared, **there)


def test_a_run_keeps_its_own_results_of_nodes_that_are_not_repeatable(tmp_path: Path) -> None:
    """Here the run was made anew before it was sent, and there is another result of the same key already."""
    here, there = ({"store": tmp_path / f"store-{x}", "runs": tmp_path / f"runs-{x}"} for x in "ab")

    def made(name: str, places: dict[str, Path]) -> Any:
        file = tmp_path / name
        file.write_text("nodes: {d: {type: toy.dice, number: '@n.number'}, n: {type: toy.const}}")
        return ex.run(file, **places, workers=0, progress=False, report=False, force=["d"])

    run, again, other = made("a.yaml", here), made("b.yaml", here), made("c.yaml", there)
    value = run["d"].number.value
    assert len({value, again["d"].number.value, other["d"].number.value}) == 3
    shared = str(tmp_path / "shared")
    sharing.push(run.id, shared=shared, **here)
    told = sharing.pull(run.id, shared=shared, **there)
    assert (told.results, told.missing) == (2, ())
    assert ex.open_run(told.folder, store=there["store"])["d"].number.value == value
    assert ex.open_run(other.folder, store=there["store"])["d"].number.value == other["d"].number.value


def test_another_run_of_the_same_id_is_not_replaced(sent: Any, tmp_path: Path) -> None:
    """Two machines may begin runs of one name in the same second."""
    run, shared, _ = sent
    sharing.push(str(run.folder), shared=shared, store=tmp_path / "store-a")  # the same one may be sent again
    folder = shutil.copytree(run.folder, tmp_path / "elsewhere" / run.id)
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps({**record, "started": record["started"] + 0.5}))
    with pytest.raises(ExmeshError, match="another run of this id is in the shared store"):
        sharing.push(str(folder), shared=shared, store=tmp_path / "store-a")


def test_what_cannot_be_brought_is_told(sent: Any, tmp_path: Path) -> None:
    run, shared, there = sent
    with pytest.raises(ExmeshError, match="there is no run other in the shared store") as caught:
        sharing.pull("other", shared=shared, **there)
    assert run.id in caught.value.expected
    for name in ("../x", "a/b", ""):
        with pytest.raises(ExmeshError):
            sharing.pull(name, shared=shared, **there)
    key = run["sum"].info["key"]
    (tmp_path / "shared" / "actions" / key[:2] / f"{key}.json").unlink()
    told = sharing.pull(run.id, shared=shared, **there)
    assert (told.results, told.missing) == (2, ("sum",))
    with pytest.raises(ExmeshError, match="no shared store is named"):
        sharing.pull(run.id, **there)


def test_a_note_that_was_changed_brings_nothing(sent: Any, tmp_path: Path) -> None:
    run, shared, there = sent
    note = tmp_path / "shared" / "runs" / f"{run.id}.json"
    note.write_text(note.read_text().replace("done", "dine"))
    with pytest.raises(ExmeshError, match="checksum"):
        sharing.pull(run.id, shared=shared, **there)
    sharing.push(str(run.folder), shared=shared, store=run.record["store"])
    note.with_name("another.json").write_text(note.read_text())
    with pytest.raises(ExmeshError, match="it is that of another run"):
        sharing.pull("another", shared=shared, **there)
    assert not there["runs"].exists()


def test_a_store_that_cannot_be_written_is_an_error_of_push(sent: Any, tmp_path: Path) -> None:
    run, _, _ = sent
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError, match="the shared store cannot be used"):
        sharing.push(str(run.folder), shared=str(tmp_path / "file" / "shared"), store=tmp_path / "store-a")


def test_the_commands(sent: Any, tmp_path: Path) -> None:
    run, shared, there = sent
    words = ["--shared", shared, "--store", str(there["store"]), "--runs", str(there["runs"])]
    listed = CliRunner().invoke(app, ["pull", *words])
    assert run.id in listed.output
    assert "3 results" in listed.output
    brought = CliRunner().invoke(app, ["pull", run.id, *words])
    assert brought.exit_code == 0, brought.output
    pushed = CliRunner().invoke(app, ["push", run.id, *words])
    assert f"sent {run.id}: 3 results" in pushed.output
