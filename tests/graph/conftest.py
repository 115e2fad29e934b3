"""The toy node pack and a small workbench: write a graph, check it, run it in a temporary store."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import Packs, load_packs
from exmesh_graph.graph.declare.ports import artifact_types
from exmesh_graph.graph.language.check import Checked, check_file
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import Runner

TOY = Path(__file__).parent / "toy"


@pytest.fixture(scope="session")
def packs() -> Iterator[Packs]:
    sys.path.insert(0, str(TOY))
    found = load_packs()
    assert "toy.const" in found.types, found.broken
    yield found
    sys.path.remove(str(TOY))


@dataclass
class Bench:
    """One temporary project folder."""

    root: Path
    packs: Packs
    events: list[Mapping[str, Any]] = field(default_factory=list)

    @property
    def store(self) -> Store:
        return Store(self.root / "store")

    def write(self, text: str, name: str = "graph.yaml") -> Path:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    def check(self, text: str, *sets: str) -> Checked:
        return check_file(self.write(text), sets, self.packs)

    def problems(self, text: str, *sets: str) -> list[Any]:
        with pytest.raises(GraphErrors) as caught:
            self.check(text, *sets)
        return list(caught.value.problems)

    def run(self, text: str, *sets: str, idle: bool = True, **options: Any) -> dict[str, Any]:
        """Run a graph, by default with the nodes that nothing needs."""
        graph = self.check(text, *sets)
        graph = graph.with_idle() if idle else graph
        folder = RunFolder(self.root / "runs", graph.name)
        self.events.clear()
        try:
            return Runner(graph, self.store, folder, self.events.append, command="exmesh run", **options).run()
        finally:
            folder.close()

    def value(self, record: Mapping[str, Any], node: str, port: str = "number") -> Any:
        row = next(row for row in record["nodes"] if row["name"] == node)
        stored = row["outputs"][port]
        loaded = self.store.load(artifact_types()[stored["type"]], stored["digest"])
        assert loaded is not None
        return getattr(loaded, "value", loaded)


def states(record: Mapping[str, Any]) -> dict[str, str]:
    return {row["name"]: row["state"] for row in record["nodes"]}


@pytest.fixture
def bench(tmp_path: Path, packs: Packs) -> Bench:
    return Bench(tmp_path, packs)


@pytest.fixture(name="states")
def states_fixture() -> Any:
    return states
