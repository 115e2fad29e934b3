"""The sample of photographs: its lens, its truth, and (slow, with the extra `photos`) photos.yaml on it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageOps
from scipy.spatial.transform import Rotation

import exmesh_graph as ex
from benchmarks.photo_sample import SAMPLE, _inside, _pixels, against_truth, steps
from benchmarks.photos import similarity
from benchmarks.scenes import photographs as shots
from benchmarks.scenes.cameras import FIELD
from benchmarks.scenes.model import decode
from benchmarks.scenes.render import FOCUSED, Stage
from exmesh_graph.native import import_open3d
from exmesh_graph.types import Views

GRAPH = Path(__file__).parent.parent.parent / "graphs" / "photos.yaml"


@pytest.mark.thorough
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.2, 0.1), (-0.25, 0.2), (0.28, -0.19)])
def test_the_lens_bends_as_its_formula_says(place):
    """A bright spot at x = X / Z is found at x (1 + k1 r^2 + k2 r^4)."""
    side, half = shots.side(), math.tan(FIELD / 2)
    grid = (np.arange(side) + 0.5) / side * 2 * half - half
    x, y = np.meshgrid(grid, grid)
    spot = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * 0.004**2))
    seen = shots.photographed(np.repeat(spot[..., None], 3, 2), np.zeros((shots.HEIGHT, shots.WIDTH, 3)))[..., 0]
    weight = np.where(seen > 0.1, seen, 0)
    rows, columns = np.indices(weight.shape)
    found = [(weight * axis).sum() / weight.sum() + 0.5 for axis in (columns, rows)]
    r2 = place[0] ** 2 + place[1] ** 2
    bend = 1 + shots.LENS[0] * r2 + shots.LENS[1] * r2**2
    middle = (shots.WIDTH / 2, shots.HEIGHT / 2)
    expected = [shots.focal() * p * bend + m for p, m in zip(place, middle, strict=True)]
    assert found == pytest.approx(expected, abs=0.1)


def test_a_similarity_is_found():
    rng = np.random.default_rng(3)
    points, rotation = rng.normal(size=(9, 3)), Rotation.random(random_state=4).as_matrix()
    scale, found, offset = similarity(points, 2.5 * points @ rotation.T + [1, 2, 3])
    assert scale == pytest.approx(2.5)
    assert found == pytest.approx(rotation)
    assert offset == pytest.approx([1, 2, 3])


def test_cameras_are_compared_in_pixels_whatever_the_world_and_the_picture_are_turned_by():
    """One camera that is turned by a hundredth of its distance is off by five pixels, the others by little."""
    random = np.random.default_rng(0)
    points = random.normal(size=(50, 3)) * 0.3
    cameras = np.repeat(np.eye(4)[None], 6, axis=0)
    for pose in cameras:
        pose[:3, :3] = Rotation.random(random_state=random).as_matrix()
        pose[:3, 3] = -3 * pose[:3, 2]
    turn, shift = Rotation.from_rotvec([0.3, -0.7, 0.2]).as_matrix(), np.array([1.0, 2, 3])
    ours = cameras.copy()
    ours[:, :3, :3] = turn.T @ cameras[:, :3, :3]
    ours[:, :3, 3] = (cameras[:, :3, 3] - shift) @ turn / 2
    ours[1, :3, :3] = ours[1, :3, :3] @ Rotation.from_euler("z", 90, degrees=True).as_matrix()  # stored on its side
    k = np.repeat(np.diag([500.0, 500, 1])[None], 6, axis=0)
    views = Views(tuple("abcdef"), np.zeros((6, 2, 2, 3), np.float32), np.ones((6, 2, 2), np.float32), k, ours, "train")
    np.testing.assert_allclose(_pixels(views, cameras, points, 2.0, turn, shift), 0, atol=1e-6)
    ours[2, :3, :3] = ours[2, :3, :3] @ Rotation.from_rotvec([0, 0.01, 0]).as_matrix()
    off = _pixels(views, cameras, points, 2.0, turn, shift)
    assert off[2] == pytest.approx(5, rel=0.15)
    assert np.delete(off, 2).max() < 1.0


def test_the_surface_is_followed_from_start_to_end():
    """As many rounds as there were; a run that was stopped after its rounds has no end."""
    whole = {"coarse": {"mesh": 0}, "rounds[1].refine": {"state": 1}, "rounds[2].refine": {"state": 2}}
    assert list(steps(whole)) == [("start", 0), ("round 1", 1), ("round 2", 2)]
    assert list(steps({**whole, "settle": {"state": 3}}))[-1] == ("end", 3)


def test_what_lies_inside_the_true_surface_counts_as_inside():
    ball = import_open3d().geometry.TriangleMesh.create_sphere(1.0, 100)
    points = np.array([[0, 0, 0.9], [0, 1.1, 0]])
    assert _inside(points, ball) == pytest.approx([0.1, -0.1], abs=2e-3)


def test_the_sample_is_small_and_as_a_camera_gives_it():
    assert sum(file.stat().st_size for file in SAMPLE.rglob("*") if file.is_file()) < 5e6
    pictures = sorted((SAMPLE / "images").glob("*.jpg"))
    truth = json.loads((SAMPLE / "truth" / "cameras.json").read_text())
    assert [path.name for path in pictures] == sorted(truth["camera_to_world"])
    sizes = [ImageOps.exif_transpose(Image.open(path)).size for path in pictures]
    assert set(sizes) == {(720, 540), (540, 720)}, "some are held upright, and say so in EXIF"


@pytest.mark.slow
def test_photographs_alone_become_an_asset(tmp_path):
    """From a plain folder to USD: cameras, masks, surface near the truth, materials, without a hand."""
    pytest.importorskip("pycolmap", reason="the extra `photos`")
    run = ex.run(GRAPH, store=tmp_path / "store", runs=tmp_path / "runs")
    assert (run.folder / "asset.usdz").is_file()
    found = against_truth(run)
    assert found["photographs"] >= 24
    assert found["direction, median"] < 0.3
    assert found["accuracy"] < 8
    assert found["completeness"] < 8


def test_a_telephone_raises_contrast_colour_and_edges():
    flat = shots.pleasing(np.full((20, 20, 3), [0.3, 0.25, 0.2]))
    np.testing.assert_allclose(flat, np.broadcast_to(flat[0, 0], flat.shape), atol=1e-12)  # no edge
    red, _, blue = flat[0, 0]
    assert red - blue > 1.1 * 0.1  # more colour
    assert flat[0, 0].mean() < 0.25  # dark becomes darker
    assert shots.pleasing(np.full((20, 20, 3), 0.75)).mean() > 0.75
    edge = np.full((20, 20, 3), 0.4)
    edge[:, 10:] = 0.6
    row = shots.pleasing(edge)[10, :, 0]
    assert row[9] < row[2] < 0.4 < 0.6 < row[17] < row[10]
    assert shots.pleasing(np.random.default_rng(0).random((9, 9, 3))).max() <= 1


def test_a_lens_darkens_corners_as_it_is_told():
    light, still = np.full((shots.side(), shots.side(), 3), 0.5), np.zeros((shots.HEIGHT, shots.WIDTH, 3))
    even, dark = (decode(shots.photographed(light, still, corner)) for corner in (1.0, 0.4))
    ratio = (dark / even)[..., 0]
    np.testing.assert_allclose(even, 0.5, rtol=1e-3)
    assert ratio[0, 0] == pytest.approx(0.4, abs=0.005)
    assert ratio[shots.HEIGHT // 2, shots.WIDTH // 2] == pytest.approx(1, abs=0.005)
    assert (np.diff(ratio[shots.HEIGHT // 2, shots.WIDTH // 2 :]) < 0).all()


def test_a_lens_is_focused_on_the_nearer_side():
    pose = np.eye(4)
    pose[:3, 3] = [0, 3, 4]
    stage = Stage.__new__(Stage)
    stage.aperture = 0.0
    assert stage._lens(pose) == {"type": "perspective"}
    stage.aperture = 0.05
    assert stage._lens(pose) == {
        "type": "thinlens", "aperture_radius": 0.05, "focus_distance": pytest.approx(5 - FOCUSED)
    }  # fmt: skip
