"""Photographs as solvers see them: prepared once, not longer kept than the photographs."""

import gc

import pytest
import torch

from exmesh_graph import testing
from exmesh_graph.gpu.cores import cores
from exmesh_graph.targets import prepare_targets, visits


@pytest.mark.thorough
def test_pictures_are_prepared_once_and_go_with_their_views():
    views = testing.views(count=3)
    first = prepare_targets(views)
    assert prepare_targets(views).images is first.images
    half = prepare_targets(views, downscale=2)
    assert half.images.shape[1:3] == (24, 24)
    assert prepare_targets(testing.views(count=3)).images is not first.images
    kept = prepare_targets(views)
    assert torch.equal(kept.images, first.images)
    del views
    gc.collect()
    assert not visits._last


def test_pictures_are_the_same_on_any_number_of_cores():
    views = testing.views(count=5)
    alone = prepare_targets(views, downscale=2).images
    visits._last.clear()
    with cores(3):
        assert torch.equal(prepare_targets(views, downscale=2).images, alone)
