"""The small .glb of a report: what quantising keeps, and that it stays a glTF file."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from exmesh_graph.errors import DataError
from exmesh_graph.export.gltf import read_glb, write_gltf
from exmesh_graph.gallery import models as model
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.types import Asset, Carrier

KINDS = {5120: (np.int8, 127), 5123: (np.uint16, 65535), 5125: (np.uint32, 1), 5126: (np.float32, 1)}


def ball(size=64, **changes):
    """A bumpy closed surface under a chart each side, maps of random values."""
    rng = np.random.default_rng(3)
    points = rng.normal(size=(60, 3))
    points *= (1 + 0.2 * rng.random((60, 1))) / np.linalg.norm(points, axis=1, keepdims=True)
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    inward = (
        np.einsum(
            "fi,fi->f", np.cross(*(points[faces[:, k]] - points[faces[:, 0]] for k in (1, 2))), points[faces[:, 0]]
        )
        < 0
    )
    faces[inward] = faces[inward][:, ::-1]
    parts = {
        "vertices": (0.7 * points + [0.3, 0, -0.1]).astype(np.float32), "faces": faces.astype(np.int32),
        "uvs": rng.random((len(faces) * 3, 2)).astype(np.float32),
        "uv_faces": np.arange(len(faces) * 3, dtype=np.int32).reshape(-1, 3),
        "texture": rng.random((size, size, 3)).astype(np.float32),
        "base_color": rng.random((size, size, 3)).astype(np.float32),
        "roughness": rng.random((size, size)).astype(np.float32),
        "seen": np.ones((size, size), bool),
        "environment": rng.random((8, 16, 3)).astype(np.float32),
    }  # fmt: skip
    return Asset(**{**parts, **changes})


def read(data, tmp_path):
    (tmp_path / "m.glb").write_bytes(data)
    document, binary = read_glb(tmp_path / "m.glb")

    def part(number):
        view = document["bufferViews"][number]
        return binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]

    def array(number):
        entry = document["accessors"][number]
        kind, top = KINDS[entry["componentType"]]
        columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[entry["type"]]
        rows = np.frombuffer(part(entry["bufferView"]), kind).reshape(entry["count"], -1)[:, :columns]
        return rows / top if entry.get("normalized") else rows

    return document, part, array


def pictures(document, part):
    found = {}
    for texture in document["textures"]:
        image = document["images"][texture["extensions"]["EXT_texture_webp"]["source"]]
        assert image["mimeType"] == "image/webp"
        found[image["name"]] = np.asarray(Image.open(io.BytesIO(part(image["bufferView"]))))
    return found


def test_the_mesh_moves_by_half_a_step_and_the_maps_not_at_all(tmp_path):
    asset = ball()
    document, part, array = read(model.asset_model(asset, np.array([1.0, 2.0, 3.0])), tmp_path)
    write_gltf(tmp_path / "plain", asset)
    plain, _, exact = read((tmp_path / "plain" / "asset.glb").read_bytes(), tmp_path)
    mine, theirs = (d["meshes"][0]["primitives"][0] for d in (document, plain))
    node = document["nodes"][0]
    placed = array(mine["attributes"]["POSITION"]) * node["scale"] + node["translation"]
    size = np.ptp(asset.vertices, axis=0).max()
    assert np.abs(placed - exact(theirs["attributes"]["POSITION"])).max() <= 0.51 * size / 65535
    for name, step in (("TEXCOORD_0", 1 / 65535), ("NORMAL", 1 / 127)):
        assert np.abs(array(mine["attributes"][name]) - exact(theirs["attributes"][name])).max() <= 0.51 * step
    np.testing.assert_array_equal(array(mine["indices"]), exact(theirs["indices"]))
    assert all(view.get("byteStride", 4) % 4 == 0 and view["byteOffset"] % 4 == 0 for view in document["bufferViews"])
    maps = pictures(document, part)
    np.testing.assert_array_equal(
        maps["base_color"], np.floor(linear_to_srgb(asset.base_color) * np.float32(255) + 0.5)
    )
    assert np.abs(maps["orm"][..., 1] / 255 - np.maximum(asset.roughness, 0.04)).max() < 0.51 / 255
    extras = document["scenes"][0]["extras"]
    assert extras["eye"] == [1, 2, 3]
    light = np.frombuffer(part(extras["light"]["bufferView"]), np.float16).reshape(8, 16, 4)
    # three.js: centre at +X, the lowest row first
    np.testing.assert_allclose(light[0, 8, :3], asset.environment[-1, 4], atol=1e-3)
    assert model.asset_model(asset, np.array([1.0, 2.0, 3.0])) == model.asset_model(asset, np.array([1.0, 2.0, 3.0]))


def test_a_normal_map_brings_its_tangents(tmp_path):
    normal = np.tile(np.array([0.6, 0, 0.8], np.float32), (64, 64, 1))
    document, part, array = read(model.asset_model(ball(normal=normal)), tmp_path)
    tangent = array(document["meshes"][0]["primitives"][0]["attributes"]["TANGENT"])
    assert set(tangent[:, 3]) <= {1.0, -1.0}
    np.testing.assert_allclose(np.linalg.norm(tangent[:, :3], axis=1), 1, atol=0.01)
    assert "normal" in pictures(document, part)


def test_a_carrier_shows_its_texture_as_it_is(tmp_path):
    asset = ball()
    carrier = Carrier(asset.vertices, asset.faces, asset.uvs, asset.uv_faces, asset.texture)
    document, part, _ = read(model.carrier_model(carrier), tmp_path)
    assert document["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}
    maps = pictures(document, part)
    assert list(maps) == ["base_color"]
    assert np.abs(maps["base_color"] / 255 - asset.texture).max() < 0.51 / 255 + 1e-4
    assert "light" not in document["scenes"][0]["extras"]


def test_large_maps_are_reduced_and_large_meshes_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(model, "MAP_SIZE", 32)
    flat = ball(base_color=np.full((64, 64, 3), 0.5, np.float32))
    document, part, _ = read(model.asset_model(flat), tmp_path)
    maps = pictures(document, part)
    assert maps["base_color"].shape == (32, 32, 3)
    assert (maps["base_color"] == 188).all()
    odd = ball(size=61)  # no divisor between 16 and 32
    document, part, _ = read(model.asset_model(odd), tmp_path)
    assert pictures(document, part)["base_color"].shape == (61, 61, 3)
    monkeypatch.setattr(model, "MAX_FACES", 10)
    with pytest.raises(DataError, match="faces"):
        model.asset_model(flat)


def test_values_out_of_range_are_clipped(tmp_path):
    bright = ball()
    bright = replace(bright, base_color=bright.base_color * 3, environment=bright.environment * 1e6)
    document, part, _ = read(model.asset_model(bright), tmp_path)
    assert pictures(document, part)["base_color"].max() == 255
