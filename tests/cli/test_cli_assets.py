"""check-usd: text, JSON and exit codes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.export.usd import write_usd
from exmesh_graph.types import Asset


def small_asset() -> Asset:
    """One triangle in two colours."""
    return Asset(
        vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32),
        faces=np.array([[0, 1, 2]], np.int32),
        uvs=np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]], np.float32),
        uv_faces=np.array([[0, 1, 2]], np.int32),
        texture=np.zeros((4, 4, 3), np.float32),
        base_color=np.full((4, 4, 3), 0.5, np.float32),
        roughness=np.full((4, 4), 0.5, np.float32),
        seen=np.ones((4, 4), bool),
        environment=np.ones((2, 4, 3), np.float32),
    )


def test_good_and_broken_files(exmesh: Callable[..., Any], tmp_path: Path) -> None:
    write_usd(tmp_path / "out", small_asset())
    good = exmesh("check-usd", "out/scene.usda", "out/asset.usdz").stdout
    assert "2 files, 0 errors, 0 warnings" in good
    text = (tmp_path / "out" / "mtl.usda").read_text()
    (tmp_path / "out" / "mtl.usda").write_text(text.replace('sourceColorSpace = "sRGB"', 'sourceColorSpace = "raw"'))
    told = exmesh("check-usd", "out/asset.usda", code=1).stdout
    assert "error colorSpace at /asset/mtl/surface/base_color" in told
    found = json.loads(exmesh("check-usd", "--json", "out/asset.usda", "none.usdc", code=1).stdout)
    assert [(entry["file"], entry["rule"]) for entry in found] == [
        ("out/asset.usda", "colorSpace"),
        ("none.usdc", "open"),
    ]


def test_what_is_no_usd_is_told_and_never_a_traceback(exmesh: Callable[..., Any], tmp_path: Path) -> None:
    write_usd(tmp_path / "out", small_asset())
    whole = (tmp_path / "out" / "asset.usdz").read_bytes()
    (tmp_path / "text.txt").write_text("no stage")
    (tmp_path / "text.usda").write_text("no stage")
    (tmp_path / "cut.usdz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "headless.usdz").write_bytes(whole[100:])
    (tmp_path / "empty.usdz").touch()
    (tmp_path / "cut.usdc").write_bytes((tmp_path / "out" / "geo.usdc").read_bytes()[:-50])
    for file, rule, told in (
        ("none.usda", "open", "does not exist"),
        ("out", "open", "this is a folder: give asset.usdz"),
        ("text.txt", "open", "USD cannot read it"),
        ("text.usda", "open", "USD cannot read it"),
        ("cut.usdz", "package", "not a whole zip archive"),
        ("headless.usdz", "package", ""),
        ("empty.usdz", "package", "not a whole zip archive"),
        ("cut.usdc", "open", "USD cannot read it"),
    ):
        done = exmesh("check-usd", file, "--json", code=1)
        problems = json.loads(done.stdout)
        assert any(p["rule"] == rule and told in p["what"] for p in problems), (file, problems)
        assert "Traceback" not in done.stderr
        if file != "out":  # `view` takes folders
            shown = exmesh("view", file, "--no-open", code=1).stderr
            assert "Traceback" not in shown
            assert file in shown


def test_view_writes_one_page_beside_the_asset(exmesh: Callable[..., Any], tmp_path: Path) -> None:
    write_usd(tmp_path / "out", small_asset())
    shown = exmesh("view", "out", "--no-open", "--light", "out/env.exr").stdout
    assert shown.strip() == str(tmp_path / "out" / "view.html")
    page = (tmp_path / "out" / "view.html").read_text()
    assert '"name": "env"' in page
    assert exmesh("view", "out/scene.usda", "--no-open", "--out", "page.html").stdout.strip().endswith("page.html")
    assert "no USD package" in exmesh("view", ".", "--no-open", code=1).stderr
    assert "no dome light" in exmesh("view", "out/asset.usda", "--no-open", code=1).stderr
