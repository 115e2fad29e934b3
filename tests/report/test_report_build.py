"""The run report: what report.json holds, that the page stands alone, what a run without scores gives."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from exmesh_graph.io.images import write_image
from exmesh_graph.report import build_report
from exmesh_graph.report.collect import collect
from exmesh_graph.types import Gallery, Metrics
from tests.report.chromium import screenshot

METRICS = {
    "shape": {
        "headline": [
            {"label": "Chamfer", "value": 14.2, "unit": "‰ of radius", "better": "lower", "series": "Chamfer"}
        ],
        "mesh": {"faces": 2000, "closed": True},
    },
    "final": {
        "headline": [
            {"label": "Chamfer", "value": 4.9, "unit": "‰ of radius", "better": "lower", "series": "Chamfer"},
            {"label": "Closed", "value": False},
        ]
    },
    "score": {
        "headline": [
            {
                "label": "Relit PSNR",
                "value": 32.4,
                "unit": "dB",
                "floor": 24.3,
                "goal": 30.0,
                "better": "higher",
                "series": "relit PSNR",
            }
        ],
        "held_out": {"psnr_per_view": {"a <b>": 31.0}},
    },
    "history": {"curves": {"iteration": [0, 10, 20], "loss": [1.0, 0.5, 0.25], "seconds": [0.0, 1.0, 2.0]}},
}


@pytest.fixture
def record():
    def node(name, kind, state, seconds, inputs, outputs, warnings=()):
        stored = {p: {"type": t, "digest": d, "bytes": 1000} for p, (t, d) in outputs.items()}
        return {"name": name, "type": kind, "state": state, "seconds": seconds, "inputs": inputs,
                "outputs": stored, "warnings": list(warnings), "peak_rss": 5_000_000}  # fmt: skip

    nodes = [
        node("views", "data.blender", "hit", 1.0, {}, {"train": ("Views", "v")}),
        node("hull", "init.visual_hull", "done", 4.0, {"views": "@views.train"}, {"mesh": ("Mesh", "h")}),
        node("rough", "evaluate.mesh", "done", 0.5, {"mesh": "@hull.mesh"}, {"metrics": ("Metrics", "shape")}),
    ]
    last = "@hull.mesh"
    for i in (1, 2):
        nodes.append(
            node(f"rounds[{i}].refine", "stage1.refine", "done", 10.0, {"state": last, "views": "@views.train"},
                 {"state": ("Stage1State", f"s{i}"), "history": ("Metrics", "history")}, ["a <script> & more"])
        )  # fmt: skip
        last = f"@rounds[{i}].refine.state"
    nodes += [
        node("shape", "evaluate.mesh", "done", 0.5, {"mesh": last}, {"metrics": ("Metrics", "final")}),
        node("pbr", "stage2.fit", "done", 50.0, {"carrier": last}, {"asset": ("Asset", "a"), "none": ("none", "none")}),
        node("score", "evaluate.asset", "done", 5.0, {"asset": "@pbr.asset"},
             {"metrics": ("Metrics", "score"), "gallery": ("Gallery", "g")}),
    ]  # fmt: skip
    return {"id": "run-1", "graph": "demo", "file": "/somewhere/graphs/demo.yaml", "command": "exmesh run demo.yaml",
            "state": "done", "seconds": 80.0, "machine": {"processor": "test", "cpus": 2}, "nodes": nodes}  # fmt: skip


@pytest.fixture
def load(tmp_path):
    root = tmp_path / "gallery"
    root.mkdir()
    write_image(root / "view.png", np.random.default_rng(0).random((8, 8, 3)))
    captions = [{"file": "view.png", "title": "A view", "caption": "ours | truth"}]
    (root / "captions.json").write_text(json.dumps(captions))
    return lambda digest: Gallery(root=root) if digest == "g" else Metrics(METRICS[digest])


@pytest.fixture
def report(tmp_path, record, load):
    page = build_report(tmp_path, record, load)
    return json.loads((tmp_path / "report.json").read_text()), page.read_text()


def test_headline_holds_value_floor_and_what_it_cost(report):
    headline = report[0]["headline"]
    relit = headline["Relit PSNR"]
    assert (relit["value"], relit["unit"], relit["floor"], relit["goal"]) == (32.4, "dB", 24.3, 30.0)
    assert relit["node"] == "score"
    # everything the scored asset needed: views 1, hull 4, two rounds of 10, pbr 50; no evaluation
    assert relit["after_seconds"] == 75.0
    assert headline["Closed"]["value"] is False
    assert headline["Seconds, total"]["value"] == 81.0


def test_one_measure_of_two_nodes_keeps_both_apart(report):
    headline = report[0]["headline"]
    assert headline["Chamfer (rough)"]["after_seconds"] == 5.0
    assert headline["Chamfer (shape)"]["after_seconds"] == 25.0
    assert "Chamfer" not in headline


def test_json_lists_nodes_edges_metrics_and_warnings(report):
    data = report[0]
    assert data["schema"] == "exmesh.report.v1"
    assert [node["name"] for node in data["nodes"]][:2] == ["views", "hull"]
    assert data["nodes"][1] == {"name": "hull", "type": "init.visual_hull", "state": "done", "seconds": 4.0,
                                "peak_memory": 5_000_000, "bytes": 1000, "warnings": []}  # fmt: skip
    assert ["rounds[1].refine", "rounds[2].refine"] in data["edges"]
    assert data["metrics"]["shape.metrics"] == METRICS["final"]
    assert data["warnings"][0] == {"node": "rounds[1].refine", "message": "a <script> & more"}
    assert data["seconds"] == {"this_run": 80.0, "all_results": 81.0}
    assert data["graph"] == "demo.yaml"
    assert data["pictures"][0]["title"] == "A view"
    assert data["machine"] == {"processor": "test", "cpus": "2"}
    assert data["versions"]["numpy"][0].isdigit()


def test_wires_are_also_read_from_the_resolved_graph(tmp_path, record, load):
    record["resolved"] = {"nodes": {node["name"]: {"inputs": node.pop("inputs")} for node in record["nodes"]}}
    build_report(tmp_path, record, load)
    headline = json.loads((tmp_path / "report.json").read_text())["headline"]
    assert headline["Relit PSNR"]["after_seconds"] == 75.0


class _Checker(HTMLParser):
    void = ("meta", "img", "br", "link")

    def __init__(self):
        super().__init__()
        self.stack, self.sources, self.text = [], [], []

    def handle_starttag(self, tag, attributes):
        if tag not in self.void:
            self.stack.append(tag)
        self.sources += [value for name, value in attributes if name in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_the_page_is_well_formed_and_loads_nothing_from_elsewhere(report):
    checker = _Checker()
    checker.feed(report[1])
    assert checker.stack == []
    assert all(source.startswith(("data:image/png;base64,", "#")) for source in checker.sources)
    assert "url(" not in report[1]
    assert "@import" not in report[1]


def test_the_page_shows_figures_floors_pictures_and_the_folded_graph(report):
    page = report[1]
    for text in ("32.40", "uninformed guess: 24.30 dB", "goal: 30.00 dB", "rounds.refine ×2", "A view", "run-1"):
        assert text in page, text
    assert page.count("<svg") >= 5  # node bars, relit and Chamfer over time, loss, graph
    assert page.count('src="data:image/png;base64,') == 1


def test_text_from_the_run_is_escaped(report):
    assert "<script>" not in report[1]
    assert "a &lt;script&gt; &amp; more" in report[1]
    assert "a &lt;b&gt;" in report[1]


def test_a_run_that_failed_early_still_gets_a_report(tmp_path):
    node = {"name": "views", "type": "data.blender", "state": "failed", "seconds": 0.0, "outputs": {}}
    page = build_report(tmp_path, {"graph": "broken", "state": "failed", "nodes": [node]}, lambda digest: None)
    assert "failed" in page.read_text()
    assert list(json.loads((tmp_path / "report.json").read_text())["headline"]) == ["Seconds, total"]


def test_building_it_again_gives_the_same_bytes(tmp_path, record, load):
    first = build_report(tmp_path, record, load).read_bytes()
    assert build_report(tmp_path, record, load).read_bytes() == first
    assert not list(tmp_path.glob(".*partial"))


def test_no_heavy_library_is_imported_by_building_a_report(tmp_path):
    code = f"""
import sys
from pathlib import Path
from exmesh_graph.report import build_report
from exmesh_graph.types import Metrics
output = {{"type": "Metrics", "digest": "m", "bytes": 1}}
node = {{"name": "a", "type": "t", "state": "hit", "seconds": 1.0, "outputs": {{"metrics": output}}}}
build_report(Path({str(tmp_path)!r}), {{"nodes": [node]}}, lambda digest: Metrics({{"x": 1.0}}))
heavy = {{"torch", "open3d", "pxr", "warp", "scipy", "numpy", "pymeshlab", "OpenImageIO"}} & set(sys.modules)
sys.exit(f"imported: {{heavy}}" if heavy else 0)
"""
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_every_svg_is_closed_and_has_no_nan(report):
    charts = re.findall(r"<svg.*?</svg>", report[1], re.S)
    assert len(charts) == report[1].count("<svg")
    assert not any("nan" in chart or "inf" in chart.replace("uninformed", "") for chart in charts)


def test_the_error_of_a_fit_is_drawn_against_seconds(tmp_path, record, load, monkeypatch):
    curves = {"iteration": [0, 10, 20], "psnr": [20.0, 25.0, 27.0]}
    monkeypatch.setitem(METRICS, "history", {"curves": curves})
    psnr = [curve for curve in collect(record, load).curves if curve.name == "psnr"]
    assert [curve.span for curve in psnr] == [(5.0, 15.0), (15.0, 25.0)]  # views 1, hull 4, then 10 a round
    assert "seconds spent, even within a node" in build_report(tmp_path, record, load).read_text()


def test_a_film_is_shown_as_what_it_is(tmp_path, record, load):
    root = load("g").root
    (root / "turn.webp").write_bytes(b"RIFF")
    (root / "captions.json").write_text(json.dumps([{"file": "turn.webp", "title": "Film", "caption": ""}]))
    assert "data:image/webp;base64,UklGRg==" in build_report(tmp_path, record, load).read_text()


@pytest.mark.thorough
def test_chromium_shows_the_page_without_a_network(tmp_path, record, load):
    pixels = screenshot(build_report(tmp_path, record, load), 1250, 1800)
    assert pixels.shape == (1800, 1250, 3)
    colors = np.unique((pixels * 255).round().astype(int).reshape(-1, 3), axis=0)
    assert len(colors) > 50
    drawn = np.abs(pixels - pixels[2, 2]).max(axis=2) > 0.1  # against the page's background
    assert 0.02 < drawn.mean() < 0.6
    rows = drawn.any(axis=1).reshape(6, 300).mean(axis=1)
    assert (rows > 0.1).all()  # every part of the page shows something


def test_the_docs_name_every_key_of_report_json(report):
    text = (Path(__file__).parents[2] / "docs" / "report.md").read_text(encoding="utf-8")
    table = text.partition("## report.json")[2].partition("## ")[0]
    named = [
        key for row in table.splitlines() if row.startswith("| `") for key in re.findall(r"`(\w+)`", row.split("|")[1])
    ]
    assert sorted(named) == sorted(report[0])


def test_malformed_figures_of_an_old_store_are_told_and_lose_no_report(record, load):
    values = {"headline": [{"label": "A", "value": [1]}, {"label": "B", "value": 2.0}], "stages": 5}
    told = collect(record, lambda digest: Metrics(values) if digest == "final" else load(digest)).data["warnings"]
    assert [row["message"] for row in told if row["node"] == "shape"] == [
        "its figures are left out: headline[0] (A) has the value [1]: no number, text or bool",
        "its figures are left out: stages is int, no list",
    ]
