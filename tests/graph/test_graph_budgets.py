"""The budgets of the shipped graphs: each resolves and checks, and the default is the sample's schedule."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.language.check import check_file

GRAPHS = Path(__file__).resolve().parents[2] / "graphs"
BUDGETS = ("1min", "5min", "30min")


def shape(graph: Any) -> dict[str, Any]:
    return {name: bound.params.model_dump(mode="json") for name, bound in graph.nodes.items()}


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["quickstart", "hull", "use", "pgsr", "sphere"])
def test_every_budget_checks(name: str, packs: Any) -> None:
    rounds = []
    for budget in BUDGETS:
        graph = check_file(GRAPHS / f"{name}.yaml", [f"budget={budget}"], packs)
        nodes = shape(graph)
        rounds.append(sum(node.startswith("rounds[") and node.endswith(".refine") for node in nodes))
        share = sum(nodes[f"rounds[{k}].refine"]["share"] for k in range(1, rounds[-1] + 1)) + nodes["settle"]["share"]
        assert share == pytest.approx(1), "rounds and what follows are all of Stage I"
        assert nodes["views"]["train_side"] == graph.params["train_side"] > 0
        assert nodes["settle"]["seconds"] == graph.params["stage1_seconds"] > 0
    assert rounds == sorted(rounds)


def test_more_time_is_more_of_everything(packs: Any) -> None:
    params = [check_file(GRAPHS / "quickstart.yaml", [f"budget={budget}"], packs).params for budget in BUDGETS]
    for name in ("train_side", "train_megapixels", "start_seconds", "faces", "stage1_seconds", "pbr_iterations"):
        values = [param[name] for param in params]
        assert values == sorted(set(values)), name


def test_without_a_budget_the_schedule_is_the_samples(packs: Any) -> None:
    nodes = shape(check_file(GRAPHS / "quickstart.yaml", [], packs))
    assert [nodes[f"rounds[{k}].refine"]["iterations"] for k in range(1, 5)] == [400] * 4
    assert "rounds[5].refine" not in nodes
    assert (nodes["settle"]["iterations"], nodes["settle"]["total_iterations"]) == (1400, 3000)
    assert nodes["settle"]["share"] == nodes["settle"]["seconds"] == nodes["views"]["train_side"] == 0
    assert (nodes["coarse"]["seconds"], nodes["pbr"]["iterations"], nodes["pbr"]["corrections"]) == (10_000, 800, 3)
    assert (nodes["score"]["max_views"], nodes["score"]["supersampling"], nodes["look"]["max_views"]) == (0, 2, 0)


def test_what_is_set_beside_a_budget_counts(packs: Any) -> None:
    graph = check_file(GRAPHS / "quickstart.yaml", ["budget=1min", "faces=12345"], packs)
    assert graph.nodes["rounds[1].split"].params.max_faces == 12345
