"""A plain folder of photographs: cameras found from the pictures, the lens undone, clear errors."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from exmesh_nodes import data as nodes
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

from benchmarks.photos import differences
from exmesh_graph.errors import DataError, MissingLibraryError
from exmesh_graph.io import motion
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.images import Photo, write_image
from exmesh_graph.io.motion import Motion, find_motion
from exmesh_graph.io.photos import list_photos, place_photos
from exmesh_graph.io.placed import object_sphere
from exmesh_graph.io.settings import MotionSettings, PhotosOptions
from exmesh_graph.io.undistort import pinhole, resampled
from exmesh_graph.io.working import upright
from exmesh_graph.testing import FakeContext
from tests.io.io_scenes import look_at, of_placed

WIDTH, HEIGHT, FOCAL, COUNT = 200, 150, 260.0, 9


def poses():
    angles = np.radians(9.0 * np.arange(COUNT))
    eyes = 3 * np.stack([np.sin(angles), 0.3 + 0.2 * np.cos(3 * angles), np.cos(angles)], axis=1)
    return np.stack([look_at(eye, np.zeros(3), np.array([0, 1.0, 0])) for eye in eyes])


def painted():
    noise = np.random.default_rng(0).normal(size=(200, 400))
    return np.clip(0.5 + 0.25 * gaussian_filter(noise, 1.5) / 0.35, 0, 1).astype(np.float32)


def picture(pose, texture, width=WIDTH, height=HEIGHT, focal=FOCAL):
    """A painted unit ball before the painted inside of a large one."""
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    d = np.stack([x / focal, y / focal, np.ones_like(x)], axis=-1) @ pose[:3, :3].T
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    eye = pose[:3, 3]
    b, near, far = d @ eye, eye @ eye - 1, eye @ eye - 49
    hit = b * b > near
    t = np.where(hit, -b - np.sqrt(np.maximum(b * b - near, 0)), -b + np.sqrt(b * b - far))
    p = eye + t[..., None] * d
    p /= np.linalg.norm(p, axis=-1, keepdims=True)
    u = (np.arctan2(p[..., 0], p[..., 2]) / (2 * np.pi) + 0.5) * (texture.shape[1] - 1)
    v = np.arccos(p[..., 1].clip(-1, 1)) / np.pi * (texture.shape[0] - 1)
    return map_coordinates(texture, [v, u], order=1), hit


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Nine overlapping pictures with masks beside them, and one that shows something else."""
    texture = painted()
    root = tmp_path_factory.mktemp("photos")
    (root / "masks").mkdir()
    for i, pose in enumerate(poses()):
        grey, ball = picture(pose, texture)
        write_image(root / f"p{i}.png", np.repeat(grey[..., None], 3, axis=2))
        write_image(root / "masks" / f"p{i}.png", ball.astype(np.float32))
    write_image(root / "p9.png", np.zeros((HEIGHT, WIDTH, 3), np.float32))
    write_image(root / "masks" / "p9.png", np.ones((HEIGHT, WIDTH), np.float32))
    return root


def placed(folder, work, **changes):
    pytest.importorskip("pycolmap", reason="pip install 'exmesh-graph[photos]'")
    work.mkdir()
    return place_photos(folder, PhotosOptions(**changes), work)


def found(folder, work, **changes):
    return of_placed(placed(folder, work, **changes))


def test_cameras_and_points_are_found_and_repeat_to_the_byte(folder, tmp_path):
    photos = placed(folder, tmp_path / "a")
    scene, points, motion = of_placed(photos)
    assert sorted(motion.camera_to_world) == [f"p{i}.png" for i in range(COUNT)]
    assert motion.left_out == ("p9.png",)
    assert any("p9.png" in note for note in scene.notes)
    degrees, place = differences(np.stack([motion.camera_to_world[f"p{i}.png"] for i in range(COUNT)]), poses())
    assert degrees.max() < 1
    assert place.max() < 3
    assert not motion.focal_known
    assert motion.figures()["focal"] == pytest.approx(FOCAL, rel=0.05)
    assert scene.train.has_masks
    assert scene.test.names == ("p3",)
    assert len(points) > 100
    assert np.linalg.norm(points.points, axis=1).max() < 1  # the hull of nine views from one side holds the ball
    assert not photos.alpha
    whole = photos.scene(world=scene.frame, masks=False)  # the same world with what lies around the ball
    assert (scene.train.has_masks, whole.train.has_masks) == (True, False)
    np.testing.assert_allclose(whole.train.camera_to_world, scene.train.camera_to_world, rtol=0, atol=1e-13)
    outside = np.asarray(scene.train.alpha) == 0
    assert not np.asarray(scene.train.images)[outside].any()
    assert np.asarray(whole.train.images)[outside].any(axis=1).mean() > 0.9
    again = found(folder, tmp_path / "b")
    assert np.array_equal(again[1].points, points.points)
    assert np.array_equal(again[0].train.camera_to_world, scene.train.camera_to_world)


def test_the_node_reads_the_focal_length_of_the_camera_and_only_the_object(folder, tmp_path):
    pytest.importorskip("pycolmap", reason="pip install 'exmesh-graph[photos]'")
    place = tmp_path / "images"
    place.mkdir()
    (tmp_path / "masks").mkdir()
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = round(FOCAL / np.hypot(WIDTH, HEIGHT) * np.hypot(36, 24))  # FocalLengthIn35mmFilm
    for i in range(5):
        Image.open(folder / f"p{i}.png").save(place / f"p{i}.jpg", quality=97, exif=exif.tobytes())
        Image.open(folder / "masks" / f"p{i}.png").save(tmp_path / "masks" / f"p{i}.jpg.png")
    context = FakeContext(scratch=tmp_path)
    p = nodes.PhotosParams(path=tmp_path, keep="object", lens="pinhole", holdout=4)
    assert {"images/p0.jpg", "masks/p0.jpg.png"} <= set(nodes._photo_files(p))
    out = nodes.photos(context, p=p)
    assert any("from what was known" in line for line in context.lines)
    assert out.cameras.values["registered"] == 5
    k = out.train.intrinsics[0]
    assert k[0, 0] == pytest.approx(FOCAL, rel=0.1)
    assert (k[0, 2], k[1, 2]) == (WIDTH / 2, HEIGHT / 2)


def test_one_opaque_picture_does_not_hide_the_alpha_of_the_others(folder, tmp_path):
    place = tmp_path / "photos"
    place.mkdir()
    for i in range(COUNT):
        rgb, mask = Image.open(folder / f"p{i}.png"), Image.open(folder / "masks" / f"p{i}.png")
        if i:
            rgb.putalpha(mask.convert("L"))
        rgb.save(place / f"p{i}.png")
    scene, points, _ = found(place, tmp_path / "a")
    assert scene.train.has_masks
    assert any("have no mask: p0" in note for note in scene.notes)
    assert np.linalg.norm(points.points, axis=1).max() < 1  # the sphere is that of the masks


def test_without_the_extra_the_error_says_what_to_install(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(MissingLibraryError, match=r"exmesh-graph\[photos\]"):
        place_photos(folder, PhotosOptions(), tmp_path)


def test_a_folder_that_cannot_do_is_refused_by_name(folder, tmp_path):
    with pytest.raises(DataError, match="does not exist"):
        list_photos(tmp_path / "none")
    for i in range(2):
        write_image(tmp_path / f"black{i}.png", np.zeros((40, 60, 3), np.float32))
    with pytest.raises(DataError, match="holds 2 pictures"):
        list_photos(tmp_path)
    write_image(tmp_path / "black2.png", np.zeros((40, 60, 3), np.float32))
    with pytest.raises(DataError, match=r"0 of 3 pictures; without one: black0\.png, black1\.png, black2\.png"):
        found(tmp_path, tmp_path / "a")
    write_image(tmp_path / "black2.tif", np.zeros((40, 60, 3), np.float32))
    with pytest.raises(DataError, match="two pictures are called 'black2'"):
        list_photos(tmp_path)


def test_portraits_turned_by_exif_and_a_second_camera_give_one_set_of_views(tmp_path):
    """Three pictures taken with the camera on its side (EXIF says so), two with another camera, wider and sharper."""
    place, held, wide = tmp_path / "mixed", (1, 4, 7), (2, 5)
    (place / "masks").mkdir(parents=True)
    texture, true = painted(), poses()
    exif = Image.Exif()
    exif[0x0112] = 6
    for i, pose in enumerate(true):
        size = (320, 180, 300.0) if i in wide else (WIDTH, HEIGHT, FOCAL)
        grey, ball = picture(pose @ upright(np.eye(4), -1) if i in held else pose, texture, *size)
        stored = Image.fromarray(np.round(255 * np.repeat(grey[..., None], 3, axis=2)).astype(np.uint8))
        stored.save(place / f"p{i}.png", exif=exif if i in held else None)
        seen = np.rot90(ball, -1) if i in held else ball  # the mask is of what one sees
        write_image(place / "masks" / f"p{i}.png", seen.astype(np.float32))
    scene, _, motion = found(place, tmp_path / "a", lens="pinhole")
    assert sorted(motion.camera_to_world) == [f"p{i}.png" for i in range(COUNT)]
    assert motion.figures()["lenses"] == 2
    assert any("2 of 9 pictures have another size" in note and "p2.png, p5.png" in note for note in scene.notes)
    views = [(part, k) for part in (scene.train, scene.test) for k in range(len(part))]
    by_name = {part.names[k]: (part.images[k], part.alpha[k], part.intrinsics[k], part.camera_to_world[k])
               for part, k in views}  # fmt: skip
    shown = [by_name[f"p{i}"] for i in range(COUNT)]
    found_poses = np.stack([upright(pose, int(i in held)) for i, (*_, pose) in enumerate(shown)])
    degrees, off = differences(found_poses, true)
    assert degrees.max() < 1
    assert off.max() < 3
    assert (
        -found_poses[:, 1, 1] > 0.85
    ).all()  # level cameras, in a world that is Y-up although three lie in the views
    for i, (image, alpha, k, _) in enumerate(shown):
        assert image.shape == (HEIGHT, WIDTH, 3)
        focal = 300.0 * HEIGHT / 180 if i in wide else FOCAL
        assert k[0, 0] == pytest.approx(focal, rel=0.05)
        assert k[0, 0] == pytest.approx(k[1, 1])
        grey, ball = picture(true[i] @ upright(np.eye(4), -1) if i in held else true[i], texture, focal=focal)
        off = np.abs(linear_to_srgb(image[..., 0] / np.maximum(alpha, 1e-6)) - grey)[ball & (alpha > 0.99)]
        assert off.mean() < (0.04 if i in wide else 0.02)  # 0.2 where the two do not belong together
        assert np.abs(alpha - ball).mean() < 0.01


def test_a_video_with_a_blurred_stretch_gives_views_by_time(tmp_path):
    av = pytest.importorskip("av", reason="pip install 'exmesh-graph[video]'")
    texture = painted()
    with av.open(str(tmp_path / "clip.mp4"), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = WIDTH, HEIGHT, "yuv420p", 8_000_000
        for i, pose in enumerate(poses()):
            grey = picture(pose, texture)[0]
            grey = gaussian_filter(grey, 2.5) if i == 8 else grey
            rgb = np.round(255 * np.repeat(grey[..., None], 3, axis=2)).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
        container.mux(stream.encode())
    scene, _, motion = found(tmp_path / "clip.mp4", tmp_path / "a", lens="pinhole", blurred=0.5)
    assert motion.dropped == {"blurred": ("t0000_800.png",), "alike": ()}
    assert motion.figures()["blurred"] == ["t0000_800.png"]
    assert any("blurred beside the others (`blurred`): t0000_800.png" in note for note in scene.notes)
    names = sorted([*scene.train.names, *scene.test.names])
    assert names == [f"t0000_{i}00" for i in range(8)]
    by_name = {name: pose for part in (scene.train, scene.test)
               for name, pose in zip(part.names, part.camera_to_world, strict=True)}  # fmt: skip
    assert differences(np.stack([by_name[name] for name in names]), poses()[:8])[0].max() < 2


def test_one_focal_length_for_two_cameras_is_refused(folder, tmp_path):
    for i in range(3):
        Image.open(folder / f"p{i}.png").resize((WIDTH - 40 * (i == 2), HEIGHT)).save(tmp_path / f"p{i}.png")
    (tmp_path / "w").mkdir()
    with pytest.raises(DataError, match=r"one number, and the pictures are of 2 cameras"):
        place_photos(tmp_path, PhotosOptions(focal=200.0), tmp_path / "w")


@pytest.mark.parametrize("k1", [-0.2, 0.15])
def test_a_lens_is_undone(k1):
    """A picture that is a function of the ray, drawn through the lens and through the pinhole that is made of it."""
    k = np.array([[80.0, 0, 33], [0, 80, 22], [0, 0, 1]])

    def lens(rays):
        at = rays[:, :2] / rays[:, 2:]
        at = at * (1 + k1 * (at**2).sum(1, keepdims=True))
        return at @ k[:2, :2].T + k[:2, 2]

    def value(x, y):
        return 0.5 + 0.3 * np.sin(9 * x) * np.cos(7 * y)

    grid, places = pinhole(lens, k, 64, 48)
    pixels = np.stack(np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5), axis=-1)
    straight = (pixels - k[:2, 2]) / 80
    bent = straight.copy()
    for _ in range(50):  # the ray of each pixel of the photograph
        bent = straight / (1 + k1 * (bent**2).sum(-1, keepdims=True))
    shot = value(bent[..., 0], bent[..., 1]).astype(np.float32)
    photo = Photo(np.repeat(shot[..., None], 3, axis=2), np.ones((48, 64), np.float32), False, True)
    true = value(*np.moveaxis((pixels - grid[:2, 2]) / [grid[0, 0], grid[1, 1]], -1, 0))
    made = resampled(photo, places)
    assert np.abs(made.rgb[..., 0] - true)[2:-2, 2:-2].max() < 2e-3
    assert (places >= 0).all()
    assert (places <= [64, 48]).all()
    assert (grid[0, 0] > 80) == (k1 > 0)
    assert np.array_equal(grid[:, 2], k[:, 2])


def test_of_many_pictures_those_that_look_alike_are_matched(folder, tmp_path, monkeypatch):
    pytest.importorskip("pycolmap", reason="pip install 'exmesh-graph[photos]'")
    monkeypatch.setattr(motion, "MANY", 2)
    told, work = [], tmp_path / "work"
    work.mkdir()
    options = PhotosOptions(mapping="incremental", matching="plain")
    made = place_photos(folder, options, work, tell=told.append).motion
    names = [f"p{i}.png" for i in range(COUNT)]
    assert set(names) <= set(made.camera_to_world)
    degrees, _ = differences(np.stack([made.camera_to_world[name] for name in names]), poses())
    assert degrees.max() < 1
    assert [line.split()[0] for line in told] == ["features", "matching", "cameras"]
    assert "look alike" in told[1]


def test_the_sphere_without_masks_holds_what_the_cameras_look_at():
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(500, 3))
    ball = 0.4 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [0.1, 0, 0]
    wall = rng.normal(size=(400, 3))
    wall = 9 * wall / np.linalg.norm(wall, axis=1, keepdims=True)
    around = np.stack([look_at(np.array([3 * np.sin(a), 0.5, 3 * np.cos(a)]), np.zeros(3), np.array([0, 1.0, 0]))
                       for a in np.linspace(0, 6, 12)])  # fmt: skip
    centre, radius = object_sphere(np.concatenate([ball, wall]), np.full(900, 4), around)
    assert centre == pytest.approx([0.1, 0, 0], abs=0.05)
    assert 0.4 < radius < 0.5
    with pytest.raises(DataError, match="too few to locate"):
        object_sphere(wall, np.full(400, 4), around)
    floor = rng.uniform(-2, 2, size=(2000, 3)) * [1, 0, 1] - [0, 0.5, 0]
    centre, radius = object_sphere(np.concatenate([ball, floor]), np.full(2500, 4), around / 1)
    assert 1.5 < radius < 0.85 * np.linalg.norm(around[:, :3, 3] - centre, axis=1).min()


@pytest.mark.parametrize(
    ("plain", "wide", "even", "taken"),
    [
        ((300, 0), None, None, "plain"),  # enough: not done again
        ((90, 0), (200, 0), None, "wide"),
        ((90, 0), (100, 0), None, "plain"),  # hardly more: the precise ones
        ((300, 2), (280, 0), None, "wide"),  # more pictures
        ((90, 1), (300, 3), (300, 1), "plain"),  # fewer pictures, and no more
        ((90, 3), (100, 2), (80, 1), "even"),
        ((90, 3), (100, 2), (300, 2), "wide"),  # no more pictures: the more precise ones
    ],
)
def test_few_points_are_looked_for_in_the_wide_way_and_in_even_pictures(
    monkeypatch, tmp_path, plain, wide, even, taken
):
    """(sightings a picture, pictures without a camera) of each way, None: it must not be tried; which is taken."""
    given = {"plain": plain, "wide": wide, "even": even}
    images = [tmp_path / f"{k}.png" for k in range(12)]
    names = [image.name for image in images]

    def found(mapped, left_out, matching):
        sightings, without = given[matching]
        kept = names[: len(names) - without]
        poses, camera = {name: np.eye(4) for name in kept}, dict.fromkeys(kept, 0)
        nothing, tracks = np.zeros((0, 3)), np.full(len(kept), sightings)
        return Motion(poses, camera, (), nothing, nothing, tracks, tuple(names[len(kept) :]), 0.0, True, "", matching)

    colmap = SimpleNamespace(logging=SimpleNamespace(minloglevel=0), set_random_seed=lambda seed: None)
    monkeypatch.setattr(motion, "import_pycolmap", lambda: colmap)
    asked: list[tuple[str, str | None]] = []

    def pairs(_, database, *given):
        asked.append((database.parent.name, given[-1] and given[-1].parent.name))

    monkeypatch.setattr(motion, "_pairs", pairs)
    for nothing in ("_features", "_match", "match_guided", "map_cameras", "turning_masks", "even_pictures"):
        monkeypatch.setattr(motion, nothing, lambda *given, **named: None)
    monkeypatch.setattr(motion, "motion_of", found)
    for way in ("auto", *(way for way, figures in given.items() if figures)):
        work = tmp_path / way
        work.mkdir()
        settings = MotionSettings(matching=way)
        asked.clear()
        assert find_motion(images, {}, settings, work).matching == (taken if way == "auto" else way)
        assert asked[0] == ("plain" if way == "auto" else way, None)
        assert all(before == "plain" for _, before in asked[1:])  # what looked alike there is asked again
