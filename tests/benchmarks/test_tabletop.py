"""An object on a table: what is the table's, and what stays the object's."""

import numpy as np
import pytest

from benchmarks.scenes.catalogue import RECIPES
from benchmarks.scenes.tabletop import SUNK, TOPS, on_table


@pytest.mark.parametrize("top", list(TOPS))
def test_a_table_stands_below_the_object_which_keeps_its_paint(top):
    own = RECIPES["teapot"]
    placed = on_table(own, top, "interior")
    table, *rest = placed.solids()
    assert [one.name for one in rest] == [one.name for one in own.solids()]
    points = np.concatenate([chart.points for one in rest for chart in one.charts])
    board = np.concatenate([chart.points for chart in table.charts])
    radius = np.linalg.norm(board[:, :2] - board[:, :2].mean(0), axis=1).max()
    assert 0 < board[:, 2].max() - points[:, 2].min() < 1.01 * SUNK * radius
    assert radius > 1.4 * np.ptp(points[:, :2], axis=0).max() / 2
    part = np.array(["china"] * len(points) + ["table"] * len(board))
    both, up = np.concatenate([points, board]), np.tile([0.0, 0, 1], (len(points) + len(board), 1))
    base, rough, metal = placed.paint(both, up, part)
    before = own.paint(points, up[: len(points)], part[: len(points)])
    for got, expected in zip((base, rough, metal), before, strict=True):
        np.testing.assert_allclose(got[: len(points)], expected)
    assert metal[len(points) :].max() == 0
    assert ((base[len(points) :] >= 0) & (base[len(points) :] <= 1)).all()
    assert (placed.ground, placed.light[0]) == (("table",), "interior")
