"""The gate finds each of the broken files, each made from a good export, and passes good variations."""

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from usd_example import SIZE, example_asset, tilted_normals

from exmesh_graph.export.usd import ExportSettings, validate_usd, write_usd
from exmesh_graph.io.images import write_image
from exmesh_graph.types import Frame

MESH, MATERIAL, DOME = "/scene/asset/geo/mesh", "/scene/asset/mtl/surface", "/scene/environment"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good") / "out"
    write_usd(folder, example_asset(normal=tilted_normals()))
    return folder


@pytest.fixture
def folder(tmp_path, good):
    return Path(shutil.copytree(good, tmp_path / "out"))


def _rules(folder, change, level="error"):
    """Rules that object after `change(stage, folder)`; an edit of the stage lands in scene.usda as an override."""
    from pxr import Usd

    stage = Usd.Stage.Open(str(folder / "scene.usda"))
    change(stage, folder)
    stage.GetRootLayer().Save()
    del stage  # and with it the layers that it holds in memory
    return {problem.rule for problem in validate_usd(folder / "scene.usda") if problem.level == level}


def _set(path, attribute, value):
    return lambda stage, _: stage.GetPrimAtPath(path).GetAttribute(attribute).Set(value)


def _clear(path, attribute):
    return lambda stage, _: stage.GetPrimAtPath(path).GetAttribute(attribute).Block()


def _element(path, attribute, index, value):
    def change(stage, _):
        found = stage.GetPrimAtPath(path).GetAttribute(attribute)
        values = np.array(found.Get())
        values[index] = value
        found.Set(values)

    return change


def _metadata(key):
    return lambda stage, _: stage.ClearMetadata(key)


def _remove(name):
    return lambda _, folder: (folder / name).unlink()


def _absolute(stage, folder):
    path = str((folder / "textures" / "base_color.png").resolve())
    stage.GetPrimAtPath(f"{MATERIAL}/base_color").GetAttribute("inputs:file").Set(path)


def _wrong_type_of_varname(stage, _):
    stage.GetPrimAtPath(f"{MATERIAL}/st").GetAttribute("inputs:varname").Set("uv")


def _binding_api_missing(stage, folder):
    text = (folder / "payload.usda").read_text()
    (folder / "payload.usda").write_text(text.replace('prepend apiSchemas = ["MaterialBindingAPI"]', ""))
    next(layer for layer in stage.GetUsedLayers() if layer.identifier.endswith("payload.usda")).Reload(force=True)


def _dome_1_on_z_up(stage, folder):
    _z_up(stage, folder)
    stage.GetPrimAtPath(DOME).SetTypeName("DomeLight_1")


def _z_up(stage, _):
    from pxr import UsdGeom

    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)


def _mirrored_dome(stage, _):
    from pxr import UsdGeom

    UsdGeom.Xformable(stage.GetPrimAtPath(DOME)).AddScaleOp().Set((-1, 1, 1))


def _write(name, data):
    return lambda _, folder: (folder / name).write_bytes(data)


def _no_binding(stage, _):
    stage.GetPrimAtPath(MESH).GetRelationship("material:binding").SetTargets([])


def _light_in_asset(stage, _):
    stage.DefinePrim("/scene/asset/geo/lamp", "SphereLight")


def _mesh_outside(stage, _):
    stage.DefinePrim("/other", "Xform").GetReferences().AddReference("./geo.usdc", "/high")


def _flat_texture_coordinates(stage, _):
    """All corners of one face at one place."""
    attribute = stage.GetPrimAtPath(MESH).GetAttribute("primvars:st:indices")
    indices = np.array(attribute.Get())
    indices[:3] = indices[0]
    attribute.Set(indices)


# The list of broken files that anchors the gate; the last is a warning.
BROKEN = {
    "missing texture": ("image", _remove("textures/base_color.png")),
    "no defaultPrim": ("defaultPrim", lambda stage, _: stage.ClearDefaultPrim()),
    "no upAxis": ("stageMetadata", _metadata("upAxis")),
    "no metersPerUnit": ("stageMetadata", _metadata("metersPerUnit")),
    "missing environment": ("domeImage", _remove("env.exr")),
    "binding API missing": ("bindingApi", _binding_api_missing),
    "normal sRGB": ("colorSpace", _set(f"{MATERIAL}/normal", "inputs:sourceColorSpace", "sRGB")),
    "normal without scale": ("normalScaleBias", _clear(f"{MATERIAL}/normal", "inputs:scale")),
    "normal without bias": ("normalScaleBias", _clear(f"{MATERIAL}/normal", "inputs:bias")),
    "DirectX scale": ("normalScaleBias", _set(f"{MATERIAL}/normal", "inputs:scale", (2, -2, 2, 1))),
    "base raw": ("colorSpace", _set(f"{MATERIAL}/base_color", "inputs:sourceColorSpace", "raw")),
    "roughness auto": ("colorSpace", _set(f"{MATERIAL}/roughness", "inputs:sourceColorSpace", "auto")),
    "st index out of range": ("stIndex", _element(MESH, "primvars:st:indices", 0, 24)),
    "vertex index out of range": ("vertexIndex", _element(MESH, "faceVertexIndices", 5, 99)),
    "st count": ("stCount", _set(MESH, "primvars:st:indices", [0, 1, 2])),
    "NaN point": ("finitePoints", _element(MESH, "points", (0, 0), np.nan)),
    "extent": ("extent", _set(MESH, "extent", [(0, 0, 0), (1, 1, 1)])),
    "subdivision": ("subdivision", _set(MESH, "subdivisionScheme", "catmullClark")),
    "left-handed": ("orientation", _set(MESH, "orientation", "leftHanded")),
    "degenerate st": ("stDegenerate", _flat_texture_coordinates),
    "varname": ("varname", _wrong_type_of_varname),
    "unbound": ("unbound", _no_binding),
    "absolute path": ("relativePath", _absolute),
    "corrupt PNG": ("image", _write("textures/roughness.png", b"no picture")),
    "dome exposure": ("domeExposure", _set(DOME, "inputs:exposure", 1.0)),
    "DomeLight_1 on Z-up": ("domeType", _dome_1_on_z_up),
    "DomeLight unrotated on Z-up": ("domeUpAxis", _z_up),
}
MORE = {
    "negative vertex index": ("vertexIndex", _element(MESH, "faceVertexIndices", 5, -1)),
    "wrap": ("wrap", _clear(f"{MATERIAL}/base_color", "inputs:wrapS")),
    "texture path": ("image", _set(f"{MATERIAL}/base_color", "inputs:file", "./textures/none.png")),
    "one channel": ("channels", _set(f"{MATERIAL}/base_color", "inputs:file", "./textures/roughness.png")),
    "no st": ("st", _clear(MESH, "primvars:st")),
    "st range": ("stRange", _set(MESH, "primvars:st", [(2.0, 0.1)] * 24)),
    "normals": ("normals", _set(MESH, "normals", [(0, 1, 0)])),
    "normals reversed": ("winding", _set(MESH, "normals", -example_asset().vertices / np.float32(0.8))),
    "face counts": ("faceCounts", _set(MESH, "faceVertexCounts", [3] * 7)),
    "quads": ("triangles", _set(MESH, "faceVertexCounts", [4] * 6)),
    "no surface": ("surface", _set(f"{MATERIAL}/preview", "info:id", "Other")),
    "dome format": ("domeFormat", _set(DOME, "inputs:texture:format", "angular")),
    "dome mirrored": ("domeMirrored", _mirrored_dome),
    "dome not 2:1": ("domeImage", _set(DOME, "inputs:texture:file", "./textures/roughness.png")),
    "a light in the asset": ("lightInAsset", _light_in_asset),
    "a mesh outside": ("outside", _mesh_outside),
    "geometry missing": ("composition", _remove("geo.usdc")),
}


@pytest.mark.thorough
@pytest.mark.parametrize(("rule", "change"), (BROKEN | MORE).values(), ids=(BROKEN | MORE).keys())
def test_each_fault_is_found_by_its_rule(folder, rule, change):
    assert rule in _rules(folder, change)


def test_mirrored_charts_are_a_warning(tmp_path):
    mirrored = example_asset().uv_faces.copy()
    mirrored[2] = mirrored[2][::-1]
    report = write_usd(tmp_path / "out", example_asset(uv_faces=mirrored))
    assert [(p.level, p.rule) for p in validate_usd(tmp_path / "out" / "scene.usda")] == [("warning", "stMirrored")]
    assert report["problems"] == ["stMirrored: 1 of 8 faces have mirrored texture coordinates"]


def test_a_fault_in_an_unselected_variant_is_found(folder):
    text = (folder / "mtl.usda").read_text()
    at = text.index('"base_only" {')
    right, wrong = "</asset/mtl/surface/base_color.outputs:rgb>", "</asset/mtl/surface/roughness.outputs:r>"
    (folder / "mtl.usda").write_text(text[:at] + text[at:].replace(right, wrong, 1))
    problems = [p for p in validate_usd(folder / "asset.usda") if p.level == "error"]
    assert {(p.rule, p.where) for p in problems} == {
        ("colorSpace", "/asset/mtl/surface/roughness {shading=base_only}"),
        ("channels", "/asset/mtl/surface/roughness {shading=base_only}"),
    }


def test_openusd_is_asked_too(folder):
    (folder / "textures" / "base_color.png").unlink()
    found = {problem.rule for problem in validate_usd(folder / "scene.usda")}
    assert any("MissingReference" in rule or "UnresolvableDependency" in rule for rule in found), found


def test_a_negative_environment_is_found(folder):
    write_image(folder / "env.exr", np.full((4, 8, 3), -1.0, np.float32), "half")
    assert {"domeImage"} <= {problem.rule for problem in validate_usd(folder / "scene.usda")}


def test_files_that_are_no_usd_are_problems_not_crashes(tmp_path):
    (tmp_path / "broken.usda").write_text("#usda 1.0\n(\n")
    assert [problem.rule for problem in validate_usd(tmp_path / "broken.usda")] == ["open"]
    assert [problem.rule for problem in validate_usd(tmp_path / "none.usda")] == ["open"]


def test_a_package_that_is_packed_wrongly_is_found(folder):
    with zipfile.ZipFile(folder / "asset.usdz") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for compression, what in ((zipfile.ZIP_STORED, "multiple of 64"), (zipfile.ZIP_DEFLATED, "compressed")):
        path = folder / f"packed{compression}.usdz"
        with zipfile.ZipFile(path, "w", compression) as archive:
            for name, data in members.items():
                archive.writestr(name, data)
        assert any(p.rule == "package" and what in p.what for p in validate_usd(path))


# --------------------------------------------------------------------------- good variations

SHIFTED = Frame(np.array([[30.0, 0, 0, 5], [0, 30.0, 0, -200], [0, 0, 30.0, 7], [0, 0, 0, 1]]), np.eye(4), 0.01)
TINY = Frame(np.diag([1e-3, 1e-3, 1e-3, 1.0]), np.eye(4))
LARGE = Frame(np.diag([1e3, 1e3, 1e3, 1.0]), np.eye(4))
OPEN = {"faces": example_asset().faces[:5], "uv_faces": example_asset().uv_faces[:5]}
METAL = {"metallic": np.ones((SIZE, SIZE), np.float32)}
WIDE = {
    name: np.concatenate([getattr(example_asset(), name)] * 2, axis=1) for name in ("base_color", "roughness", "seen")
}
LOW = {"low": example_asset(**OPEN)}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("file", "changes", "frame", "options"),
    [
        ("asset.usda", {}, None, {}),
        ("scene.usda", {}, None, {}),
        ("asset.usdz", {}, None, {}),
        ("asset_ar.usdz", {}, None, {}),
        ("scene.usda", {"normal": tilted_normals()}, None, {}),
        ("scene.usda", {"normal": tilted_normals()}, None, {"normal_bits": 16}),
        ("scene.usda", METAL, None, {}),
        ("asset.usdz", {**METAL, "normal": tilted_normals()}, None, {}),
        ("scene.usda", {}, SHIFTED, {}),
        ("scene.usda", {}, SHIFTED, {"up_axis": "Z"}),
        ("asset.usdz", {}, TINY, {"up_axis": "Z"}),
        ("scene.usda", {}, LARGE, {}),
        ("scene.usda", OPEN, None, {}),
        ("spot_2.usda", {}, None, {"name": "spot_2"}),
        ("scene.usda", WIDE, None, {}),
        ("asset.usda", {"lods": LOW}, None, {}),
    ],
)
def test_good_variations_pass(tmp_path, file, changes, frame, options):
    changes = dict(changes)
    lods = changes.pop("lods", None)
    write_usd(tmp_path / "out", example_asset(**changes), frame, lods=lods, settings=ExportSettings(**options))
    assert validate_usd(tmp_path / "out" / file) == []
    assert not [p for p in Path(tmp_path).iterdir() if p.name.startswith(".")]
