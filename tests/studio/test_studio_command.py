"""`exmesh studio`: what it says where it cannot start, and what it opens for a run."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import exmesh_graph as ex
from exmesh_graph.cli.studio import studio
from exmesh_graph.errors import ExmeshError, MissingLibraryError
from exmesh_graph.studio.serving import serve
from exmesh_graph.studio.workspace import Workspace


def test_without_the_extra_it_says_which(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(MissingLibraryError, match="uvicorn") as told:
        serve(workspace)
    assert told.value.fix == "pip install 'exmesh-graph[studio]'"


def test_without_a_graph_it_says_so(folder: Path) -> None:
    for what in ("runs/latest", "nothing.yaml"):
        with pytest.raises(ExmeshError, match="there is no graph and no run"):
            studio(Path(what))


def test_a_run_is_opened_as_it_was_set(folder: Path) -> None:
    run = ex.run(folder / "graphs" / "small.yaml", set={"one.value": 4}, variant="alone", workers=0, progress=False,
                 store=folder / ".exmesh", runs=folder / "runs", report=False)  # fmt: skip
    opened = Workspace.of_run(run.folder)
    told = opened.facts(wait=60)
    opened.close()
    assert told["run"] == run.id
    assert told["ops"] == [{"disconnect": "sum.b"}, {"set": "one.value", "to": 4}]
    assert told["dirty"] is False
    assert told["plan"]["counts"] == {"hit": len(run), "run": 0, "unknown": 0}
