"""Training pictures reduced for the fits: by which factor, to what, and that test pictures and the world stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exmesh_graph import testing
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.io.train_size import factor_for, reduced
from exmesh_graph.types.pictures import Pictures


@pytest.mark.parametrize(
    ("side", "megapixels", "factor"),
    [(0, 0, 1), (48, 0, 1), (47, 0, 2), (24, 0, 2), (23, 0, 3), (0, 0.018432, 1), (0, 0.018431, 2), (40, 0.001, 5)],
)
def test_the_least_whole_factor(side, megapixels, factor):
    assert factor_for(testing.views(count=8, size=48), side, megapixels) == factor


def test_reduced_views_are_area_means_seen_by_the_same_cameras():
    views = testing.views(count=2, size=50)
    small = reduced(views, 3)
    assert small.images.shape == (2, 16, 16, 3)
    blocks = views.images[:, :48, :48].reshape(2, 16, 3, 16, 3, 3)
    np.testing.assert_allclose(small.images, blocks.mean(axis=(2, 4)), rtol=1e-6)
    np.testing.assert_allclose(small.intrinsics[:, :2], views.intrinsics[:, :2] / 3)
    assert reduced(views, 1) is views


def test_a_loader_reduces_training_pictures_alone(blender_scene):
    options = BlenderOptions(truth=False)
    whole = load_blender(blender_scene, options)
    small = load_blender(blender_scene, options.replaced(train_side=whole.train.width // 2))
    assert small.train.width == whole.train.width // 2
    assert small.test.width == whole.test.width
    assert small.test.images.tobytes() == whole.test.images.tobytes()
    assert small.train.camera_to_world.tobytes() == whole.train.camera_to_world.tobytes()
    assert small.frame.scene_from_normalised.tobytes() == whole.frame.scene_from_normalised.tobytes()


def test_a_large_set_goes_into_files(monkeypatch, tmp_path):
    monkeypatch.setattr("exmesh_graph.io.picture_files.too_large", lambda *_: True)
    views = testing.views(count=3, size=32)
    kept, filed = (reduced(replace(views), 2), reduced(views, 2))
    assert isinstance(filed.images, Pictures)
    np.testing.assert_array_equal(np.asarray(filed.images), np.asarray(kept.images))
