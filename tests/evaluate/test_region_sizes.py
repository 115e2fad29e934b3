"""What counts without masks, where a loader has reduced the training pictures and not the held-out ones."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from exmesh_graph import testing
from exmesh_graph.errors import DataError
from exmesh_graph.evaluate import region
from exmesh_graph.evaluate.settings import RegionSettings
from exmesh_graph.io.train_size import reduced
from exmesh_graph.types import DepthMaps

SETTINGS = RegionSettings(downscale=1)


@pytest.fixture
def photographs():
    views = testing.views(count=4, size=25)
    views = replace(views, has_masks=False, alpha=np.ones_like(views.alpha))
    return views.subset([0, 2]), views.subset([1, 3])


@pytest.mark.parametrize("downscale", [1, 2])
def test_depth_is_found_at_the_size_of_the_training_pictures(photographs, monkeypatch, downscale):
    """What a loader has reduced is not reduced once more."""
    held, train = photographs
    ramp = np.arange(1.0, 145.0, dtype=np.float32).reshape(12, 12)

    def found_by(views, settings):
        assert settings.side == 32
        depth = np.stack([ramp] * len(views))
        return SimpleNamespace(depths=DepthMaps(views.names, depth))

    monkeypatch.setattr(region, "patch_match", found_by)
    monkeypatch.setattr(region, "_structured", lambda grey: torch.ones_like(grey, dtype=torch.bool))
    monkeypatch.setattr(region, "_grazing", lambda depth, *_: torch.zeros_like(depth, dtype=torch.bool))
    found = region._own_depth(held, reduced(train, 2), SETTINGS.replaced(downscale=downscale))
    assert found.shape == held.alpha.shape
    np.testing.assert_array_equal(found[1, :24, :24], ramp.repeat(2, axis=0).repeat(2, axis=1))
    assert not found[:, 24:].any()
    assert not found[:, :, 24:].any()


def test_other_sizes_are_refused(photographs):
    held, train = photographs
    odd = replace(train, images=train.images[:, :12, :11], alpha=train.alpha[:, :12, :11])
    with pytest.raises(DataError, match="the training views have 11 x 12 pixels"):
        region._own_depth(held, odd, SETTINGS)


def _ball_on_a_disc(views, radius: float = 0.9):
    """True depth [N, H, W] of a ball of radius 0.4 that stands on a disc, and which pixels are the ball's."""
    depth, ball = np.zeros(views.alpha.shape, np.float32), np.zeros(views.alpha.shape, bool)
    for i, pose in enumerate(views.camera_to_world):
        rays, place = region.pixel_directions(views, i), pose[:3, 3]
        square, half = (rays**2).sum(-1), rays @ place
        inner = half**2 - square * (place @ place - 0.16)
        near = np.where(inner > 0, (-half - np.sqrt(np.maximum(inner, 0))) / square, np.inf)
        flat = (-0.4 - place[2]) / rays[..., 2]
        spot = place + flat[..., None] * rays
        flat = np.where((flat > 0) & (np.linalg.norm(spot[..., :2], axis=-1) < radius), flat, np.inf)
        depth[i] = np.where(np.isfinite(np.minimum(near, flat)), np.minimum(near, flat), 0)
        ball[i] = np.isfinite(near) & (near < flat)
    return depth, ball


def _from_above(views):
    """The views without masks whose cameras look down on the plane z = -0.4."""
    above = [i for i, pose in enumerate(views.camera_to_world) if pose[2, 3] > 0.2]
    chosen = views.subset(above)
    return replace(chosen, has_masks=False, alpha=np.ones_like(chosen.alpha))


@pytest.mark.thorough
def test_the_table_that_the_object_stands_on_does_not_count(monkeypatch):
    views = _from_above(testing.views(count=24, size=160))
    depth, ball = _ball_on_a_disc(views)
    shown = np.where(ball, 0.8, np.where(depth > 0, 0.3, 0.0))  # the pictures' edges are the depths'
    views = replace(views, images=shown[..., None].repeat(3, axis=-1).astype(np.float32))
    monkeypatch.setattr(region, "_own_depth", lambda *_: depth)
    kept = region.find_region(views, None, RegionSettings(table="keep", downscale=1))
    found = region.find_region(views, None, RegionSettings(downscale=1))
    table = (depth > 0) & ~ball
    assert kept.inside[table].mean() > 0.8
    assert found.inside[table].mean() < 0.03
    assert found.inside[ball].mean() > 0.8
    assert (found.inside & ~kept.inside).sum() == 0


def test_the_base_of_an_object_is_no_table(monkeypatch):
    views = _from_above(testing.views(count=24, size=96))
    depth, _ = _ball_on_a_disc(views, radius=0.3)
    monkeypatch.setattr(region, "_own_depth", lambda *_: depth)
    found = region.find_region(views, None, RegionSettings(downscale=1))
    np.testing.assert_array_equal(
        found.inside, region.find_region(views, None, RegionSettings(table="keep", downscale=1)).inside
    )
