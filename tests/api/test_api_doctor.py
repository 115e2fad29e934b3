"""doctor tries things and names what is missing, what that costs, and the fix."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.api import doctor
from exmesh_graph.api.doctor import FAIL, OK, WARN, Finding, examine
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import Packs, load_packs


@pytest.fixture
def packs(folder: Path) -> Packs:
    return load_packs()


@pytest.fixture(autouse=True)
def no_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_gpu", lambda: Finding(OK, "GPU", "not looked at"))


def findings(store: Path, packs: Packs, shared: str | None = None) -> dict[str, Finding]:
    return {finding.what: finding for finding in examine(Store(store, shared), packs)}


@pytest.mark.thorough
def test_a_sound_machine(tmp_path: Path, packs: Packs) -> None:
    shown = findings(tmp_path / "not" / "there", packs)
    assert {f.what: f.state for f in shown.values() if f.what.startswith("store")} == {
        "store, rename": OK, "store, fsync": OK, "store, locks": OK, "store, file times": OK,
    }  # fmt: skip
    assert "Python 3" in shown["version"].found
    assert list(tmp_path.iterdir()) == []
    assert all(f.fix for f in shown.values() if f.state != OK)


@pytest.mark.thorough
def test_file_systems_that_lack_something(tmp_path: Path, packs: Packs, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", lambda *_: None)
    monkeypatch.setattr(os, "rename", refuse)
    monkeypatch.setattr(doctor, "sync", refuse)
    shown = findings(tmp_path, packs)
    assert {name: shown[f"store, {name}"].state for name in ("rename", "fsync", "locks")} == {
        "rename": FAIL, "fsync": FAIL, "locks": WARN,
    }  # fmt: skip
    assert "a lock can be taken twice" in shown["store, locks"].found
    assert "fix: " in str(shown["store, rename"])


@pytest.mark.thorough
def test_a_store_that_may_only_be_read(tmp_path: Path, packs: Packs, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> str:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(doctor.tempfile, "mkdtemp", refuse)
    finding = findings(tmp_path, packs)["store"]
    assert finding.state == FAIL
    assert "Read-only file system" in finding.found


@pytest.mark.thorough
@pytest.mark.parametrize(("free", "state"), [(10**7, FAIL), (10**9, WARN), (10**12, OK)])
def test_free_space(tmp_path: Path, packs: Packs, monkeypatch: pytest.MonkeyPatch, free: int, state: str) -> None:
    class Usage:
        pass

    Usage.free = free  # type: ignore[attr-defined]
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _: Usage)
    assert findings(tmp_path, packs)["free space"].state == state


@pytest.mark.thorough
def test_missing_libraries_name_their_nodes(tmp_path: Path, packs: Packs, monkeypatch: pytest.MonkeyPatch) -> None:
    real = doctor._there
    monkeypatch.setattr(doctor, "_there", lambda module: module not in ("xatlas", "ray") and real(module))
    shown = findings(tmp_path, packs)
    assert shown["library xatlas"].state == WARN
    assert "uv.xatlas_regen" in shown["library xatlas"].found
    assert "pip install xatlas" in str(shown["library xatlas"])
    assert shown["library ray"].state == OK
    assert "optional" in shown["library ray"].found
    assert not any("toy_pack" in what or "exmesh" in what for what in shown)


def test_broken_packs_and_system_libraries(tmp_path: Path, packs: Packs, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "SYSTEM", {"libnothere.so.1": "nothere"})
    broken = Packs()
    broken.broken["pack.module"] = "SyntaxError: x"
    shown = findings(tmp_path, broken)
    assert shown["node pack"].state == shown["node types"].state == FAIL
    assert "apt-get install nothere" in str(shown["libnothere.so.1"])


@pytest.mark.thorough
def test_a_shared_store_out_of_reach(tmp_path: Path, packs: Packs) -> None:
    pytest.importorskip("fsspec")
    (tmp_path / "file").write_text("x")
    assert findings(tmp_path / "s", packs, str(tmp_path / "file" / "x"))["shared store"].state == WARN
    assert findings(tmp_path / "s", packs, str(tmp_path / "y"))["shared store"].state == OK
