"""Exported USD read back: geometry, texture coordinates, maps, light, package, determinism, refusals."""

import json
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from usd_example import SIZE, example_asset, tilted_normals

from exmesh_graph.errors import DataError, ExmeshError
from exmesh_graph.export.usd import ExportSettings, read_usd, validate_usd, write_usd
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.io.images import read_raw
from exmesh_graph.types import Frame

FILES = ("asset.usda", "scene.usda", "asset.usdz")
FRAME = Frame(
    scene_from_normalised=np.array([[2.5, 0, 0, 1], [0, 2.5, 0, -2], [0, 0, 2.5, 3], [0, 0, 0, 1.0]]),
    dataset_from_scene=np.eye(4),
)


def _maps(**changes):
    return ExportSettings(**changes)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("usd") / "out"
    return folder, write_usd(folder, example_asset(), FRAME)


@pytest.mark.parametrize("file", FILES)
def test_geometry_and_texture_coordinates_survive(exported, file):
    asset, contents = example_asset(), read_usd(exported[0] / file)
    np.testing.assert_allclose(contents.points, asset.vertices * 2.5 + [1, -2, 3], atol=1e-6)
    np.testing.assert_array_equal(contents.faces, asset.faces)
    np.testing.assert_array_equal(contents.st[contents.st_faces], asset.uvs[asset.uv_faces])
    # an octahedron's smooth normals point along its vertices
    np.testing.assert_allclose(contents.normals, asset.vertices / 0.8, atol=1e-6)
    assert contents.up_axis == "Y"


@pytest.mark.parametrize("file", FILES)
def test_maps_survive_within_half_a_code_value(exported, file):
    asset, contents = example_asset(), read_usd(exported[0] / file)
    assert contents.textures["base_color"].shape == (SIZE, SIZE, 3)
    assert contents.textures["roughness"].shape == (SIZE, SIZE, 1)
    assert contents.textures["base_color"].dtype == np.uint8
    back = srgb_to_linear(contents.textures["base_color"] / 255.0)
    low = srgb_to_linear((contents.textures["base_color"] - 0.501) / 255.0)
    high = srgb_to_linear((contents.textures["base_color"] + 0.501) / 255.0)
    assert ((low <= asset.base_color) & (asset.base_color <= high)).all()
    assert np.abs(back - asset.base_color).max() < 0.005
    assert np.abs(contents.textures["roughness"][..., 0] / 255.0 - asset.roughness).max() <= 0.501 / 255


def test_row_zero_of_the_array_is_the_top_of_the_picture_and_v_points_up(tmp_path):
    asset = example_asset(base_color=np.zeros((SIZE, SIZE, 3), np.float32))
    asset.base_color[5, 20] = 1.0
    write_usd(tmp_path / "out", asset)
    contents = read_usd(tmp_path / "out" / "asset.usda")
    row, column = np.argwhere(contents.textures["base_color"][..., 0] == 255)[0]
    assert (row, column) == (5, 20)
    # the lowest texture coordinate (v near 0) belongs to the last rows of the picture
    assert np.isclose(contents.st[:, 1].min(), 0.075)
    assert np.isclose(asset.uvs[:, 1].min(), contents.st[:, 1].min())


def test_the_component_has_no_light_and_the_scene_has_the_environment(exported):
    assert read_usd(exported[0] / "asset.usda").environment is None
    for file in ("scene.usda", "asset.usdz"):
        environment = read_usd(exported[0] / file).environment
        np.testing.assert_allclose(environment, example_asset().environment, rtol=2**-11, atol=1e-7)


def test_stage_metadata_kinds_and_binding(exported):
    from pxr import Usd, UsdGeom, UsdLux, UsdShade

    stage = Usd.Stage.Open(str(exported[0] / "scene.usda"))
    model = stage.GetPrimAtPath("/scene/asset")
    assert Usd.ModelAPI(stage.GetDefaultPrim()).GetKind() == "assembly"
    assert Usd.ModelAPI(model).GetKind() == "component"
    assert Usd.ModelAPI(model).GetAssetName() == "asset"
    assert Usd.ModelAPI(model).GetAssetIdentifier().path == "./asset.usda"
    assert {str(child.GetTypeName()) for child in model.GetChildren()} == {"Scope"}
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/scene/asset/geo/mesh"))
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    surface, _, _ = material.ComputeSurfaceSource()
    assert surface.GetInput("metallic").Get() == 0.0
    assert surface.GetInput("ior").Get() == 1.5
    dome = UsdLux.DomeLight(stage.GetPrimAtPath("/scene/environment"))
    assert dome.GetTextureFormatAttr().Get() == "latlong"
    assert dome.GetIntensityAttr().Get() == 1.0
    assert not dome.GetExposureAttr().HasAuthoredValue()
    assert not UsdGeom.Xformable(dome).GetOrderedXformOps()
    root = Usd.Stage.Open(str(exported[0] / "asset.usda"), Usd.Stage.LoadNone)
    assert root.GetDefaultPrim().GetVariantSets().GetNames() == ["lod", "shading"]  # seen before the payload is
    assert not root.GetPrimAtPath("/asset/geo")


def test_no_problem_is_found(exported):
    for file in (*FILES, "asset_ar.usdz"):
        assert validate_usd(exported[0] / file) == []


def test_the_package_is_stored_aligned_and_equals_the_scene(exported):
    path = exported[0] / "asset.usdz"
    data = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
    assert members[0].filename == "scene.usda"
    for member in members:
        assert member.compress_type == zipfile.ZIP_STORED
        name, extra = struct.unpack_from("<HH", data, member.header_offset + 26)
        assert (member.header_offset + 30 + name + extra) % 64 == 0
    assert _flattened(path) == _flattened(exported[0] / "scene.usda")


def _flattened(path):
    from pxr import Usd

    stage = Usd.Stage.Open(str(path))
    found = {}
    for prim in stage.Traverse():
        for attribute in prim.GetAttributes():
            value = attribute.Get()
            found[str(attribute.GetPath())] = value.path if hasattr(value, "resolvedPath") else str(value)
        found[str(prim.GetPath())] = (prim.GetTypeName(), str(prim.GetAllAuthoredMetadata().get("kind")))
    return found


def test_equal_assets_give_equal_bytes(exported, tmp_path):
    write_usd(tmp_path / "again", example_asset(), FRAME)
    first = {p.relative_to(exported[0]): p.read_bytes() for p in exported[0].rglob("*") if p.is_file()}
    again = {p.relative_to(tmp_path / "again"): p.read_bytes() for p in (tmp_path / "again").rglob("*") if p.is_file()}
    assert first == again
    assert len(first) == 11


def test_no_absolute_path_nor_place_is_written(exported):
    for path in exported[0].rglob("*"):
        if path.is_file():
            assert str(exported[0].parent).encode() not in path.read_bytes(), path.name


def test_normal_and_metallic_maps(tmp_path):
    normal = tilted_normals()
    metallic = np.linspace(0, 1, SIZE * SIZE, dtype=np.float32).reshape(SIZE, SIZE)
    write_usd(tmp_path / "out", example_asset(normal=normal, metallic=metallic))
    assert validate_usd(tmp_path / "out" / "asset.usdz") == []
    contents = read_usd(tmp_path / "out" / "asset.usdz")
    decoded = contents.textures["normal"] / 255.0 * 2 - 1
    assert np.abs(decoded - normal).max() <= 1.01 / 255
    assert np.abs(contents.textures["metallic"][..., 0] / 255.0 - metallic).max() <= 0.501 / 255


def test_the_roughness_floor_is_applied_and_counted(tmp_path):
    roughness = np.full((SIZE, SIZE), 0.5, np.float32)
    roughness[SIZE // 2 :, :] = 0.01
    report = write_usd(tmp_path / "out", example_asset(roughness=roughness), settings=_maps(roughness_floor=0.1))
    pixels = read_usd(tmp_path / "out" / "asset.usda").textures["roughness"]
    assert pixels.min() == round(0.1 * 255)
    assert 0 < report["roughness_texels_raised"] < SIZE * SIZE / 2
    assert json.loads((tmp_path / "out" / "export.json").read_text())["roughness_floor"] == 0.1


def test_charts_are_padded(tmp_path):
    from exmesh_graph.uv.raster import rasterize_atlas

    asset = example_asset(seen=np.zeros((SIZE, SIZE), bool))
    face, _ = rasterize_atlas(asset.uvs, asset.uv_faces, SIZE)
    asset.base_color[face < 0] = [1, 0, 0]
    asset.base_color[face >= 0] = [0, 0, 1]
    write_usd(tmp_path / "out", asset, settings=_maps(dilation=SIZE))
    assert (read_usd(tmp_path / "out" / "asset.usda").textures["base_color"] == [0, 0, 255]).all()
    write_usd(tmp_path / "bare", asset, settings=_maps(dilation=0))
    bare = read_usd(tmp_path / "bare" / "asset.usda").textures["base_color"]
    assert (bare[face < 0] == [255, 0, 0]).all()


def test_units_and_scale(tmp_path, exported):
    assert exported[1]["scale"] == "unknown"
    measured = Frame(FRAME.scene_from_normalised, FRAME.dataset_from_scene, metres_per_unit=0.001)
    report = write_usd(tmp_path / "out", example_asset(), measured)
    contents = read_usd(tmp_path / "out" / "asset.usda")
    assert contents.metres_per_unit == 0.001
    assert contents.custom_data["scale"] == report["scale"] == "measured"
    assert np.isclose(report["scene_units_per_normalised"], 2.5)


def test_a_turned_frame_turns_the_dome_with_the_mesh(tmp_path):
    from pxr import Gf, Usd, UsdGeom

    angle = 0.7
    turn = np.eye(4)
    turn[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    write_usd(tmp_path / "out", example_asset(), Frame(turn, np.eye(4)))
    stage = Usd.Stage.Open(str(tmp_path / "out" / "scene.usda"))
    dome = UsdGeom.Xformable(stage.GetPrimAtPath("/scene/environment"))
    seen = dome.ComputeLocalToWorldTransform(Usd.TimeCode.Default()).TransformDir(Gf.Vec3d(0, 0, 1))
    np.testing.assert_allclose(np.array(seen), turn[:3, :3] @ [0, 0, 1], atol=1e-12)
    points = read_usd(tmp_path / "out" / "asset.usda").points
    np.testing.assert_allclose(points, example_asset().vertices @ turn[:3, :3].T, atol=1e-6)


def _with(name, index, value):
    def change(asset):
        array = getattr(asset, name).copy()
        array[index] = value
        return example_asset(**{name: array})

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_with("vertices", (2, 1), np.nan), r"vertices\[2, 1\] is not finite"),
        (_with("faces", (3, 0), 6), r"faces\[3, 0\] = 6 points outside the 6 vertices"),
        (_with("faces", (3, 0), -1), r"faces\[3, 0\] = -1 points outside"),
        (_with("uv_faces", (0, 2), 24), r"uv_faces\[0, 2\] = 24 points outside the 24 uvs"),
        (_with("uvs", (1, 0), 1.5), r"uvs\[1, 0\] lies outside \[0, 1\]|uvs\[1, 0\] lies outside"),
        (_with("base_color", (0, 0, 0), 1.1), r"base_color\[0, 0, 0\] lies outside \[0, 1\]"),
        (_with("base_color", (4, 5, 1), np.inf), r"base_color\[4, 5, 1\] is not finite"),
        (_with("roughness", (1, 1), -0.1), r"roughness\[1, 1\] lies outside"),
        (_with("environment", (0, 3, 2), -1e-3), r"environment\[0, 3, 2\] lies outside"),
        (_with("environment", (0, 3, 2), 70000.0), r"environment\[0, 3, 2\] lies outside"),
        (lambda a: example_asset(environment=np.ones((8, 8, 3), np.float32)), "8 x 8"),
        (lambda a: example_asset(roughness=np.ones((4, 4), np.float32)), r"Asset\.roughness: is float32 \[4, 4\]"),
        (lambda a: example_asset(faces=np.zeros((0, 3), np.int32), uv_faces=np.zeros((0, 3), np.int32)), "empty"),
        (lambda a: example_asset(normal=-tilted_normals()), r"below the surface"),
        (lambda a: example_asset(normal=2 * tilted_normals()), r"unit length"),
    ],
)
def test_bad_assets_are_refused_before_anything_is_written(tmp_path, change, message):
    with pytest.raises(ExmeshError, match=message):
        write_usd(tmp_path / "out", change(example_asset()))
    assert list(tmp_path.iterdir()) == []


def test_bad_frames_names_and_targets_are_refused(tmp_path):
    shear = np.eye(4)
    shear[0, 1] = 0.3
    for frame in (shear, np.diag([1.0, 1, -1, 1]), np.zeros((4, 4))):
        with pytest.raises(ExmeshError, match="not a similarity"):
            write_usd(tmp_path / "out", example_asset(), Frame(frame, np.eye(4)))
    with pytest.raises(ExmeshError, match="not a USD identifier"):
        write_usd(tmp_path / "out", example_asset(), settings=ExportSettings(name="my-asset"))
    (tmp_path / "there").mkdir()
    with pytest.raises(ExmeshError, match="the target exists"):
        write_usd(tmp_path / "there", example_asset())
    assert [p.name for p in tmp_path.iterdir()] == ["there"]


def test_a_failure_while_writing_leaves_nothing_behind(tmp_path, monkeypatch):
    from exmesh_graph.export.usd import write

    def broken(*_args):
        raise OSError("disk full")

    monkeypatch.setattr(write, "write_usdz", broken)
    with pytest.raises(OSError, match="disk full"):
        write_usd(tmp_path / "out", example_asset())
    assert list(tmp_path.iterdir()) == []


def test_the_confidence_map_lies_beside_the_maps_and_is_named_in_the_report(tmp_path):
    confidence = np.linspace(0, 0.9, SIZE * SIZE, dtype=np.float32).reshape(SIZE, SIZE)
    report = write_usd(tmp_path / "out", example_asset(confidence=confidence))
    written = read_raw(tmp_path / "out" / report["confidence_map"])[..., 0]
    assert np.abs(written / 255.0 - confidence).max() <= 0.501 / 255
    assert "confidence" not in read_usd(tmp_path / "out" / "asset.usdz").textures
    with pytest.raises(DataError, match="confidence"):
        write_usd(tmp_path / "bad", example_asset(confidence=confidence[:4]))


def test_a_part_that_shrank_to_nothing_is_left_out_where_the_gate_would_refuse_its_faces(tmp_path):
    asset = example_asset()
    n, t = len(asset.vertices), len(asset.uvs)
    speck = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32)
    spoilt = replace(
        asset,
        vertices=np.concatenate([asset.vertices, np.full((4, 3), 0.3, np.float32)]),
        faces=np.concatenate([asset.faces, speck + n]),
        uvs=np.concatenate([asset.uvs, np.full((4, 2), 0.5, np.float32)]),
        uv_faces=np.concatenate([asset.uv_faces, speck + t]),
    )
    report = write_usd(tmp_path / "out", spoilt, FRAME)
    assert (report["faces"], report["vertices"], report["gate"]) == (8, 6, "passed")
    assert len(read_usd(tmp_path / "out" / "asset.usdz").faces) == 8
