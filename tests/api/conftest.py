"""The front door with the toy node pack, in an empty working folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import exmesh_graph as ex
from exmesh_graph.graph.declare.packs import load_packs

TOY = Path(__file__).parent.parent / "graph" / "toy"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(TOY))
    monkeypatch.delenv("EXMESH_STORE", raising=False)
    assert "toy.const" in load_packs().types
    return tmp_path


def loop(rounds: int = 3) -> ex.Graph:
    """A constant, a repeat block with another node in every second round, files that are published."""
    graph = ex.Graph("loop")
    count = graph.param("n", rounds, doc="Rounds.", ge=0)
    one = graph.add("one", "toy.const", value=1)
    with graph.repeat("rounds", count, state=one.number) as block:
        step = block.add("step", "toy.step", state=block.carry.state, amount=block.round)
        leap = block.add("leap", "toy.step", state=step, amount=0, every={2: {"type": "toy.leap", "factor": 3}})
        block.next(state=leap.state)
    files = graph.add("files", "toy.folder", number=block.state)
    graph.output("asset", files.files)
    return graph


@pytest.fixture(name="loop")
def loop_fixture() -> Callable[..., ex.Graph]:
    return loop


@pytest.fixture
def run() -> Callable[..., Any]:
    """ex.run in this process, without a view."""
    return lambda graph, **options: ex.run(graph, workers=0, progress=False, **options)
