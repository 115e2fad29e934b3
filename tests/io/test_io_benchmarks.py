"""Loaders of Synthetic4Relight and Stanford-ORB, on tiny folders of the published layout."""

import json
import shutil

import numpy as np
import pytest
from exmesh_nodes import data
from io_scenes import ANGLE, CENTRE, RADIUS, blender_from_opencv, edit_json, ring, sphere_picture, write_blender

from benchmarks.meshes import write_obj
from exmesh_graph.errors import DataError
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.envmaps import canonical_directions
from exmesh_graph.io.images import encode_rgba, write_image
from exmesh_graph.io.normalise import frame_scale
from exmesh_graph.io.settings import Synthetic4RelightOptions
from exmesh_graph.io.stanford_orb import load_orb, world_from_panorama
from exmesh_graph.io.synthetic4relight import load_synthetic4relight
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import LitViews


@pytest.fixture(scope="module")
def relight_scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("s4r") / "chair"
    write_blender(folder, "train", ring(6))
    for i, pose in enumerate(ring(6)):  # linear, no alpha, the mask beside it; values above 1
        rgb, alpha, _ = sphere_picture(pose)
        (folder / "train" / f"{i:03d}_rgba.png").unlink()
        write_image(folder / "train" / f"{i:03d}_rgb.exr", 3 * rgb, "float")
        write_image(folder / "train" / f"{i:03d}_mask.png", alpha)
    write_blender(folder, "test", ring(3, offset=0.5))
    (folder / "test_rli").mkdir()
    for i, pose in enumerate(ring(3, offset=0.5)):
        rgb, alpha, _ = sphere_picture(pose)
        color = np.dstack([np.clip(linear_to_srgb(rgb / np.maximum(alpha, 1e-6)[..., None]), 0, 1), alpha])
        write_image(folder / "test" / f"{i:03d}_albedo.png", color)
        write_image(folder / "test" / f"{i:03d}_rough.png", np.full_like(alpha, 0.4) * (alpha > 0))
        for light, level in (("envmap6", 0.5), ("envmap12", 0.25), ("other", 0.1)):
            write_image(folder / "test_rli" / f"{light}_{i:03d}.png", encode_rgba(level * rgb, alpha))
    maps = folder.parent / "envmaps"
    maps.mkdir()
    for number, level in ((3, 3.0), (6, 6.0), (12, 12.0)):
        write_image(maps / f"envmap{number}.exr", np.full((8, 16, 3), level, np.float32), "float")
    return folder


@pytest.fixture
def changed(relight_scene, tmp_path):
    return shutil.copytree(relight_scene.parent, tmp_path / "copy") / "chair"


def test_synthetic4relight(relight_scene):
    out = data.synthetic4relight(FakeContext(), p=data.Synthetic4RelightParams(path=relight_scene))
    assert (len(out.train), len(out.test)) == (6, 3)
    assert (out.train.clipped, out.test.clipped) == (False, True)
    assert out.train.has_masks
    rgb, alpha, _ = sphere_picture(ring(6)[0])
    np.testing.assert_allclose(out.train.images[0], 3 * rgb * np.round(alpha * 255)[..., None] / 255, atol=0.01)
    assert out.train.images.max() > 2  # not clipped, not encoded
    assert list(out.truth.relit) == ["envmap6", "envmap12"]
    assert [float(out.truth.relit[name][0].max()) for name in out.truth.relit] == [6, 12]
    assert float(out.truth.environment.max()) == 3
    test_rgb, test_alpha, _ = sphere_picture(ring(3, offset=0.5)[1])
    np.testing.assert_allclose(out.truth.relit["envmap12"][1][1], 0.25 * test_rgb, atol=0.01)
    inside = test_alpha == 1
    np.testing.assert_allclose(out.truth.albedo[1][inside], test_rgb[inside], atol=0.01)
    np.testing.assert_allclose(out.truth.roughness[1][inside], 0.4, atol=0.003)


def test_synthetic4relight_names_what_is_missing(changed):
    with pytest.raises(DataError, match="no pictures relit by envmap9") as caught:
        load_synthetic4relight(changed, Synthetic4RelightOptions(lights=("envmap9",)))
    assert "envmap12" in caught.value.fix
    (changed.parent / "envmaps" / "envmap6.exr").unlink()
    with pytest.raises(DataError, match="map envmap6 does not exist"):
        load_synthetic4relight(changed)
    for file in (changed / "train").glob("*_rgb.exr"):
        shutil.copy(changed / "test" / "000_rgba.png", file.with_name(file.name.replace("_rgb.exr", "_rgba.png")))
        file.unlink()
    with pytest.raises(DataError, match="6 training pictures are not linear"):
        load_synthetic4relight(changed)


def test_test_views_in_the_training_list_are_refused(changed):
    def steal(content):
        frames = json.loads((changed / "transforms_test.json").read_text())["frames"]
        content["frames"].append(frames[0])

    edit_json(changed / "transforms_train.json", steal)
    with pytest.raises(DataError, match="training"):
        load_synthetic4relight(changed)


@pytest.fixture(scope="module")
def orb(tmp_path_factory):
    """Two captures of one ball; the second one's test views are the first one's novel views."""
    root = tmp_path_factory.mktemp("orb")
    home = root / "blender_HDR" / "ball_scene001"
    splits = {"train": ring(6), "test": ring(3, offset=0.5)}
    for split, poses in splits.items():
        frames = [_photograph(home, f"{split}/{i:04d}", pose) for i, pose in enumerate(poses)]
        (home / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": ANGLE, "frames": frames}))
    truth = root / "ground_truth" / "ball_scene001"
    for place in ("z_depth", "surface_normal", "pseudo_gt_albedo", "mesh_blender"):
        (truth / place).mkdir(parents=True)
    for i, pose in enumerate(splits["test"]):
        rgb, alpha, depth = sphere_picture(pose, samples=1)
        np.save(truth / "z_depth" / f"{i:04d}.npy", depth.astype(np.float32))
        up = np.zeros((*depth.shape, 3), np.float32)
        up[..., 1] = alpha  # OpenGL: the camera's up
        np.save(truth / "surface_normal" / f"{i:04d}.npy", up)
        write_image(truth / "pseudo_gt_albedo" / f"{i:04d}.png", np.clip(linear_to_srgb(rgb), 0, 1))
    vertices, faces = icosphere(1)
    write_obj(truth / "mesh_blender" / "mesh.obj", vertices * RADIUS + CENTRE, faces)
    other, light = root / "blender_HDR" / "ball_scene002", root / "ground_truth" / "ball_scene002" / "env_map"
    light.mkdir(parents=True)
    frames = []
    for i, pose in enumerate(ring(2, offset=0.9)):
        frame = _photograph(other, f"test/{i:04d}", pose, 0.5)
        frames.append(frame | {"scene_name": "ball_scene002", "camera_angle_x": ANGLE})
        write_image(light / f"{i:04d}.exr", _panorama(16, 32), "float")
    (home / "transforms_novel.json").write_text(json.dumps({"frames": frames}))
    return home


def _photograph(folder, stem, pose, level=2.0):
    split, number = stem.split("/")
    rgb, alpha, _ = sphere_picture(pose)
    for place in (split, f"{split}_mask"):
        (folder / place).mkdir(parents=True, exist_ok=True)
    wall = (1 - alpha)[..., None] * 0.3  # real photographs have a background
    write_image(folder / split / f"{number}.exr", level * rgb + wall, "float")
    write_image(folder / f"{split}_mask" / f"{number}.png", alpha)
    return {"file_path": stem, "transform_matrix": blender_from_opencv(pose).tolist()}


def _panorama(height, width):
    """Red forward (the middle), green to the right, blue up, as the camera sees it."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    side = 2 * np.pi * (u - 0.5)
    d = np.stack([np.sin(side) * np.sin(np.pi * v), np.cos(np.pi * v), np.cos(side) * np.sin(np.pi * v)], -1)
    return np.maximum(d[..., [2, 0, 1]], 0).astype(np.float32)


def test_stanford_orb(orb):
    out = data.stanford_orb(FakeContext(), p=data.OrbParams(path=orb, downscale=2))
    assert [len(views) for views in (out.train, out.test, out.novel)] == [6, 3, 2]
    assert out.train.images.shape == (6, 24, 24, 3)
    assert out.train.images.max() > 1.2
    assert out.train.images[:, 0, 0].max() == 0  # the mask took the background
    assert out.novel.names == ("ball_scene002_test_0000", "ball_scene002_test_0001")
    assert out.truth.names == out.test.names
    # depth in normalised units: the ball's middle is a radius behind the nearest point
    depth, alpha = out.truth.depth[0], out.test.alpha[0] == 1
    middle = np.linalg.norm(out.test.camera_to_world[0, :3, 3] - out.truth.mesh_vertices.mean(0))
    assert middle - depth[alpha].min() == pytest.approx(RADIUS / frame_scale(out.frame), rel=0.05)
    np.testing.assert_allclose(out.truth.normal[0][alpha], [[0, -1, 0]] * alpha.sum(), atol=1e-6)  # up is -y
    assert out.truth.albedo.shape == (3, 24, 24, 3)


def test_a_novel_views_light_is_turned_with_its_camera(orb):
    _, novel = load_orb(orb)
    for environment, pose in zip(novel.environments, novel.camera_to_world, strict=True):
        directions = canonical_directions(*environment.shape[:2])
        forward, right, up = pose[:3, 2], pose[:3, 0], -pose[:3, 1]
        for channel, axis in enumerate((forward, right, up)):
            brightest = directions[np.unravel_index(environment[..., channel].argmax(), environment.shape[:2])]
            assert brightest @ axis > 0.95
    still = world_from_panorama(_panorama(16, 32), np.diag([1.0, -1, -1]))  # looks along -Z, its up is +Y
    directions = canonical_directions(16, 32)
    np.testing.assert_allclose(still[..., 2], np.maximum(directions[..., 1], 0), atol=0.01)
    np.testing.assert_allclose(still[..., 0], np.maximum(-directions[..., 2], 0), atol=0.03)


def test_lit_views_survive_the_store(orb, tmp_path):
    _, novel = load_orb(orb)
    novel.save(tmp_path)
    again = LitViews.load(tmp_path)
    assert again.names == novel.names
    np.testing.assert_array_equal(again.environments, novel.environments)
    np.testing.assert_array_equal(again.images, novel.images)


def test_stanford_orb_names_what_is_missing(orb, tmp_path):
    home = shutil.copytree(orb.parent.parent, tmp_path / "orb") / "blender_HDR" / "ball_scene001"
    truth = home.parent.parent / "ground_truth"
    (truth / "ball_scene001" / "z_depth" / "0001.npy").unlink()
    with pytest.raises(DataError, match="truth map does not exist") as caught:
        load_orb(home)
    assert "0001.npy" in caught.value.where
    (truth / "ball_scene002" / "env_map" / "0000.exr").unlink()
    with pytest.raises(DataError, match="environment map does not exist"):
        load_orb(home)
    (home / "test_mask" / "0000.png").unlink()
    with pytest.raises(DataError, match="no mask"):
        load_orb(home)


def test_every_file_that_is_read_is_a_source(orb, relight_scene):
    orb_sources = data._orb_sources(data.OrbParams(path=orb))
    assert {"blender_HDR/ball_scene002/test/0000.exr", "ground_truth/ball_scene002/env_map/0001.exr"} < set(orb_sources)
    assert {"train/0000.exr", "test_mask/0002.png", "transforms_novel.json"} < set(orb_sources)
    assert "ground_truth/ball_scene001/mesh_blender/mesh.obj" in orb_sources
    sources = data._s4r_sources(data.Synthetic4RelightParams(path=relight_scene))
    assert {"train/000_rgb.exr", "train/000_mask.png", "envmaps/envmap3.exr", "test_rli/envmap6_002.png"} < set(sources)


def test_a_novel_view_of_the_same_capture_is_refused(orb, tmp_path):
    home = shutil.copytree(orb.parent.parent, tmp_path / "orb") / "blender_HDR" / "ball_scene001"
    edit_json(home / "transforms_novel.json", lambda c: c["frames"][1].update(scene_name="ball_scene001"))
    with pytest.raises(DataError, match="not of another capture"):
        load_orb(home)
