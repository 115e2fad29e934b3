"""Every fault that the checks of cameras and pictures look for, and clean scenes on which they stay silent."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from check_scenes import BALLS, cameras, close_cameras, drawn, outlines
from io_scenes import blender_from_opencv, look_at

from exmesh_graph.errors import DataError
from exmesh_graph.io.blender import list_blender, load_blender
from exmesh_graph.io.checks.finding import Finding, settle
from exmesh_graph.io.checks.half_pixel import find_half_pixel, told
from exmesh_graph.io.checks.lens import check_lens
from exmesh_graph.io.checks.light import check_light
from exmesh_graph.io.checks.masks import check_masks
from exmesh_graph.io.checks.outlines import Outlines
from exmesh_graph.io.checks.pictures import check_pictures
from exmesh_graph.io.checks.places import check_places
from exmesh_graph.io.checks.readings import Cameras
from exmesh_graph.io.idr import list_idr, load_idr
from exmesh_graph.io.images import encode_rgba, write_image
from exmesh_graph.io.load import load_shots, shifted
from exmesh_graph.io.settings import BlenderOptions, IdrOptions

SAMPLE = Path(__file__).parents[2] / "graphs" / "samples" / "spot"
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def clean():
    return outlines(cameras())


def with_k(seen, scale, columns=3):
    k = seen.cameras.intrinsics.copy()
    k[:, :2, :columns] *= scale
    return replace(seen, cameras=replace(seen.cameras, intrinsics=k))


def with_poses(seen, poses):
    return replace(seen, cameras=replace(seen.cameras, camera_to_world=poses))


def masks_of(seen, masks):
    return Outlines.of(masks, seen.cameras)


FAULTS = {
    "camera file for twice the size": (lambda s: with_k(s, 2), "half the size that the camera file is for"),
    "camera file for half the size": (lambda s: with_k(s, 0.5), "2 times the size that the camera file is for"),
    "focal length for a third of the size": (lambda s: with_k(s, 1 / 3, 2), "3 times the size that the focal length"),
    "axes of OpenGL": (lambda s: with_poses(s, s.cameras.camera_to_world @ FLIP), "axes are those of the other"),
    "world to camera": (lambda s: with_poses(s, np.linalg.inv(s.cameras.camera_to_world)), "are world-to-camera"),
    "left-handed": (lambda s: with_poses(s, MIRROR @ s.cameras.camera_to_world @ MIRROR), "left-handed world"),
    "mirrored pictures": (lambda s: masks_of(s, s.masks[:, :, ::-1]), "left-handed world|mirrored left to right"),
    "pictures on their heads": (lambda s: masks_of(s, s.masks[:, ::-1, ::-1]), "turned by 180 degrees"),
    "white background": (lambda s: masks_of(s, ~s.masks), "white on the background"),
    "one place too late": (lambda s: masks_of(s, np.roll(s.masks, 1, axis=0)), "listed one place too"),
    "1, 10, 11, ..., 2": (
        lambda s: masks_of(s, s.masks[np.argsort(s.cameras.names)]), "1, 10, 11, ..., 2"
    ),
    "shuffled": (
        lambda s: masks_of(s, s.masks[np.random.default_rng(3).permutation(len(s))]), "in another order than"
    ),
}  # fmt: skip


class TestMasks:
    def test_a_clean_scene_supports_its_cameras(self, clean):
        assert check_masks(clean) == ([], True)

    def test_masks_with_a_ragged_rim_pass(self, clean):
        rng = np.random.default_rng(0)
        ragged = Outlines.of(clean.wide & (clean.masks | (rng.random(clean.masks.shape) < 0.5)), clean.cameras)
        assert check_masks(ragged) == ([], True)

    @pytest.mark.thorough
    @pytest.mark.parametrize("name", FAULTS)
    def test_a_fault_of_all_views(self, clean, name):
        fault, cause = FAULTS[name]
        [finding], supported = check_masks(fault(clean))
        assert not supported
        assert finding.grave
        assert any(part in finding.cause for part in cause.split("|")), str(finding)

    @pytest.mark.thorough
    @pytest.mark.parametrize(
        ("change", "cause"),
        [
            (lambda m: m[:, ::-1], "mirrored left to right"),
            (lambda m: ~m, "inverted"),
            (lambda m: m & (np.arange(m.shape[1]) < 44), "the mask or the camera of the view is wrong"),
        ],
    )
    def test_one_wrong_mask(self, clean, change, cause):
        masks = clean.masks.copy()
        masks[4] = change(masks[4])
        seen = masks_of(clean, masks)
        [finding], supported = check_masks(seen)
        assert finding.views == ("v5",)
        assert cause in finding.cause
        assert "wrong_masks: 1" in finding.cure
        assert finding.grave
        assert not supported
        [outvoted], supported = check_masks(seen, wrong_masks=1)
        assert supported
        assert not outvoted.grave

    def test_two_swapped(self, clean):
        masks = clean.masks.copy()
        masks[[2, 9]] = masks[[9, 2]]
        [finding], _ = check_masks(masks_of(clean, masks))
        assert finding.views == ("v3", "v10")
        assert "swapped" in finding.cause

    def test_a_focal_length_a_little_too_long_is_named_and_no_mask_blamed(self):
        """On the sample, whose long lens lets one or two masks alone contradict it."""
        fit = load_shots(list_blender(SAMPLE, BlenderOptions())[0][::2], split="training")
        k = fit.silhouette_intrinsics * np.array([[1.25, 1, 1], [1, 1.25, 1], [1, 1, 1]])
        seen = Cameras(fit.names, k, fit.camera_to_world, *fit.silhouettes.shape[:0:-1])
        [finding], supported = check_masks(Outlines.of(fit.silhouettes >= 0.5, seen))
        assert not supported
        assert finding.grave
        assert not finding.views
        assert "focal length is about 1.25 times" in finding.cause

    def test_a_camera_turned_away_is_left_to_others(self, clean):
        poses = clean.cameras.camera_to_world.copy()
        poses[3, :3, :3] = poses[3, :3, :3] @ np.diag([-1.0, 1.0, -1.0])
        assert check_masks(with_poses(clean, poses)) == ([], True)

    def test_few_views_are_not_judged(self, clean):
        assert check_masks(clean.subset([0, 5, 9])) == ([], False)


class TestLens:
    def test_clean(self):
        assert check_lens(cameras(), False) == []

    def test_principal_point_in_the_corner(self):
        seen = cameras()
        [finding] = check_lens(replace(seen, intrinsics=seen.intrinsics * [[1, 1, 2], [1, 1, 2], [1, 1, 1]]), False)
        assert finding.grave
        assert "pictures of about 192 x 160" in finding.cause
        assert "by 2" in finding.cure

    def test_one_cropped_view_is_named_and_a_crop_that_masks_support_is_no_fault(self):
        seen = cameras()
        k = seen.intrinsics.copy()
        k[3, 0, 2] += 15
        [finding] = check_lens(replace(seen, intrinsics=k), False)
        assert finding.views == ("v4",)
        assert not finding.grave
        assert "cropped" in finding.cause
        assert check_lens(replace(seen, intrinsics=k), True) == []

    @pytest.mark.parametrize(("factor", "grave"), [(60, True), (20, False), (0.15, True)])
    def test_field_of_view(self, factor, grave):
        seen = cameras()
        k = seen.intrinsics * [[factor, 1, 1], [1, factor, 1], [1, 1, 1]]
        [finding] = check_lens(replace(seen, intrinsics=k), False)
        assert "field of view" in finding.what
        assert finding.grave is grave

    def test_stretched_pixels(self):
        seen = cameras()
        [finding] = check_lens(replace(seen, intrinsics=seen.intrinsics * [[1.5, 1, 1], [1, 1, 1], [1, 1, 1]]), True)
        assert "differ by 50%" in finding.what


class TestPlaces:
    def test_clean_with_masks_and_without(self, clean):
        assert check_places(clean.cameras, np.zeros(3), 0.9, clean, False) == []
        assert check_places(clean.cameras, np.zeros(3), 0.9, None, True) == []

    def test_box_in_other_units(self, clean):
        [large] = check_places(clean.cameras, np.zeros(3), 90.0, None, True)
        assert "14 of 14 cameras stand inside" in large.what
        assert large.grave
        [masked] = check_places(clean.cameras, np.zeros(3), 90.0, clean, True)
        assert masked == large
        [small] = check_places(clean.cameras, np.zeros(3), 0.01, None, True)
        assert "pixels wide" in small.what

    def test_one_camera_inside_the_object(self, clean):
        poses = clean.cameras.camera_to_world.copy()
        poses[6, :3, 3] = 0.0
        seen = with_poses(clean, poses)
        [finding] = check_places(seen.cameras, np.zeros(3), 0.9, seen, False)
        assert finding.views == ("v7",)

    def test_all_cameras_look_away(self, clean):
        turned = replace(clean.cameras, camera_to_world=clean.cameras.camera_to_world @ FLIP)
        [finding] = check_places(turned, np.zeros(3), 0.9, None, False)
        assert "axes" in finding.cause
        assert finding.grave


class TestLight:
    def colours(self, gain):
        places = cameras(24).camera_to_world[:, :3, 3]
        rng = np.random.default_rng(1)
        colours = 0.3 * np.exp(0.05 * rng.normal(size=(24, 3)) + 0.1 * places)
        test = np.arange(24) % 4 == 1
        names = tuple(f"t{i}" for i in range(6))
        return (colours[~test], places[~test]), (colours[test] * gain, places[test]), np.zeros(3), names

    def test_clean(self):
        assert check_light(*self.colours(1.0)) == []

    @pytest.mark.parametrize(("gain", "said"), [(1.4, "times as bright"), (0.7, "times as dark")])
    def test_exposure(self, gain, said):
        [finding] = check_light(*self.colours(gain))
        assert said in finding.what
        assert not finding.grave

    def test_sides_that_no_training_view_lies_beside_are_not_asked(self):
        axes = np.concatenate([np.eye(3), -np.eye(3)])
        between = np.array([[1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1]]) / np.sqrt(3)
        close = np.repeat(between, 4, axis=0) + 0.2 * np.tile(np.eye(4)[:, :3], (4, 1))  # four about each
        dark, bright, names = np.full((16, 3), 0.3), np.full((4, 3), 0.42), ("a", "b", "c", "d")
        assert check_light((dark[:6], axes), (bright, between), np.zeros(3), names) == []
        [finding] = check_light((dark, close), (bright, between), np.zeros(3), names)
        assert "1.40 times as bright" in finding.what

    def test_white_balance(self):
        [finding] = check_light(*self.colours(np.array([1.2, 1.0, 0.85])))
        assert finding.check == "white balance"


@pytest.fixture(scope="module")
def photographs():
    """Pictures of close neighbours on a textured ground, without masks, and their cameras."""
    seen = close_cameras()
    return np.sqrt(np.stack([drawn(seen, view, ground=True)[0] for view in range(24)])), seen


class TestPictures:
    @pytest.mark.thorough
    def test_clean(self, photographs):
        assert check_pictures(*photographs) == ([], True)

    @pytest.mark.thorough
    @pytest.mark.parametrize(
        ("change", "cause"),
        [
            (lambda c: replace(c, intrinsics=c.intrinsics * [[2, 1, 2], [1, 2, 2], [1, 1, 1]]), "half the size"),
            (lambda c: replace(c, camera_to_world=c.camera_to_world @ FLIP), "axes are those of the other"),
            (lambda c: replace(c, camera_to_world=np.linalg.inv(c.camera_to_world)), "are world-to-camera"),
            (lambda c: replace(c, camera_to_world=MIRROR @ c.camera_to_world @ MIRROR), "left-handed"),
            (
                lambda c: replace(c, camera_to_world=c.camera_to_world[np.random.default_rng(2).permutation(24)]),
                "order",
            ),
        ],
    )
    def test_a_fault_of_all_views(self, photographs, change, cause):
        pictures, seen = photographs
        findings, supported = check_pictures(pictures, change(seen))
        assert not supported
        assert findings[0].grave
        assert cause in findings[0].cause

    @pytest.mark.thorough
    def test_two_swapped_are_named(self, photographs):
        pictures, seen = photographs
        poses = seen.camera_to_world.copy()
        poses[[4, 19]] = poses[[19, 4]]
        [finding], _ = check_pictures(pictures, replace(seen, camera_to_world=poses))
        assert finding.views == ("v5", "v20")  # of the other too few matches are left to say so by itself
        assert "swapped" in finding.cause
        assert not finding.grave

    @pytest.mark.thorough
    def test_a_camera_that_no_other_view_has_is_named_alone(self, photographs):
        pictures, seen = photographs
        poses = seen.camera_to_world.copy()
        turn = np.eye(4)
        turn[:2, :2] = [[0, -1], [1, 0]]
        poses[4] = poses[4] @ turn
        [finding], _ = check_pictures(pictures, replace(seen, camera_to_world=poses))
        assert finding.views == ("v5",)
        assert "or their cameras are wrong" in finding.cause

    def test_pictures_without_texture_say_nothing(self, photographs):
        pictures, seen = photographs
        assert check_pictures(np.full_like(pictures, 0.5), seen) == ([], False)

    @pytest.mark.thorough
    @pytest.mark.parametrize("truth", [0.0, 0.5])
    def test_half_a_pixel(self, photographs, truth):
        pictures, seen = photographs
        k = seen.intrinsics.copy()
        k[:, :2, 2] -= truth
        offset, found, decided = find_half_pixel(pictures, replace(seen, intrinsics=k), 1)
        assert decided
        assert offset == truth
        assert abs(found.best - truth) < 4 * found.error < 0.4

    def test_half_a_pixel_that_cannot_be_told_is_said(self, photographs):
        pictures, seen = photographs
        offset, found, decided = find_half_pixel(np.full_like(pictures, 0.5), seen, 1)
        assert (offset, found, decided) == (0.5, None, False)
        assert "too few matches" in told(offset, found, decided)


def test_grave_findings_are_one_error_that_says_how_to_go_on():
    grave = Finding("a", "this is so", "a reason", "do that", ("v1",))
    other = Finding("b", "that too", "another", "mend it", grave=False)
    with pytest.raises(DataError, match="this is so; probable cause: a reason") as caught:
        settle([other, grave], "error")
    assert caught.value.where == "views v1"
    assert caught.value.fix == "do that; `checks: warn` on the loader goes on regardless"
    assert settle([other, grave], "warn") == [str(other), str(grave)]


def write_scene(folder, seen, held, gain=1.0):
    for split, part, by in (("train", seen, 1.0), ("test", held, gain)):
        (folder / split).mkdir(exist_ok=True)
        frames = []
        for view, name in enumerate(part.names):
            rgb, alpha = drawn(part, view, by)
            write_image(folder / split / f"{name}.png", encode_rgba(rgb, alpha))
            frames.append({"file_path": f"{split}/{name}.png",
                           "transform_matrix": blender_from_opencv(part.camera_to_world[view]).tolist()})  # fmt: skip
        k = seen.intrinsics[0]
        numbers = {"fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], "w": part.width, "h": part.height}
        (folder / f"transforms_{split}.json").write_text(json.dumps({**numbers, "frames": frames}))


class TestLoader:
    options = BlenderOptions(truth=False)

    def test_clean_then_half_size_then_told_to_go_on(self, tmp_path):
        seen = cameras()
        write_scene(tmp_path, seen.subset(range(0, 14, 2)), seen.subset(range(1, 14, 4)))
        assert load_blender(tmp_path, self.options).notes == []
        for split in ("train", "test"):
            file = tmp_path / f"transforms_{split}.json"
            content = json.loads(file.read_text())
            file.write_text(json.dumps(content | {name: 2 * content[name] for name in ("fl_x", "fl_y", "cx", "cy")}))
        with pytest.raises(DataError, match="half the size that the camera file is for") as caught:
            load_blender(tmp_path, self.options)
        assert "checks: warn" in caught.value.fix
        box = tuple(BALLS[:, :3].min(0) - 0.3), tuple(BALLS[:, :3].max(0) + 0.3)
        scene = load_blender(tmp_path, self.options.replaced(checks="warn", box=box))
        assert any("half the size" in note for note in scene.notes)
        assert load_blender(tmp_path, self.options.replaced(checks="off", box=box)).notes == []

    def test_darker_test_pictures_are_a_note(self, tmp_path):
        seen = cameras(24)
        write_scene(tmp_path, seen.subset([k for k in range(24) if k % 4 != 1]), seen.subset(range(1, 24, 4)), gain=0.6)
        [note] = load_blender(tmp_path, self.options).notes
        assert "times as dark as training pictures" in note


def test_idr_asks_the_pictures_for_the_half_pixel(idr_scene):
    told = load_idr(idr_scene)
    given = load_idr(idr_scene, IdrOptions(pixel_offset=0.5))
    assert np.array_equal(told.train.intrinsics, given.train.intrinsics)
    assert [note for note in told.notes if note not in given.notes] == [
        "too few matches to tell where the camera file's pixel centres lie: pixel_offset 0.5 is taken"
    ]
    with pytest.raises(ValueError, match=r"0 to 0\.5 pixels, or auto"):
        IdrOptions(pixel_offset=0.7)


def test_all_principal_points_move_alike(idr_scene):
    train, _, _ = list_idr(idr_scene, IdrOptions())
    loaded = load_shots(train, split="training", downscale=2)
    moved = shifted(loaded, 0.5)
    assert np.allclose(moved.intrinsics[:, :2, 2] - loaded.intrinsics[:, :2, 2], 0.25)
    assert np.allclose(moved.silhouette_intrinsics[:, :2, 2] - loaded.silhouette_intrinsics[:, :2, 2], 0.5)


def close_ups(wrong=()):
    """Twenty views, half of them from half as far, aimed at one of the balls, whose edges the body crosses; the views
    `wrong` look elsewhere than they say."""
    seen = cameras(20)
    poses = seen.camera_to_world.copy()
    for view in range(1, 20, 2):
        at = BALLS[view // 2 % len(BALLS), :3]
        poses[view] = look_at(at + 0.5 * (poses[view, :3, 3] - at), at, np.array([0, 0, 1.0]))
    found = outlines(replace(seen, camera_to_world=poses))
    for view in wrong:
        poses[view] = poses[(view + 7) % 20]
    return with_poses(found, poses)


def test_close_ups_contradict_nobody():
    """What lies beyond their edges is for the whole views to say."""
    seen = close_ups()
    assert seen.partial[1::2].mean() > 0.7
    assert not seen.partial[::2].any()
    assert check_masks(seen) == ([], True)


@pytest.mark.parametrize("wrong", [4, 7])
def test_a_wrong_camera_among_close_ups_is_found(wrong):
    (finding,), supported = check_masks(close_ups([wrong]))
    assert finding.views == (f"v{wrong + 1}",)
    assert not supported
