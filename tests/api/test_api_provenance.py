"""Where a run comes from, and what differs between two."""

from __future__ import annotations

import getpass
import json
import platform
import subprocess
from pathlib import Path

import pytest

import exmesh_graph as ex
from exmesh_graph.api.provenance import commit_of, differences, sign_assets
from exmesh_graph.export.packing import write_usdz
from exmesh_graph.export.stamp import stamp_usd
from exmesh_graph.export.usd.package import package_rules

GRAPH = "nodes: {one: {type: toy.const}}\n"


def git(folder: Path, *words: str) -> str:
    own = ["-c", "user.name=a", "-c", "user.email=a@b"]
    return subprocess.run(["git", *own, *words], cwd=folder, check=True, capture_output=True, text=True).stdout.strip()


def test_a_run_tells_commit_libraries_machine_and_command(folder: Path) -> None:
    (folder / "graph.yaml").write_text(GRAPH)
    git(folder, "init", "-q")
    git(folder, "add", "graph.yaml")
    git(folder, "commit", "-q", "-m", "a")
    first = ex.run("graph.yaml", workers=0, report=False)
    told = first.record["provenance"]
    assert told["project"] == {"commit": git(folder, "rev-parse", "HEAD"), "dirty": False}
    assert told["command"] == "exmesh run graph.yaml --workers 0"
    assert told["libraries"]["numpy"] != "not installed"
    assert told["machine"]["processor"]
    assert json.loads((first.folder / "provenance.json").read_text()) == told
    assert told["by"] == ""
    assert json.loads((first.folder / "run.json").read_text())["provenance"] == told
    (folder / "graph.yaml").write_text(GRAPH + "# a change\n")
    second = ex.run("graph.yaml", workers=0, report=False)
    assert second.record["provenance"]["project"]["dirty"] is True
    assert second["one"].info["state"] == "hit"  # none of it is in a key
    commit = told["project"]["commit"][:12]
    assert f"project commit: {commit} -> {commit} (with changes)" in str(ex.diff(first, second))
    assert "commit" not in str(ex.diff(first, first))


def test_what_differs_is_said_once_and_older_runs_say_nothing(folder: Path) -> None:
    old = {"machine": {"processor": "A", "torch": "2.4"}, "libraries": {"numpy": "1"}, "gpus": [], "command": "x"}
    new = {"machine": {"processor": "B", "torch": "2.4"}, "libraries": {"numpy": "2"}, "gpus": ["C"], "command": "y"}
    assert list(differences(old, new)) == ["processor: A -> B", "numpy: 1 -> 2", "gpus: none -> C"]
    assert commit_of(folder) == {}


def test_nothing_public_names_a_user_a_machine_or_a_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(getpass, "getuser", lambda: "anna-login")
    monkeypatch.setattr(platform, "node", lambda: "annas-host")
    (folder / "anna-home").mkdir()
    (folder / "anna-home" / "graph.yaml").write_text(GRAPH)
    done = ex.run(folder / "anna-home" / "graph.yaml", store=folder / "anna-home" / "kept", workers=0, report=False)
    told = (done.folder / "provenance.json").read_text()
    assert json.loads(told)["command"] == "exmesh run graph.yaml --store kept --workers 0"
    assert "anna" not in told
    monkeypatch.setenv("EXMESH_AUTHOR", "Anna, of the lab")
    again = ex.run(folder / "anna-home" / "graph.yaml", workers=0, report=False)
    assert json.loads((again.folder / "provenance.json").read_text())["by"] == "Anna, of the lab"


def test_a_published_usd_says_where_it_comes_from(folder: Path, tmp_path: Path) -> None:
    from pxr import Sdf, Usd

    home, root = tmp_path / "asset", '#usda 1.0\n(\n    defaultPrim = "a"\n    upAxis = "Y"\n)\n\ndef Xform "a"\n{\n}\n'
    home.mkdir()
    (home / "asset.usda").write_text(root)
    (home / "scene.usda").write_text("#usda 1.0\n(\n    subLayers = [@./asset.usda@]\n)\n")
    write_usdz(home / "asset.usdz", [(name, home / name) for name in ("scene.usda", "asset.usda")])
    before = (home / "asset.usda").read_bytes()
    record = {
        "id": "r",
        "published": {"asset": "asset/asset.usdz"},
        "provenance": {
            "project": {"commit": "c0", "dirty": True},
            "exmesh_graph": {"version": "1"},
            "libraries": {"usd-core": "25"},
            "machine": {"processor": 'A "fast" one'},
            "gpus": [],
            "by": "",
            "command": "exmesh run /home/anna/g.yaml",
        },
    }
    sign_assets(tmp_path, record)
    for name in ("asset.usda", "scene.usda", "asset.usdz"):
        told = Sdf.Layer.FindOrOpen(str(home / name)).customLayerData["exmesh_graph"]
        assert told["project"] == {"commit": "c0", "dirty": True}
        assert told["libraries"] == {"usd-core": "25"}
        assert told["machine"]["processor"] == 'A "fast" one'
        assert (told["command"], told["run"]) == ("exmesh run g.yaml", "r")
    assert Usd.Stage.Open(str(home / "asset.usdz")).GetPrimAtPath("/a")
    assert list(package_rules(home / "asset.usdz")) == []
    assert b"def Xform" in (home / "asset.usda").read_bytes() != before
    assert stamp_usd(home, {"x": "y"}) == []  # once
