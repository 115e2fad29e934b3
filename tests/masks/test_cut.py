"""The cut against every cut there is, and outlines that are drawn too large or too small."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mask_scenes import overlap_of

from exmesh_graph.errors import DataError
from exmesh_graph.masks.cut import least_cut, moved_to_edges, sides

STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))


def cost_of(labels, unlike, contrast, smoothness):
    """What a labelling bool [H, W] costs, written out: NaN in `unlike` [H, W] marks pixels that are certain."""
    height, width = labels.shape
    is_open = ~np.isnan(unlike)
    total = np.where(labels, unlike, 1 - unlike)[is_open].sum()
    for (down, right), like in zip(STEPS, contrast, strict=True):
        for row, column in itertools.product(range(height), range(width)):
            r, c = row + down, column + right
            if r < height and 0 <= c < width and (is_open[row, column] or is_open[r, c]):
                total += (labels[row, column] != labels[r, c]) * smoothness * like[row, column] / np.hypot(down, right)
    return total


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.floats(0, 3))
def test_no_other_cut_costs_less(seed, smoothness):
    rng = np.random.default_rng(seed)
    shape = (3, 4)
    kind = rng.integers(0, 4, shape)  # 0: certainly inside, 1: certainly outside, others open
    band, sure_in = kind >= 2, kind == 0
    unlike = np.where(band, rng.random(shape), np.nan)
    contrast = [rng.random(shape) for _ in STEPS]
    found = sure_in.copy()
    found[band] = least_cut(unlike[band], contrast, band, sure_in, smoothness)
    best = np.inf
    for choice in itertools.product((False, True), repeat=int(band.sum())):
        labels = sure_in.copy()
        labels[band] = choice
        best = min(best, cost_of(labels, unlike, contrast, smoothness))
    assert cost_of(found, unlike, contrast, smoothness) == pytest.approx(best, abs=0.05)  # capacities are rounded


def disc(radius, size=80, x=40.0, y=38.0):
    rows, columns = np.indices((size, size)) + 0.5
    return np.hypot(columns - x, rows - y) < radius


def painted(inside, seed=0):
    """A brown disc on patchy ground: the ground has one colour on the left that the disc has too, on the right."""
    noise = np.random.default_rng(seed).normal(0, 0.02, (*inside.shape, 3))
    left = (np.arange(inside.shape[1]) < inside.shape[1] / 2)[None, :, None]
    ground, own = np.where(left, [0.2, 0.5, 0.2], [0.5, 0.5, 0.6]), np.where(left, [0.5, 0.3, 0.2], [0.2, 0.5, 0.2])
    return (np.where(inside[..., None], own, ground) + noise).clip(0, 1).astype(np.float32)


@pytest.mark.parametrize(("drawn", "x"), [(25, 40.0), (16, 40.0), (20, 43.5)])
def test_an_outline_goes_to_the_edge_although_both_sides_share_a_colour_elsewhere(drawn, x):
    truth = disc(20)
    given_, band = disc(drawn, x=x), 7
    moved = moved_to_edges(painted(truth), given_, band)
    assert overlap_of(given_, truth) < 0.85
    assert overlap_of(moved, truth) > 0.98


def test_nothing_moves_farther_than_the_band():
    truth, given_ = disc(20), disc(30)
    moved = moved_to_edges(painted(truth), given_, 4)
    assert moved[disc(25.5)].all()
    assert not moved[~disc(34.5)].any()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 60), st.integers(0, 60), st.integers(0, 1000))
def test_what_lies_far_from_the_outline_has_no_say(rows, columns, seed):
    """The same cut in a larger picture of other colours, wherever the smaller one lies in it."""
    truth, drawn = disc(9, 48, 24.0, 23.0), disc(11, 48, 24.0, 23.0)
    picture = painted(truth, seed)  # 12 pixels from the outline to its rim, of which 11 count
    alone = moved_to_edges(picture, drawn, 3)
    large = np.random.default_rng(seed).random((48 + 60, 48 + 60, 3)).astype(np.float32)
    where = np.s_[rows : rows + 48, columns : columns + 48]
    large[where], whole = picture, np.zeros(large.shape[:2], bool)
    whole[where] = drawn
    assert (moved_to_edges(large, whole, 3)[where] == alone).all()


def test_cracks_are_open_to_their_middles():
    cracked = np.ones((60, 60), bool)
    cracked[:8] = False
    cracked[30:34, 20:40] = False
    assert not sides(cracked, 8)[1][25:40].any()
    grey = np.random.default_rng(0).uniform(0.5, 0.6, (60, 60, 3)).astype(np.float32)
    grey[:8] = 0.1
    assert moved_to_edges(grey, cracked, 8)[10:].all()


def test_thin_parts_and_gaps_keep_their_middles():
    thin = np.zeros((60, 60), bool)
    thin[10:50, 10:50] = True
    thin[27:33, 14:46] = False
    thin[20:22, 50:60] = True
    sure_in, sure_out, is_open = sides(thin, 8)
    assert (sure_in.astype(int) + sure_out + is_open == 1).all()
    assert sure_out[29:31, 18:42].all()
    assert not sure_out[27, 16:44].any()
    assert sure_in[20:22, 54:58].any()
    assert not (sure_in & ~thin).any()
    assert not (sure_out & thin).any()


@pytest.mark.parametrize("drawn", [np.zeros((9, 8), bool), np.ones((9, 8), bool)])
def test_a_picture_without_an_outline_stays(drawn):
    assert (moved_to_edges(np.zeros((9, 8, 3), np.float32), drawn, 3) == drawn).all()


def test_a_picture_of_another_size_is_refused():
    with pytest.raises(DataError, match=r"shape \[8, 8, 3\].*\[9, 8\]"):
        moved_to_edges(np.zeros((8, 8, 3), np.float32), np.ones((9, 8), bool), 3)
