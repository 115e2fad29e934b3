"""The loaders: geometry of the normalised world, splits, and every kind of bad input they name."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from io_scenes import ANGLE, CENTRE, RADIUS, SIZE, edit_json, ring, write_blender

from benchmarks.meshes import write_ply
from exmesh_graph.errors import DataError
from exmesh_graph.io.blender import blender_files, load_blender
from exmesh_graph.io.idr import load_idr
from exmesh_graph.io.images import read_image, write_image
from exmesh_graph.io.middlebury import load_middlebury
from exmesh_graph.io.normalise import FILL, bounding_sphere, nearest_point
from exmesh_graph.io.reduce import downscale_area
from exmesh_graph.io.settings import BlenderOptions, IdrOptions, MiddleburyOptions
from exmesh_graph.io.shots import hold_out, spread
from tests.io.projecting import project

SAMPLE = Path(__file__).parents[2] / "graphs" / "samples" / "spot"
NO_TRUTH = BlenderOptions(truth=False)


def disc_error(views):
    """Largest difference, over the views, between the mask's pixel area and that of the FILL sphere at the origin."""
    errors = []
    for alpha, k, pose in zip(views.alpha, views.intrinsics, views.world_to_camera, strict=True):
        points = np.random.default_rng(0).normal(size=(4000, 3))
        points *= FILL / np.linalg.norm(points, axis=1, keepdims=True)
        pixels, depth = project(points, k, pose)
        assert (depth > 0).all()
        rows, columns = np.nonzero(alpha >= 0.5)
        low, high = pixels.min(0), pixels.max(0)
        errors += [columns.min() - low[0], columns.max() + 1 - high[0], rows.min() - low[1], rows.max() + 1 - high[1]]
    return np.abs(errors).max()


class TestBlender:
    def test_object_fills_the_unit_sphere_and_cameras_see_it(self, tmp_path):
        write_blender(tmp_path, "train", ring(24))  # the hull of fewer views stands out from the sphere
        write_blender(tmp_path, "test", ring(3, offset=0.2))
        scene = load_blender(tmp_path, NO_TRUTH)
        assert disc_error(scene.train) < 1.3
        assert disc_error(scene.test) < 1.3
        assert scene.train.split == "train"
        assert scene.test.split == "test"
        assert scene.train.has_masks
        assert scene.train.facets() == {"split": "train", "masks": True}

    def test_frame_returns_to_the_files_world(self, blender_scene):
        scene = load_blender(blender_scene, NO_TRUTH)
        matrix = scene.frame.dataset_from_scene @ scene.frame.scene_from_normalised
        assert matrix[:3, 3] == pytest.approx(CENTRE, abs=0.02)
        assert np.cbrt(np.linalg.det(matrix[:3, :3])) * FILL == pytest.approx(1.06 * RADIUS, rel=0.06)
        back = matrix @ scene.train.camera_to_world[0][:, 3]
        assert back[:3] == pytest.approx(ring(9)[0][:3, 3])
        rotation = matrix[:3, :3] @ scene.train.camera_to_world[0][:3, :3]
        assert rotation / np.cbrt(np.linalg.det(rotation)) == pytest.approx(ring(9)[0][:3, :3])

    def test_the_world_does_not_depend_on_downscale(self, blender_scene):
        full, half = (load_blender(blender_scene, NO_TRUTH.replaced(downscale=d)) for d in (1, 2))
        assert np.array_equal(full.frame.scene_from_normalised, half.frame.scene_from_normalised)
        assert half.train.images.shape[1:] == (SIZE // 2, SIZE // 2, 3)
        assert np.allclose(half.train.intrinsics[:, :2] * 2, full.train.intrinsics[:, :2])
        mean = full.train.images.reshape(9, SIZE // 2, 2, SIZE // 2, 2, 3).mean((2, 4))
        assert np.abs(half.train.images - mean).max() < 1e-6

    def test_exr_is_taken_where_it_is_there(self, tmp_path):
        write_blender(tmp_path, "train", ring(9), ending="_rgba.png")
        write_blender(tmp_path, "test", ring(3, offset=0.2), ending="_rgba.png")
        with pytest.raises(DataError, match=r"hdr: auto"):
            load_blender(tmp_path, NO_TRUTH.replaced(hdr="true"))
        write_blender(tmp_path, "train", ring(9), ending="_rgba.exr")
        write_blender(tmp_path, "test", ring(3, offset=0.2), ending="_rgba.exr")
        hdr, ldr = (load_blender(tmp_path, NO_TRUTH.replaced(hdr=h)).train for h in ("auto", "false"))
        assert not hdr.clipped
        assert ldr.clipped
        assert 0 < np.abs(hdr.images - ldr.images).max() < 0.01

    @pytest.mark.parametrize("test", ["missing", "one frame"])
    def test_views_are_held_out_where_there_are_no_test_frames(self, blender_scene, test):
        file = blender_scene / "transforms_test.json"
        if test == "missing":
            file.unlink()
        else:
            edit_json(file, lambda c: c.update(frames=c["frames"][:1]))
        scene = load_blender(blender_scene, NO_TRUTH.replaced(holdout=4))
        assert scene.test.names == ("train_002", "train_006")
        assert len(scene.train) == 7
        assert not set(scene.train.names) & set(scene.test.names)

    def test_subsets_are_spread(self, blender_scene):
        scene = load_blender(blender_scene, NO_TRUTH.replaced(max_views=3, max_test_views=1))
        assert scene.train.names == ("train_001", "train_004", "train_007")
        assert len(scene.test) == 1

    def test_full_intrinsics_and_principal_point(self, blender_scene):
        def change(content):
            del content["camera_angle_x"]
            content.update(fl_x=95.0, fl_y=90.0, cx=20.0, cy=26.0)

        edit_json(blender_scene / "transforms_train.json", change)
        scene = load_blender(blender_scene, NO_TRUTH.replaced(box=((0, 0, 0), (1, 1, 1)), checks="off"))
        assert scene.train.intrinsics[0].tolist() == [[95, 0, 20], [0, 90, 26], [0, 0, 1]]
        f = 0.5 * SIZE / np.tan(0.5 * ANGLE)
        assert np.allclose(scene.test.intrinsics[0], [[f, 0, SIZE / 2], [0, f, SIZE / 2], [0, 0, 1]])

    def test_without_alpha_the_optical_axes_locate_the_object(self, blender_scene):
        for picture in (*(blender_scene / "train").iterdir(), *(blender_scene / "test").iterdir()):
            write_image(picture, read_image(picture)[..., :3])
        assert load_blender(blender_scene, NO_TRUTH).train.has_masks  # on one flat colour
        scene = load_blender(blender_scene, NO_TRUTH.replaced(key=False))
        assert not scene.train.has_masks
        assert (scene.train.alpha == 1).all()
        assert np.linalg.norm(scene.train.camera_to_world[:, :3, 3], axis=1).min() > 1

    def test_truth_goes_along(self, blender_scene):
        (blender_scene / "mesh").mkdir()
        corners = CENTRE + RADIUS * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0.0]])
        write_ply(blender_scene / "mesh" / "mesh.ply", corners, np.array([[0, 1, 2], [1, 3, 2]]))
        env = np.random.default_rng(0).random((4, 8, 3)).astype(np.float32)
        write_image(blender_scene / "env_train.exr", env, "float")
        (blender_scene / "test_rli").mkdir()
        (blender_scene / "envmaps").mkdir()
        write_image(blender_scene / "envmaps" / "noon.exr", env * 2, "float")
        for i in range(3):
            shutil.copy(blender_scene / "test" / f"{i:03d}_rgba.png", blender_scene / "test_rli" / f"noon_{i:03d}.png")
            shutil.copy(blender_scene / "test" / f"{i:03d}_rgba.png", blender_scene / "test_rli" / f"lost_{i:03d}.png")
            shutil.copy(blender_scene / "test" / f"{i:03d}_rgba.png", blender_scene / "test" / f"{i:03d}_albedo.png")
            write_image(blender_scene / "test" / f"{i:03d}_rough.png", np.full((SIZE, SIZE), 0.25), "uint16")
        scene = load_blender(blender_scene)
        truth = scene.truth
        norms = np.linalg.norm(truth.mesh_vertices, axis=1)
        assert norms == pytest.approx(FILL / 1.06, rel=0.06)
        # z up becomes Y up: the corner above the centre has the largest y
        assert truth.mesh_vertices[2] == pytest.approx([0, norms[2], 0], abs=0.05)
        assert truth.names == scene.test.names
        assert list(truth.relit) == ["noon"]
        assert np.array_equal(truth.relit["noon"][0], np.roll(env * 2, -2, axis=1))
        assert np.array_equal(truth.environment, np.roll(env, -2, axis=1))
        assert "lost" in scene.notes[0]
        straight = scene.test.images[0] / np.maximum(scene.test.alpha[0], 1e-6)[..., None]
        covered = scene.test.alpha[0] > 0
        assert np.abs(truth.albedo[0] - straight)[covered].max() < 1e-5
        assert truth.roughness == pytest.approx(0.25, abs=1e-4)
        names = blender_files(blender_scene, BlenderOptions())
        assert {"mesh/mesh.ply", "env_train.exr", "envmaps/noon.exr", "test_rli/noon_001.png"} <= set(names)
        assert not any("lost" in name for name in names)

    @pytest.mark.thorough
    def test_the_sample_scene(self):
        scene = load_blender(SAMPLE)
        assert len(scene.train) == 40
        assert len(scene.test) == 8
        assert 0.93 < np.linalg.norm(scene.truth.mesh_vertices, axis=1).max() < 0.97
        # Drawn with the cameras, the true vertices fall onto the masks.
        pixels, _ = project(scene.truth.mesh_vertices, scene.test.intrinsics[3], scene.test.world_to_camera[3])
        columns, rows = np.floor(pixels).astype(int).T
        assert (scene.test.alpha[3][rows, columns] > 0).mean() > 0.999
        mean = scene.truth.albedo[3][scene.test.alpha[3] == 1].mean(0)
        assert mean[0] > mean[2]  # the cow is pinkish


class TestBadBlender:
    def bad(self, folder, match, options=NO_TRUTH):
        with pytest.raises(DataError, match=match) as caught:
            load_blender(folder, options)
        assert caught.value.fix or caught.value.expected
        return str(caught.value)

    def test_missing_folder_and_file(self, tmp_path):
        self.bad(tmp_path / "nowhere", "nowhere: the scene folder does not exist")
        self.bad(tmp_path, r"transforms.json: the camera file does not exist")

    def test_missing_image(self, blender_scene):
        (blender_scene / "train" / "004_rgba.png").unlink()
        self.bad(blender_scene, r"(?s)train/004: the image does not exist.*004_rgba\.png")
        with pytest.raises(DataError, match="004"):
            blender_files(blender_scene, NO_TRUTH)

    def test_undecodable_image(self, blender_scene):
        file = blender_scene / "train" / "002_rgba.png"
        file.write_bytes(file.read_bytes()[:200])
        self.bad(blender_scene, r"002_rgba\.png: the image cannot be decoded")

    def test_mask_of_another_size(self, blender_scene):
        for picture in (*(blender_scene / "train").iterdir(), *(blender_scene / "test").iterdir()):
            pixels = read_image(picture)
            stem = picture.name.removesuffix("_rgba.png")
            write_image(picture.with_name(stem + ".png"), pixels[..., :3])
            write_image(picture.with_name(stem + "_mask.png"), pixels[..., 3])
            picture.unlink()
        assert load_blender(blender_scene, NO_TRUTH).train.has_masks
        write_image(blender_scene / "train" / "005_mask.png", np.ones((SIZE, SIZE // 2)))
        self.bad(blender_scene, r"005_mask\.png: the mask is 24 x 48, its image 48 x 48")

    def test_cameras_in_one_place_and_one_that_looks_away(self, blender_scene):
        file = blender_scene / "transforms_train.json"
        text = json.loads(file.read_text())
        kept = json.loads(file.read_text())
        turn = np.diag([-1.0, 1.0, -1.0, 1.0])
        text["frames"][2]["transform_matrix"] = (np.array(text["frames"][2]["transform_matrix"]) @ turn).tolist()
        file.write_text(json.dumps(text))
        scene = load_blender(blender_scene, NO_TRUTH)
        assert "1 cameras look past the object" in scene.notes[0]
        assert scene.train.names[2] in scene.notes[0]
        for frame in kept["frames"]:
            matrix = np.array(frame["transform_matrix"])
            matrix[:3, 3] = [1.0, 2.0, 3.0]
            frame["transform_matrix"] = matrix.tolist()
        file.write_text(json.dumps(kept))
        self.bad(blender_scene, r"all 9 training cameras stand in one place")

    def test_training_views_may_lack_masks_and_test_views_may_not(self, blender_scene):
        for picture in (*(blender_scene / "train").iterdir(), *(blender_scene / "test").iterdir()):
            pixels = read_image(picture)
            stem = picture.name.removesuffix("_rgba.png")
            write_image(picture.with_name(stem + ".png"), pixels[..., :3])
            write_image(picture.with_name(stem + "_mask.png"), pixels[..., 3])
            picture.unlink()
        whole = load_blender(blender_scene, NO_TRUTH)
        assert not whole.notes
        (blender_scene / "train" / "005_mask.png").unlink()
        scene = load_blender(blender_scene, NO_TRUTH)
        assert "1 of" in scene.notes[0]
        assert "005" in scene.notes[0]
        assert scene.train.has_masks
        assert [n for n, known in zip(scene.train.names, scene.train.masked, strict=True) if not known] == [
            scene.train.names[5]
        ]
        ours, theirs = (s.frame.scene_from_normalised for s in (scene, whole))
        np.testing.assert_allclose(ours, theirs, atol=0.1 * np.abs(theirs).max())
        next((blender_scene / "test").glob("*_mask.png")).unlink()
        self.bad(blender_scene, r"the image has no alpha channel or mask")

    def test_empty_mask(self, blender_scene):
        write_image(blender_scene / "train" / "003_rgba.png", np.zeros((SIZE, SIZE, 4)))
        self.bad(blender_scene, r"003_rgba\.png: the mask is empty")

    @pytest.mark.parametrize(("value", "what"), [(0.0, "singular"), (2.0, "not rigid"), (float("nan"), "NaN")])
    def test_bad_camera(self, blender_scene, value, what):
        def change(content):
            content["frames"][6]["transform_matrix"][0] = [value, 0, 0, 0]
            content["frames"][6]["transform_matrix"][1] = [0, value, 0, 0]

        edit_json(blender_scene / "transforms_train.json", change)
        self.bad(blender_scene, rf"view train_006.*{what}")

    def test_sizes(self, blender_scene):
        write_image(blender_scene / "train" / "001_rgba.png", np.ones((SIZE, SIZE + 2, 4)))
        self.bad(blender_scene, r"001_rgba\.png: the image is 50 x 48, the camera file says 48 x 48")
        for split in ("train", "test"):
            edit_json(blender_scene / f"transforms_{split}.json", lambda c: [c.pop("w"), c.pop("h")])
        scene = load_blender(blender_scene, BlenderOptions(checks="off"))
        assert scene.train.images.shape[1:3] == (SIZE, SIZE)  # brought to what most have
        assert any("train_001" in note and "brought to it" in note for note in scene.notes)

    def test_zero_views(self, blender_scene):
        edit_json(blender_scene / "transforms_train.json", lambda c: c.update(frames=[]))
        self.bad(blender_scene, r"transforms_train\.json: the file lists no views")

    def test_too_few_views_to_hold_out(self, blender_scene):
        (blender_scene / "transforms_test.json").unlink()
        edit_json(blender_scene / "transforms_train.json", lambda c: c.update(frames=c["frames"][:3]))
        self.bad(blender_scene, "too few to hold out")

    def test_malformed_json_and_frames(self, blender_scene):
        edit_json(blender_scene / "transforms_train.json", lambda c: c["frames"][2].pop("transform_matrix"))
        self.bad(blender_scene, r"transforms_train\.json, frame 2")
        edit_json(blender_scene / "transforms_train.json", lambda c: c["frames"][2].update(transform_matrix=[[1, 2]]))
        self.bad(blender_scene, r"frame 2: transform_matrix is \(1, 2\)")
        (blender_scene / "transforms_train.json").write_text("{")
        self.bad(blender_scene, "not valid JSON")

    def test_distortion_and_field_of_view(self, blender_scene):
        edit_json(blender_scene / "transforms_train.json", lambda c: c.update(k1=0.1))
        self.bad(blender_scene, "lens distortion")
        edit_json(blender_scene / "transforms_train.json", lambda c: c.update(k1=0, camera_angle_x=0))
        self.bad(blender_scene, "camera_angle_x is 0")

    def test_a_training_picture_among_the_test_pictures(self, blender_scene):
        shutil.copy(blender_scene / "train" / "004_rgba.png", blender_scene / "test" / "001_rgba.png")
        self.bad(blender_scene, r"same content.*test_001, which equals train_004")

        def change(content):
            content["frames"][0]["file_path"] = "train/003"

        edit_json(blender_scene / "transforms_test.json", change)
        self.bad(blender_scene, r"same name.*train_003")

    def test_doubled_names(self, blender_scene):
        edit_json(blender_scene / "transforms_train.json", lambda c: c["frames"].append(c["frames"][0]))
        self.bad(blender_scene, "two views are called 'train_000'")

    def test_downscale_must_divide(self, blender_scene):
        self.bad(blender_scene, r"cannot be reduced by 5", NO_TRUTH.replaced(downscale=5))

    def test_masks_without_a_common_part(self, blender_scene):
        def change(content):
            for frame in content["frames"][:5]:
                frame["transform_matrix"][2][3] += 40

        edit_json(blender_scene / "transforms_train.json", change)
        self.bad(blender_scene, "no common part")

    def test_missing_truth_of_one_view(self, blender_scene):
        write_image(blender_scene / "test" / "000_albedo.png", np.ones((SIZE, SIZE, 4)))
        self.bad(blender_scene, r"001_albedo\.png", BlenderOptions())


class TestMiddlebury:
    options = MiddleburyOptions(downscale=1, holdout=4, first=2, wrong_masks=0)

    def test_loading(self, middlebury_scene):
        scene = load_middlebury(middlebury_scene, self.options)
        assert scene.test.names == ("v02", "v06")
        assert len(scene.train) == 8
        assert disc_error(scene.train) < 2.5
        assert scene.frame.scene_from_normalised[:3, 3] == pytest.approx(CENTRE, abs=0.04)
        assert (scene.train.images[scene.train.alpha == 0] == 0).all()

    def test_default_split_is_every_eighth_from_the_fourth(self):
        assert hold_out(47, 8, 3)[1] == [3, 11, 19, 27, 35, 43]

    def test_given_box(self, middlebury_scene):
        box = (tuple(CENTRE - RADIUS), tuple(CENTRE + RADIUS))
        scene = load_middlebury(middlebury_scene, self.options.replaced(box=box))
        assert scene.frame.scene_from_normalised[:3, 3] == pytest.approx(CENTRE)
        assert scene.frame.scene_from_normalised[0, 0] == pytest.approx(RADIUS * np.sqrt(3) / FILL)

    def test_one_wrong_mask_is_outvoted(self, middlebury_scene):
        mask = np.zeros((SIZE, SIZE))
        mask[:6, :6] = 1
        write_image(middlebury_scene / "mask" / "v04.png", mask)
        with pytest.raises(DataError, match="views v04: 1 of 8 masks contradict the others"):
            load_middlebury(middlebury_scene, self.options)
        scene = load_middlebury(middlebury_scene, self.options.replaced(wrong_masks=1))
        assert scene.frame.scene_from_normalised[:3, 3] == pytest.approx(CENTRE, abs=0.08)

    @pytest.mark.parametrize(
        ("damage", "match"),
        [
            ("image", r"v03\.png: the image does not exist"),
            ("mask", r"v03\.png: the mask does not exist"),
            ("size", r"mask/v03\.png: the mask is 8 x 8"),
            ("numbers", r"ball_par\.txt: line 5 does not hold 21 numbers"),
            ("count", r"ball_par\.txt: the first line"),
            ("none", r"holds 0 camera files"),
            ("singular", r"camera of view v03.*singular"),
        ],
    )
    def test_bad_input(self, middlebury_scene, damage, match):
        par = middlebury_scene / "ball_par.txt"
        lines = par.read_text().splitlines()
        if damage == "image":
            (middlebury_scene / "image" / "v03.png").unlink()
        elif damage == "mask":
            (middlebury_scene / "mask" / "v03.png").unlink()
        elif damage == "size":
            write_image(middlebury_scene / "mask" / "v03.png", np.ones((8, 8)))
        elif damage == "numbers":
            lines[4] = lines[4].rsplit(" ", 1)[0]
        elif damage == "count":
            lines[0] = "11"
        elif damage == "singular":
            words = lines[4].split()
            lines[4] = " ".join(words[:10] + ["0"] * 9 + words[19:])
        par.write_text("\n".join(lines) + "\n")
        if damage == "none":
            par.unlink()
        with pytest.raises(DataError, match=match):
            load_middlebury(middlebury_scene, self.options)


class TestIdr:
    options = IdrOptions(holdout=5, first=2, up="y")

    def test_loading(self, idr_scene):
        scene = load_idr(idr_scene, self.options)
        assert not scene.train.has_masks
        assert scene.test.names == ("000002", "000007")
        pixel, _ = project(np.zeros((1, 3)), scene.train.intrinsics[0], scene.train.world_to_camera[0])
        pose = ring(10, up=(0, 1, 0))[0]
        expected, _ = project(CENTRE[None], scene.train.intrinsics[0], np.linalg.inv(pose))
        assert pixel[0] == pytest.approx(expected[0])
        assert scene.frame.scene_from_normalised[0, 0] == pytest.approx(2 * RADIUS / FILL)
        f = 0.5 * SIZE / np.tan(0.5 * ANGLE)
        assert np.allclose(scene.train.intrinsics[0], [[f, 0, SIZE / 2], [0, f, SIZE / 2], [0, 0, 1]])

    def test_masks(self, idr_scene):
        (idr_scene / "mask").mkdir()
        disc = np.hypot(*np.mgrid[-24:24, -24:24]) < 15
        for i in range(10):
            write_image(idr_scene / "mask" / f"{i:03d}.png", disc.astype(float))
        assert load_idr(idr_scene, self.options).train.has_masks
        assert not load_idr(idr_scene, self.options.replaced(masks="none")).train.has_masks
        (idr_scene / "mask" / "004.png").unlink()
        with pytest.raises(DataError, match="9 masks for 10 pictures"):
            load_idr(idr_scene, self.options)
        with pytest.raises(DataError, match="folder of masks"):
            load_idr(idr_scene, self.options.replaced(masks="elsewhere"))

    def test_bad_input(self, idr_scene):
        file = idr_scene / "cameras_sphere.npz"
        arrays = dict(np.load(file))
        np.savez(file, **{**arrays, "world_mat_4": np.zeros((4, 4))})
        with pytest.raises(DataError, match=r"world_mat_4 \(view 000004\): .*singular"):
            load_idr(idr_scene, self.options)
        np.savez(file, **{**arrays, "scale_mat_4": np.eye(4)})
        with pytest.raises(DataError, match="scale_mat is not one"):
            load_idr(idr_scene, self.options)
        np.savez(file, **{n: a for n, a in arrays.items() if n != "world_mat_9"})
        with pytest.raises(DataError, match="10 pictures in image/ but 9 cameras"):
            load_idr(idr_scene, self.options)
        file.write_bytes(file.read_bytes()[:100])
        with pytest.raises(DataError, match="cannot be read"):
            load_idr(idr_scene, self.options)
        file.unlink()
        with pytest.raises(DataError, match="no camera file"):
            load_idr(idr_scene, self.options)


def test_area_averaging_is_exact():
    image = np.arange(24, dtype=np.float32).reshape(4, 6)
    assert downscale_area(image, 2).tolist() == [[3.5, 5.5, 7.5], [15.5, 17.5, 19.5]]


def test_spread_and_hold_out():
    assert spread(10, 0) == list(range(10))
    assert spread(10, 5) == [1, 3, 5, 7, 9]
    kept, held = hold_out(10, 4, 1)
    assert held == [1, 5, 9]
    assert sorted(kept + held) == list(range(10))


def test_nearest_point_and_parallel_axes():
    target = np.array([1.0, 2, 3])
    origins = np.random.default_rng(0).normal(size=(6, 3))
    directions = (target - origins) / np.linalg.norm(target - origins, axis=1, keepdims=True)
    assert nearest_point(origins, directions) == pytest.approx(target)
    with pytest.raises(DataError, match="parallel"):
        nearest_point(origins, np.repeat([[0, 0, 1.0]], 6, axis=0))


def test_bounding_sphere():
    points = np.random.default_rng(0).normal(size=(5000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points = points[points[:, 0] > -0.6] * 2 + 5  # most of a sphere: its bounding box is off centre
    centre, radius = bounding_sphere(points)
    assert radius == pytest.approx(2, rel=0.02)
    assert np.linalg.norm(points - centre, axis=1).max() == pytest.approx(radius)


def test_another_true_mesh_may_be_named(tmp_path: Path) -> None:
    from exmesh_graph.io.truth_files import mesh_file

    (tmp_path / "mesh").mkdir()
    for name in ("mesh.obj", "object.obj"):
        (tmp_path / "mesh" / name).write_text("")
    assert mesh_file(tmp_path) == tmp_path / "mesh" / "mesh.obj"
    assert mesh_file(tmp_path, "mesh/object.obj") == tmp_path / "mesh" / "object.obj"
    with pytest.raises(DataError, match=r"true_mesh.*mesh/mesh\.obj|no such true mesh"):
        mesh_file(tmp_path, "mesh/none.obj")
