"""Cameras adjusted to the photographs: derivatives and equations against plain references, known walls, same bytes."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from exmesh_nodes import data
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from exmesh_graph.errors import DataError
from exmesh_graph.io import photos
from exmesh_graph.io.lens import UNCHANGED, LensChange
from exmesh_graph.io.motion import Motion
from exmesh_graph.io.scene import Scene
from exmesh_graph.io.train_size import reduced
from exmesh_graph.priors.adjust import cameras, reference, system
from exmesh_graph.priors.adjust.cameras import Adjusted, adjust_cameras, through_lens
from exmesh_graph.priors.adjust.patches import MOST, Patches, patches_of
from exmesh_graph.priors.adjust.system import level_of, share_of
from exmesh_graph.priors.patch_match.estimate import Stereo
from exmesh_graph.priors.together import together
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import DepthMaps, Frame, PointCloud, Views
from tests.io.io_scenes import look_at
from tests.io.test_io_photos import COUNT, painted, picture, poses
from tests.priors.prior_scenes import wall

SIZE = 40


def disturbed(poses, turn=0.004, shift=0.01, seed=0):
    random = np.random.default_rng(seed)
    moved = poses.copy()
    for pose in moved:
        pose[:3, :3] = Rotation.from_rotvec(turn * random.normal(size=3)).as_matrix() @ pose[:3, :3]
        pose[:3, 3] += shift * random.normal(size=3)
    return moved


def bent(count=3, seed=0):
    """Pictures a + b x + c y + d x y, which bilinear samples and their slopes meet exactly, and a few patches."""
    views, _ = wall(count=count, size=SIZE)
    random = np.random.default_rng(seed)
    y, x = np.indices((SIZE, SIZE)) / SIZE
    gray = np.stack([b * x + c * y + d * x * y for b, c, d in random.uniform(0.5, 2, (count, 3))])
    rays = np.concatenate([random.uniform(-0.12, 0.12, (5, 2)), np.ones((5, 1))], axis=1)
    normals = random.normal(size=(5, 3)) * [0.3, 0.3, 0.1] - [0, 0, 1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    patches = Patches(rays, random.uniform(2.3, 2.6, 5), normals)
    poses = disturbed(views.camera_to_world)
    return level_of(gray, views.intrinsics), patches, poses, gray


def by_definition(gray, intrinsics, view, source, patches, logs, poses, lens):
    """(r [P, 9], correlations [P]) by the definition, sample by sample; pictures as they are, lenses other."""
    residuals, correlations = [], []
    for ray, depth, normal, log in zip(patches.rays, patches.depths, patches.normals, logs, strict=True):
        values = [[], []]
        for dy in (-2, 0, 2):
            for dx in (-2, 0, 2):
                one = ray + np.array([dx / intrinsics[view, 0, 0], dy / intrinsics[view, 1, 1], 0])
                turned = np.array([*lens.rays(one[:2]), 1.0])
                local = turned * depth * np.exp(log) * (normal @ ray) / (normal @ one)
                world = poses[view, :3, :3] @ local + poses[view, :3, 3]
                for k, camera in enumerate((view, source)):
                    seen = poses[camera, :3, :3].T @ (world - poses[camera, :3, 3])
                    # the view's own samples stay where they are
                    shown = one[:2] if k == 0 else lens.shown(seen[:2] / seen[2])
                    at = intrinsics[camera, :2, :2] @ shown + intrinsics[camera, :2, 2] - 0.5
                    values[k].append(map_coordinates(gray[camera], at[::-1, None], order=1)[0])
        own, other = (np.asarray(part) - np.mean(part) for part in values)
        own, other = (part / (np.sqrt((part**2).mean()) + 1e-3) for part in (own, other))
        residuals.append(other - own)
        correlations.append((other * own).mean())
    return np.array(residuals), np.array(correlations)


def twisted(poses, twists):
    return np.stack([cameras._motion(twist) @ pose for twist, pose in zip(twists, poses, strict=True)])


@pytest.mark.parametrize("seed", [0, 1])
def test_the_equations_are_those_of_all_residuals_with_the_depths_eliminated(seed):
    """Derivatives by central differences of the definition, in one dense matrix of all twists, of both changes of the
    lenses and of all depths."""
    level, patches, poses, gray = bent(seed=seed)
    level = level.through(LensChange(0.02, 0.3) if seed else UNCHANGED)
    slopes = np.stack([gray, *np.gradient(gray, axis=(2, 1))], axis=-1)
    level = replace(level, values=torch.from_numpy(slopes.astype(np.float32)))
    logs = np.random.default_rng(seed).normal(0, 0.01, len(patches))
    size, count = 6 * len(poses) + 2, len(patches)
    curvature, slope, dense, dense_slope = (
        np.zeros(s) for s in ((size, size), size, (size + count,) * 2, size + count)
    )
    share = share_of(level, 0, patches, logs, np.array([2, 1, -1]), poses)
    share.add(curvature, slope)

    def residual(source, change):
        lens = LensChange(level.lens.growth + change[size - 2], level.lens.bend + change[size - 1])
        return by_definition(gray, level.intrinsics, 0, source, patches, logs + change[size:],
                         twisted(poses, change[: size - 2].reshape(-1, 6)), lens)  # fmt: skip

    for source in (1, 2):
        r, correlation = residual(source, np.zeros(size + count))
        weight = (1 + 2 * (1 - correlation) / 0.3) ** -2
        steps = 1e-6 * np.eye(size + count)
        slopes = np.stack([(residual(source, e)[0] - residual(source, -e)[0]) / 2e-6 for e in steps], axis=-1)
        dense += np.einsum("p,pna,pnb->ab", weight, slopes, slopes)
        dense_slope += np.einsum("p,pna,pn->a", weight, slopes, r)
    dense[size:, size:] += np.eye(count)  # what holds the depths
    own, mixed = dense[size:, size:], dense[size:, :size]
    eliminated = dense[:size, :size] - mixed.T @ np.linalg.solve(own, mixed)
    np.testing.assert_allclose(curvature, eliminated, rtol=2e-4, atol=2e-4 * np.abs(eliminated).max())
    left = dense_slope[:size] - mixed.T @ np.linalg.solve(own, dense_slope[size:])
    np.testing.assert_allclose(slope, left, rtol=2e-4, atol=2e-4 * np.abs(left).max())
    twists = np.random.default_rng(seed).normal(0, 1e-3, size)
    depths = -np.linalg.solve(own, dense_slope[size:] + mixed @ twists)
    np.testing.assert_allclose(share.depths(twists), depths, rtol=2e-4, atol=2e-4 * np.abs(depths).max())


@pytest.mark.parametrize("lens", [UNCHANGED, LensChange(-0.03, 0.4), LensChange(0.02, -0.3)])
def test_the_kernel_is_the_plain_reference(lens):
    """On noise, which has every slope, with patches at the rim, one seen from the side, one behind a camera."""
    level, patches, poses, gray = bent()
    random = np.random.default_rng(3)
    # cameras as they come: in any order of memory
    level = level_of(random.uniform(size=gray.shape).astype(np.float32), np.asfortranarray(level.intrinsics))
    level, poses = level.through(lens), np.asfortranarray(poses)
    rays = np.concatenate([patches.rays, random.uniform(-0.4, 0.4, (60, 3)) * [1, 1, 0] + [0, 0, 1]])
    normals = np.concatenate([patches.normals, np.tile([0.6, 0, -0.8], (59, 1)), [[0, 1, 0]]])
    patches = Patches(rays, random.uniform(0.3, 2.6, len(rays)), normals)
    poses[2, :3, 3] += 0.7 * poses[2, :3, 2]
    logs = random.normal(0, 0.05, len(rays))
    given = level, 0, patches, logs, np.array([2, 1]), poses
    ours, plain = system.compared(*given), reference.compared(*given)
    seen = plain[2] > -2
    assert seen.any()
    assert not seen.all()
    for one, other in zip(ours, plain, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())


@pytest.mark.parametrize("case", ["flat", "outside", "behind", "no source"])
def test_what_cannot_be_compared_says_nothing(case):
    level, patches, poses, gray = bent()
    sources = np.array([1, 2])
    if case == "flat":
        level = level_of(np.full_like(gray, 0.5), level.intrinsics)
    elif case == "outside":
        poses[1:, :3, 3] += [9, 0, 0]
    elif case == "behind":
        poses[1:, :3, :3] = poses[1:, :3, :3] @ np.diag([1, -1, -1])
    else:
        sources = np.array([-1, -1])
    share = share_of(level, 0, patches, np.zeros(len(patches)), sources, poses)
    if case == "no source":
        assert share is None
        return
    assert share.compared == 0
    assert not share.curvature.any()
    assert not share.slope.any()
    assert np.isfinite(share.depths(np.ones(20))).all()


def ball(size=160, true=None):
    """Nine views of a painted ball of radius 0.6, nine degrees apart, or `true` ones, before a wall far away."""
    true = poses() if true is None else true.copy()
    pictures = [picture(pose, painted(), size, size, 1.6 * size)[0] for pose in true]
    true[:, :3, 3] *= 0.6
    matrix = np.array([[1.6 * size, 0, size / 2], [0, 1.6 * size, size / 2], [0, 0, 1]])
    images = np.repeat((np.stack(pictures) ** 2.2)[..., None], 3, axis=-1).astype(np.float32)
    return Views(
        tuple(f"b{k}" for k in range(len(true))), images, np.ones(images.shape[:3], np.float32),
        np.repeat(matrix[None], len(true), axis=0), true, "train", has_masks=False,
    )  # fmt: skip


def apart(views, found, true):
    """Mean pixels between where cameras show the ball, after the move of the world (with scale) that makes it least."""
    points = np.random.default_rng(0).normal(size=(60, 3)) * [0.3, 0.3, 0.1] + [0.4, 0.2, 1]
    points *= 0.6 / np.linalg.norm(points, axis=1, keepdims=True)

    def shown(poses):
        local = np.einsum("nji,npj->npi", poses[:, :3, :3], points - poses[:, None, :3, 3])
        image = np.einsum("nij,npj->npi", views.intrinsics, local)
        return image[..., :2] / image[..., 2:]

    def off(change):
        moved = found.copy()
        moved[:, :3, 3] *= np.exp(change[6])
        return shown(cameras._motion(change[:6]) @ moved) - shown(true)

    best = least_squares(lambda change: off(change).ravel(), np.zeros(7))
    return float(np.linalg.norm(off(best.x), axis=-1).mean())


def test_disturbed_cameras_of_a_painted_ball_come_back():
    views = ball(120)
    begun = replace(views, camera_to_world=disturbed(views.camera_to_world))
    adjusted = adjust_cameras(begun)
    assert apart(views, begun.camera_to_world, views.camera_to_world) > 0.7
    assert apart(views, adjusted.camera_to_world, views.camera_to_world) < 0.1
    assert adjusted.correlation[1] > adjusted.correlation[0]
    assert 0.3 < np.median(adjusted.moved) < 5
    turns = adjusted.camera_to_world[:, :3, :3]
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-9)
    centres = [poses[:, :3, 3].mean(axis=0) for poses in (adjusted.camera_to_world, begun.camera_to_world)]
    np.testing.assert_allclose(*centres, atol=0.02)  # the world is where it was


@pytest.mark.thorough
def test_right_cameras_stay():
    views = ball()
    assert apart(views, adjust_cameras(views).camera_to_world, views.camera_to_world) < 0.05


def around(distance):
    """Twenty-four views of the ball, all around it."""
    angles = np.radians(15.0 * np.arange(24))
    eyes = distance * np.stack([np.sin(angles), 0.3 + 0.2 * np.cos(3 * angles), np.cos(angles)], axis=1)
    return ball(120, np.stack([look_at(eye, np.zeros(3), np.array([0, 1.0, 0])) for eye in eyes]))


@pytest.mark.thorough
@pytest.mark.parametrize("wrong", [0.97, 1.03])
def test_a_wrong_focal_length_is_found_where_views_go_around(monkeypatch, wrong):
    """With the cameras where they would show the ball as large. So small pictures leave some of it; and lenses are
    held straight, for of a ball in the middle of the picture bending explains most of it as well."""
    monkeypatch.setattr(cameras, "_BEND", 1e9)
    views = around(3)
    begun = views.camera_to_world.copy()
    begun[:, :3, 3] *= wrong
    intrinsics = LensChange(np.log(wrong)).longer(views.intrinsics)
    adjusted = adjust_cameras(replace(views, camera_to_world=begun, intrinsics=intrinsics))
    assert abs(wrong * adjusted.lens.zoom - 1) < 0.6 * abs(wrong - 1)
    assert np.median(adjusted.moved) < 2  # pixels, not those of a step back


@pytest.mark.thorough
@pytest.mark.parametrize("bend", [-0.3, 0.3])
def test_how_much_the_lens_bends_is_found(bend):
    """Where the ball fills the pictures. They are drawn through the lens here, and straight in the end."""
    views, change = around(2), LensChange(0.0, bend)
    matrix, pixels = views.intrinsics[0], np.moveaxis(np.indices((views.height, views.width))[::-1], 0, -1) + 0.5
    rays = change.rays((pixels - matrix[:2, 2]) / matrix[[0, 1], [0, 1]])
    at = (rays * matrix[[0, 1], [0, 1]] + matrix[:2, 2] - 0.5)[..., ::-1]
    images = np.stack([[map_coordinates(c, np.moveaxis(at, -1, 0), order=1, mode="nearest")
                        for c in np.moveaxis(image, -1, 0)] for image in views.images])  # fmt: skip
    through = replace(views, images=np.moveaxis(images, 1, -1))
    adjusted = adjust_cameras(through)
    assert abs(adjusted.lens.bend - bend) < 0.4 * abs(bend)
    assert abs(adjusted.lens.growth) < 0.01
    straight = through_lens(through, adjusted.lens).images
    off = [np.abs(images - views.images)[:, 10:-10, 10:-10].mean() for images in (through.images, straight)]
    assert off[1] < 0.6 * off[0]


def test_pictures_without_paint_leave_the_cameras_as_they_are():
    views, _ = wall(count=3, size=64)
    blank = replace(views, images=np.full_like(views.images, 0.2), has_masks=False)
    np.testing.assert_array_equal(adjust_cameras(blank).camera_to_world, views.camera_to_world)
    with pytest.raises(DataError, match="no parallax"):
        adjust_cameras(blank.subset([0]))


@pytest.mark.thorough
def test_any_number_of_cores_gives_the_same_bytes():
    views, _ = wall(count=4, size=96)
    begun = replace(views, camera_to_world=disturbed(views.camera_to_world), has_masks=False)
    points = PointCloud(
        np.random.default_rng(0).uniform(-0.2, 0.2, (40, 3)).astype(np.float32), np.ones((40, 3), np.float32)
    )
    one, two, three = (adjust_cameras(begun, points, threads=n).camera_to_world.tobytes() for n in (1, 2, 3))
    assert one == two == three


def test_training_and_test_views_are_compared_together_at_one_size():
    views = ball(96)
    test = replace(views.subset([1, 4]), split="test")
    half = reduced(views.subset([0, 2, 3, 5, 6, 7, 8]), 2)
    all_views = together(half, test)
    assert all_views.names == (*half.names, *test.names)
    np.testing.assert_array_equal(all_views.images[:7], half.images)
    np.testing.assert_array_equal(all_views.images[7:], reduced(test, 2).images)
    np.testing.assert_array_equal(all_views.intrinsics[7:], reduced(test, 2).intrinsics)
    assert together(half, test.subset([])).names == half.names


def test_patches_lie_on_paint_whose_depth_is_known_one_in_a_cell():
    views, depths = wall(count=2, size=120, flat_half=True)
    gray = views.images[0].mean(axis=2) ** (1 / 2.2)
    depth = depths.depth[0].copy()
    depth[:60] = 0
    normals = np.zeros((60, 60, 3), np.float32)  # of another size
    normals[..., 2] = -1
    patches = patches_of(gray, views.intrinsics[0], depth, normals)
    pixels = patches.rays[:, :2] * views.intrinsics[0, [0, 1], [0, 1]] + views.intrinsics[0, :2, 2] - 0.5
    cells = {tuple(cell) for cell in (pixels // 12).astype(int)}
    assert 10 < len(patches) == len(cells) <= MOST
    assert (pixels[:, 1] >= 60 - 1e-6).all()
    x, y = np.round(pixels).astype(int).T
    np.testing.assert_allclose(patches.depths, depth[y, x])
    world = (
        patches.rays * patches.depths[:, None] @ views.camera_to_world[0, :3, :3].T + views.camera_to_world[0, :3, 3]
    )
    assert (world[:, 0] > -0.1).all()  # the flat half has none but at its edge


def test_no_patches_are_an_empty_share():
    level, patches, poses, _ = bent()
    none = Patches(patches.rays[:0], patches.depths[:0], patches.normals[:0])
    assert share_of(level, 0, none, np.zeros(0), np.array([1]), poses) is None


class Known:
    """Photographs with cameras, and how they were read."""

    def __init__(self, scene, motion, *, alpha=False):
        self.made, self.motion, self.alpha, self.read = scene, motion, alpha, []

    def scene(self, *, masks=True, world=None, after=None):
        self.read.append((after is not None, masks))
        if after is None:
            return self.made
        parts = [replace(part, camera_to_world=np.stack([after.camera_to_world[name] for name in part.names]))
                 for part in (self.made.train, self.made.test)]  # fmt: skip
        return replace(self.made, train=parts[0], test=parts[1])

    def points(self, frame):
        nothing = np.zeros((0, 3), np.float32)
        return PointCloud(nothing, nothing)


@pytest.mark.parametrize(
    ("parameters", "motion", "masks", "done"),
    [
        ({}, {}, "", True),
        ({"adjust": False}, {}, "", False),
        ({}, {"turned": True}, "", True),
        ({}, {"matching": ""}, "", False),  # another program's cameras are used as they are
        ({}, {}, "alpha", False),  # what lies beyond it is gone
        ({}, {}, "files", True),
    ],
)
def test_photographs_have_their_cameras_adjusted_where_nothing_speaks_against_it(
    monkeypatch, tmp_path, parameters, motion, masks, done
):
    views = replace(ball(96), has_masks=bool(masks))
    begun = replace(views, camera_to_world=disturbed(views.camera_to_world))
    train, test = begun.subset(range(1, COUNT)), replace(begun.subset([0]), split="test")
    nothing = np.zeros((0, 3), np.float32)
    scene = Scene(train, test, Frame(np.eye(4), np.eye(4)))
    found = Motion({}, {}, (), nothing, nothing, np.zeros(0), (), 0.5, True, "incremental", **motion)
    known = Known(scene, found, alpha=masks == "alpha")
    monkeypatch.setattr(Motion, "figures", lambda self: {"registered": 9, "pictures": 9, "focal": 150.0})
    monkeypatch.setattr(photos, "place_photos", lambda *given: known)
    context = FakeContext(scratch=tmp_path)
    out = data.photos(context, p=data.PhotosParams(path=tmp_path, **parameters))
    assert done == any("cameras adjusted" in line for line in context.lines)
    assert not any("cameras stay" in line for line in context.lines)
    assert done == ("adjusted_px" in out.cameras.values)
    whole = [(False, False)] if masks == "files" else []
    assert known.read == ([(False, True), *whole, (True, True)] if done else [(False, True)])
    for after, before in ((out.train, train), (out.test, test)):
        assert done != np.array_equal(after.camera_to_world, before.camera_to_world)
        assert (after.names, after.split) == (before.names, before.split)


def test_it_is_told_where_adjusted_cameras_are_no_better(tmp_path):
    views, _ = wall(count=4, size=64)
    blank = replace(views, images=np.full_like(views.images, 0.2), has_masks=False)
    context, figures = FakeContext(scratch=tmp_path), {"focal": 100.0}
    nothing = np.zeros((0, 3), np.float32)
    same = data._adjusted(context, blank, PointCloud(nothing, nothing), figures, data.PhotosParams(path=tmp_path))
    assert not same.astray.any()
    np.testing.assert_array_equal(same.camera_to_world, blank.camera_to_world)
    assert figures == {"adjusted_px": 0.0, "adjusted_most_px": 0.0, "focal": 100.0, "bend": 0.0}
    assert any("cameras stay" in line for line in context.lines)


@pytest.mark.parametrize(("known", "alike", "expected"), [
    ([0.3] * 9 + [0.05], [0.5] * 9 + [0.3], [9]),  # one of ten went astray
    ([0.3] * 9 + [0.135], [0.5] * 9 + [0.38], [9]),  # a mug, nearly as round as it is wrong
    ([0.3] * 9 + [0.05], [0.5] * 10, []),  # seen by few others, which agree
    ([0.3] * 10, [0.5] * 9 + [0.3], []),  # it shines
    ([0.3] * 7 + [0.05] * 3, [0.5] * 7 + [0.2] * 3, []),  # so many: who is right?
])  # fmt: skip
def test_cameras_go_astray_where_depth_and_patches_say_so(known, alike, expected):
    count = len(known)
    depth = np.zeros((count, 10, 100), np.float32)
    for k, share in enumerate(known):
        depth[k, :, : round(100 * share)] = 1
    depths = DepthMaps(tuple(f"v{k}" for k in range(count)), depth)
    stereo = Stereo(depths, np.zeros((count, 1, 1, 3)), np.zeros((count, 1, 1)), ())
    found = Adjusted(np.eye(4)[None].repeat(count, 0), UNCHANGED, np.zeros(count), (0.5, 0.5), stereo, np.array(alike))
    assert np.flatnonzero(found.astray).tolist() == expected


@pytest.mark.thorough
def test_a_camera_that_went_astray_is_left_out_by_name(tmp_path):
    views = replace(ball(), has_masks=False)
    poses = views.camera_to_world.copy()
    poses[4] = poses[4] @ np.diag([-1.0, -1, 1, 1])  # upside down
    views = replace(views, camera_to_world=poses)
    order = [k for k in range(COUNT) if k != 2]
    scene = Scene(views.subset(order), replace(views.subset([2]), split="test"), Frame(np.eye(4), np.eye(4)))
    context, nothing = FakeContext(scratch=tmp_path), np.zeros((0, 3), np.float32)
    figures = {"registered": COUNT, "left_out": ["other"], "focal": 100.0}
    p = data.PhotosParams(path=tmp_path, vignetting=False)
    known = Known(scene, None)
    after = data._compared(context, scene, known.scene, PointCloud(nothing, nothing), figures, p, True, False)
    assert len(known.read) == 1
    assert set(scene.train.names) - set(after.train.names) == {views.names[4]}
    assert after.test.names == scene.test.names
    assert (figures["registered"], figures["left_out"]) == (COUNT - 1, ["other", views.names[4]])
    assert any(views.names[4] in line for line in context.warnings)
