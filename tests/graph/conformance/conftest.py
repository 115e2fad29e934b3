"""Every backend under one name: `backend` makes the one under test for a store."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run.backends import Backend, Inline
from exmesh_graph.graph.run.backends.local import Local

TOY = Path(__file__).parent.parent / "toy"
RAY = [pytest.mark.ray, pytest.mark.slow]


@pytest.fixture(scope="session")
def ray_cluster() -> Iterator[Any]:
    """A Ray of two cpus on this machine, shared by the tests; runs leave it alone since they did not start it."""
    ray = pytest.importorskip("ray", reason="Ray is not installed (pip install 'exmesh-graph[ray]')")
    before = os.environ.get("PYTHONPATH", "")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(TOY), before]))  # for its workers
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False, object_store_memory=80 * 2**20)
    yield ray
    ray.shutdown()
    os.environ["PYTHONPATH"] = before


@pytest.fixture(params=["inline", "local", pytest.param("ray", marks=RAY)])
def kind(request: pytest.FixtureRequest) -> str:
    if request.param == "ray":
        request.getfixturevalue("ray_cluster")
    return str(request.param)


@pytest.fixture
def backend(kind: str) -> Iterator[Callable[[Store], Backend]]:
    made: list[Backend] = []

    def make(store: Store) -> Backend:
        if kind == "ray":
            from exmesh_graph.graph.run.backends.ray import RayCluster

            made.append(RayCluster(store))
        else:
            made.append(Local(2) if kind == "local" else Inline(store))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def run_on(bench: Any, backend: Callable[[Store], Backend]) -> Callable[..., Any]:
    """`run_on(text, ...)`: a run on the backend under test, two cpus at most."""

    def run(text: str, *sets: str, tokens: Any = None, **options: Any) -> Any:
        return bench.run(text, *sets, backend=backend(bench.store), tokens={"cpu": 2, **(tokens or {})}, **options)

    return run
