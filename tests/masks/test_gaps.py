"""Gaps that masks fill: narrow ones with another colour in each view are opened, and undercuts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mask_scenes import GROUND, overlap_of, stood

from exmesh_graph.masks.gaps import reaching_out, seen_through
from exmesh_graph.masks.last import opened, undercut


def pictures(width, behind, count=3):
    """Red frames whose opening shows what is behind, another colour in each view: (pictures, filled masks, gaps)."""
    mask, gap = np.zeros((2, count, 64, 64), bool)
    mask[:, 16:48, 12:52] = True
    gap[:, 22:42, 32 - width // 2 : 32 + width // 2] = True
    colours = np.where((mask & ~gap)[..., None], [0.7, 0.1, 0.1], np.asarray(behind)[:count, None, None])
    noise = np.random.default_rng(0).normal(0, 0.01, colours.shape)
    return (colours + noise).clip(0, 1).astype(np.float32), mask, gap


WALLS = np.array([[0.2, 0.3, 0.5], [0.9, 0.9, 0.9], [0.1, 0.4, 0.1]])


def test_a_narrow_gap_that_shows_what_lies_around_is_found():
    shown, mask, gap = pictures(8, WALLS)
    found = seen_through(shown, mask, mask & ~gap, 7)
    assert (found & gap).sum() > 0.8 * gap.sum()
    assert not (found & ~gap).any()


def test_wide_parts_are_no_gaps():
    """A part of metal mirrors what lies around it."""
    shown, mask, gap = pictures(18, WALLS)
    assert not seen_through(shown, mask, mask & ~gap, 7).any()


def test_what_other_views_confirm_is_no_gap():
    shown, mask, _ = pictures(8, WALLS)
    assert not seen_through(shown, mask, mask, 7).any()


def test_the_colours_of_the_object_are_no_gap():
    shown, mask, gap = pictures(8, np.full((3, 3), 0.4))
    shown[gap] = [0.7, 0.1, 0.1]
    assert not seen_through(shown, mask, mask & ~gap, 7).any()


def test_nothing_to_compare_with_is_no_gap():
    shown, mask, _ = pictures(8, WALLS)
    assert not seen_through(shown, mask, np.zeros_like(mask), 7).any()
    assert not seen_through(shown, np.zeros_like(mask), np.zeros_like(mask), 7).any()


@pytest.fixture(scope="module")
def posts():
    """Two posts, seen from 20 and 35 degrees above, and masks that fill the gap between them."""
    parts = [([x, GROUND, -0.06], [x + 0.12, 0.35, 0.06]) for x in (-0.2, 0.08)]
    return stood(parts, ([-0.2, GROUND, -0.06], [0.2, 0.35, 0.06]), (20, 35))


@pytest.fixture(scope="module")
def brim():
    """A post with a wide top, below which four views of sixteen look."""
    parts = ([-0.08, GROUND, -0.08], [0.08, 0.2, 0.08]), ([-0.22, 0.2, -0.22], [0.22, 0.3, 0.22])
    return stood(parts, ([-0.22, GROUND, -0.22], [0.22, 0.3, 0.22]), [4] * 4 + [84] * 12)


def test_masks_that_fill_a_gap_are_opened(posts):
    given, true, whole = posts
    found = opened(given, whole)
    assert found is not None
    assert not (found & ~whole).any()
    assert overlap_of(found, true) > overlap_of(whole, true) + 0.05
    assert (true & ~found).sum() < 0.05 * true.sum()


def test_masks_without_gaps_stay(posts):
    given, true, _ = posts
    assert opened(given, true) is None
    assert undercut(given, true) is None
    alone = replace(given, small=replace(given.small, table=None))
    assert opened(alone, true) is None
    assert undercut(alone, true) is None


def test_what_few_views_look_through_below_a_brim_is_opened(brim):
    given, true, whole = brim
    assert opened(given, whole) is None  # too few of them
    found = undercut(given, whole)
    low = slice(0, 4)
    assert not (found & ~whole).any()
    assert (whole & ~true)[low].sum() > 0.2 * true[low].sum()
    assert (found & ~true)[low].sum() < 0.6 * (whole & ~true)[low].sum()
    assert (true & ~found).sum() < 0.03 * true.sum()


def test_gaps_reach_out_where_a_rim_alone_lies_between():
    mask, gaps = np.zeros((2, 1, 30, 30), bool)
    mask[:, 5:25, 5:25] = True
    gaps[:, 10:14, 7:12] = gaps[:, 10:14, 14:18] = True  # two pixels of the mask beside the one
    assert (reaching_out(gaps, mask) == (gaps & (np.arange(30) < 13))).all()
    assert not reaching_out(np.roll(gaps, 3, axis=2), mask).any()
