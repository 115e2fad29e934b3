"""glTF and OBJ read back by plain readers of their own; the Khronos validator where node and its package are there.

npm install gltf-validator; EXMESH_GLTF_VALIDATOR=node_modules/gltf-validator pytest tests/export/test_gltf_obj.py
"""

import json
import os
import subprocess

import numpy as np
import pytest
from usd_example import SIZE, example_asset, tilted_normals

from exmesh_graph.errors import DataError, ExmeshError
from exmesh_graph.export.gltf import read_glb, write_gltf
from exmesh_graph.export.gltf_compact import compact_glb
from exmesh_graph.export.obj import write_textured_obj
from exmesh_graph.export.settings import FileSettings
from exmesh_graph.geometry.tangents import corner_tangents
from exmesh_graph.io.images import read_raw
from exmesh_graph.types import Frame

VALIDATOR = os.environ.get("EXMESH_GLTF_VALIDATOR", "")
FRAME = Frame(np.array([[0, 0, 2.0, 1], [0, 2.0, 0, -2], [-2.0, 0, 0, 3], [0, 0, 0, 1.0]]), np.eye(4), 0.01)
METAL = np.linspace(0, 1, SIZE * SIZE, dtype=np.float32).reshape(SIZE, SIZE)
NO_PADDING = FileSettings(dilation=0)
_TYPES = {5126: np.float32, 5125: np.uint32}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def accessor(document, binary, number):
    entry = document["accessors"][number]
    view = document["bufferViews"][entry["bufferView"]]
    data = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    return np.frombuffer(data, _TYPES[entry["componentType"]]).reshape(entry["count"], _COLUMNS[entry["type"]])


def picture(document, binary, name, folder):
    image = next(image for image in document["images"] if image["name"] == name)
    view = document["bufferViews"][image["bufferView"]]
    (folder / "picture.png").write_bytes(binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
    return read_raw(folder / "picture.png")


@pytest.fixture(scope="module")
def mirrored():
    """One face's chart is mirrored."""
    corners = example_asset().uv_faces.copy()
    corners[2] = corners[2][::-1]
    return example_asset(uv_faces=corners, normal=tilted_normals(), metallic=METAL)


def test_geometry_in_metres_with_tangents_of_unit_length(tmp_path, mirrored):
    write_gltf(tmp_path / "out", mirrored, FRAME, NO_PADDING, provenance={"key": "abc"})
    document, binary = read_glb(tmp_path / "out" / "asset.glb")
    assert document["asset"]["extras"]["key"] == "abc"
    primitive = document["meshes"][0]["primitives"][0]
    found = {name: accessor(document, binary, number) for name, number in primitive["attributes"].items()}
    index = accessor(document, binary, primitive["indices"]).reshape(-1, 3)
    metres = 0.01 * (mirrored.vertices @ FRAME.scene_from_normalised[:3, :3].T + FRAME.scene_from_normalised[:3, 3])
    np.testing.assert_allclose(found["POSITION"][index], metres[mirrored.faces], atol=1e-7)
    entry = document["accessors"][primitive["attributes"]["POSITION"]]
    np.testing.assert_array_equal([entry["min"], entry["max"]], [found["POSITION"].min(0), found["POSITION"].max(0)])
    np.testing.assert_allclose(
        found["TEXCOORD_0"][index], mirrored.uvs[mirrored.uv_faces] * [1, -1] + [0, 1], atol=1e-7
    )  # v down
    np.testing.assert_allclose(np.linalg.norm(found["TANGENT"][:, :3], axis=1), 1, atol=1e-6)
    np.testing.assert_allclose((found["TANGENT"][:, :3] * found["NORMAL"]).sum(1), 0, atol=1e-6)
    tangent, sign = corner_tangents(mirrored.vertices, mirrored.faces, mirrored.uvs, mirrored.uv_faces)
    turn = FRAME.scene_from_normalised[:3, :3] / 2
    np.testing.assert_allclose(found["TANGENT"][index][..., :3], tangent @ turn.T, atol=1e-5)
    np.testing.assert_array_equal(found["TANGENT"][index][..., 3], np.repeat(sign[:, None], 3, axis=1))
    assert set(sign) == {1, -1}


def test_roughness_and_metal_share_a_picture(tmp_path, mirrored):
    write_gltf(tmp_path / "out", mirrored, settings=NO_PADDING)
    document, binary = read_glb(tmp_path / "out" / "asset.glb")
    orm = picture(document, binary, "orm", tmp_path)
    assert (orm[..., 0] == 255).all()
    assert np.abs(orm[..., 1] / 255 - mirrored.roughness).max() <= 0.501 / 255
    assert np.abs(orm[..., 2] / 255 - METAL).max() <= 0.501 / 255
    material = document["materials"][0]
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 1
    normal = picture(document, binary, "normal", tmp_path)
    assert np.abs(normal / 127.5 - 1 - tilted_normals()).max() < 0.01
    assert document["textures"][material["normalTexture"]["index"]]["name"] == "normal"
    write_gltf(tmp_path / "plain", example_asset())
    document, _ = read_glb(tmp_path / "plain" / "asset.glb")
    assert document["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] == 0
    assert "normalTexture" not in document["materials"][0]


def test_equal_assets_give_equal_bytes_and_bad_ones_nothing(tmp_path, mirrored):
    for write, file in ((write_gltf, "asset.glb"), (write_textured_obj, "asset.obj")):
        write(tmp_path / f"a{file}", mirrored)
        write(tmp_path / f"b{file}", mirrored)
        assert (tmp_path / f"a{file}" / file).read_bytes() == (tmp_path / f"b{file}" / file).read_bytes()
        with pytest.raises(ExmeshError, match="lies outside"):
            write(tmp_path / "bad", example_asset(roughness=np.full((SIZE, SIZE), 2, np.float32)))
        assert not (tmp_path / "bad").exists()


def test_a_cut_glb_is_refused(tmp_path, mirrored):
    write_gltf(tmp_path / "out", mirrored)
    (tmp_path / "cut.glb").write_bytes((tmp_path / "out" / "asset.glb").read_bytes()[:-7])
    with pytest.raises(DataError, match="not a whole glTF"):
        read_glb(tmp_path / "cut.glb")


@pytest.mark.skipif(not VALIDATOR, reason="EXMESH_GLTF_VALIDATOR names no npm package gltf-validator")
@pytest.mark.parametrize("kind", ["plain", "all maps", "frame", "compact"])
def test_khronos_finds_nothing(tmp_path, mirrored, kind):
    asset = example_asset() if kind == "plain" else mirrored
    write_gltf(tmp_path / "out", asset, FRAME if kind == "frame" else None)
    if kind == "compact":
        (tmp_path / "out" / "asset.glb").write_bytes(compact_glb(*read_glb(tmp_path / "out" / "asset.glb")))
    script = (
        "const v = require(process.argv[1]); const fs = require('fs');"
        "v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2])))"
        ".then(r => console.log(JSON.stringify(r.issues)))"
    )
    command = ["node", "-e", script, os.path.abspath(VALIDATOR), str(tmp_path / "out" / "asset.glb")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    issues = json.loads(done.stdout)
    assert (issues["numErrors"], issues["numWarnings"], issues["messages"]) == (0, 0, [])


def test_obj_and_its_material(tmp_path, mirrored):
    write_textured_obj(tmp_path / "out", mirrored, FRAME, FileSettings(name="spot"))
    values = {"v": [], "vt": [], "vn": [], "f": []}
    for line in (tmp_path / "out" / "spot.obj").read_text().splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "f":
            values["f"].append([[int(n) - 1 for n in corner.split("/")] for corner in rest.split()])
        elif kind in values:
            values[kind].append([float(x) for x in rest.split()])
    corner = np.array(values["f"])
    points = mirrored.vertices @ FRAME.scene_from_normalised[:3, :3].T + FRAME.scene_from_normalised[:3, 3]
    np.testing.assert_allclose(np.array(values["v"])[corner[..., 0]], points[mirrored.faces], atol=1e-6)
    np.testing.assert_allclose(np.array(values["vt"])[corner[..., 1]], mirrored.uvs[mirrored.uv_faces], atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(values["vn"], axis=1), 1, atol=1e-5)
    material = (tmp_path / "out" / "spot.mtl").read_text()
    for statement in (
        "map_Kd base_color.png",
        "map_Pr roughness.png",
        "map_Pm metallic.png",
        "norm normal.png",
        "Pm 1",
    ):
        assert statement in material.splitlines()
        if ".png" in statement:
            assert (tmp_path / "out" / statement.split()[1]).is_file()


@pytest.mark.parametrize("write", [write_gltf, write_textured_obj])
def test_a_part_that_has_shrunk_to_nothing_is_left_out(tmp_path, write):
    plain = example_asset()
    speck, count = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]), len(plain.vertices)
    grown = example_asset(
        vertices=np.concatenate([plain.vertices, np.full((4, 3), 0.1, np.float32)]),
        faces=np.concatenate([plain.faces, (speck + count).astype(np.int32)]),
        uv_faces=np.concatenate([plain.uv_faces, plain.uv_faces[:1].repeat(4, 0)]),
    )
    write(tmp_path / "plain", plain)
    write(tmp_path / "grown", grown)
    for file in sorted((tmp_path / "plain").iterdir()):
        assert (tmp_path / "grown" / file.name).read_bytes() == file.read_bytes()
