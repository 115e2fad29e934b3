"""Looks at artifacts: pictures, models in levels, tables, and that nothing else of the disk can be had."""

from __future__ import annotations

import functools
import json
import struct
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from exmesh_graph.gallery.levels import Level, clustered, levels_of, model_level
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.studio.artifacts.shelf import Shelf
from exmesh_graph.studio.workspace import Workspace
from exmesh_graph.types import Artifact, Asset, Carrier, Files, Metrics, Views


def grid(cells: int) -> dict[str, Any]:
    """A square sheet in space and in the atlas."""
    x, y = np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(0, 1, cells + 1))
    at = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = at[:-1, :-1].ravel(), at[:-1, 1:].ravel(), at[1:, 1:].ravel(), at[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    flat = np.stack([x.ravel(), y.ravel()], 1).astype(np.float32)
    points = np.concatenate([flat - 0.5, 0 * flat[:, :1]], axis=1)
    return {"vertices": points, "faces": faces, "uvs": flat, "uv_faces": faces.copy(),
            "texture": np.full((64, 64, 3), 0.5, np.float32)}  # fmt: skip


def asset(cells: int = 4, side: int = 64) -> Asset:
    one = np.ones((side, side), np.float32)
    return Asset(**grid(cells), base_color=np.full((side, side, 3), 0.2, np.float32), roughness=0.5 * one,
                 seen=one > 0, environment=np.ones((8, 16, 3), np.float32))  # fmt: skip


def stored(workspace: Workspace, value: Artifact) -> str:
    store = workspace.store()
    with store.attempt() as attempt:
        return str(store.put(value, attempt).digest)


def document(data: bytes) -> dict[str, Any]:
    (length,) = struct.unpack_from("<I", data, 12)
    return dict(json.loads(data[20 : 20 + length]))


def test_the_first_level_of_a_large_mesh_is_small_and_keeps_its_shape() -> None:
    sheet = Carrier(**grid(150))
    assert [(level.faces, level.side) for level in levels_of(sheet)] == [(20_000, 0), (0, 0)]
    coarse = clustered(sheet, 5_000)
    assert 2_000 < len(coarse.faces) < 10_000
    assert isinstance(coarse, Carrier)
    corners, flat = coarse.vertices[coarse.faces], coarse.uvs[coarse.uv_faces]
    assert np.abs(corners[..., :2] + 0.5 - flat).max() < 1e-5  # the map from the atlas to space is kept


def test_a_model_stands_where_the_mesh_does() -> None:
    data, faces = model_level(Carrier(**grid(4)), Level(0, 0))
    told = document(data)
    assert faces == 32
    assert told["nodes"][0]["translation"] == [-0.5, -0.5, 0.0]
    assert told["nodes"][0]["scale"] == [1.0, 1.0, 1.0]
    assert told["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}
    whole = document(model_level(asset(), Level(0, 0))[0])
    assert "metallicRoughnessTexture" in whole["materials"][0]["pbrMetallicRoughness"]
    assert whole["scenes"][0]["extras"]["light"]["width"] == 64 // 4  # the asset's own, beside it


def test_looks_of_an_asset(client: TestClient, workspace: Workspace) -> None:
    digest = stored(workspace, asset())
    told = client.get("/api/artifact", params={"digest": digest}).json()
    assert [show["kind"] for show in told["shows"]] == ["model", "picture", "maps", "environment", "viewer", "facts"]
    for path, query in (
        ("model", {"level": 0}), ("picture", {"show": "maps", "name": "roughness", "size": 32}),
        ("picture", {"show": "atlas", "layer": "stretch", "size": 128}), ("environment", {"width": 16}),
        ("picture", {"show": "environment", "size": 16}),
    ):  # fmt: skip
        answer = client.get(f"/api/artifact/{path}", params={"digest": digest, **query})
        assert answer.status_code == 200, answer.text
        assert "immutable" in answer.headers["cache-control"]
    again = client.get("/api/artifact/model", params={"digest": digest}, headers={"if-none-match": f'"{digest[:40]}"'})
    assert again.status_code == 304


def test_views_are_read_one_by_one(client: TestClient, workspace: Workspace) -> None:
    count, height, width = 3, 20, 30
    alpha = np.zeros((count, height, width), np.float32)
    alpha[:, 5:15, 5:15] = 1
    views = Views(
        names=("a", "b", "<script>"), images=alpha[..., None] * np.float32([1, 0, 0]), alpha=alpha,
        intrinsics=np.tile(np.eye(3), (count, 1, 1)), camera_to_world=np.tile(np.eye(4), (count, 1, 1)), split="train",
    )  # fmt: skip
    digest = stored(workspace, views)
    told = client.get("/api/artifact", params={"digest": digest}).json()
    assert told["shows"][0]["names"][2] == "<script>"
    sheet = client.get("/api/artifact/contact", params={"digest": digest, "size": 16})
    assert int(sheet.headers["x-columns"]) * int(sheet.headers["x-rows"]) >= count
    mask = client.get("/api/artifact/picture", params={"digest": digest, "layer": "mask", "index": 2})
    assert mask.headers["content-type"] == "image/png"
    assert client.get("/api/artifact/picture", params={"digest": digest, "index": 3}).status_code == 404
    assert len(client.get("/api/artifact/cameras", params={"digest": digest}).json()["cameras"]) == count


def test_figures_and_histories(client: TestClient, workspace: Workspace) -> None:
    values = {"headline": [{"label": "PSNR", "value": 30.0}], "history": {"iteration": [1, 2], "psnr": [20.0, 30.0]},
              "decisions": [{"name": "metallic", "value": False, "reason": "no"}]}  # fmt: skip
    digest = stored(workspace, Metrics(values))
    kinds = [s["kind"] for s in client.get("/api/artifact", params={"digest": digest}).json()["shows"]]
    assert kinds == ["figures", "table", "curves", "facts"]
    curves = client.get("/api/artifact/curves", params={"digest": digest}).json()["curves"]
    assert curves == [{"name": "psnr", "axis": "iteration", "x": [1.0, 2.0], "y": [20.0, 30.0]}]
    assert client.get("/api/artifact/table", params={"digest": digest}).json()["columns"] == ["name", "value", "reason"]


@pytest.mark.thorough
@pytest.mark.parametrize("path", ["../../artifact.json", "/etc/passwd", "..%2f..%2fartifact.json", "link", "a\0b"])
def test_files_of_an_artifact_and_nothing_else(
    client: TestClient, workspace: Workspace, tmp_path: Path, path: str
) -> None:
    home = tmp_path / "files"
    home.mkdir()
    (home / "page.html").write_text("<script>alert(1)</script>")
    digest = stored(workspace, Files(root=home, main="page.html"))
    folder = workspace.store().data(digest) / "files"
    (folder / "link").symlink_to("/etc/passwd")
    good = client.get("/api/artifact/file", params={"digest": digest, "path": "page.html"})
    if good.status_code == 200:  # a store that sees the link first takes the artifact away, which is right as well
        assert good.headers["content-type"] == "application/octet-stream"
        assert good.headers["content-disposition"].startswith("attachment")
    assert client.get("/api/artifact/file", params={"digest": digest, "path": path}).status_code == 404


def test_what_is_made_reads_its_value_while_others_are_made(tmp_path: Path) -> None:
    """More looks at once than there are turns, each of a value that nobody has read: they waited for one another."""
    store = Store(tmp_path)
    with store.attempt() as attempt:
        digests = [store.put(Metrics({"n": n}), attempt).digest for n in range(6)]
    shelf, reads = Shelf(lambda: store), Counter[str]()

    def make(digest: str) -> bytes:
        time.sleep(0.05)
        reads[digest] += 1
        return shelf.value(digest).type_name.encode()

    asked = [
        threading.Thread(target=shelf.made, args=(d, functools.partial(make, d)), daemon=True) for d in 2 * digests
    ]
    for one in asked:
        one.start()
    for one in asked:
        one.join(10)
    assert not any(one.is_alive() for one in asked)
    assert set(reads.values()) == {1}, "each is made once"
