"""Lineage, chart geometry and the layout of the graph picture."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exmesh_graph.report import text
from exmesh_graph.report.charts import Mark, bar_chart, line_chart, thin
from exmesh_graph.report.collect import cumulative_seconds
from exmesh_graph.report.drawing.svg import fold_edges, fold_name


def test_rounds_fold_into_one_node():
    assert fold_name("rounds[12].refine") == "rounds.refine"
    assert fold_name("outer[1].inner[2].x") == "outer.inner.x"
    assert fold_name("plain") == "plain"


def test_folded_edges_keep_the_way_in_and_out_but_not_from_round_to_round():
    edges = [
        ("start", "r[1].a"),
        ("r[1].a", "r[1].b"),
        ("r[1].b", "r[2].a"),
        ("r[2].a", "r[2].b"),
        ("r[2].b", "end"),
    ]
    assert fold_edges(edges) == [("start", "r.a"), ("r.a", "r.b"), ("r.b", "end")]


def test_shared_ancestors_are_counted_once():
    nodes = [("a", 1.0), ("b", 2.0), ("c", 4.0), ("d", 8.0)]
    edges = [("a", "b"), ("a", "c"), ("b", "d"), ("c", "d")]
    assert cumulative_seconds(nodes, edges) == {"a": 0.0, "b": 1.0, "c": 1.0, "d": 7.0}


@given(st.lists(st.tuples(st.floats(0, 1e5), st.floats(-50, 1e4)), min_size=1, max_size=30), st.booleans())
def test_points_stay_inside_the_frame(points, with_floor):
    xs, ys = [p[0] for p in points], [p[1] for p in points]
    chart = line_chart([("c", xs, ys)], title="t", x_label="x", floor=20.0 if with_floor else None, points=True)
    placed = re.findall(r'<circle[^>]*cx="([-\d.]+)" cy="([-\d.]+)"', chart)
    assert len(placed) == len(points)
    assert all(55 <= float(x) <= 325 and 25 <= float(y) <= 167 for x, y in placed)


@given(st.lists(st.tuples(st.floats(1e-5, 1e5), st.floats(1e-9, 1e4)), min_size=1, max_size=30), st.sampled_from("xy"))
def test_on_log_axes_equal_ratios_are_equal_lengths_and_points_stay_inside(points, axis):
    xs, ys = [p[0] for p in points], [p[1] for p in points]
    chart = line_chart([("c", xs, ys)], title="t", x_label="x", points=True, log=axis)
    placed = re.findall(r'<circle[^>]*cx="([-\d.]+)" cy="([-\d.]+)"', chart)
    assert all(55 <= float(x) <= 325 and 25 <= float(y) <= 167 for x, y in placed)
    steps = line_chart([("c", [3, 30, 300], [2.0, 8.0, 32.0])], title="t", x_label="x", points=True, log="xy")
    (x1, y1), (x2, y2), (x3, y3) = (
        (float(x), float(y)) for x, y in re.findall(r'<circle[^>]*cx="([-\d.]+)" cy="([-\d.]+)"', steps)
    )
    assert x2 - x1 == pytest.approx(x3 - x2, abs=0.2)
    assert y2 - y1 == pytest.approx(y3 - y2, abs=0.2)
    assert all(f">{tick}<" in steps for tick in (5, 20, 100))


def test_bars_are_proportional():
    chart = bar_chart([Mark("a", 10.0), Mark("b", 5.0, kind="hit"), Mark("c", 0.0)], text.seconds, name="seconds")
    long, half, none = (float(w) for w in re.findall(r'<rect[^>]*width="([\d.]+)"', chart))
    assert long == pytest.approx(2 * half, rel=0.01)
    assert none < 2


@given(st.integers(1, 5000), st.integers(2, 500))
def test_thinning_keeps_both_ends(count, at_most):
    kept = thin(range(count), at_most)
    assert kept[0] == 0
    assert kept[-1] == count - 1
    assert len(kept) <= max(at_most, 2)


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (True, "yes"),
        (5856, "5\u202f856"),
        (33.214, "33.21"),
        (0.01234, "0.0123"),
        (0.0, "0.00"),
        (123456.7, "123\u202f457"),
        (None, "–"),
        ("gray", "gray"),
    ],
)
def test_numbers_for_people(value, shown):
    assert text.number(value) == shown


@pytest.mark.parametrize(
    ("value", "shown"), [(0.421, "0.42 s"), (12.34, "12.3 s"), (200, "3 min 20 s"), (3725, "1 h 02 min"), (None, "–")]
)
def test_seconds_for_people(value, shown):
    assert text.seconds(value) == shown
