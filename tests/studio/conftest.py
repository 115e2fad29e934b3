"""A workspace over a small graph of the toy pack, and a client that has its cookie."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")
pytest.importorskip("httpx", reason="the extra `test` is not installed")

from starlette.testclient import TestClient

from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.studio.web.app import application
from exmesh_graph.studio.workspace import Workspace

TOY = Path(__file__).parent.parent / "graph" / "toy"
HOST, TOKEN = "127.0.0.1:8000", "token-of-the-tests"

GRAPH = """\
# A small graph.
name: small
params:
  n: {type: int, default: 3, ge: 0, doc: Rounds.}   # how often
nodes:
  one: {type: toy.const, value: 1}     # begins
  rounds:
    repeat: "${n}"
    carry: {state: "@one.number"}
    nodes:
      step: {type: toy.step, state: "@carry.state", amount: 2}
      leap: {type: toy.leap, state: "@step.state", at: {2: {factor: 3}}}
    next: {state: "@leap.state"}
  sum: {type: toy.add, a: "@rounds.state", b: "@one.number"}
  files: {type: toy.folder, number: "@sum.number"}
outputs: {asset: "@files.files"}
variants:
  alone: [{disconnect: sum.b}]
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with `graphs/small.yaml`."""
    return made_in(tmp_path, monkeypatch)


def made_in(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the small graph, and the toy pack at hand, also for processes."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(TOY))
    monkeypatch.setenv("PYTHONPATH", str(TOY))
    monkeypatch.delenv("EXMESH_STORE", raising=False)
    assert "toy.const" in load_packs().types
    (folder / "graphs").mkdir()
    (folder / "graphs" / "small.yaml").write_text(GRAPH, encoding="utf-8")
    return folder


@pytest.fixture
def workspace(folder: Path) -> Iterator[Workspace]:
    made = Workspace(folder / "graphs" / "small.yaml", store=folder / ".exmesh", runs=folder / "runs")
    yield made
    made.close()


@pytest.fixture
def client(workspace: Workspace) -> Iterator[TestClient]:
    """A browser that opened the address with the token."""
    with opened(workspace) as browser:
        yield browser


@contextlib.contextmanager
def opened(workspace: Workspace) -> Iterator[TestClient]:
    """The application in this process, and a client with its cookie."""
    with TestClient(application(workspace, {HOST}, TOKEN), base_url=f"http://{HOST}") as browser:
        assert browser.get("/", params={"token": TOKEN}).status_code in (200, 404)  # 404: a page that is not built
        browser.headers["x-exmesh"] = "1"
        yield browser
