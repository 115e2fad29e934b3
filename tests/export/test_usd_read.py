"""Reading USD of any origin: what is taken, and what is refused with a reason."""

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from usd_example import example_asset

from exmesh_graph.errors import DataError
from exmesh_graph.export.usd import read_usd, validate_usd, write_usd
from exmesh_graph.io.images import read_raw, write_codes

MESH, MATERIAL = "/scene/asset/geo/mesh", "/scene/asset/mtl/surface"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good") / "out"
    write_usd(folder, example_asset())
    return folder


@pytest.fixture
def folder(tmp_path, good):
    return Path(shutil.copytree(good, tmp_path / "out"))


def _changed(folder, change):
    """scene.usda after `change(stage)`."""
    from pxr import Usd

    stage = Usd.Stage.Open(str(folder / "scene.usda"))
    change(stage)
    stage.GetRootLayer().Save()
    return folder / "scene.usda"


def _set(path, attribute, value):
    return lambda stage: stage.GetPrimAtPath(path).GetAttribute(attribute).Set(value)


def _clear(path, attribute):
    return lambda stage: stage.GetPrimAtPath(path).GetAttribute(attribute).Block()


def _two_meshes(stage):
    stage.DefinePrim("/scene/other", "Mesh")


def _per_vertex(stage):
    stage.GetPrimAtPath(MESH).GetAttribute("primvars:st").SetMetadata("interpolation", "vertex")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_two_meshes, "2 meshes"),
        (_set(MESH, "faceVertexCounts", [4] * 6), "not triangles"),
        (_clear(MESH, "primvars:st"), "no texture coordinates"),
        (_per_vertex, "no texture coordinates"),
        (_set(MESH, "primvars:st:indices", [0, 1, 2]), "3 texture coordinates for 8 triangles"),
        (_set(f"{MATERIAL}/base_color", "inputs:file", "./none.png"), "does not exist"),
        (_clear(f"{MATERIAL}/roughness", "inputs:file"), "roughness is fed by no picture"),
        (_set("/scene/environment", "inputs:texture:file", "./none.exr"), "does not exist"),
    ],
)
def test_what_cannot_be_read_is_refused_by_name(folder, change, message):
    with pytest.raises(DataError, match=message):
        read_usd(_changed(folder, change))


def test_a_dome_without_a_picture_is_no_light(folder):
    contents = read_usd(_changed(folder, _clear("/scene/environment", "inputs:texture:file")))
    assert contents.environment is None
    with pytest.raises(DataError, match="no dome light with a picture"):
        contents.asset()


def test_plain_texture_coordinates_missing_normals_and_alpha_are_taken(folder):
    """As other exporters write them."""
    before = read_usd(folder / "scene.usda")
    pixels = read_raw(folder / "textures" / "base_color.png")
    write_codes(folder / "textures" / "base_color.png", np.concatenate([pixels, pixels[..., :1]], axis=-1))

    def change(stage):
        mesh = stage.GetPrimAtPath(MESH)
        mesh.GetAttribute("primvars:st").Set(before.st[before.st_faces].reshape(-1, 2))
        mesh.GetAttribute("primvars:st:indices").Block()
        mesh.GetAttribute("normals").Block()

    after = read_usd(_changed(folder, change))
    assert after.normals.shape == (0, 3)
    np.testing.assert_array_equal(after.st[after.st_faces], before.st[before.st_faces])
    np.testing.assert_array_equal(after.asset().base_color, before.asset().base_color)


def test_a_damaged_picture_in_a_package_is_a_finding(folder):
    with zipfile.ZipFile(folder / "asset.usdz") as archive:
        info = archive.getinfo("textures/roughness.png")
        data = archive.read(info)
    package = bytearray((folder / "asset.usdz").read_bytes())
    at = package.index(data)
    package[at + len(data) // 2] ^= 255
    (folder / "asset.usdz").write_bytes(package)
    assert any(p.rule == "image" and "package does not give" in p.what for p in validate_usd(folder / "asset.usdz"))
    with pytest.raises(DataError, match="package does not give"):
        read_usd(folder / "asset.usdz")
