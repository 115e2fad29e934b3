"""Environment values in graph files: declared, keyed, and nothing that was not meant for graphs."""

from __future__ import annotations

from typing import Any

import pytest

GRAPH = """
params: {{value: {{type: float, env: {name}, default: 2}}, word: {{type: str, env: EXMESH_PARAM_WORD, default: x}}}}
nodes: {{a: {{type: toy.const, value: "${{value}}", label: "${{word}}"}}}}
"""
OWN = GRAPH.format(name="EXMESH_PARAM_VALUE")


def value(graph: Any, name: str = "value") -> Any:
    return getattr(graph.nodes["a"].params, name)


def test_a_declared_variable_is_a_value_and_in_the_key(
    bench: Any, states: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert value(bench.check(OWN)) == 2
    first = bench.run(OWN)
    monkeypatch.setenv("EXMESH_PARAM_VALUE", "5")
    monkeypatch.setenv("EXMESH_PARAM_WORD", "12:30")
    graph = bench.check(OWN)
    assert (value(graph), value(graph, "label")) == (5, "12:30")
    assert graph.params["value"] == 5
    second = bench.run(OWN)
    assert states(second) == {"a": "done"}
    assert first["nodes"][0]["key"] != second["nodes"][0]["key"]
    assert states(bench.run(OWN, "value=2", "word=x")) == {"a": "hit"}  # --set counts more


def test_a_patch_counts_more(bench: Any, packs: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from exmesh_graph.graph.variants.checked import check_variants

    monkeypatch.setenv("EXMESH_PARAM_VALUE", "5")
    rows = check_variants(bench.write(OWN + "matrix: {value: [7, 8]}\n"), (), packs)
    assert [value(row.checked) for row in rows] == [5, 7, 8]


@pytest.mark.parametrize("name", ["AWS_SECRET_ACCESS_KEY", "HOME", "5", "EXMESH_SHARED"])
def test_what_was_not_meant_for_graphs_is_not_told(bench: Any, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setenv(name, "12345")
    (problem,) = bench.problems(GRAPH.format(name=name))
    assert "is not a variable that a graph may ask for" in problem.what
    assert problem.expected == "EXMESH_PARAM_NAME"
    assert "12345" not in str(problem)


def test_a_value_of_the_wrong_type_is_told(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXMESH_PARAM_VALUE", "much")
    problem = bench.problems(OWN)[0]
    assert "cannot be 'much'" in problem.what
    assert problem.where.line == 2
