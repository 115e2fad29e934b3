"""Environment conventions, by maps whose texels hold the direction they stand for."""

import numpy as np
import pytest
from io_scenes import blender_directions, blender_from_canonical

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import scene_from_dataset
from exmesh_graph.io.envmaps import (
    canonical_directions,
    canonical_from_blender,
    read_environment,
)
from exmesh_graph.io.images import write_image


@pytest.mark.parametrize(("height", "width"), [(4, 8), (16, 32), (10, 20), (5, 12)])
def test_direction_coded_map(height, width):
    """Each texel of the Blender map holds its direction turned to Y up: the canonical map must hold its own."""
    turn = scene_from_dataset("z", np.eye(4)[None])[:3, :3]
    coded = blender_directions(height, width) @ turn.T
    assert np.abs(canonical_from_blender(coded) - canonical_directions(height, width)).max() < 1e-12


def test_formula_of_the_data():
    """u = 0.5 - atan2(d.y, d.x) / 2 pi, v = acos(d.z) / pi gives each texel's own column and row."""
    height, width = 6, 16
    d = blender_directions(height, width)
    columns = ((0.5 - np.arctan2(d[..., 1], d[..., 0]) / (2 * np.pi)) % 1) * width - 0.5
    rows = np.arccos(d[..., 2]) / np.pi * height - 0.5
    assert np.allclose(columns, np.arange(width)[None])
    assert np.allclose(rows, np.arange(height)[:, None])


def test_canonical_landmarks():
    """Image centre +Z, u = 1/4 is +X, row 0 is +Y."""
    d = canonical_directions(201, 400)
    assert d[100, 199:201].mean(0) == pytest.approx([0, 0, 1], abs=0.01)
    assert d[100, 99:101].mean(0) == pytest.approx([1, 0, 0], abs=0.01)
    assert d[0, 0] == pytest.approx([0, 1, 0], abs=0.01)


def test_width_that_is_no_multiple_of_four_is_resampled():
    width = 30
    smooth = blender_directions(8, width) @ scene_from_dataset("z", np.eye(4)[None])[:3, :3].T
    assert np.abs(canonical_from_blender(smooth) - canonical_directions(8, width)).max() < 0.01
    noise = np.random.default_rng(0).random((8, width, 3))
    assert canonical_from_blender(noise).mean() == pytest.approx(noise.mean())


def test_inverse():
    noise = np.random.default_rng(0).random((8, 32, 3)).astype(np.float32)
    assert np.array_equal(blender_from_canonical(canonical_from_blender(noise)), noise)


def test_reading(tmp_path):
    pixels = np.random.default_rng(0).random((4, 8, 3)).astype(np.float32)
    pixels[0, 0, 0] = -0.5
    write_image(tmp_path / "e.exr", pixels, "float")
    read = read_environment(tmp_path / "e.exr")
    assert read[0, 0, 0] == 0
    assert np.array_equal(read[1:], pixels[1:])
    write_image(tmp_path / "gray.exr", pixels[..., :1], "float")
    with pytest.raises(DataError, match=r"gray\.exr.*no colour"):
        read_environment(tmp_path / "gray.exr")
