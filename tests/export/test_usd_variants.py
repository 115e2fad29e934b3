"""What the composed stage shows: variants that switch, cameras, up axis, levels of detail, provenance, light."""

import json
from dataclasses import replace

import numpy as np
import pytest
from usd_example import SIZE, example_asset, tilted_normals

from exmesh_graph.edit.cameras import orbit
from exmesh_graph.errors import DataError, ExmeshError
from exmesh_graph.export.folder import provenance_of
from exmesh_graph.export.usd import ExportSettings, read_usd, validate_usd, write_usd
from exmesh_graph.types import Frame, Views

TURNED = np.array([[0, 0, 2.0, 1], [0, 2.0, 0, -2], [-2.0, 0, 0, 3], [0, 0, 0, 1.0]])
FRAME = Frame(scene_from_normalised=TURNED, dataset_from_scene=np.eye(4))


def example_views(count=3):
    intrinsics, pose = orbit(count, 40, 48)
    intrinsics = intrinsics.copy()
    intrinsics[:, 0, 0] *= 1.1
    intrinsics[:, 0, 2] += 3.5
    intrinsics[:, 1, 2] -= 2.25
    names = tuple(f"test.{k}" for k in range(count))
    blank = np.zeros((count, 40, 48), np.float32)
    return Views(names, np.zeros((count, 40, 48, 3), np.float32), blank, intrinsics, pose, "test")


def coarse(asset):
    """Half an octahedron with a normal map of its own."""
    return replace(asset, faces=asset.faces[:4], uv_faces=asset.uv_faces[:4], normal=tilted_normals())


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("usd") / "out"
    asset = example_asset()
    origin = provenance_of("abc", {"held_out": {"psnr": 31.5, "names": ["a"]}, "ok": True, "none": float("nan")})
    report = write_usd(folder, asset, FRAME, example_views(), lods={"low": coarse(asset)}, provenance=origin)
    return folder, report


@pytest.mark.parametrize("file", ["asset.usda", "scene.usda", "asset.usdz"])
def test_levels_of_detail_switch_mesh_and_maps(exported, file):
    high, low = (read_usd(exported[0] / file, {"lod": lod}) for lod in ("high", "low"))
    assert (len(high.faces), len(low.faces)) == (8, 4)
    np.testing.assert_array_equal(high.textures["base_color"], low.textures["base_color"])
    assert np.abs(low.textures["normal"] / 127.5 - 1 - tilted_normals()).max() < 0.01
    assert (high.textures["normal"] == high.textures["normal"][0, 0]).all()  # the fine mesh needs none: a flat one
    assert exported[1]["faces_low"] == 4
    assert {"normal_low.png", "normal.png"} <= {p.name for p in (exported[0] / "textures").iterdir()}
    with pytest.raises(DataError, match="no variant lod=mid"):
        read_usd(exported[0] / file, {"lod": "mid"})


def test_shading_switches_what_the_surface_reads(exported):
    maps = {c: set(read_usd(exported[0] / "scene.usda", {"shading": c}).textures) for c in ("full", "no_normal")}
    assert maps == {"full": {"base_color", "normal", "roughness"}, "no_normal": {"base_color", "roughness"}}
    plain = read_usd(exported[0] / "scene.usda", {"shading": "base_only"})
    assert set(plain.textures) == {"base_color"}
    assert plain.constants["roughness"] == 0.5


def test_materialx_follows_the_same_variants(exported):
    from pxr import Usd, UsdShade

    stage = Usd.Stage.Open(str(exported[0] / "asset.usda"))
    material = UsdShade.Material(stage.GetPrimAtPath("/asset/mtl/surface"))
    surface = material.ComputeSurfaceSource("mtlx")[0]
    assert surface.GetIdAttr().Get() == "ND_open_pbr_surface_surfaceshader"
    normal = surface.GetInput("geometry_normal").GetConnectedSources()[0][0].source.GetPrim()
    assert UsdShade.Shader(normal).GetIdAttr().Get() == "ND_normalmap_float"
    image = UsdShade.Shader(stage.GetPrimAtPath("/asset/mtl/surface/mtlx_base_color"))
    assert image.GetInput("file").GetAttr().GetColorSpace() == "srgb_texture"
    stage.GetDefaultPrim().GetVariantSets().GetVariantSet("shading").SetVariantSelection("base_only")
    surface = material.ComputeSurfaceSource("mtlx")[0]
    assert not surface.GetInput("geometry_normal")
    assert not surface.GetInput("specular_roughness").HasConnectedSource()
    assert surface.GetInput("base_color").HasConnectedSource()


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_cameras_come_back_where_they_were(tmp_path, up_axis):
    views = example_views()
    write_usd(tmp_path / "out", example_asset(), FRAME, views, settings=ExportSettings(up_axis=up_axis))
    contents = read_usd(tmp_path / "out" / "scene.usda")
    assert contents.up_axis == up_axis
    assert [camera.view for camera in contents.cameras] == list(views.names)
    upright = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]]) if up_axis == "Z" else np.eye(3)
    for camera, intrinsics, pose in zip(contents.cameras, views.intrinsics, views.camera_to_world, strict=True):
        np.testing.assert_allclose(camera.intrinsics, intrinsics, rtol=1e-6)  # UsdGeomCamera keeps floats
        place = upright @ (TURNED[:3, :3] @ pose[:3, 3] + TURNED[:3, 3])
        np.testing.assert_allclose(camera.camera_to_world[:3, 3], place, atol=1e-9)
        np.testing.assert_allclose(
            camera.camera_to_world[:3, :3], upright @ TURNED[:3, :3] / 2 @ pose[:3, :3], atol=1e-9
        )
        assert (camera.width, camera.height) == (48, 40)
    points = (example_asset().vertices @ TURNED[:3, :3].T + TURNED[:3, 3]) @ upright.T
    np.testing.assert_allclose(contents.points, points, atol=1e-6)


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_a_direction_coded_light_comes_from_where_it_says(tmp_path, up_axis):
    """Texel = d / 2 + 1 / 2: what the stage says of direction d must be d in the environment's own axes."""
    height = 32
    v, u = (np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height)
    lat, lon = np.pi * (0.5 - v)[:, None], np.pi * (1 - 2 * u)[None]
    along = [np.sin(lon) * np.cos(lat), np.sin(lat) + 0 * lon, np.cos(lon) * np.cos(lat)]
    coded = (0.5 * np.stack(along, axis=-1) + 0.5).astype(np.float32)
    write_usd(tmp_path / "out", example_asset(environment=coded), FRAME, settings=ExportSettings(up_axis=up_axis))
    contents = read_usd(tmp_path / "out" / "scene.usda")
    rng = np.random.default_rng(0)
    stage = rng.normal(size=(200, 3))
    stage /= np.linalg.norm(stage, axis=1, keepdims=True)
    local = stage @ contents.rotation  # L(d) = E(R^T d)
    column = (0.5 - np.arctan2(local[:, 0], local[:, 2]) / (2 * np.pi)) * 2 * height
    row = np.arccos(local[:, 1]) / np.pi * height
    seen = 2 * contents.environment[row.astype(int), column.astype(int) % (2 * height)] - 1
    # Procrustes: the rotation from what is seen to the stage
    left, _, right = np.linalg.svd(stage.T @ seen)
    upright = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]]) if up_axis == "Z" else np.eye(3)
    found = left @ right
    assert np.linalg.det(found) > 0
    np.testing.assert_allclose(found, upright @ TURNED[:3, :3] / 2, atol=0.01)
    assert np.abs(stage - seen @ found.T).max() < 0.12  # a texel is 5.6 degrees wide


CENTIMETRES = Frame(np.array([[30.0, 0, 0, 5], [0, 30.0, 0, -200], [0, 0, 30.0, 7], [0, 0, 0, 1]]), np.eye(4), 0.01)
FAR = Frame(np.array([[0.2, 0, 0, 4e5], [0, 0.2, 0, -3e2], [0, 0, 0.2, 5e6], [0, 0, 0, 1]]), np.eye(4))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("frame", "options"),
    [
        (None, {}),
        (FRAME, {}),
        (FRAME, {"up_axis": "Z"}),
        (CENTIMETRES, {"up_axis": "Z"}),
        (FAR, {"recentre": True}),
    ],
    ids=["normalised", "turned", "Z-up", "centimetres", "far"],
)
def test_what_is_read_back_looks_the_same(tmp_path, frame, options):
    """The picture of the scene file, read by our own reader, against the picture of the asset itself."""
    import torch

    from exmesh_graph.evaluate.metrics.image import psnr
    from exmesh_graph.stage2.render import render_transport, render_views

    torch.set_num_threads(1)
    smooth = np.linspace(0.1, 0.7, SIZE, dtype=np.float32)
    asset = example_asset(
        base_color=np.stack(np.broadcast_arrays(smooth[:, None], smooth[None], smooth[::-1, None]), axis=-1).copy(),
        roughness=np.broadcast_to(0.3 + 0.5 * smooth[None], (SIZE, SIZE)).copy(),
        environment=np.broadcast_to(np.linspace(1.5, 0.2, 8, dtype=np.float32)[:, None, None], (8, 16, 3)).copy(),
        normal=tilted_normals(),
    )
    views = example_views(2)
    settings = ExportSettings(normal_bits=16, **options)
    write_usd(tmp_path / "out", asset, frame, views, settings=settings)
    contents = read_usd(tmp_path / "out" / "asset.usdz")
    back = contents.asset()
    pose = np.stack([contents.normalised_pose(camera) for camera in contents.cameras])
    intrinsics = np.stack([camera.intrinsics for camera in contents.cameras])
    light = render_transport(asset, 1, 64, 400)
    ours = render_views(asset, views.intrinsics, views.camera_to_world, 40, 48, transport=light, seed=3)
    theirs = render_views(back, intrinsics, pose, 40, 48, transport=render_transport(back, 1, 64, 400), seed=3)
    assert psnr(ours.images, theirs.images) > 60
    assert np.abs(ours.alpha - theirs.alpha).max() == 0


def test_provenance_is_in_the_asset_and_beside_it(exported):
    inside = read_usd(exported[0] / "asset.usda").custom_data
    assert inside["key"] == "abc"
    assert inside["metrics"] == {"held_out_psnr": 31.5}
    assert inside["tool"] == "exmesh-graph"
    assert inside["gate"] == "passed"
    beside = json.loads((exported[0] / "export.json").read_text())
    assert beside["provenance"]["metrics"] == inside["metrics"]
    assert beside["bytes"]["asset.usdz"] == (exported[0] / "asset.usdz").stat().st_size


def test_the_flat_package_is_the_bare_component(exported):
    from pxr import Usd

    stage = Usd.Stage.Open(str(exported[0] / "asset_ar.usdz"))
    assert len(stage.GetUsedLayers(includeClipLayers=False)) == 2  # the layer and the session's
    assert {str(prim.GetTypeName()) for prim in stage.Traverse()} == {"Xform", "Scope", "Mesh", "Material", "Shader"}
    assert not stage.GetDefaultPrim().GetVariantSets().GetNames()
    assert not stage.GetPrimAtPath("/asset/mtl/surface/openpbr")


def test_an_override_on_the_class_reaches_an_instance_downstream(exported, tmp_path):
    from pxr import Sdf, Usd

    stage = Usd.Stage.CreateInMemory()
    stage.DefinePrim("/shop/chair").GetReferences().AddReference(str(exported[0] / "asset.usda"))
    color = stage.OverridePrim("/__class__/asset/mtl/surface/preview")
    color.CreateAttribute("inputs:ior", Sdf.ValueTypeNames.Float).Set(1.3)
    assert np.isclose(stage.GetPrimAtPath("/shop/chair/mtl/surface/preview").GetAttribute("inputs:ior").Get(), 1.3)


@pytest.mark.parametrize(
    ("settings", "changes", "message"),
    [
        ({"require_scale": True}, {}, "metric scale is unknown"),
        (
            {"require_closed": True},
            {"faces": example_asset().faces[1:], "uv_faces": example_asset().uv_faces[1:]},
            "open",
        ),
        ({}, {"base_color": np.full((SIZE, SIZE, 3), 1.5, np.float32)}, "lies outside"),
    ],
)
def test_demands_are_kept_before_anything_is_written(tmp_path, settings, changes, message):
    with pytest.raises(ExmeshError, match=message):
        write_usd(tmp_path / "out", example_asset(**changes), FRAME, settings=ExportSettings(**settings))
    assert list(tmp_path.iterdir()) == []


def test_clipping_is_counted(tmp_path):
    bright = example_asset().base_color.copy()
    bright[0, :3] = 1.5
    light = example_asset().environment.copy()
    light[0, 0, 0] = 1e6
    report = write_usd(
        tmp_path / "out", example_asset(base_color=bright, environment=light), settings=ExportSettings(clip=True)
    )
    assert report["base_color_values_clipped"] == 9
    assert report["environment_values_clipped"] == 1


def test_crooked_cameras_are_refused(tmp_path):
    views = example_views()
    views.camera_to_world[1, :3, :3] *= 1.1
    with pytest.raises(DataError, match="not rigid"):
        write_usd(tmp_path / "out", example_asset(), FRAME, views)


def test_a_broken_export_is_not_published_and_the_gate_can_be_left_out(tmp_path, monkeypatch):
    from exmesh_graph.export.usd import write

    real = write.mesh_content

    def inside_out(asset, placement):
        content = real(asset, placement)
        return replace(content, normals=-content.normals)

    monkeypatch.setattr(write, "mesh_content", inside_out)
    with pytest.raises(DataError, match="winding at /asset/geo/mesh"):
        write_usd(tmp_path / "out", example_asset())
    assert list(tmp_path.iterdir()) == []
    write_usd(tmp_path / "out", example_asset(), settings=ExportSettings(gate=False))
    assert read_usd(tmp_path / "out" / "asset.usda").custom_data["gate"] == "skipped"
    assert {p.rule for p in validate_usd(tmp_path / "out" / "asset.usda")} == {"winding"}
