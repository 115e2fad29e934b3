"""Steering and rewiring in a real browser, on nodes that take no time: bypass, swap, loops, frames, saving, faults."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.session import current_session
from tests.studio.browser import Studio, browser_page, place, reveal, select
from tests.studio.conftest import GRAPH, TOY
from tests.studio.test_studio_page import keep

pytestmark = pytest.mark.slow

PART = """\
inputs: {number: {type: Number}}
nodes:
  twice: {type: toy.add, a: "@inputs.number", b: "@inputs.number"}
  more: {type: toy.step, state: "@twice.number"}
outputs: {number: "@more.state"}
"""
RUNS = """\
name: runs
nodes:
  one: {type: toy.const, value: 1}
  wait: {type: toy.slow, number: "@one.number", seconds: 20, steps: 200}
  bad: {type: toy.fail, number: "@wait.number", value: 5}
  # after it
  last: {type: toy.add, a: "@bad.number"}
outputs: {last: "@last.number"}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    pytest.importorskip("playwright", reason="needs playwright: the extra `browser`")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(TOY))
        patch.syspath_prepend(str(TOY))
        made = tmp_path_factory.mktemp("edited")
        (made / "part.yaml").write_text(PART)
        held = GRAPH.replace("  files:", '  part: {graph: part.yaml, number: "@sum.number"}\n  files:')
        (made / "small.yaml").write_text(held.replace('folder, number: "@sum', 'folder, number: "@part'))
        (made / "runs.yaml").write_text(RUNS)
        yield made
        shutil.rmtree(made)


@pytest.fixture(scope="module")
def studio(folder: Path) -> Iterator[Studio]:
    made = Studio(folder / "small.yaml")
    yield made
    made.end()


@pytest.fixture
def page(studio: Studio) -> Iterator[Any]:
    with browser_page() as browser:
        browser.goto(studio.address)
        browser.wait_for_selector(".plan:has-text('would run'), .plan:has-text('in the store')")
        yield browser
        assert not browser.faults


def test_bypass_and_swap(page: Any) -> None:
    select(page, "rounds.leap")
    page.click(".inspector button:text-is('Bypass')")
    page.wait_for_selector('[data-node="rounds.leap"]', state="detached")
    assert page.locator('[data-node="rounds.step"]').count() == 1
    undone(page)
    page.wait_for_selector('[data-node="rounds.leap"]')
    select(page, "rounds.step")
    page.click(".inspector button:text-is('Swap…')")
    page.click(".swaps button:has-text('toy.leap')")
    page.wait_for_selector('[data-node="rounds.step"]:has-text("toy.leap")')
    assert page.locator(".plan.bad").count() == 0
    undone(page)


def test_a_loop_is_wired_by_dragging_the_ends_of_its_frame(page: Any) -> None:
    frame = '[data-frame="rounds"]'
    reveal(page, "rounds.leap")
    drag(page, '[data-node="rounds.step"] [data-handleid="out:state"]', f'{frame} [data-handleid="next:state"]')
    page.wait_for_selector(".dirty")
    page.click('.dock [role=tab]:has-text("Changes")')
    page.wait_for_selector(".patch:has-text('connect: rounds.next.state')")
    page.keyboard.press("f")  # all of it beside the text
    drag(page, f'{frame} [data-handleid="carry:state"]', '[data-node="rounds.leap"] [data-handleid="in:state"]')
    page.wait_for_selector(".patch:has-text('connect: rounds.leap.state, to: \"@carry.state\"')")
    keep(page, "loop")
    undone(page)
    undone(page)


def test_rounds_and_sub_graphs_fold_and_open(page: Any) -> None:
    views = page.locator('[data-frame="rounds"] .switch button')
    views.nth(0).click()
    page.wait_for_selector('[data-node="rounds"].kind-block')
    assert page.locator('[data-node="rounds.step"]').count() == 0
    x, y = place(page, '[data-node="rounds"] .box-name')
    page.mouse.dblclick(x, y)
    page.wait_for_selector('[data-frame="rounds"]')
    page.locator('[data-frame="rounds"] .switch button').nth(2).click()
    page.wait_for_selector('[data-frame="rounds[1]"]')
    page.click(".react-flow__controls-fitview")
    place(page, '[data-frame="rounds[1]"]')
    page.locator('[data-node="rounds.step"]').nth(2).wait_for()  # one for each round
    keep(page, "rounds")
    page.locator('[data-frame="rounds[1]"] .switch button').nth(1).click()
    page.wait_for_selector('[data-frame="part"] .switch')
    assert page.locator('[data-node="part.twice"]').count() == 1
    page.locator('[data-frame="part"] .switch button').nth(0).click()
    page.wait_for_selector('[data-node="part"].kind-part')
    assert page.locator('[data-node="part.twice"]').count() == 0


def test_inside_sub_graphs_and_in_one_round(page: Any) -> None:
    page.keyboard.press("f")
    select(page, "part.more")
    page.click(".inspector button:text-is('Bypass')")
    page.wait_for_selector('[data-node="part.more"][data-state=bypassed]')
    keep(page, "bypassed")
    page.click(".inspector button:text-is('Use it again')")
    page.wait_for_selector('[data-node="part.more"]:not([data-state=bypassed])')
    page.click(".inspector button:text-is('Swap…')")
    page.click(".swaps button:has-text('toy.leap')")
    page.wait_for_selector('[data-node="part.more"]:has-text("toy.leap")')
    page.keyboard.press("a")
    page.locator(".window select").select_option("part")
    page.fill(".window input[type=search]", "toy.const")
    page.click(".window .list button:has-text('toy.const')")
    page.keyboard.press("Enter")
    page.wait_for_selector('.box.selected[data-node="part.const"]')
    page.keyboard.press("Delete")
    page.wait_for_selector('[data-node="part.const"]', state="detached")
    for _ in range(3):
        undone(page)
    page.wait_for_selector(".dirty", state="detached")
    select(page, "rounds.leap", "Parameters")
    page.locator(".round-choice select").select_option("2")
    page.click(".inspector button:text-is('Bypass in round 2')")
    page.locator('[data-frame="rounds"] .switch button').nth(2).click()
    page.wait_for_selector('[data-node="rounds.leap"][data-state=bypassed]', state="attached")
    assert page.locator('[data-node="rounds.leap"][data-state=bypassed]').count() == 1
    undone(page)


def test_edits_are_saved_in_place_and_as_a_child(page: Any, folder: Path) -> None:
    before = (folder / "small.yaml").read_text()
    change(page, "one", "value", "7")
    save(page, "In place")
    assert (folder / "small.yaml").read_text() == before.replace("value: 1}     # begins", "value: 7}     # begins")
    change(page, "one", "value", "8")
    save(page, "As a new file", "mine")
    page.wait_for_selector(".file:has-text('mine.yaml')")
    assert (folder / "mine.yaml").read_text() == "extends: small.yaml\nname: mine\nnodes:\n  one: {value: 8}\n"
    current_session().check(folder / "mine.yaml")
    change(page, "one", "value", "1")
    save(page, "As a variant", "few")
    page.wait_for_selector(".file:has-text('few')")
    assert (folder / "mine.yaml").read_text().endswith("variants:\n  few:\n    - {set: one.value, to: 1}\n")
    opened(page, "small.yaml")


def test_a_run_is_stopped_gone_on_with_fails_and_tells_why(page: Any, folder: Path) -> None:
    opened(page, "runs.yaml")
    page.click("button.run")
    page.wait_for_selector('[data-node="wait"][data-state=running]')
    page.wait_for_selector(".chart path, .chart polyline", state="attached")  # the loss grows while it runs
    first = page.locator(".charts").inner_html()
    for _ in range(60):
        page.wait_for_timeout(200)
        if page.locator(".charts").inner_html() != first:
            break
    assert page.locator(".charts").inner_html() != first
    page.click("button.stop")
    page.keyboard.press("Escape")
    page.wait_for_selector(".run-card:has-text('interrupted')")
    page.click(".run-card button:has-text('Go on')")
    page.wait_for_selector('[data-node="bad"][data-state=failed]')
    reveal(page, "last")
    assert page.locator('[data-node="last"]').get_attribute("data-state") in ("blocked", "waiting", "unknown")
    select(page, "bad", "State")
    page.wait_for_selector(".failure:has-text('the number is too small')")
    assert "exmesh replay" in page.inner_text(".failure .command code")
    keep(page, "failed")
    page.click(".why button:has-text('Log of this node')")
    page.wait_for_selector(".log:has-text('about to compare')")
    select(page, "one", "State")
    page.wait_for_selector(".why:has-text('in the store')")
    assert "memory up to" in page.inner_text(".why")
    select(page, "wait", "State")
    page.wait_for_selector(".why .card:has-text('In the run')")
    # what it would take to mend it, and the run as it was
    change(page, "bad", "value", "0")
    page.wait_for_selector(".plan:has-text('would run')")
    page.wait_for_selector('[data-node="bad"][data-state=run]')  # other work than that which failed
    select(page, "bad", "State")
    page.wait_for_selector(".why:has-text('value')")  # why it must run: the parameter that was changed
    page.click("button.run")
    page.wait_for_selector(".plan:has-text('in the store')")


def test_a_run_of_another_state_of_the_file_is_drawn_with_its_own_graph(page: Any, folder: Path) -> None:
    opened(page, "runs.yaml")
    page.click("button.run")
    page.wait_for_selector(".run-card:has-text('of 4 nodes')")
    page.wait_for_selector("button.stop", state="detached")
    (folder / "runs.yaml").write_text("name: runs\nnodes: {other: {type: toy.const, value: 3}}\n")
    opened(page, "runs.yaml")
    page.wait_for_selector('[data-node="other"]')
    page.click(".menu-holder > button")
    page.locator(".menu.runs .run-line button[role=menuitem]").first.click()
    page.wait_for_selector('[data-node="wait"]')
    assert page.locator('[data-node="other"]').count() == 0
    page.wait_for_selector("text=A run's own graph")
    keep(page, "own_graph")
    page.click("button:has-text('Back to the open graph')")
    page.wait_for_selector('[data-node="other"]')


def test_names_that_are_words_of_javascript(page: Any, folder: Path) -> None:
    (folder / "words.yaml").write_text(
        "nodes:\n  constructor: {type: toy.const}\n  __proto__: {type: toy.add, a: '@constructor.number'}\n"
        "  toString: {type: constructor}\n"
    )
    opened(page, "words.yaml")
    for node in ("constructor", "__proto__", "toString"):
        select(page, node)
    assert page.locator(".plan.bad").count() == 1  # there is no type `constructor`
    opened(page, "small.yaml")


def drag(page: Any, source: str, target: str) -> None:
    (x0, y0), (x1, y1) = place(page, source), place(page, target)
    page.mouse.move(x0, y0)
    page.mouse.down()
    page.mouse.move(x0 + 12, y0 + 6, steps=4)
    page.wait_for_selector(".handle.fits", state="attached")
    page.mouse.move(x1, y1, steps=8)
    page.wait_for_timeout(200)
    page.mouse.up()


def undone(page: Any) -> None:
    page.click("button[aria-label=Undo]")
    page.wait_for_timeout(300)


def change(page: Any, node: str, parameter: str, text: str) -> None:
    select(page, node, "Parameters")
    field = page.locator(f'.field:has(label:text-is("{parameter}")) input').first
    field.fill(text)
    field.press("Enter")
    page.wait_for_selector(".dirty")


def save(page: Any, kind: str, name: str = "") -> None:
    page.click("button:text-is('Save…')")
    page.click(f".window .choice:has-text('{kind}')")
    if name:
        page.locator(".window input[required]").fill(name)
    page.click(".window button[type=submit]")
    page.wait_for_selector(".dirty", state="detached")


def opened(page: Any, file: str) -> None:
    page.click("button.file")
    page.click(f".window .list-row button:has-text('{file}') >> nth=0")
    page.wait_for_selector(f".file:has-text('{file}')")
    page.wait_for_selector(".window", state="detached")
    page.wait_for_timeout(500)
