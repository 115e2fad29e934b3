"""What the page shows does not stay as it was: files, code and reports that others write are seen."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import exmesh_graph as ex
from exmesh_graph.studio import planner
from exmesh_graph.studio.watching import Watcher
from exmesh_graph.studio.workspace import Workspace

PART = """\
inputs: {number: {type: Number}}
nodes: {twice: {type: toy.add, a: "@inputs.number", b: "@inputs.number"}}
outputs: {number: "@twice.number"}
"""
USER = """\
extends: base.yaml
name: user
nodes:
  one: {type: toy.const, value: 1}
  part: {graph: part.yaml, number: "@one.number"}
outputs: {end: "@part.number"}
"""


@pytest.mark.parametrize("name", ["user.yaml", "base.yaml", "part.yaml"])
def test_any_file_of_the_graph_that_somebody_writes_is_told(folder: Path, name: str) -> None:
    home = folder / "graphs"
    (home / "base.yaml").write_text("name: base\nparams: {n: 3}\nnodes: {other: {type: toy.const, value: 5}}\n")
    (home / "part.yaml").write_text(PART)
    (home / "user.yaml").write_text(USER)
    time.sleep(0.02)
    workspace = Workspace(home / "user.yaml", store=folder / ".exmesh", runs=folder / "runs")
    told: list[tuple[str, Mapping[str, Any]]] = []
    workspace.hub.publish = lambda kind, data: told.append((kind, data))  # type: ignore[method-assign]
    workspace.facts()
    workspace._look_at_disk()
    assert not told
    assert workspace.facts()["disk"] == "same"
    (home / name).write_text((home / name).read_text() + "# by somebody else\n")
    for _ in range(2):
        workspace._look_at_disk()
    assert told == [("disk", {"changed": True})]
    assert workspace.facts()["disk"] == "changed"
    workspace.document.reload()
    assert workspace.facts()["disk"] == "same"
    workspace._look_at_disk()
    assert told[-1] == ("disk", {"changed": False})
    workspace.close()


def test_a_sub_graph_whose_file_comes_later(folder: Path) -> None:
    home = folder / "graphs"
    (home / "user.yaml").write_text(USER.replace("extends: base.yaml\n", ""))
    workspace = Workspace(home / "user.yaml", store=folder / ".exmesh", runs=folder / "runs")
    told = workspace.facts()
    assert (len(told["problems"]), told["disk"]) == (1, "same")
    (home / "part.yaml").write_text(PART)
    assert workspace.facts()["disk"] == "changed"
    workspace.document.reload()
    assert not workspace.facts()["problems"]
    workspace.close()


def test_a_plan_that_is_asked_for_later_sees_edited_files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planner, "FRESH", 0.0)
    (folder / "number.txt").write_text("5")
    file = folder / "graphs" / "read.yaml"
    file.write_text("nodes: {a: {type: toy.file, path: ../number.txt}}\n")
    ex.run(file, store=folder / ".exmesh", runs=folder / "runs", workers=0, report=False, progress=False)
    workspace = Workspace(file, store=folder / ".exmesh", runs=folder / "runs")
    assert workspace.facts(wait=60)["plan"]["counts"] == {"hit": 1, "run": 0, "unknown": 0}
    (folder / "number.txt").write_text("6")
    assert workspace.facts(wait=60)["plan"]["counts"] == {"hit": 0, "run": 1, "unknown": 0}
    workspace.close()


CODE = """\
from typing import NamedTuple
from exmesh_graph.graph import Context, Params, node
from exmesh_graph.types import Metrics
class NoParams(Params):
    pass
class Out(NamedTuple):
    metrics: Metrics
@node("mine.one", version="1")
def one(ctx: Context, *, p: NoParams) -> Out:
    "One."
    return Out(Metrics({"x": 1.0}))
"""


def test_a_plan_that_is_asked_for_later_sees_edited_code(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planner, "FRESH", 0.0)
    monkeypatch.syspath_prepend(str(folder))
    (folder / "edited_pack.py").write_text(CODE)
    file = folder / "graphs" / "mine.yaml"
    file.write_text("nodes: {a: {type: mine.one}}\n")
    with ex.Session(packs=["edited_pack"]) as session:
        store, runs = folder / ".exmesh", folder / "runs"
        ex.run(file, store=store, runs=runs, workers=0, report=False, progress=False, session=session)
        workspace = Workspace(file, store=store, runs=runs)
        assert workspace.facts(wait=60)["plan"]["counts"] == {"hit": 1, "run": 0, "unknown": 0}
        time.sleep(0.02)
        (folder / "edited_pack.py").write_text(CODE.replace('"x": 1.0', '"x": 2.0'))
        assert workspace.facts(wait=60)["plan"]["counts"] == {"hit": 0, "run": 1, "unknown": 0}
        workspace.close()


def test_a_report_that_comes_after_the_end_is_told(folder: Path) -> None:
    """The run lets go of its folder, and writes its report then: headline and link stayed away until a reload."""
    run = ex.run("graphs/small.yaml", store=folder / ".exmesh", workers=0, report=False, progress=False)
    told: list[tuple[str, Mapping[str, Any]]] = []
    watcher = Watcher(folder / "runs", lambda kind, data: told.append((kind, data)), lambda ended: None)
    watcher.look()
    told.clear()
    watcher.look()
    assert not told
    run.make_report()
    watcher.look()
    watcher.look()
    assert told == [("runs", {"id": run.id})]
    view = watcher.view(run.id)
    assert view is not None
    assert view.facts()["report"]
