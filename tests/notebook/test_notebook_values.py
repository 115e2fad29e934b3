"""What wire types show of themselves in a notebook: whole, offline, apart from each other, of bounded size."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from IPython.core.formatters import DisplayFormatter

from exmesh_graph import notebook, testing
from exmesh_graph.gallery import models as glb
from exmesh_graph.notebook.values import artifact_html
from exmesh_graph.types import (
    Artifact,
    Decision,
    DepthMaps,
    EnvMap,
    Files,
    Frame,
    Gallery,
    LitViews,
    Metrics,
    PlanarGaussians,
    PointCloud,
    Region,
    SceneNeeds,
    ScoredViews,
    UsdAsset,
)
from tests.report.chromium import WEBGL, screenshot

VOID = {"img", "br", "meta", "input", "hr"}


@pytest.fixture(scope="module")
def views() -> Any:
    return testing.views(count=4, size=32)


def examples(views: Any, folder: Path) -> dict[str, Artifact]:
    ball = testing.mesh(1)
    folder.mkdir()
    (folder / "captions.json").write_text(json.dumps([{"file": "a.webp", "title": "A film", "caption": "It turns."}]))
    (folder / "a.webp").write_bytes(b"RIFF")
    lit = LitViews(**{**vars(views), "environments": np.ones((4, 8, 16, 3), np.float32)})
    return {
        "mesh": ball,
        "carrier": testing.carrier(),
        "state": testing.state(),
        "asset": testing.asset(metallic=np.zeros((32, 32), np.float32)),
        "views": views,
        "lit": lit,
        "depth": testing.depth_maps(ball, views),
        "nothing measured": DepthMaps(("a",), np.zeros((1, 8, 8), np.float32)),
        "region": Region(("a",), np.ones((1, 8, 8), bool), *2 * [np.ones((1, 8, 8), np.float32)]),
        "light": EnvMap(testing.sky()),
        "metrics": Metrics({"headline": [{"label": "held out", "value": 31.5, "unit": "dB", "floor": 12.0}],
                            "iteration": [1, 2, 3], "psnr": [10.0, 20.0, 25.0], "holes": 3}),
        "gallery": Gallery(folder, "a.webp"),
        "files": Files(folder, "a.webp"),
        "needs": SceneNeeds({"bounces": Decision(1, 0.3, 0.1, 1.2, "Light <bounces>.")}),
        "scored": ScoredViews(({"kind": "held_out", "name": "v0", "number": 0, "figures": {}},),
                              np.ones((1, 2, 8, 8, 3), np.float16), "v0", np.eye(3), np.eye(4)),
        "gaussians": PlanarGaussians(ball.vertices, ball.vertices, np.ones((len(ball.vertices), 4), np.float32),
                                     np.ones(len(ball.vertices), np.float32),
                                     np.ones((len(ball.vertices), 1, 3), np.float32)),
        "points": PointCloud(ball.vertices, np.abs(ball.vertices)),
    }  # fmt: skip


class Page(HTMLParser):
    """Tags that are open at the end, ids, and the pages in frames."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.frames: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if tag not in VOID:
            self.open.append(tag)
        self.ids += [str(found["id"])] if "id" in found else []
        self.frames += [str(found["srcdoc"])] if "srcdoc" in found else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_every_type_shows_itself_whole_and_offline(views: Any, tmp_path: Path) -> None:
    for name, value in examples(views, tmp_path / "gallery").items():
        html = artifact_html(value)
        assert html is not None, name
        page = Page(html)
        assert page.open == [], name
        assert page.ids == [], name  # so that several outputs on one page cannot clash
        assert len(html) < 400_000, name
        assert not re.search(r"(?:src|href)=[\"']?https?:|url\(\s*[\"']?https?:|@import", html), name


def test_a_mesh_turns_in_a_frame_of_its_own(views: Any) -> None:
    for value, choices in ((testing.mesh(1), True), (testing.carrier(), False), (testing.asset(), False)):
        (frame,) = Page(artifact_html(value) or "").frames
        assert '"modules"' in frame
        assert f"{len(value.faces)} faces" in frame
        assert ("display: none !important; }</style>" in frame) == choices  # a bare mesh has no maps to choose
        assert frame.startswith("<!DOCTYPE html>")


def test_views_are_a_sheet_with_names_and_at_most_24(views: Any) -> None:
    html = artifact_html(views) or ""
    assert html.count("<img") == 4
    assert all(name in html for name in views.names)
    many = replace(views.subset([0] * 60), names=tuple(f"n{i}" for i in range(60)))
    html = artifact_html(many) or ""
    assert html.count("<img") == 24
    assert "24 of 60" in html


def test_figures_come_with_their_floor_and_histories_as_curves(views: Any, tmp_path: Path) -> None:
    html = artifact_html(examples(views, tmp_path / "gallery")["metrics"]) or ""
    assert "31.50 dB" in html
    assert "uninformed guess 12" in html
    assert html.count("<polyline") == 1
    assert "holes" in html


def test_texts_are_escaped(views: Any, tmp_path: Path) -> None:
    html = artifact_html(examples(views, tmp_path / "gallery")["needs"]) or ""
    assert "&lt;bounces&gt;" in html


def test_what_a_page_cannot_bear_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(glb, "MAX_FACES", 10)
    html = artifact_html(testing.mesh(1)) or ""
    assert "Not shown: the mesh has 80 faces" in html
    assert "<iframe" not in html


def test_a_usd_asset_of_a_run_turns(tmp_path: Path) -> None:
    from exmesh_graph.export.usd import write_usd

    write_usd(tmp_path / "usd", testing.asset())
    html = artifact_html(UsdAsset(tmp_path / "usd", "asset.usdz")) or ""
    assert "As asset.usdz holds it" in Page(html).frames[0]
    assert "scene.usda" in html


def test_a_type_of_ones_own_says_how_it_looks() -> None:
    @dataclass(frozen=True, eq=False)
    class Note(Artifact):
        text: str = "x"

        def _repr_html_(self) -> str:
            return f"<b>{self.text}</b>"

    assert artifact_html(Note("hello")) == "<b>hello</b>"
    assert artifact_html(Frame(np.eye(4), np.eye(4))) is None  # its text says all


def test_texts_are_short(views: Any, tmp_path: Path) -> None:
    for name, value in examples(views, tmp_path / "gallery").items():
        assert len(repr(value)) < 330, name
        assert "\n" not in repr(value), name
    assert repr(testing.mesh(1)) == "Mesh(vertices [42, 3], faces [80, 3]; manifold, closed, units normalised)"


def test_a_text_does_not_fail_where_facets_do() -> None:
    @dataclass(frozen=True, eq=False)
    class Broken(Artifact):
        values: np.ndarray

        def facets(self) -> dict[str, Any]:
            raise ValueError

    assert repr(Broken(np.zeros((3, 7)))).endswith("Broken(values [3, 7])")


def test_ipython_shows_the_types_and_imports_nothing_for_it(views: Any) -> None:
    shell = SimpleNamespace(display_formatter=DisplayFormatter())
    assert notebook.register(shell)
    data, _ = shell.display_formatter.format(testing.state())  # by its base
    assert "<iframe" in data["text/html"]
    assert data["text/plain"].startswith("Stage1State(")
    plain, _ = shell.display_formatter.format(Frame(np.eye(4), np.eye(4)))
    assert set(plain) == {"text/plain"}
    assert not notebook.register()  # no kernel runs here
    shell.display_formatter.formatters["text/html"].for_type(Artifact, lambda value: "mine")
    notebook.register(shell)
    assert shell.display_formatter.format(testing.mesh(1))[0]["text/html"] == "mine"


def test_the_classes_that_are_shown_exist() -> None:
    from importlib import import_module

    for module, name in notebook.SHOWN:
        assert hasattr(import_module(module), name)


@pytest.mark.slow
def test_several_models_turn_on_one_page(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    outputs = [artifact_html(value) or "" for value in (testing.mesh(1), testing.carrier(), testing.asset())]
    page.write_text(f"<!DOCTYPE html><meta charset=utf-8>{''.join(outputs)}", encoding="utf-8")
    shot = screenshot(page, 900, 1500, *WEBGL, "--virtual-time-budget=20000")
    thirds = [shot[top + 130 : top + 330, 350:550] for top in (0, 440, 1020)]
    assert all(np.ptp(third) > 0.2 for third in thirds)  # the asset's light has 16 columns
    saturation = [np.ptp(third, axis=-1).max() for third in thirds]
    assert saturation[0] < 0.25 < min(saturation[1:])  # clay, and the colours of the texture
