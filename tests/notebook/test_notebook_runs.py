"""Graphs and runs in a notebook: pictures with states, progress, the summary; a kernel that is interrupted."""

from __future__ import annotations

import os
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from queue import Empty
from typing import Any

import pytest

import exmesh_graph as ex
from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.notebook import runs
from exmesh_graph.notebook.runs import (
    LiveRun,
    checked_html,
    difference_html,
    graph_html,
    node_html,
    plan_html,
    run_html,
    sweep_html,
)

TOY = Path(__file__).parent.parent / "graph" / "toy"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with the toy nodes at hand."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(TOY))
    monkeypatch.delenv("EXMESH_STORE", raising=False)
    assert "toy.const" in load_packs().types
    return tmp_path


def graph() -> ex.Graph:
    made = ex.Graph("small")
    one = made.add("one", "toy.const", value=1)
    step = made.add("step", "toy.step", state=one.number, amount=2)
    made.output("asset", made.add("files", "toy.folder", number=step.state).files)
    return made


def test_a_graph_draws_itself_with_its_states() -> None:
    before = graph_html(graph())
    assert before.count("<svg") == 1
    assert "would run" in before
    assert "toy.step" in before
    ex.run(graph(), workers=0, progress=False)
    after = checked_html(ex.check(graph()))
    assert "from the store" in after
    assert "would run" not in after


def test_a_plan_is_a_table_of_what_would_run() -> None:
    ex.run(graph(), workers=0, progress=False)
    changed = graph()
    changed.set("step", amount=3)
    plan = ex.plan(changed)
    html = plan_html(plan)
    assert "1 from the store, 1 to run, 1 below a node that must run" in html
    assert "parameter amount: 2 -&gt; 3" in html
    assert repr(plan) == str(plan)


def test_a_sweep_and_a_difference_show_themselves() -> None:
    varied = graph()
    varied.variant("more", {"set": "step.amount", "to": 5})
    sweep = ex.sweep(varied, workers=0, progress=False)
    html = sweep_html(sweep)
    assert "<td>more</td>" in html
    assert str(sweep.page) in html
    assert not (sweep.folder / "report.json").exists()
    assert "done" in (run_html(sweep.run) or "")
    assert not (sweep.folder / "report.json").exists()  # looking at it makes none
    changed = graph()
    changed.set("step", amount=3)
    html = difference_html(ex.diff(graph(), changed))
    assert "amount" in html
    assert html.count("<svg") == 1
    assert "<svg" not in difference_html(ex.diff(graph(), graph()))


def test_a_graph_with_faults_says_them() -> None:
    made = ex.Graph("open")
    made.add("step", "toy.step")
    html = graph_html(made)
    assert "<svg" not in html
    assert "state" in html


def test_a_run_is_summed_up() -> None:
    run = ex.run(graph(), workers=0, progress=False)
    html = run_html(run) or ""
    assert "done, 3 nodes, 0 from the store, 3 run" in html
    assert str(run.folder) in html
    assert "Seconds, total" in html
    assert html.count("<svg") == 1
    told = node_html(run["step"])
    assert ".state" in told
    assert "toy.step" in told


def test_a_failed_run_names_its_nodes() -> None:
    made = graph()
    made.output("broken", made.add("broken", "toy.fail", number=made["one"].number).number)
    with pytest.raises(ex.RunFailed) as failure:
        ex.run(made, workers=0, progress=False)
    html = run_html(failure.value.run) or ""
    assert f"failed: broken: {failure.value.records[0]['message']}" in unescape(html)


class Handle:
    """What IPython's display gives back."""

    def __init__(self) -> None:
        self.shown: list[str] = []

    def update(self, content: Any, **_: Any) -> None:
        self.shown.append(content["text/html"])


def test_progress_follows_the_events() -> None:
    live = LiveRun({"a": "toy.a", "b": "toy.b"}, "run-1")
    live.handle = handle = Handle()  # type: ignore[assignment]
    events: list[dict[str, Any]] = [
        {"event": "run_started", "nodes": ["a", "b"]},
        {"event": "node_started", "node": "a"},
        {"event": "progress", "node": "a", "step": 3, "total": 12, "loss": 0.5},
        {"event": "warning", "node": "a", "message": "<thin>"},
    ]
    for k, event in enumerate(events):
        live.listen({"time": float(k), **event})
    html = live.html(4.0)
    assert 'max="12" value="3"' in html
    assert "loss 0.5" in html
    assert "a: &lt;thin&gt;" in html
    assert "running: 0 of 2 nodes" in html
    live.listen({"time": 5.0, "event": "node_finished", "node": "a", "state": "done", "seconds": 4.0})
    live.listen({"time": 6.0, "event": "run_finished", "state": "interrupted"})
    assert "interrupted: 1 of 2 nodes" in live.html(7.0)
    assert "the same call goes on" in live.html(7.0)
    assert 0 < len(handle.shown) < len(events) + 2  # not every event draws


def test_the_summary_takes_the_place_of_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = runs.Cells()
    monkeypatch.setattr(ex.api.progress, "notebook", shown)
    monkeypatch.setattr(ex.api.progress, "in_notebook", lambda: True)
    monkeypatch.setattr(runs, "_cell", lambda: 7)
    handle = Handle()
    monkeypatch.setattr("IPython.display.display", lambda content, **_: handle.update(content) or handle)
    run = ex.run(graph(), workers=0)
    assert "running: 0 of 3" in handle.shown[0]
    assert "done, 3 nodes" in handle.shown[-1]
    assert run_html(run) is None  # the cell shows it already
    monkeypatch.setattr(runs, "_cell", lambda: 8)
    assert run_html(run) is not None
    assert shown.live == {}


@pytest.fixture
def kernel(folder: Path) -> Iterator[Any]:
    """A client of a fresh kernel in the working folder."""
    from jupyter_client.manager import start_new_kernel

    path = os.pathsep.join([str(TOY), *filter(None, [os.environ.get("PYTHONPATH")])])
    manager, client = start_new_kernel(cwd=str(folder), env={**os.environ, "PYTHONPATH": path})
    yield client
    client.stop_channels()
    manager.shutdown_kernel(now=True)


def outputs(client: Any, code: str, interrupt: Any = None) -> list[dict[str, Any]]:
    """What a cell puts out; `interrupt` is called once a node makes progress."""
    asked = client.execute(code)
    found = []
    while True:
        try:
            message = client.get_iopub_msg(timeout=120)
        except Empty:
            pytest.fail("the kernel says nothing")
        if message["parent_header"].get("msg_id") != asked:
            continue
        if message["msg_type"] == "status" and message["content"]["execution_state"] == "idle":
            return found
        found.append({"type": message["msg_type"], **message["content"]})
        if interrupt is not None and 'value="' in str(found[-1].get("data")) and "/200" in str(found[-1]["data"]):
            interrupt()
            interrupt = None


@pytest.mark.slow
def test_a_kernel_shows_a_run_and_stops_it_when_interrupted(kernel: Any) -> None:
    begun = outputs(
        kernel,
        """
import exmesh_graph as ex
ex.call("toy.const", value=1)
g = ex.Graph("slow")
one = g.add("one", "toy.const", value=1)
g.add("long", "toy.slow", number=one.number, seconds=20.0, steps=200)
g""",
    )
    assert "<svg" in begun[-1]["data"]["text/html"]
    kernel_manager = kernel.parent
    stopped = outputs(kernel, "ex.run(g, workers=0)", kernel_manager.interrupt_kernel)
    assert stopped[-1]["ename"] == "KeyboardInterrupt"
    shown = [entry["data"]["text/html"] for entry in stopped if "data" in entry]
    assert "interrupted: 1 of 2 nodes" in shown[-1]
    assert "the same call goes on" in shown[-1]
    again = outputs(kernel, 'ex.run(g, workers=0, set={"long.seconds": 0.0})')
    html = [entry["data"] for entry in again if "data" in entry]
    assert "done, 2 nodes, 1 from the store" in [data["text/html"] for data in html if "text/html" in data][-1]
    assert html[-1]["text/plain"].startswith("<run ")
