"""The export nodes: a judged asset with its provenance, its warnings, and a refusal to hand out a bad one."""

import shutil

import numpy as np
import pytest
from exmesh_nodes import export

from exmesh_graph.errors import DataError
from exmesh_graph.export.gltf import read_glb
from exmesh_graph.export.usd import Problem, read_usd, write
from exmesh_graph.types import Frame, Metrics, UsdAsset

FRAME = Frame(np.diag([3.0, 3, 3, 1]), np.eye(4))


def test_the_exported_files_survive_the_store(scene, context, tmp_path):
    scores = Metrics({"held_out": {"psnr": 30.5}})
    out = export.usd(context, scene.asset, FRAME, scene.train, metrics=scores, p=export.ExportSettings())
    assert isinstance(out.files, UsdAsset)
    assert out.files.main == "asset.usdz"
    (tmp_path / "kept").mkdir()
    out.files.save(tmp_path / "kept")
    back = UsdAsset.load(tmp_path / "kept")
    contents = read_usd(back.root / back.main)
    np.testing.assert_allclose(contents.points, 3 * scene.asset.vertices, rtol=1e-6)
    assert [camera.view for camera in contents.cameras] == list(scene.train.names)
    assert contents.custom_data["metrics"] == {"held_out_psnr": 30.5}
    assert contents.custom_data["key"] == context.key
    names = {str(path.relative_to(back.root)) for path in back.root.rglob("*") if path.is_file()}
    assert {"asset.usdz", "asset.usda", "geo.usdc", "scene.usda", "env.exr", "textures/base_color.png"} <= names
    assert "report.json" not in names  # the run keeps its own file of that name beside the published asset
    assert any("metric scale" in warning for warning in context.warnings)


@pytest.mark.parametrize("up", ["Y", "Z"])
def test_the_value_says_which_way_its_stage_is_up(scene, context, up):
    files = export.usd(context, scene.asset, FRAME, p=export.ExportSettings(up_axis=up)).files
    assert files.facets() == {"up": up.lower()}
    assert read_usd(files.root / files.main).up_axis == up
    assert "up" not in UsdAsset.conventions  # a port that takes any takes both


def test_a_scene_far_from_its_origin_is_told_of_and_can_be_recentred(scene, context):
    matrix = np.eye(4)
    matrix[:3, 3] = [3e5, 0, -5e6]  # a survey's coordinates
    for recentre in (False, True):
        settings = export.ExportSettings(recentre=recentre)
        files = export.usd(context, scene.asset, Frame(matrix, np.eye(4)), p=settings).files
        told = [warning for warning in context.warnings if "set `recentre`" in warning]
        contents = read_usd(files.root / files.main)
        moved = np.abs(contents.normalised(contents.points) - scene.asset.vertices).max()
        if recentre:
            assert told == []
            assert moved == 0
            assert contents.custom_data["recentred_by_z"] == -5e6
        else:
            assert len(told) == 1
            assert moved > 0.01
        context.warnings.clear()
        shutil.rmtree(files.root)


def test_levels_of_detail_are_wired_in(scene, context):
    out = export.usd(context, scene.asset, low=scene.asset, p=export.ExportSettings())
    read_usd(out.files.root / "asset.usda", {"lod": "low"})
    with pytest.raises(DataError, match="no variant lod=mid"):
        read_usd(out.files.root / "asset.usda", {"lod": "mid"})


def test_a_validation_error_fails_the_node(scene, context, monkeypatch):
    problem = Problem("colorSpace", "/scene", "wrong")
    monkeypatch.setattr(write, "validate_usd", lambda path, pictures: [problem])
    with pytest.raises(DataError, match="colorSpace at /scene: wrong"):
        export.usd(context, scene.asset, p=export.ExportSettings())
    assert list(context.scratch.iterdir()) == []


def test_a_validation_warning_is_passed_on_once(scene, context, monkeypatch):
    problem = Problem("stMirrored", "/scene", "3 faces", "warning")
    monkeypatch.setattr(write, "validate_usd", lambda path, pictures: [problem])
    export.usd(context, scene.asset, p=export.ExportSettings())
    assert sum("stMirrored" in warning for warning in context.warnings) == 1


def test_raised_roughness_and_a_missing_frame_are_told(scene, context):
    export.usd(context, scene.asset, p=export.ExportSettings(roughness_floor=0.6))
    assert any("no frame is wired in" in warning for warning in context.warnings)
    assert any("roughness floor 0.6" in warning for warning in context.warnings)


def test_gltf_and_obj_nodes_name_their_files(scene, context):
    glb = export.gltf(context, scene.asset, FRAME, Metrics({"psnr": 30.5}), p=export.FileSettings(name="spot")).files
    assert (glb.root / glb.main).name == "spot.glb"
    document, _ = read_glb(glb.root / glb.main)
    assert document["asset"]["extras"]["metrics"] == {"psnr": 30.5}
    assert any("metric scale" in warning for warning in context.warnings)
    files = export.obj(context, scene.asset, FRAME, p=export.FileSettings()).files
    assert (files.root / files.main).is_file()
