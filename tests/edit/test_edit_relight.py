"""Other light: rotation's sense, exposure, cameras that see the whole object, films."""

import json
import math

import numpy as np
import pytest
import torch

from exmesh_graph.edit.cameras import orbit
from exmesh_graph.edit.relight import relit, turned
from exmesh_graph.shading import envmap
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import EnvMap
from tests.edit.edit_scenes import ball


@pytest.mark.parametrize("angle", [0.0, math.pi / 2, 1.0, -2.0, 2 * math.pi])
def test_a_light_turns_counter_clockwise_seen_from_above(angle):
    directions = envmap.texel_directions(64, 128)
    axis = np.array([0.0, 0.3, 1.0]) / np.linalg.norm([0.0, 0.3, 1.0])
    radiance = np.exp(20 * (directions @ axis - 1))[..., None].repeat(3, axis=-1).astype(np.float32)
    turn = np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
    got = envmap.lookup(torch.from_numpy(turned(radiance, angle)), torch.tensor([turn @ axis], dtype=torch.float32))
    assert got[0, 0] == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(turned(radiance, angle).sum(axis=1), radiance.sum(axis=1), rtol=1e-5)


def test_a_whole_turn_and_no_exposure_keep_the_bytes():
    asset = ball()
    same = relit(asset, rotation=2 * math.pi)
    assert same.environment.tobytes() == asset.environment.tobytes()
    brighter = relit(asset, np.ones((4, 8, 3), np.float32), exposure=2.0)
    assert np.array_equal(brighter.environment, np.full((4, 8, 3), 4.0, np.float32))
    assert brighter.base_color is asset.base_color


@pytest.mark.parametrize("size", [(64, 64), (48, 96), (96, 48)])
def test_every_camera_of_an_orbit_sees_the_unit_ball_upright(size):
    height, width = size
    intrinsics, pose = orbit(5, height, width, elevation=0.6)
    points = np.random.default_rng(0).normal(size=(500, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    for k, c2w in zip(intrinsics, pose, strict=True):
        assert np.allclose(c2w[:3, :3] @ c2w[:3, :3].T, np.eye(3))
        assert np.linalg.det(c2w[:3, :3]) > 0
        local = (points - c2w[:3, 3]) @ c2w[:3, :3]
        assert (local[:, 2] > 0).all()
        pixel = local @ k.T
        pixel = pixel[:, :2] / pixel[:, 2:]
        assert (pixel >= 0).all()
        assert (pixel <= [width, height]).all()
        assert c2w[1, 1] < 0  # the image's downward axis points down


@pytest.mark.slow
def test_the_nodes_give_an_asset_pictures_and_a_film(tmp_path):
    from exmesh_nodes.edit import RelightParams, TurntableParams, relight, turntable
    from PIL import Image

    red = np.zeros((8, 16, 3), np.float32)
    red[..., 0] = 1
    context = FakeContext(scratch=tmp_path)
    out = relight(context, ball(), EnvMap(red), p=RelightParams(size=24, pictures=2, bounces=0))
    assert np.array_equal(out.asset.environment, red)
    captions = json.loads((out.gallery.root / "captions.json").read_text())
    assert [entry["file"] for entry in captions] == ["picture_00.png", "picture_01.png", "light.png", "model.glb"]
    picture = np.asarray(Image.open(out.gallery.root / "picture_00.png")).astype(int)
    middle = picture[12, 12]
    assert middle[0] > 100
    assert middle[1] == middle[2] == 0

    for turn in ("camera", "light"):
        film = turntable(
            FakeContext(scratch=tmp_path / turn), ball(),
            p=TurntableParams(frames=4, size=24, seconds=1, bounces=0, turn=turn),
        ).film  # fmt: skip
        with Image.open(film.root / film.main) as shown:
            assert shown.n_frames == 4
            assert shown.size == (24, 24)
            frames = []
            for k in range(4):
                shown.seek(k)
                frames.append(np.asarray(shown.convert("RGB")).astype(int))
        assert abs(frames[0] - frames[2]).max() > 20  # something turns


def test_a_film_is_the_same_twice(tmp_path):
    from exmesh_graph.edit.relight import write_film

    images = list(np.random.default_rng(0).random((3, 16, 16, 3)))
    for name in ("a", "b"):
        write_film(tmp_path / f"{name}.webp", images)
    assert (tmp_path / "a.webp").read_bytes() == (tmp_path / "b.webp").read_bytes()
