"""The export node: a validated asset, its warnings, and a refusal to hand out a bad one."""

import numpy as np
import pytest
from exmesh_nodes import export

from exmesh_graph.errors import DataError
from exmesh_graph.io import usd as usd_io
from exmesh_graph.types import Frame, UsdAsset


def test_the_exported_files_survive_the_store(scene, context, tmp_path):
    out = export.usd(context, scene.asset, Frame(np.diag([3.0, 3, 3, 1]), np.eye(4)), p=export.UsdParams())
    assert isinstance(out.files, UsdAsset)
    assert out.files.main == "asset.usdz"
    (tmp_path / "kept").mkdir()
    out.files.save(tmp_path / "kept")
    back = UsdAsset.load(tmp_path / "kept")
    contents = usd_io.read_usd(back.root / back.main)
    np.testing.assert_allclose(contents.points, 3 * scene.asset.vertices, rtol=1e-6)
    names = {str(path.relative_to(back.root)) for path in back.root.rglob("*") if path.is_file()}
    assert {"asset.usdz", "asset.usdc", "scene.usda", "env.exr", "textures/base_color.png"} <= names
    assert "report.json" not in names  # the run keeps its own file of that name beside the published asset
    assert any("metric scale" in warning for warning in context.warnings)


def test_a_validation_error_fails_the_node(scene, context, monkeypatch):
    problem = usd_io.Problem("error", "colorSpace", "/scene", "wrong")
    monkeypatch.setattr(usd_io, "validate_usd", lambda path: [problem])
    with pytest.raises(DataError, match="colorSpace at /scene: wrong"):
        export.usd(context, scene.asset, p=export.UsdParams())


def test_a_validation_warning_is_passed_on_once(scene, context, monkeypatch):
    problem = usd_io.Problem("warning", "stMirrored", "/scene", "3 faces")
    monkeypatch.setattr(usd_io, "validate_usd", lambda path: [problem])
    export.usd(context, scene.asset, p=export.UsdParams())
    assert sum("stMirrored" in warning for warning in context.warnings) == 1


def test_raised_roughness_and_a_missing_frame_are_told(scene, context):
    export.usd(context, scene.asset, p=export.UsdParams(roughness_floor=0.6))
    assert any("no frame is wired in" in warning for warning in context.warnings)
    assert any("roughness floor 0.6" in warning for warning in context.warnings)
