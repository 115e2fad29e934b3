"""What counts in held-out views without masks, where the training views have some."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from exmesh_graph import testing
from exmesh_graph.evaluate import masked_region, region
from exmesh_graph.geometry.grounded import hull_of
from exmesh_graph.types import Mesh


@pytest.fixture(scope="module")
def views():
    return testing.views(count=24, size=96)


def _split(views):
    """(held-out views without masks, training views with theirs, the masks of the held-out ones)."""
    held = views.subset(range(0, 24, 6))
    bare = replace(held, has_masks=False, alpha=np.ones_like(held.alpha))
    return bare, views.subset([i for i in range(24) if i % 6]), held.alpha > 0.5


def test_what_shows_the_hull_of_the_training_masks_counts(views, monkeypatch):
    """Also where stereo finds nothing, on gloss or plain walls."""
    held, train, object_ = _split(views)
    monkeypatch.setattr(region, "_own_depth", lambda views, *_: np.zeros(views.alpha.shape, np.float32))
    found = region.find_region(held, train)
    assert found.source == "hull"
    assert not (found.inside & ~object_).any()
    for inside, true in zip(found.inside, object_, strict=True):
        assert inside[binary_erosion(true, iterations=4)].all()


@pytest.mark.parametrize("mirrored", [0.0, 0.6])
def test_surface_counts_from_where_a_ray_enters_the_hull_to_what_stereo_finds(views, monkeypatch, mirrored):
    """What stands behind the object covers nothing; stereo that finds a mirrored depth lets the surface count."""
    held, train, _ = _split(views)
    carrier = testing.carrier()
    truth = testing.depth_maps(carrier, held).depth
    monkeypatch.setattr(region, "_own_depth", lambda *_: np.where(truth > 0, truth + np.float32(mirrored), 0))
    found = region.find_region(held, train)
    inside = found.inside & (truth > 0)
    assert (found.near[inside] < truth[inside]).all()
    assert (truth[inside] < found.far[inside]).all()
    assert np.median((found.far - truth)[inside]) < 0.11 + mirrored
    shown = masked_region.shown_by_masks(held, train)
    assert (found.far <= shown.end + 0.101)[found.inside].all()


def test_the_hull_is_entered_and_left_where_rays_meet_it(views):
    held, train, _ = _split(views)
    shown = masked_region.shown_by_masks(held, train)
    for i in range(len(held)):
        rays, place = masked_region.pixel_directions(held, i)[shown.inside[i]], held.camera_to_world[i][:3, 3]
        field = hull_of(train)
        for depth, way in ((shown.start[i], 1), (shown.end[i], -1)):
            at = depth[shown.inside[i]][:, None]
            assert (field.plain(place + (at + 0.05 * way) * rays) > 0).mean() > 0.97
            assert (field.plain(place + (at - 0.05 * way) * rays) < 0).all()


def test_some_masks_are_not_enough(views, monkeypatch):
    """The hull of a few masks holds much that is no object."""
    held, train, _ = _split(views)
    masked = np.arange(len(train)) < 3
    some = replace(train, alpha=np.where(masked[:, None, None], train.alpha, 1).astype(np.float32))
    assert not some.masked.all()
    monkeypatch.setattr(region, "shown_by_masks", lambda *_: pytest.fail("masks have no say"))
    monkeypatch.setattr(region, "_own_depth", lambda views, *_: np.full(views.alpha.shape, 3, np.float32))
    assert region.find_region(held, some, region.RegionSettings(table="keep")).source == "depth"


def test_what_lies_below_the_ground_does_not_count(views):
    held, train, _ = _split(views)
    square = np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], np.float32)
    ground = Mesh(square, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    whole = masked_region.shown_by_masks(held, train).inside
    upper = masked_region.shown_by_masks(held, train, ground).inside
    assert 0.2 < (upper & whole).sum() / whole.sum() < 0.95
