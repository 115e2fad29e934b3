"""Which of COLMAP's mappings the matches support, and which pictures hold together: on made-up models, no pycolmap."""

import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from exmesh_graph.io import mapping
from exmesh_graph.io.mapping import agreeing, map_cameras, tied

FOCAL, CENTRE = 300.0, 100.0


class Camera:
    """A pinhole."""

    def cam_from_img(self, pixels):
        return (pixels - CENTRE) / FOCAL

    def mean_focal_length(self):
        return FOCAL


def pose(i, tilt=0.0):
    """[R | t] of a camera on a circle around the origin, tilted by `tilt` degrees."""
    (c, own), (s, up) = (f(np.radians([12.0 * i, tilt])) for f in (np.cos, np.sin))
    turn, nod = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.array([[1, 0, 0], [0, own, -up], [0, up, own]])
    return nod @ np.c_[turn, [0.05 * i, 0.02 * i * i, 4.0]]


def image(number, matrix):
    return SimpleNamespace(
        name=f"p{number}.png", camera_id=1, has_pose=True, cam_from_world=lambda: SimpleNamespace(matrix=lambda: matrix)
    )


def new_folder(place):
    return Path(tempfile.mkdtemp(dir=place))


def point(*seen):
    return SimpleNamespace(track=SimpleNamespace(elements=[SimpleNamespace(image_id=number) for number in seen]))


def model(poses, points=()):
    images = {number: image(number, matrix) for number, matrix in poses.items()}
    return SimpleNamespace(images=images, cameras={1: Camera()}, points3D=dict(enumerate(points)))


class Database:
    """Pictures 1 to 4 with 60 points each, all matched in order; of pair (1, 2) ten matches are 3 pixels off."""

    def __init__(self):
        world = np.random.default_rng(0).uniform(-0.5, 0.5, (60, 3))
        self.keypoints = {}
        for number in range(1, 5):
            x = world @ pose(number)[:, :3].T + pose(number)[:, 3]
            pixels = FOCAL * x[:, :2] / x[:, 2:] + CENTRE
            self.keypoints[number] = np.c_[pixels, np.ones((60, 4))]
        self.off = np.arange(10)
        self.matches = {(a, b): np.repeat(np.arange(60)[:, None], 2, 1) for a in range(1, 5) for b in range(a + 1, 5)}
        self.closed = False

    def read_keypoints(self, number):
        return self.keypoints[number]

    def read_two_view_geometries(self):
        return list(self.matches), [SimpleNamespace(inlier_matches=m) for m in self.matches.values()]

    def num_images(self):
        return len(self.keypoints)

    def close(self):
        self.closed = True


@pytest.fixture
def colmap():
    database = Database()
    return SimpleNamespace(
        database=database, Database=SimpleNamespace(open=lambda path: database), pair_id_to_image_pair=lambda pair: pair
    )


def test_right_cameras_agree_with_all_matches_and_a_wrong_one_loses_its_own(colmap):
    names = [f"p{n}.png" for n in range(1, 5)]
    right = {n: pose(n) for n in range(1, 5)}
    assert agreeing(colmap, Path("x"), model(right), names) == (6 * 60, 6 * 60)
    assert colmap.database.closed
    assert agreeing(colmap, Path("x"), model(right), names[:3]) == (3 * 60, 3 * 60)
    tilted, matched = agreeing(colmap, Path("x"), model(right | {4: pose(4, 3.0)}), names)
    assert matched == 6 * 60
    assert 3 * 60 <= tilted < 3 * 60 + 90  # the pairs without picture 4, and what comes near by chance
    colmap.database.keypoints[2][:10, 1] += 3.0  # the epipolar lines are level to within a few degrees
    assert agreeing(colmap, Path("x"), model(right), names) == (6 * 60 - 3 * 10, 6 * 60)
    colmap.database.keypoints[2][:10, 1] -= 2.0
    assert agreeing(colmap, Path("x"), model(right), names) == (6 * 60, 6 * 60)


def test_the_scale_of_the_world_does_not_count(colmap):
    names = [f"p{n}.png" for n in range(1, 5)]
    poses = {n: pose(n) * [1, 1, 1, 1e-4] for n in range(1, 5)}
    assert agreeing(colmap, Path("x"), model(poses), names) == (6 * 60, 6 * 60)
    same = {n: pose(1) for n in range(1, 5)}  # no baseline at all: nothing to hold against them
    assert agreeing(colmap, Path("x"), model(same), names) == (6 * 60, 6 * 60)


def test_pictures_that_hang_on_pairs_alone_are_not_tied():
    poses = {n: pose(n) for n in range(1, 8)}
    three = [point(1, 2, 3)] * 10 + [point(3, 4, 1)] * 10
    assert tied(model(poses, three)) == {"p1.png", "p2.png", "p3.png", "p4.png"}
    assert tied(model(poses, [*three, *[point(4, 5)] * 50])) == {f"p{n}.png" for n in (1, 2, 3, 4)}
    assert tied(model(poses, [*three, *[point(4, 5, 6)] * 9])) == {f"p{n}.png" for n in (1, 2, 3, 4)}
    assert tied(model(poses, [*three, *[point(4, 5, 6)] * 10])) == {f"p{n}.png" for n in (1, 2, 3, 4, 5, 6)}
    assert tied(model(poses, [point(4, 4, 5)] * 50)) in [{f"p{n}.png"} for n in range(1, 8)]  # one picture seen twice
    assert tied(model({})) == set()


def test_the_mapping_that_most_matches_agree_with_is_taken(colmap, tmp_path, monkeypatch):
    everywhere = [point(1, 2, 3, 4)] * 12
    right = {n: pose(n) for n in range(1, 5)}
    part = model({n: right[n] for n in (1, 2, 3)}, everywhere)
    wrong, whole = model(right | {4: pose(4, 3.0)}, everywhere), model(right, everywhere)
    cases = [
        ([{}, {0: part}, {0: wrong}], "easier", 3),  # a picture placed wrongly adds nothing
        ([{0: part}, {0: whole}, {0: wrong}], "easier", 4),
        ([{0: whole}, {0: whole}, {0: whole}], "incremental", 4),
        ([{0: part, 1: whole}, {}, {}], "incremental", 4),
    ]
    for models, how, count in cases:
        given = dict(zip(("incremental", "easier", "global"), models, strict=True))
        monkeypatch.setattr(mapping, "_models", lambda *args, given=given: given[args[-1]])
        found = map_cameras(colmap, Path("x"), tmp_path, new_folder(tmp_path), 0)
        assert (found.how, len(found.names)) == (how, count)
    monkeypatch.setattr(mapping, "_models", lambda *_: {0: model(right)})
    assert (
        map_cameras(colmap, Path("x"), tmp_path, new_folder(tmp_path), 0) is None
    )  # four pictures, no point that three see
    monkeypatch.setattr(mapping, "_models", lambda *args: {0: {"global": whole}[args[-1]]})
    assert map_cameras(colmap, Path("x"), tmp_path, new_folder(tmp_path), 0, "global").how == "global"


@pytest.mark.parametrize(
    ("off", "tried"), [(0, ["incremental"]), (18, ["incremental"]), (19, ["incremental", "easier", "global"])]
)
def test_other_ways_are_tried_unless_all_pictures_are_placed_as_nearly_all_matches_say(
    off, tried, colmap, tmp_path, monkeypatch
):
    """`off` of the 360 matches lie beside their lines: 95 % are 342."""
    names, right = [], model({n: pose(n) for n in range(1, 5)}, [point(1, 2, 3, 4)] * 12)
    monkeypatch.setattr(mapping, "_models", lambda *args: names.append(args[-1]) or {0: right})
    monkeypatch.setattr(mapping, "agreeing", lambda *_: (360 - off, 360))
    taken = map_cameras(colmap, Path("x"), tmp_path, new_folder(tmp_path), 0)
    assert (taken.how, taken.agreeing, taken.matches) == ("incremental", 360 - off, 360)
    assert names == tried
    colmap.database.keypoints[5] = colmap.database.keypoints[4]  # a picture without a camera
    names.clear()
    assert len(map_cameras(colmap, Path("x"), tmp_path, new_folder(tmp_path), 0).names) == 4
    assert len(names) == 3
