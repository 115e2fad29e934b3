"""Photographs as solvers see them: prepared once, not longer kept than the photographs."""

import gc

import numpy as np
import pytest
import torch

import exmesh_graph.targets as targets_module
from exmesh_graph import testing
from exmesh_graph.gpu.cores import cores
from exmesh_graph.raster import project
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


def test_what_views_show_is_what_their_pictures_show_and_is_kept_only_for_the_same_mesh(monkeypatch):
    targets = prepare_targets(testing.views())
    ball = testing.carrier()
    vertices, faces = torch.from_numpy(np.array(ball.vertices)), torch.from_numpy(np.array(ball.faces))
    drawn = []
    original = targets_module.rasterize_projected
    monkeypatch.setattr(targets_module, "rasterize_projected", lambda *a, **k: drawn.append(1) or original(*a, **k))
    found = targets.shown(vertices, faces)
    assert len(drawn) == len(targets)
    assert found.vertices.shape == (len(targets), len(vertices))
    pixels = 0
    for view in range(len(targets)):
        face_id = original(
            project(vertices, targets.intrinsics[view], targets.world_to_camera[view]), faces, targets.height,
            targets.width,
        ).face_id  # fmt: skip
        pixels += int((face_id >= 0).sum())
        expected = torch.zeros(len(vertices), dtype=torch.bool)
        for face in set(face_id[face_id >= 0].tolist()):
            expected[faces[face].long()] = True
        assert torch.equal(found.vertices[view], expected)
    assert found.pixels == pixels > 0
    count = len(drawn)
    assert targets.shown(vertices.clone().requires_grad_(), faces) is found
    assert len(drawn) == count
    vertices[0] += 0.1
    targets.shown(vertices, faces)
    assert len(drawn) == count + len(targets)
