"""Decisions of the probe on the page: numbers, bars, and nothing where nothing was measured."""

from __future__ import annotations

import re

from exmesh_graph.report.page import advice_rows, decision_tables

ROWS = [
    {
        "name": "bounces",
        "value": 2,
        "gain": 1.5,
        "error": 0.2,
        "cost": 1.17,
        "seconds_ratio": 1.3,
        "reason": "It <pays>.",
    },
    {"name": "metallic", "value": False, "gain": -0.5, "error": None, "cost": 1.0, "reason": "It does not."},
    {"name": "texture_size", "value": 384, "gain": None, "error": None, "cost": 1.0, "reason": "So fine are pixels."},
]


def test_rows_carry_their_numbers() -> None:
    table = decision_tables({"probe.decisions": {"decisions": ROWS}, "fit.history": {"loss": [1.0, 0.5]}})
    assert list(table) == ["probe.decisions"]
    first, second, third = table["probe.decisions"]
    assert [first[k] for k in ("value", "gain", "cost", "measured")] == ["2", "+1.50 ± 0.20 dB", "+17 %", "+30 %"]
    assert (second["value"], second["gain"], second["measured"]) == ("no", "-0.50 dB", "")
    assert (third["gain"], third["bar"]) == ("", "")
    assert first["reason"] == "It <pays>."  # escaped by the template


def test_bars_start_in_the_middle_and_tell_on_from_off() -> None:
    first, second, _ = decision_tables({"p": {"decisions": ROWS}})["p"]

    def bar(row: str) -> tuple[float, float]:
        x, width = re.findall(r'<rect[^>]* x="([\d.]+)"[^>]* width="([\d.]+)"', row)[0]
        return float(x), float(width)

    (x0, w0), (x1, w1) = bar(first["bar"]), bar(second["bar"])
    assert x0 == 66
    assert x1 + w1 == 66
    assert abs(w0 / w1 - 3) < 0.05
    assert 'class="mark "' in first["bar"]
    assert 'class="mark hit"' in second["bar"]


def test_lists_of_another_kind_are_left_alone() -> None:
    assert decision_tables({"p": {"decisions": []}, "q": {"decisions": [1, 2]}, "r": {"decisions": "none"}}) == {}


def test_advice_of_all_nodes_is_one_table():
    row = {"name": "more photographs", "value": "3 from 40 degrees below a.png", "reason": "12 % are unseen."}
    found = advice_rows(
        {"a.metrics": {"advice": [row]}, "b.metrics": {"advice": ["no row"], "x": 1}, "c": {"advice": 3}}
    )
    assert found == [row]


def test_nodes_that_decided_the_same_share_a_table() -> None:
    told = {
        "a.decisions": {"decisions": ROWS},
        "b.decisions": {"decisions": ROWS[:1]},
        "c.decisions": {"decisions": ROWS},
    }
    tables = decision_tables(told)
    assert list(tables) == ["a.decisions, c.decisions", "b.decisions"]
    assert len(tables["a.decisions, c.decisions"]) == len(ROWS)
