"""The studio's page in a real browser: what a newcomer does in the first minutes, from a graph to a compared asset.

`STUDIO_PICTURES=FOLDER pytest -m slow tests/studio/test_studio_page.py` also keeps the pictures of docs/studio.md.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.studio.browser import Studio, browser_page, draw_wire, place, reveal, select

pytestmark = pytest.mark.slow

GRAPHS = Path(__file__).parents[2] / "graphs"
SMALL = """\
# The quickstart in seconds: few nodes, few steps, small pictures.
extends: quickstart.yaml
name: small
params: {faces: 1200, rounds: 2, pbr_iterations: 30, scored_views: 2, supersampling: 1, train_side: 64,
         start_seconds: 1, texels: 128}
nodes:
  rounds:
    nodes:
      refine: {iterations: 20, at: {1: {iterations: 20}}}
      uv: {state: "@merge.state"}
      progress: null
      pictures: null
      flip: null
  settle: {iterations: 30}
  light: {directions: 32}
  probe: null
  neutral: {roughness: 0.5, key_light: false, light_moves: false, needs: null}
  bounce: {bounces: 1, needs: null}
  pbr: {needs: null, metallic: false, light_first: 0, texture_size: 64, environment_height: 16}
  reshape: {iterations: 2, lobe_samples: 2}
  retouch: {directions: 32, bounces: 1, needs: null, iterations: 4}
  look: null
  score: {before: null}
  look_pictures: null
  shape: null
"""


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("graphs")
    for file in GRAPHS.glob("*.yaml"):
        shutil.copy(file, folder)
    shutil.copytree(GRAPHS / "parts", folder / "parts")
    shutil.copytree(GRAPHS / "samples" / "spot", folder / "samples" / "spot")
    (folder / "small.yaml").write_text(SMALL, encoding="utf-8")
    return folder / "small.yaml"


@pytest.fixture(scope="module")
def studio(graph: Path) -> Iterator[Studio]:
    pytest.importorskip("playwright", reason="needs playwright: the extra `browser`")
    made = Studio(graph)
    yield made
    made.end()


def test_a_newcomers_first_minutes(studio: Studio, graph: Path) -> None:
    with browser_page() as page:
        page.goto(studio.address)
        page.wait_for_selector(".plan:has-text('would run')")
        keep(page, "start")

        # watch
        page.click("button.run")
        page.wait_for_selector("[data-state=running]")
        page.wait_for_selector(".chart", timeout=300_000)
        keep(page, "running")
        page.wait_for_selector("button.stop", state="detached", timeout=600_000)
        page.wait_for_selector(".plan:has-text('in the store')")

        # look at every result of these nodes
        for node in ("views", "coarse", "atlas", "rounds.uv", "light", "pbr", "score", "score_pictures", "usd"):
            look_at_all(page, node)
        select(page, "pbr", "Results")
        page.click(".output:has-text('asset') button:has-text('Look')")
        page.click(".shows [role=tab]:has-text('mesh')")
        page.wait_for_selector("canvas[data-drawn]")
        keep(page, "asset")

        # steer: the plan is there before the edit is made
        select(page, "pbr", "Parameters")
        field = page.locator('.field:has(label:text-is("iterations")) input').first
        field.fill("45")
        page.wait_for_selector(".again-why:has-text('would run again')")
        page.wait_for_selector('[data-node="pbr"].again')
        keep(page, "steer")
        field.press("Enter")
        page.wait_for_selector('[data-node="pbr"][data-state=run]')
        assert page.locator('[data-node="bounce"]').get_attribute("data-state") in ("hit", "done")
        run_to_the_end(page)

        # rewire to direct light; what does not fit says why and is not made
        page.keyboard.press("Escape")
        reveal(page, "bounce")
        draw_wire(page, "light out:transport", "pbr in:views", drop=False)
        assert "Transport" in page.inner_text(".why-not")
        keep(page, "rewire")
        page.mouse.up()
        page.wait_for_selector(".toast.error")
        assert page.locator(".dirty").count() == 1
        draw_wire(page, "light out:transport", "pbr in:transport")
        page.wait_for_selector('.tabs button:has-text("Changes") .chip:has-text("2")')
        page.click('.dock [role=tab]:has-text("Changes")')
        page.wait_for_selector(".patch:has-text('@light.transport')")
        keep(page, "changes")
        page.keyboard.press("Control+s")
        page.fill(".window input[placeholder=direct]", "direct")
        page.click(".window button[type=submit]")
        page.wait_for_selector(".toast:has-text('direct')")
        assert "direct" in graph.read_text(encoding="utf-8")
        run_to_the_end(page)

        # compare: two runs, then with and without
        page.click('.dock [role=tab]:has-text("Compare")')
        page.click("button:has-text('Two runs')")
        page.wait_for_selector(".pairs li")
        keep(page, "runs")
        page.click(".pairs button:has-text('pbr.asset')")
        page.locator("canvas[data-drawn]").nth(1).wait_for()
        page.click("button:has-text('Wipe')")
        page.wait_for_timeout(1500)
        keep(page, "wipe")
        select(page, "rounds.merge")
        page.keyboard.press("m")
        page.wait_for_selector("text=no_merge")
        page.click("text=Compare with and without")
        page.wait_for_selector("table.sweep", timeout=600_000)
        assert page.locator("table.sweep tbody tr").count() == 2
        keep(page, "sweep")
        assert not page.faults


def test_a_killed_server_is_told_and_the_page_comes_back(graph: Path) -> None:
    first = Studio(graph)
    port = int(first.address.split(":")[2].split("/")[0])
    with browser_page() as page:
        page.goto(first.address)
        page.wait_for_selector(".box")
        first.kill()
        page.wait_for_selector(".banner.bad:has-text('does not answer')")
        second = Studio(graph, port)
        try:
            page.wait_for_selector(".banner", state="detached")  # by itself: nobody loads it again
            assert page.locator(".box").count() > 0
        finally:
            second.end()


def test_a_second_browser_sees_the_same_and_keys_do_what_the_mouse_does(studio: Studio) -> None:
    with browser_page(scheme="dark") as one:
        one.goto(studio.address)
        one.wait_for_selector(".box")
        other = one.context.new_page()
        other.goto(studio.address)
        other.wait_for_selector(".box")
        one.bring_to_front()
        one.keyboard.press("ArrowRight")
        one.wait_for_selector(".box.selected")
        one.keyboard.press("a")
        one.keyboard.type("decimate")
        one.wait_for_selector(".list [role=option].chosen")
        one.keyboard.press("Escape")
        select(one, "settle", "Parameters")
        field = one.locator('.field:has(label:text-is("iterations")) input').first
        field.fill("31")
        field.press("Enter")
        other.wait_for_selector(".dirty")
        one.keyboard.press("Escape")
        one.mouse.click(*place(one, ".brand"))
        one.keyboard.press("Control+z")
        other.wait_for_selector(".dirty", state="detached")


def test_names_and_texts_of_files_stay_texts(tmp_path: Path) -> None:
    graph = tmp_path / "evil.yaml"
    graph.write_text(
        "# <img src=x onerror=\"document.title='hacked'\">\n"
        "name: \"<script>document.title='hacked'</script>\"\n"
        "params:\n"
        "  size: {type: int, default: 1, ge: 1, doc: \"<img src=x onerror=document.title='hacked'>\"}\n"
        "nodes: {ball: {type: init.sphere}}\n",
        encoding="utf-8",
    )
    studio = Studio(graph)
    try:
        with browser_page() as page:
            page.goto(studio.address)
            page.wait_for_selector(".box, .problems")
            page.wait_for_timeout(1000)
            assert "hacked" not in page.title() or "<script>" in page.title()
            assert page.locator("img[src=x]").count() == 0
            assert page.locator("script:not([src])").count() == 0
    finally:
        studio.end()


def look_at_all(page: Any, node: str) -> None:
    """Everything that a node's results show, each without an error in its place."""
    select(page, node, "Results")
    page.wait_for_selector(".output .buttons button:has-text('Look')")
    for button in page.locator(".output .buttons button:text-is('Look')").all():
        button.click()
        page.wait_for_selector(".look-title")
        page.wait_for_timeout(300)
        shown = page.locator(".shows [role=tab]").all() or [None]
        for tab in shown:
            if tab is not None:
                tab.click()
            things = ("img", "canvas[data-drawn]", "table", ".chart", "iframe", ".tile", "p.pad")
            page.wait_for_selector(", ".join(f".look-area {thing}" for thing in things), state="attached")
            assert page.locator(".look-area .over:has-text('⚠')").count() == 0, f"{node}: {tab and tab.inner_text()}"


def run_to_the_end(page: Any) -> None:
    page.click("button.run")
    page.wait_for_selector("button.stop", timeout=120_000)
    page.wait_for_selector("button.stop", state="detached", timeout=600_000)
    page.wait_for_selector(".plan:has-text('in the store')")


def keep(page: Any, name: str) -> None:
    """The picture of this moment, where pictures are asked for."""
    folder = os.environ.get("STUDIO_PICTURES")
    if folder:
        page.screenshot(path=str(Path(folder) / f"studio_{name}.png"))
