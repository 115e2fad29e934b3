"""What nothing needs does not run: it is named, and left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.variants.checked import check_variant

GRAPH = """
nodes:
  a: {type: toy.const}
  b: {type: toy.shift, number: "@a.number"}
  lonely: {type: toy.shift, number: "@b.number", by: 5}
  figures: {type: toy.metrics, number: "@b.number"}
  end: {type: toy.shift, number: "@a.number", by: 7}
outputs: {end: "@end.number"}
"""
MOVED = f"""{GRAPH}
variants:
  moved: [{{connect: end.number, to: "@lonely.number"}}, {{remove: figures}}]
"""


def test_it_is_left_out_and_named(bench: Any) -> None:
    """Published outputs are needed, and what the report shows; its figures need b."""
    record = bench.run(GRAPH, idle=False)
    assert [row["name"] for row in record["nodes"]] == ["a", "b", "figures", "end"]
    assert record["idle"] == ["lonely"]
    assert "lonely" in record["resolved"]["nodes"]  # the record holds the graph as it was written


def test_moving_a_wire_leaves_no_orphan_running(bench: Any) -> None:
    path = bench.write(MOVED)
    base, moved = (check_variant(path, [], bench.packs, name) for name in ("base", "moved"))
    assert list(base.idle) == ["lonely"]
    assert list(moved.idle) == []
    back = bench.check(GRAPH, "figures.number=@a.number")
    assert list(back.idle) == ["b", "lonely"]


def test_a_graph_may_keep_them(bench: Any) -> None:
    assert not bench.check(GRAPH + "run: all\n").idle
    problem = bench.problems(GRAPH + "run: some\n")[0]
    assert "graph.yaml:9: [graph] run cannot be 'some'" in str(problem)


def test_a_graph_that_shows_nothing_runs_as_a_whole(bench: Any) -> None:
    text = "nodes: {a: {type: toy.const}, b: {type: toy.shift, number: '@a.number'}, c: {type: toy.const}}"
    assert list(bench.check(text).nodes) == ["a", "b", "c"]


def test_figures_beside_a_result_do_not_make_it_needed(bench: Any) -> None:
    """The first output says what a node is for: a solver with a history is not there for its history."""
    more = '  solve: {type: toy.solve, number: "@a.number"}\noutputs'
    assert list(bench.check(GRAPH.replace("outputs", more)).idle) == ["lonely", "solve"]


def test_faults_of_idle_nodes_are_told(bench: Any) -> None:
    (problem,) = bench.problems(GRAPH.replace("by: 5", "bye: 5"))
    assert "lonely" in str(problem)


def test_shipped_graphs_run_all_that_they_ran(packs: Any) -> None:
    """Only variants that move wires have idle nodes."""
    folder = Path(__file__).parents[2] / "graphs"
    for name in ("quickstart.yaml", "hull.yaml", "use.yaml", "dcc/edit.yaml", "dcc/relight.yaml"):
        assert not check_variant(folder / name, [], packs, "base").idle, name
    moved = check_variant(folder / "ablations" / "stage2.yaml", [], packs, "stage1_only")
    assert list(moved.idle) == ["probe", "light", "bounce"]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, {"a": "hit", "b": "hit", "figures": "hit", "end": "hit"}),
        ({"nodes": "lonely"}, {"a": "hit", "b": "hit", "lonely": "done"}),
        ({"force": "[bf]*"}, None),
        ({"force": "fig*"}, {"a": "hit", "b": "hit", "figures": "done", "end": "hit"}),
        ({"force": "lonely"}, {"a": "hit", "b": "hit", "lonely": "done", "figures": "hit", "end": "hit"}),
        ({"start": "b"}, {"a": "hit", "b": "done", "figures": "done", "end": "hit"}),
        ({"start": "lonely"}, {"a": "hit", "b": "hit", "lonely": "done", "figures": "hit", "end": "hit"}),
        ({"start": "a", "nodes": "end"}, {"a": "done", "end": "done"}),
    ],
)
def test_which_nodes_run_is_chosen_by_name(bench: Any, states: Any, options: Any, expected: Any) -> None:
    import exmesh_graph as ex
    from exmesh_graph.errors import GraphError

    path = bench.write(GRAPH)
    places: Any = {"store": bench.root / "store", "runs": bench.root / "runs", "workers": 0, "report": False}
    ex.run(path, **places)
    if expected is None:
        with pytest.raises(GraphError, match="no node"):
            ex.run(path, **places, **options)
    else:
        assert states(ex.run(path, **places, **options).record) == expected


ROUNDS = """
nodes:
  one: {type: toy.const}
  rounds:
    repeat: 3
    carry: {state: "@one.number"}
    nodes: {step: {type: toy.step, state: "@carry.state"}, other: {type: toy.step, state: "@step.state"}}
    next: {state: "@step.state"}
  after: {type: toy.step, state: "@rounds.state"}
run: all
"""


def test_a_name_without_rounds_means_all_of_them(bench: Any) -> None:
    from exmesh_graph.api.selecting import matching

    graph = bench.check(ROUNDS)
    steps = [f"rounds[{n}].step" for n in (1, 2, 3)]
    assert matching(graph, "rounds.step") == steps
    assert matching(graph, "rounds[*].step") == steps
    assert matching(graph, "rounds[2].*") == ["rounds[2].step", "rounds[2].other"]


def test_the_name_of_a_repeat_means_all_that_is_in_it(bench: Any) -> None:
    from exmesh_graph.api.selecting import matching, selected
    from exmesh_graph.errors import GraphError

    graph = bench.check(ROUNDS)
    inside = [f"rounds[{n}].{name}" for n in (1, 2, 3) for name in ("step", "other")]
    assert sorted(matching(graph, "rounds")) == sorted(inside)
    assert matching(graph, "rounds[2]") == inside[2:4]
    assert selected(graph, "rounds").targets == {"one", *inside}
    with pytest.raises(GraphError, match="no node 'rounds\\[4\\]'"):
        matching(graph, "rounds[4]")
