"""Medians over views, by the kernel and in numpy, against each point's own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exmesh_graph.geometry.robust import plain, robust


@pytest.mark.parametrize("medians", [robust, plain])
@given(st.integers(0, 10**6), st.integers(1, 70), st.integers(1, 4))
def test_medians_of_what_is_known(medians, seed, count, channels):
    rng = np.random.default_rng(seed)
    colours = rng.random((count, 9, channels)).astype(np.float32).round(rng.integers(1, 5))  # some alike
    colours[rng.random((count, 9)) < 0.4] = np.nan
    middle, spread, known = medians(colours)
    for pixel in range(9):
        those = colours[np.isfinite(colours[:, pixel, 0]), pixel]
        assert known[pixel] == len(those)
        if len(those) == 0:
            assert np.isnan(middle[pixel]).all()
            assert np.isnan(spread[pixel])
            continue
        assert middle[pixel] == pytest.approx(np.median(those, axis=0), abs=1e-6)
        off = 1.4826 * np.median(np.abs(those - np.median(those, axis=0)).mean(-1))
        assert spread[pixel] == pytest.approx(off, abs=1e-6)


def test_of_float64_nothing_is_rounded():
    colours = np.random.default_rng(0).random((5, 3, 3))
    middle, _, _ = robust(colours)
    assert middle.dtype == np.float64
    np.testing.assert_array_equal(middle, np.median(colours, axis=0))


def test_of_no_points_there_is_nothing():
    middle, spread, count = robust(np.zeros((4, 0, 3), np.float32))
    assert (middle.shape, spread.shape, count.shape) == ((0, 3), (0,), (0,))
