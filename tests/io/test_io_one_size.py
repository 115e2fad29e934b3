"""Lenses and sizes of pictures whose cameras are given: formulas, turned and reduced pictures, one size for all."""

import dataclasses
import functools
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.images import write_image
from exmesh_graph.io.lens import Behind, Lens, turn
from exmesh_graph.io.load import load_shots
from exmesh_graph.io.one_size import common_shape, of_one_size
from exmesh_graph.io.reduce import area_means
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.io.shots import Shot
from tests.io.io_scenes import CENTRE, RADIUS, blender_from_opencv, encode_rgba, ring

BENT = Lens(90, 70, (100.0, 96.0), (44.0, 36.5), (-0.16, 0.05, 0.01, -0.004), (0.004, -0.003), 0.8)
FISH = Lens(90, 70, (80.0, 80.0), (45.0, 35.0), (0.02, -0.01), fisheye=True)


@functools.cache
def rays_of(lens: Lens) -> np.ndarray:
    """[h, w, 9, 3]: rays through nine places of every pixel, by a fixed-point search."""
    step = (np.arange(3) + 0.5) / 3
    x, y, sx, sy = np.meshgrid(np.arange(lens.width), np.arange(lens.height), step, step, indexing="xy")
    wanted = np.stack([x + sx, y + sy], -1).reshape(-1, 2)
    k = lens.calibration_matrix()
    start = (wanted - k[:2, 2]) / k[[0, 1], [0, 1]]
    at = start.copy()
    for _ in range(60):
        off = lens.img_from_cam(np.concatenate([at, np.ones((len(at), 1))], 1)) - wanted
        at -= 0.7 * off / k[[0, 1], [0, 1]]
    assert np.abs(off).max() < 1e-6
    return np.concatenate([at, np.ones((len(at), 1))], 1).reshape(lens.height, lens.width, 9, 3)


def photographed(pose: np.ndarray, lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """(linear, premultiplied rgb, alpha) of the coloured sphere."""
    d = rays_of(lens) @ pose[:3, :3].T
    to = pose[:3, 3] - CENTRE
    a, b, c = (d * d).sum(-1), 2 * (d @ to), to @ to - RADIUS**2
    inside = b * b - 4 * a * c
    depth = (-b - np.sqrt(np.maximum(inside, 0))) / (2 * a)
    colour = np.clip(0.5 + 0.4 * (pose[:3, 3] + depth[..., None] * d - CENTRE) / RADIUS, 0, 1) * (inside > 0)[..., None]
    return colour.mean(2).astype(np.float32), (inside > 0).mean(2).astype(np.float32)


def shot_of(folder, number, pose, lens) -> Shot:
    rgb, alpha = photographed(pose, lens)
    path = folder / f"{number}.exr"
    write_image(path, np.dstack([rgb, alpha]), "float")
    k = lens.calibration_matrix()
    return Shot(f"v{number}", path, pose, k, size=(lens.width, lens.height), lens=None if lens.straight else lens)


@pytest.mark.parametrize(
    ("model", "params", "lens"),
    [
        ("OPENCV", [100, 96, 44, 36.5, -0.2, 0.05, 0.004, -0.003],
         Lens(90, 70, (100, 96), (44, 36.5), (-0.2, 0.05), (0.004, -0.003))),
        ("OPENCV_FISHEYE", [80, 82, 45, 35, 0.02, -0.01, 0.003, 0.001],
         Lens(90, 70, (80, 82), (45, 35), (0.02, -0.01, 0.003, 0.001), fisheye=True)),
        ("RADIAL", [90, 45, 35, 0.1, -0.02], Lens(90, 70, (90, 90), (45, 35), (0.1, -0.02))),
    ],
)  # fmt: skip
def test_lenses_are_colmap_s(model, params, lens):
    colmap = pytest.importorskip("pycolmap", reason="pip install 'exmesh-graph[photos]'")
    theirs = colmap.Camera(model=model, width=90, height=70, params=params)
    rays = np.random.default_rng(0).uniform([-0.5, -0.4, 0.9], [0.5, 0.4, 1.1], (50, 3))
    np.testing.assert_allclose(lens.img_from_cam(rays), theirs.img_from_cam(rays), atol=1e-9)
    np.testing.assert_allclose(lens.calibration_matrix(), theirs.calibration_matrix())
    axis = lens.img_from_cam(np.array([[0, 0, 2.0]]))
    np.testing.assert_allclose(axis, [lens.centre])


@given(quarter=st.integers(-3, 4), factor=st.floats(1, 3), ray=st.tuples(*[st.floats(-0.4, 0.4)] * 2))
def test_a_turned_and_reduced_picture_shows_a_ray_where_the_file_does(quarter, factor, ray):
    behind, towards = Behind(BENT, quarter, factor), np.array([[*ray, 1.0]])
    in_file = BENT.img_from_cam(towards)
    seen = behind.img_from_cam(towards @ turn(quarter)[:3, :3])  # the ray in the turned camera's axes
    np.testing.assert_allclose(behind.in_file(seen), in_file, atol=1e-9)
    straight = dataclasses.replace(BENT, radial=(), tangential=(0.0, 0.0), skew=0.0)
    there = Behind(straight, quarter, factor)
    at = towards @ turn(quarter)[:3, :3] @ there.calibration_matrix().T
    np.testing.assert_allclose(there.img_from_cam(towards @ turn(quarter)[:3, :3]), at[:, :2] / at[:, 2:], atol=1e-9)


@pytest.mark.parametrize("quarter", [0, 1, 2, 3])
def test_turning_is_numpy_s_and_reducing_ours(quarter):
    y, x = np.mgrid[:70, :90] + 0.5
    small = area_means(np.rot90(np.stack([x, y], -1), quarter).astype(np.float32), 1.6)
    behind = Behind(BENT, quarter, 1.6)
    assert small.shape[:2] == (behind.height, behind.width)
    row, column = np.mgrid[: behind.height, : behind.width] + 0.5
    np.testing.assert_allclose(behind.in_file(np.stack([column, row], -1)), small, atol=0.1)  # pixels are flat


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [([(6, 4), (4, 6), (8, 8)], (6, 4)), ([(4, 6), (4, 6), (6, 4)], (4, 6)), ([(6, 4), (9, 6)], (9, 6)),
     ([(5, 5)], (5, 5))],
)  # fmt: skip
def test_the_size_that_most_have(sizes, expected):
    assert common_shape(sizes) == expected


@pytest.mark.parametrize(
    "odd",
    [
        Lens(140, 100, (180.0, 180.0), (68.0, 52.0)),  # larger
        Lens(48, 36, (58.0, 58.0), (24.0, 18.0)),  # smaller
        Lens(60, 80, (100.0, 100.0), (31.0, 42.0)),  # upright
        Lens(120, 160, (200.0, 200.0), (60.0, 80.0)),  # upright and larger
        BENT, FISH,
    ],
)  # fmt: skip
def test_a_picture_of_another_size_or_lens_is_what_a_camera_of_the_common_one_sees(tmp_path, odd):
    common, poses = Lens(80, 60, (100.0, 100.0), (41.0, 29.0)), ring(4)
    shots = [shot_of(tmp_path, k, pose, odd if k == 3 else common) for k, pose in enumerate(poses)]
    alike, note = of_one_size(shots)
    assert [one is shot for one, shot in zip(alike, shots, strict=True)] == [True, True, True, False]
    assert ("v3" in note) == ((odd.width, odd.height) not in ((80, 60), (60, 80)))
    loaded = load_shots(alike, split="training")
    assert loaded.images.shape == (4, 60, 80, 3)
    k = loaded.intrinsics[3]
    held = Lens(80, 60, (k[0, 0], k[1, 1]), (k[0, 2], k[1, 2]))
    rgb, alpha = photographed(loaded.camera_to_world[3], held)
    assert alpha.mean() > 0.04
    np.testing.assert_allclose(_middle(np.asarray(loaded.alpha[3])), _middle(alpha), atol=0.03)
    assert np.abs(loaded.alpha[3] - alpha).mean() < 0.01
    inner = (alpha == 1) & (loaded.alpha[3] > 0.999)
    assert inner.sum() > 100
    assert np.abs(loaded.images[3] - rgb)[inner].mean() < 0.01


def _middle(alpha: np.ndarray) -> np.ndarray:
    row, column = np.indices(alpha.shape)
    return np.array([(alpha * column).sum(), (alpha * row).sum()]) / alpha.sum()


def test_what_is_larger_is_averaged_and_not_sampled(tmp_path):
    """A chequerboard of single pixels becomes gray."""
    noise = np.indices((120, 160)).sum(0) % 2
    for name, size in (("a", (80, 60)), ("b", (80, 60)), ("c", (160, 120))):
        picture = noise[:, :, None].repeat(3, 2) if name == "c" else np.full((60, 80, 3), 0.5)
        write_image(tmp_path / f"{name}.exr", picture.astype(np.float32), "float")
        assert size[0] == picture.shape[1]
    k = Lens(80, 60, (100.0, 100.0), (40.0, 30.0)).calibration_matrix()
    big = k * [[2], [2], [1]]
    shots = [Shot(n, tmp_path / f"{n}.exr", p, big if n == "c" else k) for n, p in zip("abc", ring(3), strict=True)]
    loaded = load_shots(of_one_size(shots)[0], split="training")
    np.testing.assert_allclose(loaded.images[2], 0.5, atol=0.01)


def test_pictures_that_are_alike_or_that_do_not_fit_their_cameras_stay(tmp_path):
    lens, poses = Lens(80, 60, (100.0, 100.0), (41.0, 29.0)), ring(3)
    shots = [shot_of(tmp_path, k, pose, lens) for k, pose in enumerate(poses)]
    assert of_one_size(shots) == (shots, "")
    for wrong in (
        dataclasses.replace(shots[1], size=(81, 60)),
        dataclasses.replace(shots[1], image=tmp_path / "no.exr"),
    ):
        mixed = [shots[0], wrong, shot_of(tmp_path, 7, poses[2], Lens(40, 30, (50.0, 50.0), (20.0, 15.0)))]
        assert of_one_size(mixed) == (mixed, "")


@pytest.mark.parametrize("model", ["OPENCV", None])
def test_nerfstudio_s_distortion_is_undone_and_portraits_lie(tmp_path, model):
    """Two cameras in one transforms.json; the vertical is that of the cameras as they were held."""
    (tmp_path / "images").mkdir()
    lenses, frames = [BENT, dataclasses.replace(BENT, skew=0.0), Lens(70, 90, (100.0, 100.0), (35.0, 45.0))], []
    lenses[0] = lenses[1]
    for number, pose in enumerate(ring(12)):
        lens = lenses[number % 3]
        rgb, alpha = photographed(pose, lens)
        write_image(tmp_path / "images" / f"{number}.png", encode_rgba(rgb, alpha))
        k1234, p12 = (
            zip(("k1", "k2", "k3", "k4"), lens.radial, strict=False),
            zip(("p1", "p2"), lens.tangential, strict=True),
        )
        names = {**dict(k1234), **dict(p12)}
        frames.append({
            "file_path": f"images/{number}.png", "transform_matrix": blender_from_opencv(pose).tolist(),
            "fl_x": lens.focal[0], "fl_y": lens.focal[1], "cx": lens.centre[0], "cy": lens.centre[1],
            "w": lens.width, "h": lens.height, **names,
        })  # fmt: skip
    content = {"frames": frames, **({"camera_model": model} if model else {})}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    scene = load_blender(tmp_path, BlenderOptions(up="auto", holdout=6))
    assert scene.train.images.shape[1:3] == (70, 90)
    for views in (scene.train, scene.test):
        points = np.zeros((1, 3))  # the ball's middle is the world's
        for number in range(len(views)):
            place = views.world_to_camera[number] @ [*points[0], 1]
            pixel = (views.intrinsics[number] @ place[:3])[:2] / place[2]
            row, column = np.nonzero(np.asarray(views.alpha[number]) > 0.5)
            assert np.abs(pixel - [column.mean() + 0.5, row.mean() + 0.5]).max() < 1.5
    content["camera_model"] = "EQUIRECTANGULAR"
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(Exception, match="camera_model is EQUIRECTANGULAR"):
        load_blender(tmp_path, BlenderOptions(up="auto"))
