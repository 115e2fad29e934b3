"""Pictures with a slider, and what stages cost."""

import numpy as np
import pytest

from exmesh_graph.gallery.pictures import GalleryWriter
from exmesh_graph.report.contents import GalleryItem, stage_costs
from exmesh_graph.report.widgets import comparison
from tests.report.chromium import screenshot


@pytest.fixture
def picture(tmp_path):
    """Ours red, the truth green, the error blue, 20 x 30 each."""
    panels = [np.broadcast_to(np.eye(3)[k], (20, 30, 3)) for k in range(3)]
    writer = GalleryWriter(tmp_path / "gallery")
    writer.add("held_out", 'A "view"', "Ours, photograph, error.", panels, compare=True)
    root = writer.finish().root
    return GalleryItem("score", "held_out.png", 'A "view"', "", (root / "held_out.png").read_bytes(), 3)


def test_the_picture_is_there_once_with_a_slider(picture):
    html = comparison(picture)
    assert html.count("base64,") == 1
    assert html.count('type="range"') == 1
    assert "--shape:30/20" in html
    assert "A &quot;view&quot;" in html
    assert "<script" not in html
    assert comparison(GalleryItem("n", "a.png", "t", "", picture.data, 0)) == ""
    assert comparison(GalleryItem("n", "a.png", "t", "", picture.data, 5)) == ""  # panels of another width


def test_only_panels_of_one_size_are_marked(tmp_path):
    import json

    writer = GalleryWriter(tmp_path / "g")
    writer.add("a", "a", "", [np.zeros((8, 8, 3)), np.zeros((8, 12, 3))], compare=True)
    writer.add("b", "b", "", [np.zeros((8, 8, 3))] * 2)
    writer.add("c", "c", "", [np.zeros((8, 8, 3))] * 2, compare=True)
    entries = json.loads((writer.finish().root / "captions.json").read_text())
    assert [entry.get("compare") for entry in entries] == [None, None, 2]


@pytest.mark.slow
@pytest.mark.parametrize(("cut", "expected"), [(50, [0, 1, 2]), (20, [1, 1, 2])])
def test_chromium_shows_ours_left_of_the_line_and_the_truth_right_of_it(picture, tmp_path, cut, expected):
    from importlib import resources

    style = (resources.files("exmesh_graph.report") / "style.css").read_text()
    page = tmp_path / "page.html"
    body = comparison(picture).replace('<div class="side"', f'<div class="side" style="--cut:{cut}%"', 1)
    page.write_text(f"<style>{style}body{{margin:0;max-width:none;padding:0}}</style>{body}")
    pixels = screenshot(page, 1000, 400)
    # 320 pixels a panel, 6 between: a third of the way into the first, its right part, the middle of the second
    colors = [pixels[100, x].argmax() for x in (110, 300, 486)]
    assert colors == [expected[0], 1, 2]


def test_seconds_are_summed_and_memory_is_the_largest():
    def node(kind, seconds, peak):
        return {"type": kind, "seconds": seconds, "peak_memory": peak}

    nodes = [node("data.blender", 1, 5), node("stage1.refine", 2, 9), node("uv.unwrap", 3, 7), node("mine.step", 4, 1)]
    rows = {row["stage"]: row for row in stage_costs(nodes)}
    assert list(rows) == ["data", "Stage I", "mine"]
    assert rows["Stage I"] == {"stage": "Stage I", "seconds": 5, "peak_memory": 9, "nodes": 2}
