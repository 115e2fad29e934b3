"""ex.run and the handle it gives: artifacts, figures, failures, interruption, later runs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import exmesh_graph as ex
from exmesh_graph.errors import ExmeshError, StoreError


def test_a_run_and_its_handle(loop: Any, run: Any, folder: Path) -> None:
    done = run(loop(), n=4)
    assert (done.state, len(done)) == ("done", 10)
    assert done["rounds[4].leap"].state.value == done["rounds.leap"].state.value == 57.0
    assert done["one"].number is done["one"].number
    assert done["one"].info["state"] == "done"
    assert done["one"].outputs == list(done["one"]) == ["number"]
    assert "number" in done["one"]
    assert "asset" not in done["one"]
    assert (done.asset.root / "number.txt").read_text() == "57.0"
    assert done.paths["asset"].read_text() == "57.0"
    assert done.folder == (folder / "runs" / "latest").resolve()
    assert done.report.is_file()
    assert done.metrics["Seconds, total"].value >= 0
    assert {row["state"] for row in run(loop(), n=4).rows.values()} == {"hit"}


def test_keys_are_those_of_the_written_file(loop: Any, run: Any) -> None:
    first = run(loop())
    again = run(first.folder / "graph.yaml")
    assert {row["state"] for row in again.rows.values()} == {"hit"}
    assert [row["key"] for row in again.rows.values()] == [row["key"] for row in first.rows.values()]
    assert "graph.yaml" in first.record["command"]


def test_events_targets_and_force(loop: Any, run: Any) -> None:
    events: list[str] = []
    part = run(loop(), nodes="rounds[1].leap", listener=lambda event: events.append(event["event"]))
    assert list(part) == ["one", "rounds[1].step", "rounds[1].leap"]
    assert (events[0], events[-1]) == ("run_started", "run_finished")
    graph = loop()
    again = run(graph, nodes=graph["one"], force=["one"])
    assert again["one"].info["state"] == "done"


def test_an_earlier_run_is_opened(loop: Any, run: Any) -> None:
    first = run(loop())
    later = ex.open_run()
    assert later["one"].number.value == first["one"].number.value
    assert (later.id, later.metrics) == (first.id, first.metrics)
    (later.folder / "report.json").unlink()
    assert ex.open_run(first.folder).metrics == first.metrics


def test_plan_says_what_would_run(loop: Any, run: Any) -> None:
    before = ex.plan(loop())
    assert {step.state for step in before} == {"run", "unknown"}
    assert repr(before).endswith("0 hit, 1 to run, 7 unknown (below a node that must run)")
    assert repr(before.graph) == "<checked graph loop: 8 nodes>"
    run(loop())
    assert {step.state for step in ex.plan(loop())} == {"hit"}
    assert [step.name for step in ex.plan(loop(), nodes="one")] == ["one"]


def test_a_failed_run_says_how_to_go_on(run: Any) -> None:
    graph = ex.Graph("g")
    one = graph.add("one", "toy.const", value=1)
    graph.add("bad", "toy.fail", number=one, value=1)
    with pytest.raises(ex.RunFailed) as caught:
        run(graph)
    error = caught.value
    assert error.node == "bad"
    assert error.run["one"].number.value == 1
    assert error.run.state == "failed"
    for words in ("bad (", "test_api_run.py:", "too small", str(error.run.folder), "run again", "exmesh run"):
        assert words in str(error)
    with pytest.raises(AttributeError, match="which is failed"):
        _ = error.run["bad"].number
    again = ex.open_run(error.run.folder).failures
    assert [(r["node"], r["message"]) for r in again] == [(r["node"], r["message"]) for r in error.run.failures]


def test_an_interrupted_run_keeps_what_it_did(run: Any) -> None:
    graph = ex.Graph("g")
    one = graph.add("one", "toy.const", value=1)
    graph.add("two", "toy.step", state=one, amount=1)

    def stop(event: Any) -> None:
        if event["event"] == "node_finished":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        run(graph, listener=stop)
    done = caught.value.run  # type: ignore[attr-defined]
    assert done.state == "interrupted"
    assert done["one"].number.value == 1
    assert run(graph)["one"].info["state"] == "hit"


def test_a_store_that_is_gone(loop: Any, run: Any, folder: Path) -> None:
    done = run(loop())
    shutil.rmtree(folder / ".exmesh")
    with pytest.raises(StoreError, match="the store is gone") as caught:
        _ = done["one"].number
    assert "run the graph again" in caught.value.fix
    assert done.paths["asset"].is_file()


def test_broken_bytes_are_not_served(loop: Any, run: Any, folder: Path) -> None:
    done = run(loop())
    digest = done.rows["one"]["outputs"]["number"]["digest"]
    for file in (folder / ".exmesh" / "objects" / digest[:2] / digest / "data").iterdir():
        file.chmod(0o644)
        file.write_text("{}")
    with pytest.raises(StoreError, match=r"one\.number"):
        _ = done["one"].number


def test_names_that_a_run_does_not_have(loop: Any, run: Any) -> None:
    done = run(loop(1))
    for ask in (lambda: done["on"], lambda: done["one"].numbr, lambda: done.metrics["time"]):
        with pytest.raises(ExmeshError) as caught:
            ask()
        assert caught.value.expected
    assert "nope" not in done
    assert not hasattr(done["one"], "nope")
    with pytest.raises(ExmeshError, match="no run folder"):
        ex.open_run("runs/nothing")


def test_a_read_only_store_serves_its_hits(loop: Any, run: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import os

    run(loop(), nodes="one")
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK and access(path, mode))
    done = run(loop())
    assert done["one"].info["state"] == "hit"
    assert done["rounds.leap"].state.value > 0  # computed on the temporary layer, which lives as long as the handle
    assert Path(done.record["store"]) == folder / ".exmesh"


def test_importing_the_package_loads_nothing() -> None:
    code = (
        "import sys, exmesh_graph as ex; assert 'pydantic' not in sys.modules; ex.Graph; print('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


def test_old_names_are_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    path.write_text("nodes: {a: {type: toy.constant}}\noutputs: {a: '@a.number'}\n")
    with pytest.warns(UserWarning, match=r"g\.yaml:1: the node type 'toy.constant' is now called 'toy.const'"):
        ex.check(path)


OWN_NODE = """
from typing import NamedTuple
import exmesh_graph as ex
from exmesh_graph.graph import node
from exmesh_graph.types import Mesh

class Out(NamedTuple):
    mesh: Mesh

@node("my.broken", version="1")
def broken(ctx) -> Out:
    raise ValueError("no mesh today")

g = ex.Graph("own")
g.add("mine", broken)
print(g.to_yaml())
try:
    ex.run(g, workers=0)
except ex.RunFailed as error:
    print(error)
"""


@pytest.mark.thorough
def test_a_script_is_told_that_commands_do_not_know_its_nodes(folder: Path) -> None:
    Path("own.py").write_text(OWN_NODE)
    told = subprocess.run([sys.executable, "own.py"], check=True, capture_output=True, text=True).stdout
    assert told.startswith("# my.broken: declared in a script or notebook")
    assert "no mesh today" in told
    assert "fix: mend it and run again, what is done is kept, from here" in told
    assert "exmesh run" not in told


def test_saving_an_output_without_its_port(loop: Any, run: Any) -> None:
    done = run(loop())
    with pytest.raises(ExmeshError, match=r"'one' names no output\n  expected: one\.number"):
        done.save("one", "copy")
    with pytest.raises(ExmeshError, match=r"expected: rounds\.leap\.state"):
        done.save("rounds.leap", "copy")
    with pytest.raises(ExmeshError, match="no node 'nothing'"):
        done.save("nothing.at_all", "copy")
