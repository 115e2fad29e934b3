"""Models in a report: what the page carries, what it says of them, and what headless Chromium shows."""

import base64
import gzip
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from exmesh_graph.gallery.models import add_model
from exmesh_graph.gallery.pictures import GalleryWriter
from exmesh_graph.report import build_report
from exmesh_graph.types import Asset, Carrier
from tests.report.chromium import NO_WEBGL, WEBGL, screenshot_when

CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float32) / 2
ASSET = Asset(
    vertices=CORNERS,
    faces=np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32),
    uvs=np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]], np.float32),
    uv_faces=np.tile(np.array([[0, 1, 2]], np.int32), (4, 1)),
    texture=np.full((8, 8, 3), [0.2, 0.7, 0.4], np.float32),
    base_color=np.full((8, 8, 3), [0.7, 0.2, 0.1], np.float32),
    roughness=np.full((8, 8), 0.5, np.float32),
    seen=np.ones((8, 8), bool),
    environment=np.ones((8, 16, 3), np.float32),
)
GREEN, RED = np.array([0.2, 0.7, 0.4]), np.array([0.855, 0.486, 0.349])  # RED: the base colour as displayed


@pytest.fixture
def run(tmp_path):
    """(folder, page, report.json) of a run with the model of Stage I and that of the asset."""
    carrier = Carrier(ASSET.vertices, ASSET.faces, ASSET.uvs, ASSET.uv_faces, ASSET.texture)
    galleries, nodes = {}, []
    for name, mesh in (("look", carrier), ("score", ASSET)):
        writer = GalleryWriter(tmp_path / name)
        writer.add("view", "A view", "", [np.zeros((4, 4, 3))])
        add_model(writer, mesh, f"<{name}>", np.array([1.0, 0.5, 1.0]))
        galleries[name] = writer.finish()
        output = {"type": "Gallery", "digest": name, "bytes": 1}
        nodes.append({"name": name, "type": "t", "state": "done", "seconds": 1.0, "outputs": {"gallery": output}})
    page = build_report(tmp_path, {"graph": "demo", "nodes": nodes}, galleries.__getitem__)
    return page, page.read_text(), json.loads((tmp_path / "report.json").read_text())


def carried(text):
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', text, re.S)[1])
    return data, lambda packed: gzip.decompress(base64.b64decode(packed))


def test_the_page_carries_every_model_and_three_js_once(run):
    page, text, report = run
    data, unpack = carried(text)
    assert [model["label"] for model in data["models"]] == ["<score> (score)", "<look> (look)"]  # the last one first
    for model, node in zip(data["models"], ("score", "look"), strict=True):
        assert unpack(model["glb"]) == (page.parent / node / "model.glb").read_bytes()
    assert set(data["modules"]) == {"three", "orbit", "viewer"}
    assert b"WebGLRenderer" in unpack(data["modules"]["three"])
    assert text.count('id="viewer"') == 1
    assert "<score>" not in text
    assert len(report["pictures"]) == 2
    assert [(m["node"], m["file"], m["bytes"]) for m in report["models"]] == [
        (node, "model.glb", (page.parent / node / "model.glb").stat().st_size) for node in ("look", "score")
    ]
    section = re.search(r'<section class="viewer".*?</section>', text, re.S)[0]
    assert "http" not in re.sub(r'"[A-Za-z0-9+/=]{200,}"', "", section)


def test_a_mesh_that_cannot_be_exported_is_no_error_but_a_remark(tmp_path):
    writer = GalleryWriter(tmp_path / "g")
    writer.add("geometry", "Geometry", "Clay.", [np.zeros((4, 4, 3))])
    add_model(writer, replace(ASSET, uvs=ASSET.uvs + 5), "Asset")
    (entry,) = json.loads((writer.finish().root / "captions.json").read_text())
    assert entry["caption"].startswith("Clay. No model to turn: uvs[0, 0] lies outside")


DRAG = """<script>
const place = document.getElementById("viewer"), canvas = place.querySelector("canvas");
canvas.setPointerCapture = canvas.releasePointerCapture = () => {}; // knows no pointers made by a script
const pointer = (kind, x) => canvas.dispatchEvent(new PointerEvent(kind, {
  pointerId: 1, pointerType: "mouse", clientX: x, clientY: 500, button: 0, buttons: 1, bubbles: true}));
const timer = setInterval(() => {
  if (place.dataset.state !== "shown") return;
  clearInterval(timer);
  place.querySelector("[value=roughness]").click();
  pointer("pointerdown", 300); pointer("pointermove", 420); pointer("pointerup", 420);
  setTimeout(() => { place.dataset.turned = ""; }, 1500);
}, 50);
</script></body>"""


@pytest.mark.slow
def test_chromium_shows_the_models_and_the_mouse_turns_them(run):
    page, text, _ = run

    def covered(color, state, wanted="shown"):
        selector = "#viewer[data-turned]" if wanted == "turned" else "#viewer[data-state=shown]"
        pixels = screenshot_when(page, selector, 900, 800, *WEBGL, state=state)
        return np.abs(pixels - color).max(axis=-1) < 0.02

    assert covered(RED, "shown=base_color").mean() > 0.03
    assert covered(GREEN, "model=1").mean() > 0.03  # Stage I: its texture as it is
    still = covered(np.full(3, 0.5), "shown=roughness")
    assert still.mean() > 0.03
    page.write_text(text.replace("</body>", DRAG))
    turned = covered(np.full(3, 0.5), "", "turned")
    assert turned.mean() > 0.03
    assert (turned != still).mean() > 0.3 * still.mean()


@pytest.mark.slow
def test_without_webgl_the_page_says_so_and_shows_the_rest(run):
    page, state = run[0], "#viewer[data-state=none]"
    with_message = screenshot_when(page, state, 900, 800, *NO_WEBGL)
    page.write_text(re.sub(r"This browser has no WebGL[^\"]*", "", run[1]))
    changed = np.abs(with_message - screenshot_when(page, state, 900, 800, *NO_WEBGL)).max(axis=-1) > 0.1
    words = np.flatnonzero(changed.any(axis=1))
    assert 5 < np.ptp(words) < 60  # a line or two of text
    below = np.abs(with_message[words[-1] + 40 :] - with_message[2, 2]).max(axis=-1) > 0.2
    assert 0.01 < below.mean() < 0.3  # the page goes on below it
