"""What stands still behind a turntable: told from what turns, from orbits and from pictures of one place."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from benchmarks.photos import differences
from exmesh_graph.errors import DataError
from exmesh_graph.io import motion
from exmesh_graph.io.checks.features import Pair, that_move
from exmesh_graph.io.images import write_image
from exmesh_graph.io.photos import place_photos
from exmesh_graph.io.settings import MotionSettings, PhotosOptions
from exmesh_graph.io.still import still_features, turning, turning_masks
from tests.io.io_scenes import look_at
from tests.io.test_io_photos import picture

SIDE, FOCAL = 720.0, 600.0


def seen(angle: float, rng: np.random.Generator, still: int, moving: int) -> np.ndarray:
    """Pixels of `still` points of a wall, the same in every picture, and of `moving` ones turned about y."""
    wall = np.random.default_rng(1).uniform(0, SIDE, (still, 2))
    cloud = np.random.default_rng(2).uniform(-1, 1, (moving, 3))
    c, s = np.cos(angle), np.sin(angle)
    turned = cloud @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    there = FOCAL * turned[:, :2] / (4 + turned[:, 2:]) + SIDE / 2
    return np.concatenate([wall, there]) + rng.normal(0, 0.3, (still + moving, 2))


def case(still: int, moving: int, angles: np.ndarray):
    rng = np.random.default_rng(0)
    pixels = {k: seen(angle, rng, still, moving) for k, angle in enumerate(angles)}
    every = np.repeat(np.arange(still + moving, dtype=np.int64)[:, None], 2, axis=1)
    wall = every[:still]
    matches = {
        (a, b): every if abs(a - b) < 3 else wall for a in pixels for b in pixels if a < b
    }  # what turns far has no matches
    return pixels, matches


@pytest.fixture(scope="module")
def colmap():
    return pytest.importorskip("pycolmap", reason="pip install 'exmesh-graph[photos]'")


def told(colmap, pixels, matches):
    places = {k: found / SIDE for k, found in pixels.items()}
    still, rest = still_features(places, matches), still_features(places, matches, 1)
    return still, turning(colmap, pixels, matches, still, rest)


def test_a_wall_behind_a_turntable_is_told_from_what_turns(colmap):
    still, turns = told(colmap, *case(300, 80, np.radians(20.0 * np.arange(9))))
    assert turns
    for found in still.values():
        assert found[:300].mean() > 0.98
        assert found[300:].mean() < 0.05


def test_an_orbit_has_nothing_that_stands_still(colmap):
    still, turns = told(colmap, *case(0, 300, np.radians(20.0 * np.arange(9))))
    assert not turns
    assert all(found.mean() < 0.05 for found in still.values())


def test_pictures_of_a_still_scene_from_one_place_are_left_alone(colmap):
    pixels, matches = case(300, 0, np.zeros(9))
    rng = np.random.default_rng(3)
    for pair, pairs in matches.items():  # chance matches beside
        matches[pair] = np.concatenate([pairs, rng.integers(0, 300, (60, 2))])
    still, turns = told(colmap, pixels, matches)
    assert all(found.mean() > 0.95 for found in still.values())
    assert not turns


def test_few_features_at_rest_change_nothing(colmap):
    _, turns = told(colmap, *case(15, 200, np.radians(20.0 * np.arange(9))))  # a mark of the camera in a corner
    assert not turns


@pytest.mark.thorough
def test_cameras_of_what_turns_before_a_painted_wall(colmap, tmp_path):
    noise = np.random.default_rng(4).normal(size=(2, 300, 400))
    wall, paint = (np.clip(0.5 + gaussian_filter(one, 1.2), 0, 1).astype(np.float32) for one in noise)
    angles = np.radians(12.0 * np.arange(8))
    eyes = 4 * np.stack([np.sin(angles), np.full(8, 0.3), np.cos(angles)], axis=1)
    cameras = np.stack([look_at(eye, np.zeros(3), np.array([0, 1.0, 0])) for eye in eyes])
    balls: list[np.ndarray] = []
    for i, pose in enumerate(cameras):
        grey, ball = picture(pose, paint, 400, 300, 430.0)
        balls.append(ball)
        write_image(tmp_path / f"p{i}.png", np.repeat(np.where(ball, grey, wall)[..., None], 3, axis=2))
    quick = PhotosOptions(matching="plain", mapping="incremental", features=800)
    for work in ("all", "moving"):
        (tmp_path / work).mkdir()
    with pytest.raises(DataError, match="cameras were found for 0 of 8 pictures"):
        place_photos(tmp_path, quick.replaced(turntable=False), tmp_path / "all")
    found = place_photos(tmp_path, quick, tmp_path / "moving").motion
    poses = np.stack([found.camera_to_world[f"p{i}.png"] for i in range(len(cameras))])
    assert differences(poses, cameras)[0].max() < 2
    masks = turning_masks(colmap, tmp_path / "moving" / "plain" / "database.db")
    shown = np.stack([masks[f"p{i}.png"] for i in range(len(cameras))])
    assert ((shown & balls).sum() / (shown | balls).sum()) > 0.9


def test_the_error_tells_how_far_to_turn(tmp_path):
    names = [f"p{k}.png" for k in range(8)]
    for turned, cure in ((True, "turn the object by 15 degrees"), (False, "of a still scene")):
        with pytest.raises(DataError) as caught:
            motion._check_enough(names, tuple(names), MotionSettings(), tmp_path, turned=turned)
        assert cure in str(caught.value)


def test_matches_at_rest_do_not_contradict_cameras():
    rng = np.random.default_rng(0)
    wall, moved = rng.uniform(0, 400, (200, 2)), rng.uniform(0, 400, (30, 2))

    def pair(first: int, still: int, moving: int) -> Pair:
        places = np.concatenate([wall[:still], moved[:moving]])
        return Pair(first, first + 1, places, places + np.repeat([[0.1, 0], [9, 2]], [still, moving], axis=0))

    behind = [pair(0, 200, 30), pair(1, 200, 4), pair(2, 150, 20)]
    assert [len(kept.places) for kept in that_move(behind, 400)] == [30, 20]
    orbit = [pair(0, 3, 30), pair(1, 2, 30)]
    assert that_move(orbit, 400) == orbit
