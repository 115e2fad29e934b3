"""Two sessions of one process: other packs, the same names with other meanings, other stores."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.errors import StoreError
from exmesh_graph.graph import NodeDef, node
from exmesh_graph.graph.cache import fingerprint as fp
from exmesh_graph.graph.declare.packs import Packs, current
from exmesh_graph.graph.declare.ports import artifact_types
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import Runner
from exmesh_graph.graph.session import Session, current_session
from exmesh_graph.report.reasons import explained as plan

NODES = """
import json
from typing import NamedTuple
from exmesh_graph.graph import Context, Component, Params, component, node, param
from exmesh_graph.types import Artifact
from {pack}.helpers import scaled

class Figure(Artifact):
    type_name = "Figure"
    def __init__(self, value): self.value = value
    def save(self, folder): (folder / "figure.json").write_text(json.dumps([self.value, "{pack}"]))
    @classmethod
    def load(cls, folder):
        value, pack = json.loads((folder / "figure.json").read_text())
        assert pack == "{pack}"
        return cls(value)

class Out(NamedTuple):
    figure: Figure

class Rule(Component):
    pass

@component("same.rule", version="1")
class Sum(Rule):
    plus: float = param(1.0, doc="x")
    def of(self, value): return value {sign} self.plus

class P(Params):
    {name}: float = param(1.0, doc="x")

@node("same.make", version="1")
def make(ctx: Context, *, p: P) -> Out:
    return Out(Figure(scaled(p.{name})))

@node("same.use", version="1")
def use(ctx: Context, figure: Figure, rule: Rule) -> Out:
    return Out(Figure(rule.of(figure.value)))
"""
GRAPH = """
name: g
nodes:
  a: {{type: same.make, {name}: 3}}
  rule: {{type: same.rule, plus: 1}}
  b: {{type: same.use, figure: "@a.figure", rule: "@rule"}}
outputs: {{b: "@b.figure"}}
"""
PACKS = {"left_pack": ("width", "+", 10), "right_pack": ("height", "-", 100)}
VALUES = {"left_pack": 31.0, "right_pack": 299.0}


@pytest.fixture
def packs_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    for pack, (name, sign, factor) in PACKS.items():
        home = tmp_path / pack
        home.mkdir()
        (home / "__init__.py").touch()
        (home / "helpers.py").write_text(f"def scaled(x):\n    return x * {factor}\n")
        (home / "nodes.py").write_text(NODES.format(pack=pack, name=name, sign=sign))
        (tmp_path / f"{pack}.yaml").write_text(GRAPH.format(name=name))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in [name for name in sys.modules if name.partition(".")[0] in PACKS]:
        del sys.modules[name]


def run(session: Session, home: Path, pack: str, store: Path, backend: Any = None) -> tuple[dict[str, str], float]:
    """The states of a run of the pack's graph, and the value of its output, read back by the session."""
    graph = session.check(home / f"{pack}.yaml", store=store)
    folder = RunFolder(home / f"runs_{pack}", graph.name)
    opened = session.open_store(store)
    try:
        record = Runner(graph, opened, folder, lambda event: None, backend=backend).run()
    finally:
        folder.close()
    stored = record["nodes"][-1]["outputs"]["figure"]
    with session:
        value: Any = opened.load(artifact_types()[stored["type"]], stored["digest"])
    return {row["name"]: row["state"] for row in record["nodes"]}, value.value


def test_two_sessions_with_packs_that_use_the_same_names(packs_there: Path) -> None:
    sessions = {pack: Session([pack]) for pack in PACKS}
    for pack, session in sessions.items():  # interleaved: each step for both before the next
        assert set(session.types) == {"same.make", "same.use", "same.rule"}
        assert session.types["same.make"].origin == f"{pack}.nodes.make"
    for state in ("done", "hit"):
        for pack, session in sessions.items():
            states, value = run(session, packs_there, pack, packs_there / f"store_{pack}")
            assert (set(states.values()), value) == ({state}, VALUES[pack])
    with pytest.raises(GraphErrors, match="no parameter 'width'"):
        sessions["right_pack"].check(packs_there / "left_pack.yaml")
    for pack, session in sessions.items():
        steps = plan(session.check(packs_there / f"{pack}.yaml"), session.store)
        assert [step.state for step in steps] == ["hit", "hit"]
        assert session.store.root.name == f"store_{pack}"
    assert not {"same.make", "same.use"} & set(current().types)
    assert "Figure" not in artifact_types()  # of the default session, which neither pack belongs to


def test_a_session_may_take_a_pack_that_another_one_imported(packs_there: Path) -> None:
    first, second = Session(["left_pack"]), Session(["left_pack.nodes"])
    assert first.types["same.make"] is second.types["same.make"]
    both = Session(["left_pack", "right_pack"]).packs()
    assert "registered twice" in both.broken["right_pack.nodes"]
    with both, pytest.raises(StoreError, match="two artifact classes are called 'Figure'"):
        artifact_types()


def test_one_store_two_sessions(packs_there: Path) -> None:
    """What one session stored under a type name is no hit of the other, whose code it is not."""
    for pack in (*PACKS, *PACKS):
        _, value = run(Session([pack]), packs_there, pack, packs_there / "store")
        assert value == VALUES[pack]


def test_two_threads(packs_there: Path) -> None:
    results: dict[str, list[Any]] = {pack: [] for pack in PACKS}
    start = threading.Barrier(2)

    def work(pack: str) -> None:
        session = Session([pack])
        start.wait()
        for turn in range(4):
            results[pack].append(run(session, packs_there, pack, packs_there / f"store_{pack}_{turn}")[1])
            with session:
                assert current_session() is session

    threads = [threading.Thread(target=work, args=(pack,)) for pack in PACKS]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == {pack: [VALUES[pack]] * 4 for pack in PACKS}


@pytest.mark.thorough
def test_worker_processes_load_the_packs_of_the_session(packs_there: Path) -> None:
    for pack in PACKS:
        states, value = run(Session([pack]), packs_there, pack, packs_there / "store", Local(1))
        assert (set(states.values()), value) == ({"done"}, VALUES[pack])


@pytest.mark.thorough
def test_a_worker_gets_types_of_modules_that_were_imported_by_hand(packs_there: Path) -> None:
    """In a process of its own: what it imports without a pack is in its default session."""
    code = f"""
import left_pack.nodes
from pathlib import Path
from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import Runner
from exmesh_graph.graph.session import current_session
home, session = Path({str(packs_there)!r}), current_session()
graph = session.check(home / "left_pack.yaml")
runs = RunFolder(home / "r", "g")
record = Runner(graph, session.open_store(home / "s"), runs, lambda e: None, backend=Local(1)).run()
print(record["state"])
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=packs_there, capture_output=True, text=True, check=False)
    assert done.stdout == "done\n", done.stderr


def test_declarations_go_to_the_current_session() -> None:
    session, outer = Session([]), current_session()
    before = dict(current().types)
    with session:
        assert current_session() is session

        @node("here.only", version="1")
        def here(ctx: Any) -> Any:
            """Nothing."""

    assert session.types["here.only"].function is here
    assert current().types == before
    assert current_session() is outer
    with session, Session([]) as inner:
        assert current_session() is inner


def test_caches_belong_to_the_session(packs_there: Path, tmp_path: Path) -> None:
    """An edit that one session has not seen yet is what a later one keys by; neither changes the other."""
    first = Session(["left_pack"])
    definition: NodeDef = first.types["same.make"]
    with first:
        before = fp.fingerprint(definition).digest
    (packs_there / "left_pack" / "helpers.py").write_text("def scaled(x):\n    return x * 11\n")
    with Session(["left_pack"]) as second:
        after = fp.fingerprint(second.types["same.make"]).digest
    with first:
        assert fp.fingerprint(definition).digest == before != after
        assert fp.sources_changed(definition) == ["left_pack.helpers"]
    with Packs() as packs:
        assert packs.library_version("numpy")
    assert packs.parts.keys() != first.packs().parts.keys()


def test_the_default_store_follows_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXMESH_STORE", str(tmp_path / "there"))
    session = Session([])
    assert session.store.root == tmp_path / "there"
    assert session.open_store(tmp_path / "other") is session.store
