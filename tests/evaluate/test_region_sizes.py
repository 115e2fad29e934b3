"""What counts without masks, where a loader has reduced the training pictures and not the held-out ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from exmesh_graph import testing
from exmesh_graph.errors import DataError
from exmesh_graph.evaluate import region
from exmesh_graph.evaluate.settings import RegionSettings
from exmesh_graph.io.train_size import reduced

SETTINGS = RegionSettings(downscale=1)


@pytest.fixture
def photographs():
    views = testing.views(count=4, size=25)
    views = replace(views, has_masks=False, alpha=np.ones_like(views.alpha))
    return views.subset([0, 2]), views.subset([1, 3])


def test_depth_is_found_at_the_size_of_the_training_pictures(photographs, monkeypatch):
    held, train = photographs
    ramp = torch.arange(1.0, 145.0).reshape(12, 12)
    monkeypatch.setattr(region, "neighbours", lambda poses, count: [np.array([2, 3])] * len(poses))
    monkeypatch.setattr(region, "search_depths", lambda *_: ramp)
    monkeypatch.setattr(region, "agreed", lambda i, near, found, *_: found[i])
    monkeypatch.setattr(region, "_structured", lambda grey: torch.ones_like(grey, dtype=torch.bool))
    monkeypatch.setattr(region, "_grazing", lambda depth, *_: torch.zeros_like(depth, dtype=torch.bool))
    found = region._own_depth(held, reduced(train, 2), SETTINGS)
    assert found.shape == held.alpha.shape
    np.testing.assert_array_equal(found[1, :24, :24], ramp.numpy().repeat(2, axis=0).repeat(2, axis=1))
    assert not found[:, 24:].any()
    assert not found[:, :, 24:].any()


def test_other_sizes_are_refused(photographs):
    held, train = photographs
    odd = replace(train, images=train.images[:, :12, :11], alpha=train.alpha[:, :12, :11])
    with pytest.raises(DataError, match="the training views have 11 x 12 pixels"):
        region._own_depth(held, odd, SETTINGS)
