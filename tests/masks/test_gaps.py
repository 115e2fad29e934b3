"""Gaps that masks fill: narrow ones with another colour in each view are opened."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from mask_scenes import GROUND, overlap_of

from exmesh_graph.masks import agreement
from exmesh_graph.masks.gaps import seen_through
from exmesh_graph.masks.ground import Table
from exmesh_graph.masks.plane import Plane
from exmesh_graph.masks.settings import CutSettings
from exmesh_graph.raster import rasterize
from exmesh_graph.testing import look_at
from exmesh_graph.types import DepthMaps, Views

SIZE = 96


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
    found = seen_through(shown, mask, mask & ~gap)
    assert (found & gap).sum() > 0.8 * gap.sum()
    assert not (found & ~gap).any()


def test_wide_parts_are_no_gaps():
    """A part of metal mirrors what lies around it."""
    shown, mask, gap = pictures(18, WALLS)
    assert not seen_through(shown, mask, mask & ~gap).any()


def test_what_other_views_confirm_is_no_gap():
    shown, mask, _ = pictures(8, WALLS)
    assert not seen_through(shown, mask, mask).any()


def test_the_colours_of_the_object_are_no_gap():
    shown, mask, gap = pictures(8, np.full((3, 3), 0.4))
    shown[gap] = [0.7, 0.1, 0.1]
    assert not seen_through(shown, mask, mask & ~gap).any()


def test_nothing_to_compare_with_is_no_gap():
    shown, mask, _ = pictures(8, WALLS)
    assert not seen_through(shown, mask, np.zeros_like(mask)).any()
    assert not seen_through(shown, np.zeros_like(mask), np.zeros_like(mask)).any()


def box(low, high):
    """A closed box: vertices float32 [8, 3], faces int32 [12, 3]."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
             [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    return (np.asarray(low) + corners * (np.asarray(high) - low)).astype(np.float32), np.array(faces, np.int32)


@pytest.fixture(scope="module")
def posts():
    """Views of two red posts, each before a wall of its own colour; depth and masks that fill the gap between them."""
    boxes = [box([x, GROUND, -0.06], [x + 0.12, 0.35, 0.06]) for x in (-0.2, 0.08)]
    true = np.concatenate([b[0] for b in boxes]), np.concatenate([boxes[0][1], boxes[1][1] + 8])
    filled = box([-0.2, GROUND, -0.06], [0.2, 0.35, 0.06])
    count = 16
    turn, height = 2 * np.pi * np.arange(count) / count, np.radians(20 + 15 * (np.arange(count) % 2))
    eyes = 2.6 * np.stack([np.cos(height) * np.sin(turn), np.sin(height), np.cos(height) * np.cos(turn)], 1)
    poses = np.stack([look_at(eye) for eye in eyes])
    k = np.repeat(np.array([[[2.0 * SIZE, 0, SIZE / 2], [0, 2.0 * SIZE, SIZE / 2], [0, 0, 1]]]), count, 0)
    cameras = torch.from_numpy(k), torch.from_numpy(np.linalg.inv(poses))
    one, other = (rasterize(*map(torch.from_numpy, mesh), *cameras, SIZE, SIZE) for mesh in (true, filled))
    masks, whole = (seen.face_id.numpy() >= 0 for seen in (one, other))
    rng = np.random.default_rng(1)
    walls = rng.uniform(0.1, 0.9, (count, 1, 1, 3)) * [0.3, 1, 1]
    images = np.where(masks[..., None], [0.5, 0.02, 0.02], walls) + rng.normal(0, 0.01, (*masks.shape, 3))
    names = tuple(f"v{i}" for i in range(count))
    views = Views(names, images.clip(0, 1).astype(np.float32), np.ones(masks.shape, np.float32), k, poses, "train",
                  has_masks=False)  # fmt: skip
    table = Table(Plane(np.array([0.0, 1.0, 0.0]), GROUND, 0.0), DepthMaps(names, other.depth.numpy()))
    return views, table, masks, whole, filled[0]


def test_masks_that_fill_a_gap_are_opened(posts):
    views, table, true, whole, corners = posts
    opened = agreement._opened(views, np.ones(16, bool), whole, corners, CutSettings(band=2), table, None)
    assert opened is not None
    assert not (opened & ~whole).any()
    assert overlap_of(opened, true) > overlap_of(whole, true) + 0.05
    assert (true & ~opened).sum() < 0.05 * true.sum()


def test_masks_without_gaps_stay(posts):
    views, table, true, _, corners = posts
    assert agreement._opened(views, np.ones(16, bool), true, corners, CutSettings(band=2), table, None) is None
