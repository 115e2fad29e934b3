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


def test_view_writes_one_page_beside_the_asset(exmesh: Callable[..., Any], tmp_path: Path) -> None:
    write_usd(tmp_path / "out", small_asset())
    shown = exmesh("view", "out", "--no-open", "--light", "out/env.exr").stdout
    assert shown.strip() == str(tmp_path / "out" / "view.html")
    page = (tmp_path / "out" / "view.html").read_text()
    assert '"name": "env"' in page
    assert exmesh("view", "out/scene.usda", "--no-open", "--out", "page.html").stdout.strip().endswith("page.html")
    assert "no USD package" in exmesh("view", ".", "--no-open", code=1).stderr
    assert "no dome light" in exmesh("view", "out/asset.usda", "--no-open", code=1).stderr
