"""Variants of a sweep beside each other: which pictures and models the page takes, and what Chromium shows of them."""

import base64
import io
import json
import re

import numpy as np
import pytest
from PIL import Image

from exmesh_graph.gallery.pictures import GalleryWriter
from exmesh_graph.report.sweep import pictures as module
from exmesh_graph.report.sweep.files import best_of
from exmesh_graph.report.sweep.pictures import SweepPictures, sweep_pictures, versus_section
from tests.report.chromium import screenshot

RED, GREEN, BLUE, GRAY, WHITE = (np.array(c) for c in ([1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5] * 3, [1, 1, 1]))
LABELS = {("f", name): name for name in ("base", "same", "<other>")}


@pytest.fixture
def sweep(tmp_path):
    """(record, members, load): `same` has the gallery of base, `<other>` one of its own; the truth is green."""
    galleries = {}
    for name, ours, error, model in (
        ("g1", RED, BLUE, b"m1"),
        ("g2", GRAY, WHITE, b"m2"),
        ("unused", GRAY, RED, b"m3"),
    ):
        writer = GalleryWriter(tmp_path / name)
        panels = [np.broadcast_to(color, (20, 30, 3)) for color in (ours, GREEN, error)]
        for title in ("Held-out view 1", "Held-out view 2", "Base colour"):
            writer.add(title.replace(" ", "_"), title, f"{name} {title}", panels, compare=True)
        writer.add("atlas", "Atlas", "", panels)
        writer.claim("model.glb", "Asset", name).write_bytes(model)
        galleries[name] = writer.finish()
    rows, members = [], []
    for variant, repeat, digest in (("base", 1, "g1"), ("base", 2, "unused"), ("same", 1, "g1"), ("<other>", 1, "g2")):
        output = {"type": "Gallery", "digest": digest, "bytes": 1}
        rows.append({"name": f"{variant}#{repeat}:score", "outputs": {"gallery": output}})
        members.append({"file": "f", "variant": variant, "repeat": repeat, "nodes": {"score": rows[-1]["name"]}})
    return {"nodes": rows}, members, lambda digest: galleries.get(digest) or pytest.fail(digest)


def test_comparisons_are_shared_and_come_one_of_each_kind_first(sweep):
    shown = sweep_pictures(*sweep)
    assert [c.title for c in shown.comparisons] == ["Held-out view 1", "Base colour", "Held-out view 2"]
    first = shown.comparisons[0]
    assert (first.panels, first.size) == (3, (30, 20))
    assert first.strips == {("f", "base"): 0, ("f", "same"): 0, ("f", "<other>"): 1}
    assert first.captions["f", "<other>"] == "g2 Held-out view 1"
    assert len(shown.strips) == 2  # the pictures of one gallery are alike here
    strip = np.asarray(Image.open(io.BytesIO(shown.strips[0])), float) / 255
    assert strip.shape == (20, 3 * 30 + 2 * 6, 3)
    for column, color in ((15, RED), (51, GREEN), (87, BLUE)):
        np.testing.assert_allclose(strip[10, column], color, atol=0.03)
    assert [(keys, model.data) for keys, model in shown.models] == [
        ([("f", "base"), ("f", "same")], b"m1"),
        ([("f", "<other>")], b"m2"),
    ]


def test_what_does_not_fit_is_counted(sweep, monkeypatch):
    monkeypatch.setattr(module, "PICTURE_BYTES", 10)
    monkeypatch.setattr(module, "MODEL_BYTES", 3)
    shown = sweep_pictures(*sweep)
    assert len(shown.comparisons) == 1  # whole: of all variants
    assert len(shown.comparisons[0].strips) == 3
    assert (shown.pictures_left_out, shown.models_left_out) == (2, 1)
    assert "2 further pictures" in versus_section(shown, LABELS, None)


def test_pictures_of_another_view_or_size_are_another_choice(sweep, tmp_path):
    record, members, load = sweep
    writer = GalleryWriter(tmp_path / "elsewhere")
    writer.add("Held-out_view_1", "Held-out view 7", "", [np.zeros((20, 30, 3))] * 3, compare=True)
    writer.add("Base_colour", "Base colour", "", [np.zeros((20, 31, 3))] * 3, compare=True)
    gallery = writer.finish()
    shown = sweep_pictures(record, members, lambda digest: gallery if digest == "g2" else load(digest))
    assert all(("f", "<other>") not in c.strips for c in shown.comparisons if len(c.strips) > 1)
    assert sum(len(c.strips) == 1 for c in shown.comparisons) == 2


def test_the_section_stands_alone_and_names_the_best(sweep):
    html = versus_section(sweep_pictures(*sweep), LABELS, (("f", "<other>"), "PSNR"))
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', html, re.S)[1])
    assert data["variants"] == ["base", "same", "<other> (best: PSNR)"]
    assert "<other>" not in html
    assert data["pictures"][0]["strips"] == {"0": 0, "1": 0, "2": 1}
    assert base64.b64decode(data["strips"][0].partition(",")[2])[:4] == b"RIFF"
    assert "http" not in html
    assert versus_section(SweepPictures(), LABELS, None) == ""


def test_the_best_is_that_of_the_first_figure_with_a_direction():
    def row(name, error, ratio):
        return {"file": "f", "variant": name, "figures": {"Error": {"mean": error}, "Yes": {"mean": ratio}}}

    figures = [{"label": "Yes", "better": ""}, {"label": "Error", "better": "lower"}]
    rows = [row("a", 2.0, 9), row("b", 1.0, 1), row("c", None, 1)]
    assert best_of({"figures": figures, "variants": rows}) == (("f", "b"), "Error")
    assert best_of({"figures": figures[:1], "variants": rows}) is None
    assert best_of({"figures": figures, "variants": rows[2:]}) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("state", "expected"),
    [
        ("", [RED, GREEN, BLUE, None]),
        ("right=2&line=20", [GRAY, GRAY, BLUE, WHITE]),
        ("left=2&right=0", [GRAY, RED, WHITE, BLUE]),
    ],
)
def test_chromium_shows_any_two(sweep, tmp_path, state, expected):
    from importlib import resources

    here = resources.files("exmesh_graph.report")
    style = "".join((here / name).read_text() for name in ("style.css", "sweep/style.css"))
    body = versus_section(sweep_pictures(*sweep), LABELS, None)
    page = tmp_path / "page.html"
    page.write_text(f"<style>{style} body{{margin:0;padding:0;max-width:none;background:#ff0}}</style>{body}")
    pixels = screenshot(page, 1400, 500, state=state)
    # panels of 440 pixels, 16 between; a third of the way into the first, its right part, the middles of the others
    for x, color in zip((145, 400, 676, 1132), expected, strict=True):
        np.testing.assert_allclose(pixels[250, x], [1, 1, 0] if color is None else color, atol=0.04)
