"""What may be carved: where the hull stands before the true surface, not where the carved surface lies behind it."""

from dataclasses import replace

import numpy as np
import pytest

from exmesh_graph.evaluate.metrics.removable import _sights, _Told, _without_gloss, removable
from exmesh_graph.geometry.carve import Carving
from exmesh_graph.geometry.hull import Grid, projections
from exmesh_graph.types import DepthMaps
from tests.evaluate.test_metrics_rephotography import painted_sphere

TRUE, HULL, PIT = 0.7, 0.82, 0.58


@pytest.fixture(scope="module")
def half_right():
    """A painted ball. On one side the hull is too large and carving is right; on the other it is right and pitted."""
    views = painted_sphere(24, size=96)
    grid = Grid.over(np.full(3, -0.9), np.full(3, 0.9), 64)
    points = grid.points()
    radius, right = np.linalg.norm(points, axis=1), points[:, 0] > 0
    hull = np.where(right, HULL, TRUE) - radius
    left = np.where(right, TRUE, PIT) - radius
    carving = Carving(grid, *(part.reshape(grid.shape).astype(np.float32) for part in (hull, left)), 0.1, 0.0)
    return views, carving


def depth_of(views, radius):
    """Depth of a ball [N, H, W], of pixels that show x > 0 and x < 0: `radius` gives both."""
    maps = []
    for k, pose in zip(views.intrinsics, views.camera_to_world, strict=True):
        y, x = np.indices((views.height, views.width)) + 0.5
        d = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(k).T @ pose[:3, :3].T
        eye = pose[:3, 3]
        depth = np.zeros(x.shape)
        for side, r in zip((1, -1), radius, strict=True):
            a, b, c = (d * d).sum(-1), 2 * d @ eye, eye @ eye - r**2
            inside = b * b - 4 * a * c
            at = (-b - np.sqrt(np.maximum(inside, 0))) / (2 * a)
            depth = np.where((inside > 0) & (side * (eye[0] + at * d[..., 0]) > 0), at, depth)
        maps.append(depth)
    return DepthMaps(views.names, np.stack(maps).astype(np.float32))


@pytest.mark.thorough
def test_photographs_let_go_what_hides_the_surface_and_keep_what_would_be_a_pit(half_right):
    views, carving = half_right
    x = carving.grid.points()[:, 0].reshape(carving.taken.shape)
    right, wrong = carving.taken & (x > 0.15), carving.taken & (x < -0.15)
    # only what the cameras, a little above the middle, look at from near the front
    band = np.abs(carving.grid.points()[:, 1].reshape(x.shape)) < 0.35
    depths = depth_of(views, (TRUE, PIT))
    depths = replace(depths, depth=np.where(depths.depth > 0, depths.depth, np.float32(6)))  # a wall behind all
    *_, bold = found = removable(carving, views, depths)
    sure = found[0]
    assert bold[right & band].mean() > 0.9
    assert bold[wrong & band].mean() < 0.1
    assert not (bold & ~carving.taken).any()
    assert not (sure & ~bold).any()
    assert sure[right & band].sum() > 10 * sure[wrong & band].sum()
    assert sure[right & band].sum() > 500


@pytest.mark.thorough
def test_what_depth_maps_do_not_look_through_is_bold(half_right):
    """Depth maps that stop at the hull, or say nothing, though photographs would let it go."""
    views, carving = half_right
    nothing = replace(depth_of(views, (TRUE, PIT)), depth=np.zeros(views.alpha.shape, np.float32))
    for depths in (depth_of(views, (HULL, TRUE)), nothing):
        sure, bold = removable(carving, views, depths)
        assert bold.any()
        assert not sure.any()


@pytest.mark.parametrize("better", [True, False])
def test_small_parts_show_by_their_details_that_they_are_none_of_gloss(better):
    """A large part stays, and of small ones those whose details are foretold better; one that no view shows goes."""
    size = 40
    mask = np.zeros((size, size, 4), bool)
    mask[2:20, 2:38] = mask[24:28, 2:6] = mask[24:28, 12:16] = mask[36:39, 36:39] = True
    at = np.flatnonzero(mask)
    grid = Grid(np.zeros(3), 1.0, mask.shape)
    camera = np.array([[10.0, 0, 0, 5], [0, 10, 0, 5], [0, 0, 0, 10]])  # orthographic, at depth 10
    gain = np.full((size, size), np.nan)
    gain[:, :30] = gain[:30] = 0.1  # [row, column] = [j, i]
    rng = np.random.default_rng(0)
    told = []
    for _ in range(8):
        before = np.full((size, size), 0.1)
        detail = 0.03 + 0.01 * rng.normal(size=before.shape)
        if not better:
            detail[12:16, 24:28] = 0.005 * rng.normal(size=(4, 4))  # row j, column i
        told.append(_Told(camera, np.full(before.shape, 9.5), np.full(before.shape, 10.5), gain, detail, before))
    left = _without_gloss(mask, grid.points()[at], at, told, 1.0)
    assert left[2:20, 2:38].all()
    assert left[24:28, 2:6].all()
    assert left[24:28, 12:16].all() == left[24:28, 12:16].any() == better
    assert not left[36:39, 36:39].any()
    assert not (left & ~mask).any()


def test_depth_maps_look_through_stop_or_say_nothing():
    views = painted_sphere(5, size=32)
    rng = np.random.default_rng(0)
    depths = DepthMaps(
        views.names,
        np.where(rng.random(views.alpha.shape) < 0.3, 0, 3.5 + 0.3 * rng.normal(size=views.alpha.shape)).astype(
            np.float32
        ),
    )
    points, step = rng.uniform(-0.9, 0.9, (400, 3)), 0.05
    slow = np.zeros((3, len(points)))
    for camera, depth in zip(projections(views.intrinsics, views.world_to_camera), depths.depth, strict=True):
        for p, point in enumerate(points):
            image = camera[:, :3] @ point + camera[:, 3]
            column, row = int(np.floor(image[0] / image[2])), int(np.floor(image[1] / image[2]))
            if 0 <= row < 32 and 0 <= column < 32:
                seen = depth[row, column]
                beyond = (seen - image[2]) / step
                slow[0, p] += seen > 0 and beyond > 1.5
                slow[1, p] += seen > 0 and -6 < beyond <= 1.5
                slow[2, p] += seen == 0
    assert np.array_equal(np.stack(_sights(points, views, depths, step)), slow)
