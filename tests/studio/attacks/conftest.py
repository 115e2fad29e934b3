"""A server that is attacked: each test ends with it answering as before, and the graph as it was."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from exmesh_graph.studio.workspace import Workspace
from tests.studio.conftest import HOST, made_in, opened


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:
        yield made_in(tmp_path_factory.mktemp("attacked"), patch)


@pytest.fixture(scope="module")
def workspace(home: Path) -> Iterator[Workspace]:
    made = Workspace(home / "graphs" / "small.yaml", store=home / ".exmesh", runs=home / "runs")
    yield made
    made.close()


@pytest.fixture(scope="module")
def open_client(workspace: Workspace) -> Iterator[TestClient]:
    with opened(workspace) as browser:
        yield browser


@pytest.fixture
def client(open_client: TestClient) -> Iterator[TestClient]:
    """A browser with the cookie; after the attack the server answers it as before, and the graph is as it was."""
    headers = dict(open_client.headers)
    yield open_client
    open_client.headers.clear()
    open_client.headers.update(headers)
    told = open_client.post("/api/open", json={"file": "small.yaml", "discard": True})
    assert told.status_code == 200
    assert (told.json()["name"], told.json()["ops"]) == ("small", [])


@pytest.fixture
def folder(home: Path) -> Iterator[Path]:
    """The working folder, which is swept afterwards."""
    yield home
    for path in home.rglob("*"):
        if (path.is_symlink() or not path.is_dir()) and path.name != "small.yaml" and ".exmesh" not in path.parts:
            path.unlink()
    shutil.rmtree(home / "runs", ignore_errors=True)


@pytest.fixture
def stranger(open_client: TestClient) -> TestClient:
    """A client of the same server that has no cookie."""
    return TestClient(open_client.app, base_url=f"http://{HOST}", follow_redirects=False)
