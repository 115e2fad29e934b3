"""A ball on a table by its true depth: the ball alone, closed; what lies in the air and beyond the pictures."""

from dataclasses import replace

import numpy as np
import pytest
from mask_scenes import GROUND, disc, overlap_of, scene

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.geometry.clean import inspect
from exmesh_graph.masks.drawn import drawn_outlines
from exmesh_graph.masks.object import object_of_depths, structured
from exmesh_graph.masks.pinhole import thinned
from exmesh_graph.masks.plane import Plane
from exmesh_graph.masks.settings import ObjectSettings
from exmesh_graph.masks.standing import down_to, looked_through, shown_by
from exmesh_graph.masks.wide import brought_back, widened, widened_points
from exmesh_graph.types import PointCloud

COARSE = ObjectSettings(resolution=64)


@pytest.fixture(scope="module")
def ball():
    return scene()


def test_the_ball_is_told_from_its_table(ball):
    found = object_of_depths(ball.views, ball.depths, COARSE)
    assert found.removed
    assert found.table.normal[1] > 0.999
    assert found.table.offset == pytest.approx(GROUND, abs=0.02)
    assert inspect(found.vertices, found.faces).closed
    assert found.vertices[:, 1].min() > GROUND - 0.02
    assert found.shares["table"] > 0.5
    assert sum(found.shares.values()) == pytest.approx(1)
    assert found.apart > 0.95
    drawn = drawn_outlines(found.vertices, found.faces, ball.views)
    assert np.mean([overlap_of(a, b) for a, b in zip(drawn, ball.masks, strict=True)]) > 0.85
    again = object_of_depths(ball.views, ball.depths, COARSE)
    assert (again.vertices == found.vertices).all()


def test_the_table_stays_where_that_is_asked(ball):
    found = object_of_depths(ball.views, ball.depths, COARSE.replaced(table="keep"))
    assert not found.removed
    assert np.ptp(found.vertices[:, 0]) == pytest.approx(1.7, abs=0.15)


def test_a_table_to_remove_must_be_there():
    free = scene(table=0)
    assert object_of_depths(free.views, free.depths, COARSE).table is None
    with pytest.raises(GeometryError, match=r"(?s)no plane was found.*table: auto"):
        object_of_depths(free.views, free.depths, COARSE.replaced(table="remove"))


def test_a_surface_that_goes_on_beyond_the_pictures_is_not_apart():
    """A ball half of which most pictures show, and one that few show at all."""
    beside = scene(count=16, table=0, at=0.8, focal=2.2)
    assert object_of_depths(beside.views, beside.depths, COARSE).apart < 0.6
    far = scene(count=16, table=0, radius=0.2, at=0.9, focal=2.6)
    with pytest.raises(GeometryError, match=r"(?s)nothing is left.*beside 9[0-9]%.*mask.files"):
        object_of_depths(far.views, far.depths, COARSE)


def test_depth_maps_that_no_two_views_share_give_no_surface(ball):
    views, depths, *_ = ball
    for alone in (np.zeros_like(depths.depth), np.where(np.arange(8)[:, None, None] == 0, depths.depth, 0)):
        with pytest.raises(GeometryError, match="gave no surface"):
            object_of_depths(views, replace(depths, depth=alone.astype(np.float32)), COARSE)


def test_a_lump_in_the_air_is_looked_through_and_the_ball_is_not(ball):
    lump = np.array([[-0.4, 0.05, -0.4], [0.5, 0.1, 0.3]])
    assert looked_through(lump, ball.views, ball.depths).all()
    assert looked_through(ball.ball[0], ball.views, ball.depths).mean() < 0.05  # of its rim, where pixels are coarse
    assert looked_through(disc(0.8)[0], ball.views, ball.depths).sum() == 0


def test_who_shows_a_point(ball):
    share = shown_by(np.array([[0.0, 0, 0], [0, 60.0, 0]]), ball.views)
    assert share.tolist() == [1.0, 0.0]


def test_depth_counts_where_the_picture_has_structure(ball):
    views, depths, *_ = ball
    images = views.images.copy()
    images[0, :20] = 0.3
    kept = structured(replace(views, images=images), depths, 0.003).depth
    assert not kept[0, :17].any()
    assert (kept[0, 23:] == depths.depth[0, 23:]).all()
    assert (kept[1:] == depths.depth[1:]).all()
    assert (structured(views, depths, 0.0).depth == depths.depth).all()


def test_a_wider_world_has_the_same_pictures(ball):
    views, depths, _, (vertices, faces) = ball
    wide = widened(views, 1.5)
    assert (
        drawn_outlines(vertices / np.float32(1.5), faces, wide) == drawn_outlines(vertices, faces, views)
    ).mean() > 0.999
    assert brought_back(brought_back(depths, 1 / 2), 2.0).depth == pytest.approx(depths.depth)
    cloud = PointCloud(vertices, np.zeros_like(vertices))
    assert widened_points(cloud, 2.0).points == pytest.approx(vertices / 2)
    assert widened_points(None, 2.0) is None


def test_feet_that_went_with_the_table_are_drawn_down_to_it():
    """A tube that ends above the plane gets a wall down to it; one that ends high above does not."""
    turn = 2 * np.pi * np.arange(12) / 12
    ring = np.stack([0.2 * np.cos(turn), np.zeros(12), 0.2 * np.sin(turn)], axis=1)
    k = np.arange(12)
    walls = np.concatenate([np.stack([k, 12 + k, (k + 1) % 12], axis=1),
                            np.stack([(k + 1) % 12, 12 + k, 12 + (k + 1) % 12], axis=1)]).astype(np.int32)  # fmt: skip
    up = np.array([0.0, 1, 0])
    tube = np.concatenate([ring + 0.05 * up, ring + 0.5 * up]).astype(np.float32)
    plane = Plane(up, 0.0, 0.5)
    vertices, faces = down_to(plane, tube, walls, 0.1)
    assert len(vertices) == 36
    assert vertices[24:, 1] == pytest.approx(0, abs=1e-6)
    assert inspect(vertices, faces).turned_edges == 0
    assert inspect(vertices, faces).open_edges == 24
    same, as_before = down_to(plane, tube, walls, 0.01)
    assert (len(same), len(as_before)) == (24, 24)


def test_large_pictures_are_looked_at_reduced(ball):
    """Twice as large and smooth: flat in 3 x 3 of their own pixels, not in the reduced ones."""
    views, depths, *_ = ball
    large = {name: np.repeat(np.repeat(getattr(views, name), 2, axis=1), 2, axis=2) for name in ("images", "alpha")}
    k = views.intrinsics.copy()
    k[:, :2] *= 2
    twice = replace(views, **large, intrinsics=k)
    maps = replace(depths, depth=np.repeat(np.repeat(depths.depth, 2, axis=1), 2, axis=2))
    assert (thinned(maps.depth, (views.height, views.width), 2) == depths.depth).all()
    here, there = object_of_depths(views, depths, COARSE), object_of_depths(twice, maps, COARSE, side=64)
    assert there.vertices == pytest.approx(here.vertices, abs=1e-5)
    with pytest.raises(DataError, match="not those of the views"):
        object_of_depths(twice, depths, COARSE)
