"""Gloss by place, and smoothness that pulls more where it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from stage1_scenes import fresh_state, grid_ball, photographs, texture

from exmesh_graph.raster import edge_table
from exmesh_graph.stage1.gloss import firmness, gloss, without_paint
from exmesh_graph.stage1.refine import refine
from exmesh_graph.stage1.regularise import pulled, weighted
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian
from exmesh_graph.types import Carrier

RADIUS = 0.6


def ball(radius=RADIUS, plain=True):
    vertices, faces, uvs, uv_faces = grid_ball(24, 36, radius)
    colours = np.full((64, 64, 3), 0.5, np.float32) if plain else texture(64)
    return Carrier(vertices, faces, uvs, uv_faces, colours)


def shining_above(views, stops):
    """The views, whose cap of the ball is brighter or darker from each of them."""
    images = np.array(views.images)
    level = np.random.default_rng(0).uniform(-1, 1, len(views)) * stops
    for i, pose in enumerate(views.camera_to_world):
        row, column = np.nonzero(views.alpha[i] > 0)
        k = views.intrinsics[i]
        rays = np.stack([(column + 0.5 - k[0, 2]) / k[0, 0], (row + 0.5 - k[1, 2]) / k[1, 1], np.ones(len(row))], 1)
        rays = rays @ pose[:3, :3].T / np.linalg.norm(rays, axis=1)[:, None]
        half = rays @ pose[:3, 3]
        root = half**2 - pose[:3, 3] @ pose[:3, 3] + RADIUS**2
        height = pose[1, 3] + (-half - np.sqrt(np.maximum(root, 0))) * rays[:, 1]
        upper = height > 0.3  # a small part from all sides: what most of it does is taken for exposure
        images[i][row[upper], column[upper]] *= np.float32(2 ** level[i])
    return replace(views, images=images)


@pytest.fixture(scope="module")
def views():
    return photographs(ball(), count=48, size=160)


def test_gloss_is_found_where_brightness_changes_from_view_to_view(views):
    height = ball().vertices[:, 1]
    found = gloss(shining_above(views, 1.0), ball())
    assert np.median(found[height > 0.35]) > 0.3
    assert np.median(found[height < -0.25]) < 0.05
    firm = firmness(shining_above(views, 1.0), ball(), 36)
    assert firm.dtype == np.float32
    np.testing.assert_allclose(firm, 1 + 36 * ((found - 0.15) / 0.25).clip(0, 1), rtol=1e-6)


def test_exposures_are_no_gloss(views):
    factors = 2 ** np.random.default_rng(1).uniform(-0.5, 0.5, len(views)).astype(np.float32)
    images = np.asarray(views.images) * factors[:, None, None, None]
    assert np.median(gloss(replace(views, images=images), ball())) < 0.03


def test_paint_on_a_misplaced_surface_is_no_gloss():
    """Its patches change from view to view, and differ from those beside them."""
    painted = photographs(ball(plain=False), count=16, size=160)
    assert np.quantile(gloss(painted, ball(0.85 * RADIUS)), 0.9) < 0.25
    assert np.median(gloss(painted, ball(0.85 * RADIUS))) < 0.05


def test_few_views_tell_nothing(views):
    few = shining_above(views, 1.0).subset(range(4))
    assert not gloss(few, ball()).any()
    assert (firmness(few, ball(), 36) == 1).all()


def test_paint_is_taken_off_patch_by_patch():
    """Against a loop over all patches; few enough are near to each that none is left out."""
    rng = np.random.default_rng(3)
    centres, level, spread = rng.random((60, 3)), rng.normal(size=60), rng.random(60)
    shown = rng.integers(0, 12, 60)
    level[shown == 0] = spread[shown == 0] = np.nan
    expected = np.zeros(60)
    for i in range(60):
        near = (np.linalg.norm(centres - centres[i], axis=1) < 0.3) & (shown >= 5)
        if near.sum() >= 3:
            own = np.median(spread[near]) ** 2
            paint = level[near].var() - own * np.pi / 2 * np.mean(1 / shown[near])
            expected[i] = np.sqrt(max(own - max(paint, 0), 0))
    assert (expected > 0).sum() > 5
    np.testing.assert_allclose(without_paint(centres, level, spread, shown, 0.3), expected, atol=1e-12)
    assert not without_paint(centres, level, spread, np.minimum(shown, 4), 0.3).any()


def test_smoothness_pulls_so_many_times_as_much():
    surface = ball()
    points = torch.from_numpy(surface.vertices + np.random.default_rng(2).normal(size=surface.vertices.shape) * 0.01)
    table = edge_table(torch.from_numpy(surface.faces))
    loss = weighted("bilaplacian", 0.3, points, table.edges).loss
    factor = torch.rand(len(points), dtype=torch.float64) * 9 + 1
    leaf = points.clone().requires_grad_()
    assert torch.equal(loss(pulled(leaf, factor)), loss(leaf))
    (plain,) = torch.autograd.grad(loss(leaf), leaf)
    (more,) = torch.autograd.grad(loss(pulled(leaf, factor)), leaf)
    assert torch.allclose(more, plain * factor[:, None], rtol=1e-12, atol=0)


@pytest.mark.thorough
def test_what_shines_stays_smooth(views):
    """Photographs that contradict one another dent the cap; less so where it is firm."""
    shining = shining_above(views, 1.0)
    start = fresh_state(ball())
    settings = RefineSettings(iterations=60, total_iterations=60)
    rough = {}
    for most in (0.0, 36.0):
        done, _ = refine(start, shining, settings.replaced(gloss_firmness=most), smoothness=Bilaplacian(), seed=1)
        away = np.linalg.norm(done.vertices, axis=1) - RADIUS
        upper, lower = start.vertices[:, 1] > 0.35, start.vertices[:, 1] < 0
        rough[most] = away[upper].std(), away[lower].std()
    assert rough[36.0][0] < 0.8 * rough[0.0][0]
    assert rough[36.0][1] == pytest.approx(rough[0.0][1], rel=0.3)
