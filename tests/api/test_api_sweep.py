"""Sweeps and differences from Python; sessions."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import exmesh_graph as ex
from exmesh_graph.errors import GraphError
from exmesh_graph.graph.problems import GraphErrors


def study(loop: Any) -> ex.Graph:
    graph = loop(2)
    graph.variant("no_leap", {"bypass": "rounds.leap"})
    graph.variant("ten", {"set": "one.value", "to": 10})
    return graph  # type: ignore[no-any-return]


def test_a_sweep_and_its_handle(loop: Any, folder: Path) -> None:
    done = ex.sweep(study(loop), workers=0, progress=False)
    assert list(done) == ["base", "no_leap", "ten"]
    assert done["base"]["one"].number is done["no_leap"]["one"].number
    assert done["ten"]["one"].number.value == 10
    assert [row["variant"] for row in done.table["variants"]] == ["base", "no_leap", "ten"]
    assert done.page.is_file()
    assert not done.failures
    assert (done.folder / "graph.yaml").is_file()
    few = ex.sweep(study(loop), only="ten", nodes="one", workers=0, progress=False)
    assert (list(few), list(few["ten"])) == (["base", "ten"], ["one"])


def test_a_sweep_tells_faults_of_all_variants_and_failures_of_some(loop: Any) -> None:
    graph = study(loop)
    graph.variant("bad", {"set": "one.value", "to": "x"})
    graph.variant("worse", {"remove": "nothing"})
    with pytest.raises(GraphErrors) as caught:
        ex.sweep(graph, workers=0, progress=False)
    assert len(caught.value.problems) == 2
    with pytest.raises(GraphError, match="no variant has a node 'on'"):
        ex.sweep(study(loop), nodes="on", workers=0, progress=False)
    graph = ex.Graph("g")
    one = graph.add("one", "toy.const", value=1)
    graph.add("bad", "toy.fail", number=one, value=0)
    graph.variant("small", {"set": "bad.value", "to": 2})
    done = ex.sweep(graph, workers=0, progress=False)
    assert "too small" in done.failures["small:bad"]
    assert [row["state"] for row in done.table["variants"]] == ["done", "failed"]


def test_differences_of_graphs_and_runs(loop: Any, run: Any) -> None:
    assert not ex.diff(loop())
    change = ex.diff(loop(), set={"one.value": 2})
    assert change
    assert "one: value 1 -> 2" in str(change)
    assert change.rerun is not None
    assert change.rerun[0] == "one"
    assert {box.name for box in change.picture().boxes} >= {"one", "rounds.step"}
    assert "no_leap" in ex.diff(study(loop), variant="no_leap").new.name
    first, second = run(loop()), run(loop(), n=2)
    assert "3 -> 2 rounds" in str(ex.diff(first, second))
    assert "keys are the same" in str(ex.diff(first.folder, second))


def test_a_session_of_its_own(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "own_pack.py").write_text(
        "from typing import NamedTuple\n"
        "from exmesh_graph.graph import Context, Params, node\n"
        "from exmesh_graph.types import Files\n"
        "class Out(NamedTuple):\n    files: Files\n"
        "class P(Params):\n    pass\n"
        '@node("own.note", version="1")\n'
        "def note(ctx: Context, *, p: P) -> Out:\n"
        '    """A file."""\n'
        '    (ctx.scratch / "a.txt").write_text("a")\n'
        '    return Out(Files(ctx.scratch, "a.txt"))\n'
    )
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "own_pack", raising=False)
    session = ex.Session(packs=["own_pack"])
    with session:
        graph = ex.Graph("g")
        graph.output("asset", graph.add("note", "own.note").files)
    with pytest.raises(GraphErrors, match="no node type"):
        ex.check(graph)
    done = ex.run(graph, session=session, workers=0, progress=False)
    assert done["note"].files.main == "a.txt"
    assert ex.call("own.note", session=session).files.main == "a.txt"
    assert isinstance(sys.modules["own_pack"], ModuleType)
