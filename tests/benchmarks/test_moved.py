"""Copies of a scene that is moved: every point stays on its pixel, and what was scored against is kept or left out."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.moved import MOVES, moved

SAMPLE = Path(__file__).resolve().parents[2] / "graphs" / "samples" / "spot"


@pytest.mark.parametrize("name", MOVES)
def test_every_point_stays_on_its_pixel(tmp_path, name):
    moved(SAMPLE, tmp_path, MOVES[name])
    move = MOVES[name]
    before, after = pixels(SAMPLE), pixels(tmp_path)
    top, left = move.margin[0][0], move.margin[1][0]
    np.testing.assert_allclose(after, before + np.array([left, top]), atol=2e-3)
    assert (tmp_path / "test_rli").exists() == (not any(move.turn))


def test_pictures_keep_their_object_within_the_margin(tmp_path):
    moved(SAMPLE, tmp_path, MOVES["padded"])
    (above, below), (left, right) = MOVES["padded"].margin
    for name in ("train/000_rgba.png", "test/000_rough.png", "test_rli/esplanade_a_000.png"):
        old, new = (np.asarray(Image.open(folder / name)) for folder in (SAMPLE, tmp_path))
        assert new.shape[:2] == (old.shape[0] + above + below, old.shape[1] + left + right)
        np.testing.assert_array_equal(new[above:-below, left:-right], old)
        assert new.astype(int).sum() == old.astype(int).sum()


def pixels(folder: Path) -> np.ndarray:
    """Where the test views see the mesh's vertices, [M, V, 2]."""
    lines = (folder / "mesh" / "mesh.obj").read_text().splitlines()
    points = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)
    cameras = json.loads((folder / "transforms_test.json").read_text())
    width, height = cameras["w"], cameras["h"]
    focal = cameras.get("fl_x") or 0.5 * width / math.tan(0.5 * cameras["camera_angle_x"])
    centre = [cameras.get("cx", 0.5 * width), cameras.get("cy", 0.5 * height)]
    found = []
    for frame in cameras["frames"]:
        pose = np.array(frame["transform_matrix"])
        seen = (points - pose[:3, 3]) @ pose[:3, :3]
        found.append(seen[:, :2] * [1, -1] / -seen[:, 2:] * focal + centre)
    return np.array(found)
