"""Variants on the command line: run, plan, check and why of one of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Exmesh = Callable[..., Any]

GRAPH = """
name: toy
nodes:
  one: {type: toy.const, value: 2}
  two: {type: toy.const, value: 5}
  sum: {type: toy.add, a: "@one.number", b: "@two.number"}
  shown: {type: toy.metrics, number: "@sum.number"}
outputs: {figure: "@shown.metrics"}
run: all
"""
VARIANTS = """
extends: toy.yaml
variants:
  lone: [{disconnect: sum.b}]
  more: [{set: two.value, to: 7}]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "toy.yaml").write_text(GRAPH)
    (tmp_path / "study.yaml").write_text(VARIANTS)
    return tmp_path


@pytest.mark.thorough
def test_one_variant_is_checked_planned_run_and_explained(exmesh: Exmesh, folder: Path) -> None:
    assert "2 variants, no faults: lone, more" in exmesh("check", "study.yaml").stdout
    assert exmesh("check", "study.yaml", "--variant", "lone").stdout.startswith("study-lone: 4 nodes")
    exmesh("run", "toy.yaml")
    assert "1 hit, 1 to run, 2 unknown" in exmesh("plan", "study.yaml", "--variant", "more").stdout
    assert "parameter value: 5 -> 7" in exmesh("why", "two", "study.yaml", "--variant", "more").stdout
    shown = exmesh("why", "shown", "study.yaml", "--variant", "more").stdout
    assert "exmesh why sum study.yaml --variant more" in shown
    exmesh("run", "study.yaml", "--variant", "more")
    record = json.loads((folder / "runs/latest/run.json").read_text())
    assert record["resolved"]["variant"] == "more"
    assert record["command"].endswith("--variant more")
    assert json.loads((folder / "runs/latest/figure/metrics.json").read_text())["value"] == 9
    assert "by two of study-more" in exmesh("why", "two").stdout  # the variant of the latest run


def test_an_unknown_variant_is_refused(exmesh: Exmesh, folder: Path) -> None:
    shown = exmesh("run", "study.yaml", "--variant", "lon", code=2).stderr
    assert "no variant 'lon'" in shown
    assert "nearest: lone" in shown
    assert "declare variants:" in exmesh("run", "toy.yaml", "--variant", "lone", code=2).stderr


# --- sweep

STUDY = """
extends: toy.yaml
nodes:
  noisy: {type: toy.seeded, number: "@sum.number"}
  score: {type: toy.score, number: "@noisy.number"}
  gate: {type: toy.fail, number: "@one.number", value: 1}
repeats: {count: 2, of: [noisy]}
variants:
  more: [{set: two.value, to: 9}]
  broken: {doc: The gate does not open., patches: [{set: gate.value, to: 3}]}
"""


def sweep_of(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "runs/latest/sweep.json").read_text())
    return found


def test_a_sweep_runs_shared_nodes_once_and_tells_one_table(exmesh: Exmesh, folder: Path) -> None:
    (folder / "study.yaml").write_text(STUDY)
    assert "3 variants x 2 seeds: 42 nodes, 17 after sharing" in exmesh("sweep", "study.yaml", "--plan").stdout
    done = exmesh("sweep", "study.yaml", "--workers", "0", code=1)
    table = sweep_of(folder)
    assert table["nodes"] == {"of_all_variants": 42, "after_sharing": 17, "from_store": 0, "run": 16}
    rows = {row["variant"]: row for row in table["variants"]}
    assert rows["base"]["figures"]["Value"]["values"] == [7.0, 8.0]  # 2 + 5 + seed
    value = rows["more"]["figures"]["Value"]
    assert (value["mean"], value["difference"], value["exceeds"]) == (11.5, 4.0, True)
    assert (rows["more"]["shared"], rows["more"]["nodes"]) == (2, 7)
    assert rows["broken"]["state"] == "failed"
    assert "the number is too small" in rows["broken"]["reason"]
    assert rows["broken"]["figures"]["Value"]["difference"] == 0
    assert "11.50 ± 0.71  +4.00" in done.stdout
    assert "failed: gate" in done.stdout
    assert "broken:gate alone, on the same inputs: exmesh replay runs/" in done.stdout
    page = (folder / "runs/latest/sweep.html").read_text()
    assert "The gate does not open." in page
    lines = (folder / "runs/latest/sweep.csv").read_text().splitlines()
    assert lines[0].startswith("variant,file,state,reason,repeats,seconds")
    assert len(lines) == 4
    again = exmesh("sweep", "study.yaml", "--workers", "0", code=1)
    assert "16 nodes from the store, 0 run" in again.stdout


def test_a_sweep_of_some_nodes_and_one_variant(exmesh: Exmesh, folder: Path) -> None:
    (folder / "study.yaml").write_text(STUDY)
    words = (
        "sweep",
        "study.yaml",
        "--only",
        "broken",
        "--node",
        "score",
        "--set",
        "seed=5",
        "--workers",
        "0",
        "--stop",
    )
    exmesh(*words)  # the gate is not among what score needs
    table = sweep_of(folder)
    assert [(row["variant"], row["state"]) for row in table["variants"]] == [("base", "done"), ("broken", "done")]
    assert [repeat["seed"] for repeat in table["variants"][0]["repeats"]] == [5, 6]
    assert table["command"].endswith("--set seed=5 --only broken --node score --workers 0 --stop")
    exmesh("sweep", "study.yaml", "--node", "broken:gate", "--workers", "0", code=1)
    assert [row["state"] for row in sweep_of(folder)["variants"]][-1] == "failed"
    assert "no variant has a node 'scor'" in exmesh("sweep", "study.yaml", "--node", "scor", code=2).stderr
    assert "no variant 'brok'" in exmesh("sweep", "study.yaml", "--only", "brok", code=2).stderr


def test_an_interrupted_sweep_says_how_to_go_on(exmesh: Exmesh, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(self: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("exmesh_graph.graph.run.runner.Runner._loop", interrupt)
    shown = exmesh("sweep", "study.yaml", "--only", "lone", "--workers", "0", "--runs", "r", code=130).stderr
    assert "go on with the same command:\n  exmesh sweep study.yaml --only lone --runs r" in shown
    assert json.loads((folder / "r/latest/run.json").read_text())["state"] == "interrupted"


def test_a_sweep_of_two_files(exmesh: Exmesh, folder: Path) -> None:
    (folder / "other.yaml").write_text(VARIANTS.replace("two.value", "one.value"))
    done = exmesh("sweep", "study.yaml", "other.yaml", "--workers", "0")
    assert "6 variants: 24 nodes" in done.stdout
    assert "other/more" in done.stdout
    assert {row["file"] for row in sweep_of(folder)["variants"]} == {"study", "other"}
    (folder / "third.yaml").write_text("extends: toy.yaml\nvariants: {own: [{set: one.value, to: 4}]}")
    shown = exmesh("sweep", "study.yaml", "third.yaml", "--only", "own", "--plan").stdout
    assert shown.startswith("2 variants: 8 nodes")
    assert "no variant 'owm'" in exmesh("sweep", "study.yaml", "third.yaml", "--only", "owm", code=2).stderr
    (folder / "deep").mkdir()
    (folder / "deep/study.yaml").write_text("extends: ../toy.yaml\nvariants: {own: [{set: one.value, to: 4}]}")
    assert "deep/study/own" in exmesh("sweep", "study.yaml", "deep/study.yaml", "--plan").stdout


def test_faults_of_all_files_of_a_sweep_come_at_once(exmesh: Exmesh, folder: Path) -> None:
    (folder / "bad.yaml").write_text("extends: toy.yaml\nvariants: {x: [{bypass: summ}], y: [{set: one.valu, to: 1}]}")
    shown = exmesh("sweep", "bad.yaml", "study.yaml", code=2).stderr
    assert "variant x: there is no node 'summ'" in shown
    assert "variant y: toy.const has no parameter 'valu'" in shown


# --- diff and show


def test_diff_says_what_changes_and_what_runs_again(exmesh: Exmesh, folder: Path) -> None:
    shown = exmesh("diff", "study.yaml", "--variant", "lone").stdout.splitlines()
    assert shown == [
        "sum: b from @two.number -> nothing",
        "2 of 4 nodes stay as they are; new or below a change: sum, shown",
    ]
    shown = exmesh("diff", "toy.yaml", "study.yaml", "--set", "one.value=3", "-o", "d.svg").stdout.splitlines()
    assert shown[0] == "one: value 2 -> 3"
    assert shown[-1] == "d.svg"
    svg = (folder / "d.svg").read_text()
    assert 'class="gp-box changed" data-name="one"' in svg
    assert 'class="gp-box rerun" data-name="sum"' in svg
    assert 'class="gp-box " data-name="two"' in svg
    assert exmesh("diff", "toy.yaml", "toy.yaml").stdout.startswith("the graphs are the same")
    assert "diff needs two graphs" in exmesh("diff", "toy.yaml", code=2).stderr
    assert "cannot draw d.png" in exmesh("diff", "toy.yaml", "study.yaml", "-o", "d.png", code=2).stderr


def test_diff_shows_a_change_in_a_component_where_it_is_plugged_in(exmesh: Exmesh, folder: Path) -> None:
    (folder / "curve.yaml").write_text("""
extends: toy.yaml
nodes:
  line: {type: curve.line, slope: 2}
  both: {type: curve.sum, first: "@line"}
  one_more: {type: toy.evaluate, number: "@one.number", curve: "@line"}
  two_more: {type: toy.evaluate, number: "@two.number", curve: "@both"}
""")
    exmesh("diff", "curve.yaml", "--set", "line.slope=3", "-o", "d.svg")
    svg = (folder / "d.svg").read_text()
    assert 'class="gp-box changed" data-name="one_more"' in svg
    assert "line: slope 2 -&gt; 3" in svg
    assert 'class="gp-box changed" data-name="two_more"' in svg
    assert "both: a component in it changed" in svg
    assert 'class="gp-box " data-name="sum"' in svg


def test_diff_of_two_runs(exmesh: Exmesh, folder: Path) -> None:
    (folder / "study.yaml").write_text(STUDY)
    exmesh("run", "study.yaml", "--workers", "0", "--runs", "a")
    exmesh("run", "study.yaml", "--variant", "more", "--workers", "0", "--runs", "b")
    shown = exmesh("diff", "a/latest", "b/latest", "-o", "runs.html").stdout
    assert "two: value 5 -> 9" in shown
    assert "Value: 7 -> 11 apples" in shown
    assert "2 of 7 keys are the same" in shown
    assert "other code" not in shown
    assert 'class="gp-box changed" data-name="two"' in (folder / "runs.html").read_text()


def test_show_draws_graphs_and_runs(exmesh: Exmesh, folder: Path) -> None:
    text = exmesh("show", "toy.yaml").stdout
    assert text.startswith("flowchart TD")
    assert "one --> sum" in text
    assert "class one run" in text
    exmesh("run", "toy.yaml", "--workers", "0")
    assert "class one hit" in exmesh("show", "toy.yaml").stdout
    assert exmesh("show", "study.yaml", "--variant", "lone", "-o", "pictures/lone.svg").stdout == "pictures/lone.svg\n"
    svg = (folder / "pictures/lone.svg").read_text()
    assert 'class="gp-box hit" data-name="one"' in svg
    assert "in   a: Number  from @one.number" in svg
    exmesh("show", "runs/latest", "-o", "run.html")
    assert 'class="gp-box done" data-name="sum"' in (folder / "run.html").read_text()


def test_show_draws_components_and_what_they_plug_into(exmesh: Exmesh, folder: Path) -> None:
    (folder / "curve.yaml").write_text("""
extends: toy.yaml
nodes:
  line: {type: curve.line, slope: 2}
  idle: {type: curve.line}
  both: {type: curve.sum, first: "@line"}
  three: {type: toy.evaluate, number: "@two.number", curve: "@both"}
""")
    text = exmesh("show", "curve.yaml").stdout
    assert "both --> three" in text
    assert "curve.sum<br>component" in text
    assert "idle" not in text  # plugged in nowhere
    exmesh("run", "curve.yaml", "--workers", "0")
    assert "both --> three" in exmesh("show", "runs/latest").stdout
    exmesh("diff", "toy.yaml", "curve.yaml", "-o", "d.svg")
    assert 'data-name="both"' in (folder / "d.svg").read_text()


def test_diff_calls_a_node_changed_of_which_some_rounds_go(exmesh: Exmesh, folder: Path) -> None:
    (folder / "rounds.yaml").write_text("""
nodes:
  a: {type: toy.const, value: 2}
  start: {type: toy.step, state: "@a.number"}
  rounds:
    repeat: 3
    carry: {state: "@start.state"}
    nodes: {hop: {type: toy.step, state: "@carry.state"}}
    next: {state: "@hop.state"}
""")
    exmesh("diff", "rounds.yaml", "--set", "rounds.repeat=2", "-o", "d.svg")
    svg = (folder / "d.svg").read_text()
    assert 'class="gp-box changed" data-name="rounds.hop"' in svg
    assert "1 round removed" in svg
