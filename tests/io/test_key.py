"""Pictures on one flat colour: their masks and colours against those that they were laid on it with."""

import json

import numpy as np
import pytest

from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.color import linear_to_srgb, srgb_to_linear
from exmesh_graph.io.images import Photo, write_image
from exmesh_graph.io.key import flat_ground, keyed
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.io.shots import Ground

WHITE, GREEN, BLACK = (1.0, 1.0, 1.0), (0.1, 0.8, 0.2), (0.0, 0.0, 0.0)


def true_picture(size=64):
    """(display colour [S, S, 3], alpha [S, S]): a ring of noise with a soft border, and a rod two pixels wide."""
    y, x = np.indices((size, size)) + 0.5
    radius = np.hypot(x - size / 2, y - size / 2)
    alpha = np.clip(size * 0.35 - radius + 0.5, 0, 1) * np.clip(radius - size * 0.12 + 0.5, 0, 1)
    alpha = np.maximum(alpha, np.clip(1.5 - np.abs(y - size / 2 - 0.25), 0, 1) * (np.abs(x - size / 2) < size * 0.45))
    colour = np.array([0.7, 0.3, 0.2]) + np.random.default_rng(0).normal(0, 0.03, (size, size, 3))
    return colour.clip(0, 1), alpha


def on(colour, alpha, ground, noise=0.0):
    """The photo as a file of 8 bits holds it, laid on the ground in display colours."""
    shown = colour * alpha[..., None] + (1 - alpha)[..., None] * np.asarray(ground)
    shown = shown + np.random.default_rng(1).uniform(-noise, noise, shown.shape)
    codes = np.rint(255 * shown.clip(0, 1)).astype(np.uint8)
    linear = srgb_to_linear(codes / 255.0).astype(np.float32)
    return Photo(linear, np.ones(alpha.shape, np.float32), False, True, codes)


def write_scene(folder, picture):
    """Eight cameras around what `picture(k)` shows, a Photo."""
    (folder / "train").mkdir()
    frames = []
    for k in range(8):
        pose, turn = np.eye(4), np.pi / 4 * k
        pose[:3] = np.column_stack([
            [np.cos(turn), np.sin(turn), 0], [0, 0, 1], [np.sin(turn), -np.cos(turn), 0],
            [3 * np.sin(turn), -3 * np.cos(turn), 0],
        ])  # fmt: skip
        frames.append({"file_path": f"train/{k:03d}", "transform_matrix": pose.tolist()})
        write_image(folder / f"train/{k:03d}.png", linear_to_srgb(picture(k).rgb))
    (folder / "transforms_train.json").write_text(json.dumps({"camera_angle_x": 0.8, "frames": frames}))


@pytest.mark.parametrize("ground", [WHITE, GREEN, BLACK])
@pytest.mark.parametrize("noise", [0.0, 2 / 255])
def test_alpha_and_colour_come_back(ground, noise):
    colour, alpha = true_picture()
    photo = on(colour, alpha, ground, noise)
    found = flat_ground([photo])
    assert np.abs(np.asarray(found.colour) - ground).max() <= 1 / 255
    cut = keyed(photo, found)
    assert cut.has_alpha
    assert np.abs(cut.alpha - alpha).mean() < 0.006
    assert np.quantile(np.abs(cut.alpha - alpha), 0.98) < 0.15
    full = alpha == 1
    np.testing.assert_allclose(cut.rgb[full & (cut.alpha == 1)], photo.rgb[full & (cut.alpha == 1)], atol=1e-5)
    true = srgb_to_linear(colour) * alpha[..., None]
    assert np.abs(cut.rgb - true).mean() < 0.006
    assert cut.alpha[32, 32] > 0.5  # the rod across the gap
    assert cut.alpha[28, 32] == 0  # and the gap


def test_a_white_highlight_before_white_is_no_gap():
    colour, alpha = true_picture()
    y, x = np.indices(alpha.shape)
    light = np.clip(1.3 - np.hypot(x - 32, y - 15) / 8, 0, 1)[..., None]  # fades as a highlight of some roughness
    colour = colour + (1.5 - colour) * light
    assert keyed(on(colour, alpha, WHITE), Ground(WHITE, 2.5 / 255)).alpha[15, 32] == 1
    assert keyed(on(colour, alpha, BLACK), Ground(BLACK, 2.5 / 255)).alpha[15, 32] == 1


def test_soft_shadows_within_the_object_are_no_gaps():
    colour, alpha = true_picture()
    y, x = np.indices(alpha.shape)
    fade = np.clip(np.hypot(x - 32, y - 15) / 12 - 0.2, 0, 1)
    colour *= fade[..., None]
    assert keyed(on(colour, alpha, BLACK), Ground(BLACK, 2.5 / 255)).alpha[15, 32] == 1


def test_other_pictures_have_no_flat_ground():
    colour, alpha = true_picture()
    photo = on(colour, alpha, WHITE)
    ramp = np.linspace(0.2, 0.8, 64)[None, :, None] * np.ones((64, 1, 3))
    assert flat_ground([on(colour, alpha, ramp)]) is None
    assert flat_ground([photo, on(colour, alpha, GREEN)]) is None
    assert flat_ground([on(colour, alpha, (0.5, 0.5, 0.5), noise=0.06)]) is None
    assert flat_ground([photo, on(colour, np.ones_like(alpha), WHITE)]) is None
    assert flat_ground([Photo(photo.rgb, photo.alpha, True, True, photo.codes)]) is None
    assert flat_ground([Photo(photo.rgb, photo.alpha, False, False, None)]) is None
    assert flat_ground([]) is None
    assert keyed(on(colour, 0 * alpha, WHITE), Ground(WHITE, 2.5 / 255)).alpha.max() == 0


def test_a_scene_without_alpha_is_read_as_one_with_it(tmp_path):
    colour, alpha = true_picture()
    write_scene(tmp_path, lambda k: on(np.roll(colour, 3 * k, axis=0), alpha, WHITE))
    scene = load_blender(tmp_path, BlenderOptions(checks="off", holdout=4))
    assert scene.train.has_masks
    assert scene.test.has_masks
    assert any("stand on one colour (255, 255, 255 of 255)" in note for note in scene.notes)
    assert np.abs(np.asarray(scene.train.alpha) - alpha).mean() < 0.01
    kept = load_blender(tmp_path, BlenderOptions(checks="off", holdout=4, key=False))
    assert not kept.train.has_masks
    assert kept.notes == []


@pytest.mark.parametrize("fault", ["white bands", "an empty picture"])
def test_masks_that_contradict_one_another_are_not_taken(tmp_path, fault):
    """An object with white bands, elsewhere in each picture; and a picture that shows nothing."""
    colour, alpha = true_picture()

    def shown(k):
        if fault == "an empty picture" and k == 3:
            return np.zeros_like(alpha)
        rows = np.indices(alpha.shape)[0]
        return alpha * (np.abs(rows - 14 - 4.5 * k) > 5) if fault == "white bands" else alpha

    write_scene(tmp_path, lambda k: on(np.roll(colour, 3 * k, axis=0), shown(k), WHITE))
    scene = load_blender(tmp_path, BlenderOptions(checks="off", holdout=4))
    assert not scene.train.has_masks
    assert any("parts of the object have it too, or pictures show nothing else" in note for note in scene.notes)
