"""Looks in a real browser: a large asset in levels, its surfaces and lights, Gaussians, two with one camera."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import exmesh_graph as ex
from exmesh_graph.graph.declare.packs import load_packs
from tests.studio.browser import Studio, browser_page, place, reveal, select
from tests.studio.test_studio_page import keep

pytestmark = pytest.mark.slow

SHOWN = Path(__file__).parent / "shown"
GRAPH = """\
name: shown
nodes:
  large: {type: shown.asset, side: 317, maps: 2048}
  flat: {type: shown.asset, height: 0.02}
  high: {type: shown.asset, height: 0.3}
  cloud: {type: shown.cloud}
"""


TIMED = """() => {
  let began = 0;
  addEventListener('click', () => { began = performance.now(); }, { capture: true, once: true });
  const look = () => {
    const canvas = document.querySelector('.stage canvas[data-drawn]'), title = document.querySelector('.look-title');
    if (began && canvas && title.innerText.includes('large.')) window.drawn = performance.now() - began;
    else requestAnimationFrame(look);
  };
  look();
}"""


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    pytest.importorskip("playwright", reason="needs playwright: the extra `browser`")
    folder = tmp_path_factory.mktemp("shown")
    (folder / "shown.yaml").write_text(GRAPH)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SHOWN))
        patch.setenv("PYTHONPATH", str(SHOWN))
        assert "shown.asset" in load_packs().types
        ex.run(folder / "shown.yaml", workers=0, progress=False, store=folder / ".exmesh", runs=folder / "runs")
        made = Studio(folder / "shown.yaml")
        yield made
        made.end()


@pytest.fixture
def page(studio: Studio) -> Iterator[Any]:
    with browser_page() as browser:
        browser.goto(studio.address)
        browser.wait_for_selector(".plan:has-text('in the store')")
        yield browser
        assert not browser.faults


def test_a_large_asset_comes_in_levels_and_turns_in_all_its_surfaces(page: Any) -> None:
    look(page, "flat")  # the viewer's own script is there then
    reveal(page, "large")
    spot = place(page, '[data-node="large"] .box-name')
    page.evaluate(TIMED)
    page.mouse.click(*spot)  # what is looked at follows what is selected
    page.wait_for_selector(".look-title:has-text('large.')")
    page.wait_for_selector("canvas[data-drawn]")
    print(f"200 000 faces and maps of 2048: first level drawn after {page.evaluate('window.drawn') / 1e3:.2f} s")
    first = int(page.locator("canvas[data-faces]").get_attribute("data-faces"))
    assert 5000 < first < 30_000  # the first level: about 20 000
    pictures = {}
    for kind in ("shaded", "base color", "roughness", "normals", "wireframe", "uv", "checker"):
        surface(page, kind)
        pictures[kind] = drawn(page)
    assert len(set(pictures.values())) == len(pictures)  # each shows something else
    page.click("button:has-text('all 199')")
    page.wait_for_selector('canvas[data-faces="199712"]', state="attached")
    keep(page, "levels")


def test_an_asset_under_other_lights_its_maps_and_its_atlas(page: Any) -> None:
    look(page, "high")
    surface(page, "shaded")
    lit = {}
    for light in ("overcast", "recovered", "studio"):
        page.click(f'[aria-label="Light"] button:text-is("{light}")')
        lit[light] = drawn(page)
    page.locator('.slider-label:has-text("Turn") input').fill("120")
    lit["turned"] = drawn(page)
    page.locator('.slider-label:has-text("Exposure") input').fill("2")
    lit["brighter"] = drawn(page)
    same = [(a, b) for a in lit for b in lit if a < b and lit[a] == lit[b]]
    assert not same
    for show, thing in (
        ("atlas with stretch", "img"),
        ("maps", "img"),
        ("environment", "img"),
        ("under any light", "iframe"),
    ):
        page.click(f'.shows [role=tab]:text-is("{show}")')
        page.wait_for_selector(f".look-area {thing}", state="attached")
        page.wait_for_timeout(300)
        assert page.locator(".look-area .over:has-text('⚠')").count() == 0, show
    page.click('.shows [role=tab]:text-is("atlas with stretch")')
    seen = [drawn(page, ".picture")]
    for button in page.locator('[aria-label="Layer"] button').all():
        button.click()
        seen.append(drawn(page, ".picture"))
    assert len(set(seen)) > 1


def test_two_artifacts_have_one_camera_side_by_side_and_under_a_wipe(page: Any) -> None:
    look(page, "flat")
    select(page, "high", "Results")
    page.click(".output:has-text('asset') button:has-text('Beside')")
    page.locator("canvas[data-drawn]").nth(1).wait_for()
    before = [drawn(page, f".side >> nth={k}") for k in (0, 1)]
    x, y = place(page, ".side >> nth=0")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 90, y - 25, steps=6)
    page.mouse.up()
    after = [drawn(page, f".side >> nth={k}") for k in (0, 1)]
    assert before[0] != after[0]
    assert before[1] != after[1]  # the other one turned with it
    page.click("button:text-is('Wipe')")
    page.wait_for_timeout(600)
    half = drawn(page, ".look-area")
    page.focus(".cut")
    for _ in range(12):
        page.keyboard.press("ArrowLeft")
    assert drawn(page, ".look-area") != half
    keep(page, "wiped")


def test_gaussians_are_drawn_as_points(page: Any) -> None:
    look(page, "cloud", "gaussians")
    page.click(".shows [role=tab]:has-text('points'), .shows [role=tab]:has-text('Gaussians')") if page.locator(
        ".shows"
    ).count() else None
    page.wait_for_selector("canvas[data-drawn]")
    first = drawn(page)
    x, y = place(page, ".stage canvas")
    page.mouse.move(x, y)
    page.mouse.wheel(0, -400)
    assert drawn(page) != first
    keep(page, "gaussians")


def look(page: Any, node: str, output: str = "asset") -> None:
    """The first look of a node's output, once it is drawn."""
    select(page, node, "Results")
    page.click(f".output:has-text('{output}') button:text-is('Look')")
    page.wait_for_selector(f".look-title:has-text('{node}.')")
    page.wait_for_selector("canvas[data-drawn]")


def surface(page: Any, kind: str) -> None:
    page.locator('select[aria-label="how the surface is shown"]').select_option(label=kind)


def drawn(page: Any, selector: str = ".stage canvas") -> bytes:
    """The picture of a part of the page once it has come to rest."""
    last = b""
    for _ in range(20):
        page.wait_for_timeout(250)
        now: bytes = page.locator(selector).first.screenshot()
        if now == last:
            break
        last = now
    return last
