"""Where a run comes from, and what differs between two."""

from __future__ import annotations

import getpass
import hashlib
import json
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import exmesh_graph as ex
from exmesh_graph.api.prov_export import prov_text
from exmesh_graph.api.provenance import commit_of, differences, sign_assets
from exmesh_graph.cli.app import app
from exmesh_graph.errors import ExmeshError
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


def test_a_run_as_w3c_prov(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Written, read back by the library; two runs that share a result name it alike."""
    model = pytest.importorskip("prov.model")
    (folder / "number.txt").write_text("5")
    (folder / "graph.yaml").write_text(
        "nodes:\n  a: {type: toy.file, path: number.txt}\n  b: {type: toy.shift, number: '@a.number', by: 2.5}\n"
    )
    first = ex.run("graph.yaml", workers=0, report=False)
    second = ex.run("graph.yaml", set={"b.by": 3}, workers=0, report=False)
    found = {}
    for run in (first, second):
        out = folder / f"{run.id}.json"
        done = CliRunner().invoke(app, ["prov", str(run.folder), "-o", str(out)])
        assert done.exit_code == 0, done.output
        assert str(folder) not in out.read_text()
        document = model.ProvDocument.deserialize(str(out))
        assert document == model.ProvDocument.deserialize(content=document.serialize())
        found[run.id] = json.loads(out.read_text())
    told, again = found.values()
    keys = {name: f"exmesh:action/{first[name].info['key']}" for name in "ab"}
    assert told["activity"].keys() == {*keys.values(), f"exmesh:run/{first.id}"}
    assert told["activity"][keys["b"]]["exmesh:param.by"] == {"$": "2.5", "type": "xsd:double"}
    used = {(one["prov:activity"], one["prov:entity"]) for one in told["used"].values()}
    number = f"exmesh:artifact/{first['a'].info['outputs']['number']['digest']}"
    source = hashlib.sha256(b"5").hexdigest()
    assert used == {(keys["a"], f"exmesh:file/{source}"), (keys["b"], number)}
    made = {(one["prov:entity"], one["prov:activity"]) for one in told["wasGeneratedBy"].values()}
    assert (number, keys["a"]) in made
    assert len(told["wasStartedBy"]) == 2
    assert keys["a"] in again["activity"], "a hit is the same activity"
    assert keys["b"] not in again["activity"]
    assert len(again["wasStartedBy"]) == 1
    shutil.rmtree(first.store.root / "actions")
    by_wires = json.loads(prov_text(ex.open_run(first.folder)))
    assert {(one["prov:activity"], one["prov:entity"]) for one in by_wires["used"].values()} == {(keys["b"], number)}
    for name, words in (("a.txt", "is not written as"), ("a.provn", "")):
        done = CliRunner().invoke(app, ["prov", str(second.folder), "-o", str(folder / name)])
        assert words in done.output or words in str(done.exception)
    assert (folder / "a.provn").read_text().startswith("document")
    monkeypatch.setitem(sys.modules, "prov.model", None)
    with pytest.raises(ExmeshError, match="prov is not installed"):
        prov_text(second)
