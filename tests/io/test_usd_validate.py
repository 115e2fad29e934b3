"""Every rule of `validate_usd` finds the fault it is there for."""

import numpy as np
import pytest
from usd_example import example_asset, tilted_normals

from exmesh_graph.io.images import write_image
from exmesh_graph.io.usd import validate_usd, write_usd

MESH, MATERIAL = "/scene/asset/geo/mesh", "/scene/asset/mtl/surface"


@pytest.fixture
def folder(tmp_path):
    write_usd(tmp_path / "out", example_asset(normal=tilted_normals()))
    return tmp_path / "out"


def _errors(folder, change):
    """Rules that object after `change(stage)` edited the scene; an edit lands in scene.usda as an override."""
    from pxr import Usd

    stage = Usd.Stage.Open(str(folder / "scene.usda"))
    change(stage)
    stage.GetRootLayer().Save()
    return {problem.rule for problem in validate_usd(folder / "scene.usda") if problem.level == "error"}


def _set(path, attribute, value):
    return lambda stage: stage.GetPrimAtPath(path).GetAttribute(attribute).Set(value)


def _clear(path, attribute):
    return lambda stage: stage.GetPrimAtPath(path).GetAttribute(attribute).Block()


def _nan_point(stage):
    attribute = stage.GetPrimAtPath(MESH).GetAttribute("points")
    points = np.array(attribute.Get())
    points[0, 0] = np.nan
    attribute.Set(points)


def _wrong_type_of_varname(stage):
    from pxr import Sdf

    reader = stage.GetPrimAtPath(f"{MATERIAL}/st")
    reader.CreateAttribute("inputs:varname", Sdf.ValueTypeNames.String).Set("uv")


def _dome_1(stage):
    stage.GetPrimAtPath("/scene/environment").SetTypeName("DomeLight_1")


def _z_up(stage):
    from pxr import UsdGeom

    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)


def _long_indices(path, attribute, value):
    def change(stage):
        found = stage.GetPrimAtPath(path).GetAttribute(attribute)
        indices = list(found.Get())
        indices[0] = value
        found.Set(indices)

    return change


@pytest.mark.parametrize(
    ("rule", "change"),
    [
        ("colorSpace", _set(f"{MATERIAL}/base_color", "inputs:sourceColorSpace", "raw")),
        ("colorSpace", _set(f"{MATERIAL}/roughness", "inputs:sourceColorSpace", "auto")),
        ("colorSpace", _set(f"{MATERIAL}/normal", "inputs:sourceColorSpace", "sRGB")),
        ("normalScaleBias", _set(f"{MATERIAL}/normal", "inputs:scale", (1, 1, 1, 1))),
        ("wrap", _clear(f"{MATERIAL}/base_color", "inputs:wrapS")),
        ("varname", _wrong_type_of_varname),
        ("image", _set(f"{MATERIAL}/base_color", "inputs:file", "./textures/none.png")),
        ("vertexIndex", _long_indices(MESH, "faceVertexIndices", 99)),
        ("stIndex", _long_indices(MESH, "primvars:st:indices", 24)),
        ("stCount", _set(MESH, "primvars:st:indices", [0, 1, 2])),
        ("st", _clear(MESH, "primvars:st")),
        ("stRange", lambda s: s.GetPrimAtPath(MESH).GetAttribute("primvars:st").Set([(2.0, 0.1)] * 24)),
        ("finitePoints", _nan_point),
        ("extent", _set(MESH, "extent", [(0, 0, 0), (1, 1, 1)])),
        ("subdivision", _set(MESH, "subdivisionScheme", "catmullClark")),
        ("orientation", _set(MESH, "orientation", "leftHanded")),
        ("normals", _set(MESH, "normals", [(0, 1, 0)])),
        ("faceCounts", _set(MESH, "faceVertexCounts", [3] * 7)),
        ("triangles", _set(MESH, "faceVertexCounts", [4] * 6)),
        ("unbound", lambda s: s.GetPrimAtPath(MESH).GetRelationship("material:binding").SetTargets([])),
        ("surface", lambda s: s.GetPrimAtPath(f"{MATERIAL}/preview").GetAttribute("info:id").Set("Other")),
        ("domeFormat", _set("/scene/environment", "inputs:texture:format", "angular")),
        ("domeExposure", _set("/scene/environment", "inputs:exposure", 1.0)),
        ("domeType", _dome_1),
        ("domeUpAxis", _z_up),
        ("domeImage", _set("/scene/environment", "inputs:texture:file", "./textures/roughness.png")),
        ("defaultPrim", lambda stage: stage.ClearDefaultPrim()),
        ("stageMetadata", lambda stage: stage.ClearMetadata("metersPerUnit")),
    ],
)
def test_each_fault_is_found_by_its_rule(folder, rule, change):
    assert rule in _errors(folder, change)


def test_a_sound_scene_passes_and_openusd_is_asked(folder):
    assert _errors(folder, lambda stage: None) == set()
    (folder / "textures" / "base_color.png").unlink()
    found = {problem.rule for problem in validate_usd(folder / "scene.usda") if problem.level == "error"}
    assert "image" in found
    assert any("MissingReference" in rule or "UnresolvableDependency" in rule for rule in found), found


def test_absolute_paths_are_found(folder):
    path = str((folder / "textures" / "base_color.png").resolve())
    assert "relativePath" in _errors(folder, _set(f"{MATERIAL}/base_color", "inputs:file", path))


def test_an_undecodable_texture_is_found(folder):
    (folder / "textures" / "roughness.png").write_bytes(b"no picture")
    assert {"image"} <= {problem.rule for problem in validate_usd(folder / "asset.usdc")}


def test_a_negative_environment_is_found(folder):
    write_image(folder / "env.exr", np.full((4, 8, 3), -1.0, np.float32), "half")
    assert {"domeImage"} <= {problem.rule for problem in validate_usd(folder / "scene.usda")}


def test_mirrored_and_flat_charts_are_told_apart_from_sound_ones(tmp_path):
    asset = example_asset()
    mirrored = asset.uv_faces.copy()
    mirrored[2] = mirrored[2][::-1]
    write_usd(tmp_path / "mirrored", example_asset(uv_faces=mirrored))
    problems = validate_usd(tmp_path / "mirrored" / "asset.usdc")
    assert [(p.level, p.rule) for p in problems] == [("warning", "stMirrored")]
    flat = asset.uv_faces.copy()
    flat[2] = flat[2][0]
    write_usd(tmp_path / "flat", example_asset(uv_faces=flat))
    assert [p.rule for p in validate_usd(tmp_path / "flat" / "asset.usdc")] == ["stDegenerate"]


def test_a_file_that_is_no_usd_is_a_problem_not_a_crash(tmp_path):
    (tmp_path / "broken.usda").write_text("#usda 1.0\n(\n")
    assert [problem.rule for problem in validate_usd(tmp_path / "broken.usda")] == ["open"]
