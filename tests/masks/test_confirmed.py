"""Thin parts that masks lack and stereo knows: a stretcher between posts comes back, nothing else does."""

from dataclasses import replace

import numpy as np
import pytest
from mask_scenes import GROUND, stood

from exmesh_graph.masks.confirmed import confirmed, confirmed_beside
from exmesh_graph.types import DepthMaps

WHOLE = [-0.25, GROUND, -0.08], [0.25, 0.35, 0.08]
POSTS = [([x, GROUND, -0.06], [x + 0.12, 0.35, 0.06]) for x in (-0.22, 0.1)]
BAR = [-0.1, -0.02, -0.02], [0.1, 0.02, 0.02]
APART = [0.4, GROUND, -0.4], [0.46, -0.1, -0.34]


@pytest.fixture(scope="module")
def chair():
    """(what masks are mended by, masks without the bar, the bar's pixels)."""
    given, whole, _ = stood([*POSTS, BAR], None, (20, 35))
    posts = stood(POSTS, None, (20, 35))[1]
    return given, posts, whole & ~posts


def with_depth(given, depth):
    table = replace(given.small.table, depths=DepthMaps(given.small.table.depths.names, depth.astype(np.float32)))
    return replace(given, small=replace(given.small, table=table))


def test_a_bar_that_stereo_knows_is_put_back(chair):
    given, posts, bar = chair
    found = confirmed(given, posts)
    assert (found & bar).sum() > 0.9 * bar.sum()
    assert (found & ~(posts | bar)).sum() < 0.05 * posts.sum()
    assert (posts & ~found).sum() < 0.05 * posts.sum()


def test_what_masks_show_already_is_left_alone(chair):
    given, posts, bar = chair
    assert confirmed(given, posts | bar) is None


def test_without_a_table_nothing_is_put_back(chair):
    given, posts, _ = chair
    assert confirmed(replace(given, small=replace(given.small, table=None)), posts) is None


def test_a_depth_that_other_views_do_not_confirm_is_none(chair):
    given, posts, bar = chair
    depth = given.small.table.depths.depth.copy()
    depth[bar] *= np.random.default_rng(0).uniform(0.85, 1.15, int(bar.sum()))
    assert confirmed(with_depth(given, depth), posts) is None


def test_what_stands_apart_and_what_lies_on_the_table_is_not_the_object_s():
    given, whole, _ = stood([*POSTS, APART], None, (20, 35))
    posts = stood(POSTS, None, (20, 35))[1]
    table = given.small.table
    near = np.array([*WHOLE, [0.5, GROUND, -0.5]])
    assert (whole & ~posts).sum() > 0.02 * posts.sum()
    assert not confirmed_beside(given.small, table, posts, near).any()
    flat = [-0.1, GROUND, -0.08], [0.1, GROUND + 0.005, 0.08]
    given, whole, _ = stood([*POSTS, flat], None, (20, 35))
    assert (whole & ~posts).sum() > 0.02 * posts.sum()
    assert not confirmed_beside(given.small, given.small.table, posts, np.array(WHOLE)).any()
