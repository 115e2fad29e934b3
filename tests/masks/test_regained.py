"""What carving lost of the masks: a rope before a ball comes back where it was, and nothing else does."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exmesh_graph.geometry.carve import Carving
from exmesh_graph.geometry.hull import Grid, SilhouetteField, projections, surface
from exmesh_graph.geometry.pixels import pixels_of
from exmesh_graph.masks.regained import _missed, _most_missed, regained
from exmesh_graph.raster import shown_faces
from tests.geometry.test_tsdf import sphere_views

BALL, ROPE = 0.4, 0.03
PLACE = np.array([0.6, 0.0, 0.0])


def field(grid, rope=True, smaller=0.0):
    """Distance into a ball, and into an upright rope beside it."""
    points = grid.points().astype(np.float64)
    values = BALL - smaller - np.linalg.norm(points, axis=1)
    if rope:
        aside = np.hypot(points[:, 0] - PLACE[0], points[:, 2] - PLACE[2])
        values = np.maximum(values, np.minimum(ROPE - aside, 0.5 - np.abs(points[:, 1])))
    return values.reshape(grid.shape).astype(np.float32)


def covered(views, values, grid):
    mesh = surface(values, grid)
    poses = zip(views.intrinsics, views.world_to_camera, strict=True)
    return np.stack([shown_faces(*mesh, k, pose, views.height, views.width) >= 0 for k, pose in poses])


def seen_of(rope):
    """Views with masks of both or of the ball alone, their hull, and it less all but the ball."""
    grid, fine = (Grid.over(np.full(3, -0.75), np.full(3, 0.75), n) for n in (60, 120))
    views, _ = sphere_views(count=24, centre=(0, 0, 0))
    views = replace(views, alpha=covered(views, field(fine, rope), fine).astype(np.float32), has_masks=True)
    hull = SilhouetteField.of_views(views)(grid.points(), floor=-3 * grid.step).reshape(grid.shape)
    return views, Carving(grid, hull, np.minimum(hull, field(grid, rope=False)), 3 * grid.step, 0.0)


def test_a_rope_that_was_carved_away_comes_back_where_it_was():
    views, carving = seen_of(rope=True)
    lost = carving.field()
    back = regained(lost, carving, views)
    bare = [
        sum(_missed(*both).sum() for both in zip(views.alpha > 0.5, covered(views, values, carving.grid), strict=True))
        for values in (lost, back)
    ]
    assert bare[0] > 1000
    assert bare[1] < 0.05 * bare[0]
    put = carving.grid.points()[((back > 0) & (lost <= 0)).ravel()]
    assert len(put) > 100
    off = np.hypot(put[:, 0] - PLACE[0], put[:, 2] - PLACE[2])
    assert np.mean(off < ROPE + 1.5 * carving.grid.step) > 0.9
    assert ((back <= 0) | (carving.hull > -0.5 * carving.grid.step)).all()
    assert np.array_equal(back[back <= 0], lost[back <= 0])


@pytest.mark.parametrize(("erring", "expected"), [(4, False), (20, True)])
def test_what_few_masks_show_beside_a_solid_is_their_error(erring, expected):
    """A rope that so many of 24 masks show, in a hull that the others do not cut."""
    views, carving = seen_of(rope=True)
    ball, _ = seen_of(rope=False)
    hull = np.maximum(carving.hull, field(carving.grid))
    mixed = replace(views, alpha=np.concatenate([views.alpha[:erring], ball.alpha[erring:]]))
    lost = carving.field()
    for found in (False, True):  # masks that are given do not err
        back = regained(lost, replace(carving, hull=hull), mixed, found=found)
        assert (((back > 0) & (lost <= 0)).sum() > 100) == (expected or not found)


def test_a_rim_of_half_a_pixel_is_not_filled():
    """A ball that is half a pixel too small everywhere, as smoothing leaves it; and views that have no mask."""
    views, carving = seen_of(rope=False)
    small = np.minimum(carving.hull, field(carving.grid, rope=False, smaller=0.5 * 3.5 / views.intrinsics[0, 0, 0]))
    assert (views.alpha > 0.5).sum() > 1.02 * covered(views, small, carving.grid).sum()
    assert np.array_equal(regained(small, carving, views), small)
    nothing = np.full_like(small, -1.0)
    nothing[30, 30, 30] = 0.01
    assert not np.array_equal(regained(nothing, carving, views), nothing)
    blind = replace(views, alpha=np.ones_like(views.alpha), has_masks=False)
    assert np.array_equal(regained(nothing, carving, blind), nothing)


@given(st.integers(0, 2**32 - 1))
def test_points_come_back_where_most_missed_rays_meet(seed):
    """Beside loops over points, views and pixels."""
    rng = np.random.default_rng(seed)
    views, _ = sphere_views(count=4, size=6)
    points = rng.uniform(-1, 1, (int(rng.integers(1, 60)), 3)).astype(np.float32)
    missed = list(rng.random((4, 6, 6)) < rng.random())
    cameras = projections(views.intrinsics, views.world_to_camera)
    on = {}  # (view, pixel): points on it
    for view, (camera, one) in enumerate(zip(cameras, missed, strict=True)):
        for p, point in enumerate(points):
            z, row, column = (float(part[0]) for part in pixels_of(point[None], camera, one.shape))
            if np.isfinite(z) and one[int(row), int(column)]:
                on.setdefault((view, row, column), []).append(p)
    count = [sum(p in some for some in on.values()) for p in range(len(points))]
    slow = np.zeros(len(points), bool)
    for some in on.values():
        most = max(count[p] for p in some)
        for p in some:
            slow[p] |= most >= 2 and count[p] >= 0.9 * most
    assert np.array_equal(_most_missed(points, cameras, missed), slow)
