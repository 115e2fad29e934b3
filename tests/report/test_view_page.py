"""The page with an asset in it: what it carries, and what a headless Chromium shows of it."""

import base64
import json
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from exmesh_graph.export.gltf import read_glb
from exmesh_graph.io.images import read_image
from exmesh_graph.report.view.page import overcast, studio, view_page
from exmesh_graph.types import Asset

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome") or ""
HEIGHT = 32


def directions(height=HEIGHT):
    lat = np.pi * (0.5 - (np.arange(height) + 0.5) / height)[:, None]
    lon = np.pi * (1 - (np.arange(2 * height) + 0.5) / height)[None]
    return np.stack([np.sin(lon) * np.cos(lat), np.sin(lat) + 0 * lon, np.cos(lon) * np.cos(lat)], axis=-1)


@pytest.fixture(scope="module")
def asset():
    """A tetrahedron, the light coded by direction."""
    corner = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float32) / 2
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32)
    return Asset(
        vertices=corner,
        faces=faces,
        uvs=np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]], np.float32),
        uv_faces=np.tile(np.array([[0, 1, 2]], np.int32), (4, 1)),
        texture=np.zeros((8, 8, 3), np.float32),
        base_color=np.full((8, 8, 3), [0.7, 0.2, 0.1], np.float32),
        roughness=np.full((8, 8), 0.5, np.float32),
        seen=np.ones((8, 8), bool),
        environment=(0.5 * directions() + 0.5).astype(np.float32),
    )


def test_the_page_carries_the_asset_and_its_lights_and_no_address(asset, tmp_path):
    page = view_page(asset, "a <b> & c", {"other": 2 * asset.environment})
    assert "<title>a &lt;b&gt; &amp; c</title>" in page
    data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.S)[1].replace("<\\/", "</"))
    assert [light["name"] for light in data["lights"]] == ["recovered", "other", "studio", "overcast"]
    (tmp_path / "a.glb").write_bytes(base64.b64decode(data["glb"]))
    document, _ = read_glb(tmp_path / "a.glb")
    assert len(document["meshes"]) == 1
    light = data["lights"][1]
    pixels = np.frombuffer(base64.b64decode(light["data"]), np.float16).reshape(light["height"], light["width"], 4)
    # three.js: column 0.5 looks along +X, row 0 is the lowest
    middle = pixels[HEIGHT // 2 - 1 : HEIGHT // 2 + 1, HEIGHT - 1 : HEIGHT + 1, :3].mean(axis=(0, 1)) - 1
    np.testing.assert_allclose(middle, [1, 0, 0], atol=0.01)
    np.testing.assert_allclose(pixels[0, :, 1].astype(float) - 1, -1, atol=0.01)
    outside = re.sub(r'data:text/javascript;base64,[^"]*', "", page)
    assert "http" not in outside.replace("http-equiv", "")


def test_plain_lights_are_finite_and_lit_from_above():
    for light in (studio(), overcast()):
        assert np.isfinite(light).all()
        assert (light >= 0).all()
        assert light[:32].mean() > light[32:].mean()


def screenshot(page, folder, state, size=(480, 360)):
    """Display values [H, W, 3] of the page in a headless Chromium, and its document afterwards."""
    (folder / "page.html").write_text(page, encoding="utf-8")
    picture = folder / "page.png"
    command = [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader",
               "--enable-unsafe-swiftshader", f"--window-size={size[0]},{size[1]}", "--hide-scrollbars",
               "--virtual-time-budget=8000", f"--screenshot={picture}", f"--user-data-dir={folder / 'profile'}",
               f"{(folder / 'page.html').as_uri()}#{state}"]  # fmt: skip
    subprocess.run(command, capture_output=True, check=True, timeout=300)
    return read_image(picture)[..., :3]


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM, reason="no Chromium on the path")
def test_chromium_shows_the_asset_and_the_light_where_it_is(asset, tmp_path):
    page = view_page(asset, "test").replace('<form id="controls">', '<form id="controls" style="display:none">')
    flat = screenshot(page, tmp_path, "shown=base_color&behind=0")
    inside = np.abs(flat - np.array([0.855, 0.486, 0.349])).max(axis=-1) < 0.02  # sRGB of the base colour
    assert 0.05 < inside.mean() < 0.6
    assert not inside[:20].any()
    shaded = screenshot(page, tmp_path, "behind=0&light=studio")
    assert shaded[inside].std() > 0.03
    rough = screenshot(page, tmp_path, "shown=roughness&behind=0")
    np.testing.assert_allclose(np.median(rough[inside], axis=0), 0.5, atol=0.01)

    # the background: camera at azimuth 30 degrees, looking at the middle; colour tells the direction
    light = screenshot(page, tmp_path, "behind=1&azimuth=30")
    height, width = light.shape[:2]
    place = np.array([np.sin(np.pi / 6) * 0.94, 0.34, np.cos(np.pi / 6) * 0.94])
    back = place / np.linalg.norm(place)
    right = np.cross([0, 1, 0], back) / np.linalg.norm(np.cross([0, 1, 0], back))
    up = np.cross(back, right)
    for row, column in ((15, 15), (15, width - 15), (height - 15, 15), (height - 15, width - 15)):
        reach = np.tan(np.radians(17.5)) * 2 / height
        ray = (column - width / 2) * reach * right - (row - height / 2) * reach * up - back
        ray /= np.linalg.norm(ray)
        seen = light[row - 2 : row + 3, column - 2 : column + 3].mean(axis=(0, 1))
        linear = np.where(seen <= 0.04045, seen / 12.92, ((seen + 0.055) / 1.055) ** 2.4)
        found = 2 * linear - 1
        assert np.degrees(np.arccos(np.dot(found / np.linalg.norm(found), ray))) < 5


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM, reason="no Chromium on the path")
def test_a_broken_asset_says_so_on_the_page(asset, tmp_path):
    page = view_page(replace(asset), "test")
    data = re.search(r'"glb": "([^"]*)"', page)[1]
    broken = screenshot(page.replace(data, base64.b64encode(b"no glb" * 10).decode()), tmp_path, "")
    assert (np.abs(broken[-15:-8, -100:] - np.array([0.533, 0, 0.133])).max() < 0.1).all()
