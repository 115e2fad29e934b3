"""The generator of rendered scenes: closed shapes, maps and lights that are what the renderer is given, true truth."""

import numpy as np
import pytest
import torch

from benchmarks.register import Digests, scenes
from benchmarks.scenes import lights, make, shapes
from benchmarks.scenes.cameras import DISTANCE, rays, spiral
from benchmarks.scenes.catalogue import RECIPES
from benchmarks.scenes.digests import differences
from benchmarks.scenes.model import Model, assemble, decode, encode, pack
from benchmarks.scenes.truth import Truth, brdf


def plain(points, normals, part):
    return np.full((len(points), 3), 0.25), np.full(len(points), 0.5), (part == "ball").astype(float)


def united(solids, **given) -> Model:
    pytest.importorskip("manifold3d", reason="objects are united by manifold3d (the extra `test`)")
    return assemble(solids, plain, given.pop("size", 128), **given)


@pytest.fixture(scope="module")
def ball_and_box() -> Model:
    solids = [shapes.ball("ball", (0, 0, 0.5), (0.5, 0.5, 0.5)), shapes.box("box", (0.5, 0.4, 0.3), 0.05)]
    return united(solids, ground=("box",))


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["chair", "plant", "flask", "padlock", "kiosk", "desk", "still", "jug"])
def test_objects_are_one_closed_surface_within_the_sphere(name):
    model = united(list(RECIPES[name].solids()))
    corners = model.vertices.astype(np.float64)[model.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.abs(across.sum(0)).max() < 1e-4 * np.abs(across).sum(), "the areas of a closed surface cancel"
    assert (corners[:, 0] * across).sum() > 0, "the volume is inside"
    facing = (model.normals[model.faces].mean(1) * across).sum(1)
    assert np.abs(across[facing < 0]).sum() < 0.01 * np.abs(across).sum(), "normals look where the faces do"
    assert np.linalg.norm(model.vertices, axis=1).max() == pytest.approx(1.2, abs=1e-4)
    assert model.uv.min() > 0
    assert model.uv.max() < 1


def test_hidden_surface_is_gone_and_parts_keep_their_paint(ball_and_box):
    truth = Truth(ball_and_box)
    outward = np.random.default_rng(0).normal(size=(500, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    met = truth.cast(np.concatenate([np.zeros((500, 3)), outward], axis=1).astype(np.float32))
    assert met.hit.all()
    assert ((met.normal * outward).sum(1) > 0).all(), "from within every ray meets the outer surface first"
    np.testing.assert_allclose(
        met.base, decode(np.round(255 * encode(np.full(3, 0.25))) / 255)[None].repeat(500, 0), atol=1e-4
    )
    on_ball = met.own > 0.5
    assert on_ball.any()
    assert not on_ball.all()
    np.testing.assert_allclose(met.metallic[on_ball], 1, atol=0.51)
    rows = ball_and_box.of_object()
    assert 0 < len(rows) < len(ball_and_box.faces)


def test_charts_do_not_overlap():
    boxes = np.random.default_rng(1).uniform(0.05, 0.6, (30, 2))
    corners, scale = pack(boxes, 256)
    used = np.zeros((256, 256), int)
    for low, (wide, high) in zip(corners, np.ceil(boxes * scale).astype(int), strict=True):
        used[low[1] : low[1] + high, low[0] : low[0] + wide] += 1
    assert used.max() == 1
    assert used.mean() > 0.4


def test_a_ball_seen_from_a_camera_has_its_depth_and_normals():
    model = united([shapes.ball("ball", (0, 0, 0), (1, 1, 1), sides=160)], size=64)
    pose = spiral(3, -0.3, 0.9, 0.4, 5)[1]
    seen = Truth(model).view(pose, 33)
    far = np.linalg.norm(pose[:3, 3])
    assert far == pytest.approx(DISTANCE, rel=0.03)
    assert seen["depth"][16, 16] == pytest.approx(far - 1.2, abs=2e-3)
    np.testing.assert_allclose(seen["normal"][16, 16], pose[:3, 2], atol=5e-3)
    along = rays(pose, 33)
    row, column = 9, 22
    step = seen["depth"][row, column] / (along[row, column, 3:] @ -pose[:3, 2])
    assert np.linalg.norm(along[row, column, :3] + step * along[row, column, 3:]) == pytest.approx(1.2, abs=2e-3)
    assert seen["alpha"][16, 16] == 1
    assert seen["alpha"][0, 0] == 0


def test_light_files_are_read_back_as_they_are_meant():
    light = np.random.default_rng(2).uniform(0, 1, (16, 32, 3)).astype(np.float32)
    towards = lights.directions(16)
    np.testing.assert_allclose(lights.lookup(light, towards.reshape(-1, 3)), light.reshape(-1, 3), atol=1e-5)
    np.testing.assert_allclose(towards[8, 16], [1, 0, 0], atol=0.15)  # the middle column looks along +x
    assert towards[0, 0, 2] > 0.99
    assert towards[8, 8, 1] > 0.95  # a quarter in, +y


@pytest.mark.thorough
@pytest.mark.parametrize("name", sorted(lights.PROCEDURAL))
def test_every_procedural_light_has_the_level_it_is_set_to(name):
    light = make.levelled(lights.PROCEDURAL[name](3), 7.6)
    height = len(light)
    weight = np.sin((np.arange(height) + 0.5) / height * np.pi)[:, None, None] * (np.pi / height) ** 2
    assert (light * weight).sum((0, 1)).mean() == pytest.approx(7.6, rel=1e-5)
    assert np.isfinite(light).all()
    assert light.min() >= 0
    np.testing.assert_array_equal(light, make.levelled(lights.PROCEDURAL[name](3), 7.6))


def test_reflectance_is_the_method_s():
    from exmesh_graph.shading.brdf import evaluate

    rng = np.random.default_rng(4)
    n, v = np.array([0.0, 0, 1]), np.array([0.6, 0, 0.8])
    l = np.abs(rng.normal(size=(50, 3)))
    l /= np.linalg.norm(l, axis=1, keepdims=True)
    for base, rough, metal in (([0.5, 0.2, 0.1], 0.4, 0.0), ([0.9, 0.6, 0.2], 0.15, 1.0), ([0.3, 0.3, 0.5], 0.7, 0.5)):
        ours = brdf(np.array(base), rough, metal, n, v, l)
        theirs = evaluate(
            *(torch.tensor(np.broadcast_to(a, (50, 3)).copy()) for a in (n, v, l, base)),
            torch.full((50,), rough, dtype=torch.float64), torch.full((50,), metal, dtype=torch.float64),
        )  # fmt: skip
        np.testing.assert_allclose(ours, theirs.numpy(), rtol=1e-6)


def test_wandering_settings_and_shadows_stay_out_of_the_test_views():
    gains = make.wandering(40, 7)
    assert 0.6 < gains.min() < 0.85 < 1.15 < gains.max() < 1.65
    poses = spiral(40, -0.3, 0.9, 0.0, 1)
    boards = make.passers(poses, lights.day(91), 7)
    assert 20 < len(boards) <= 40
    for k, corners in boards.items():
        seen = (corners - poses[k][:3, 3]) @ poses[k][:3, :3]
        assert not ((seen[:, 2] < 0) & (np.abs(seen[:, :2]).max(1) < 0.36 * -seen[:, 2])).any(), "the board is seen"


def test_a_scene_without_its_light_says_where_the_light_is():
    with pytest.raises(ValueError, match=r"--worlds.*bpy==5.0.1"):
        lights.world("city", None, 0)


def test_last_bits_pass_and_another_object_does_not():
    kept = Digests(files={"mesh/mesh.obj": "a", "test/000_rgba.png": "b"}, faces=10, area=4.0, first="10" * 192)
    near = Digests(files={"mesh/mesh.obj": "a", "test/000_rgba.png": "c"}, faces=10, area=4.0001, first="11" * 192)
    assert differences(kept, near) == ([], ["test/000_rgba.png"])
    far = near.model_copy(update={"first": "10" * 100 + "30" * 92, "area": 4.1})
    assert len(differences(kept, far)[0]) == 2


def test_the_recipes_are_in_the_register_and_share_no_seed():
    assert {name for name in RECIPES if name in scenes()} == set(RECIPES)
    seeds = [recipe.seed for recipe in RECIPES.values()]
    assert len(seeds) == len(set(seeds))
    assert all(scenes()[name].masks == (not recipe.ground) for name, recipe in RECIPES.items())


def test_mitsuba_draws_what_the_sum_over_texels_says(ball_and_box):
    pytest.importorskip("mitsuba")
    from benchmarks.scenes.render import Stage
    from benchmarks.scenes.verify import direct_light, silhouette

    stage, truth = Stage(ball_and_box, background=False), Truth(ball_and_box)
    pose = spiral(3, -0.3, 0.9, 0.4, 5)[2]
    assert silhouette(stage, truth, pose, 64) > 0.98
    for name in ("sun", "lamps"):
        light = lights.reduced(lights.PROCEDURAL[name](3), 64)
        ratio = direct_light(stage, truth, pose, name, light, 64)
        assert np.median(ratio) == pytest.approx(1, abs=0.02), name


def test_a_close_up_is_level_and_shows_what_it_is_aimed_at(ball_and_box):
    truth, far = Truth(ball_and_box), spiral(3, 0.1, 0.6, 0.0, 0)[1]
    near = make.closer(far, truth, 5)
    np.testing.assert_allclose(near[:3, :3].T @ near[:3, :3], np.eye(3), atol=1e-6)
    assert abs(near[2, 0]) < 1e-6
    ahead = truth.cast(np.concatenate([near[:3, 3], -near[:3, 2]])[None].astype(np.float32))
    along = truth.cast(np.concatenate([far[:3, 3], -near[:3, 2]])[None].astype(np.float32))
    assert ahead.hit.all()
    assert ahead.distance[0] == pytest.approx(make.NEAR * along.distance[0], rel=1e-3)


@pytest.mark.parametrize("moves", ["turntable", "camera"])
def test_light_that_moves_is_the_file_for_a_level_camera_before_the_object(moves):
    """From the side it is turned by a quarter, as the camera is."""
    light = np.random.default_rng(0).random((16, 32, 3)).astype(np.float32)
    before = np.eye(4)
    before[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # right +x, up +z, looking along +y
    aside = np.eye(4)
    aside[:3, :3] = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]) @ before[:3, :3]
    here, there = make.turning(light, [before, aside], moves)
    np.testing.assert_allclose(here, light, atol=1e-5)
    at = lights.toward(30.0, 20.0), lights.toward(120.0, 20.0)
    np.testing.assert_allclose(lights.lookup(there, at[1][None]), lights.lookup(light, at[0][None]), atol=1e-5)
    assert make.turning(light, [before], "") is light
