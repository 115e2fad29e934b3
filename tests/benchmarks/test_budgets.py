"""The table of budgets: its budgets are the graph's, its shares those of the estimate."""

from __future__ import annotations

from typing import Any

import exmesh_graph as ex
from benchmarks import budgets


def test_the_budgets_are_those_of_the_graph() -> None:
    declared = ex.check(budgets.ROOT / "graphs" / "quickstart.yaml").declared["budget"]
    assert set(declared.choices) == {"none", *budgets.SECONDS}


def test_a_row_says_how_much_of_the_budget_was_used() -> None:
    row: dict[str, Any] = {"scene": "cow", "budget": "1min", "seconds": 45.0, "processor_seconds": 81.0, "load": 0.5}
    row |= {"Chamfer": 0.8512, "held-out": 37.2, "relit": 35.4, "albedo": None}
    assert budgets.line(row) == "| cow | 1min | 45 | 81 | 0.5 | 90% | 75% | 0.851 | 37.2 | 35.4 |  |"
    assert budgets.line({**row, "budget": "none"}).split(" | ")[5:7] == ["", ""]
    assert len(budgets.HEADS) == budgets.line(row).count("|") - 1
