"""Pictures of even contrast, and cameras that are found only in them."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from exmesh_graph.errors import DataError
from exmesh_graph.io.contrast import DEVIATION, REACH, even_contrast, even_pictures
from exmesh_graph.io.images import read_raw, write_codes
from exmesh_graph.io.motion import find_motion
from exmesh_graph.io.settings import MotionSettings
from tests.io.test_io_photos import COUNT, painted, picture, poses

SIDE = 240
#: Of white, between the darkest and the lightest paint.
FAINT = 0.05


def pattern():
    noise = gaussian_filter(np.random.default_rng(0).normal(size=(SIDE, SIDE)), 1.5)
    return noise / noise.std()


def test_a_faint_pattern_in_the_dark_comes_out_as_a_bold_one_in_the_light():
    """So does a bright one half behind a step of light; what differs by less than noise stays faint."""
    bold, dark, noise = (0.5 + 0.1 * pattern(), 0.15 + 0.03 * pattern(), 0.1 + 0.003 * pattern())
    bold_after, dark_after, noise_after = (even_contrast(gray) for gray in (bold, dark, noise))
    assert bold_after.std() == pytest.approx(DEVIATION, rel=0.1)
    assert dark_after.std() / bold_after.std() > 0.65  # 0.3 before
    assert noise_after.std() < 0.15 * bold_after.std()
    assert np.corrcoef(dark_after.ravel(), pattern().ravel())[0, 1] > 0.9
    half = np.concatenate([dark[:, : SIDE // 2], bold[:, SIDE // 2 :]], axis=1)
    away = int(8 * REACH * SIDE) + 2  # of two filters of four spreads each
    np.testing.assert_allclose(even_contrast(half)[:, : SIDE // 2 - away], dark_after[:, : SIDE // 2 - away], atol=1e-3)


@pytest.mark.parametrize("value", [0.0, 0.4, 1.0])
def test_what_is_of_one_value_is_gray(value):
    np.testing.assert_allclose(even_contrast(np.full((40, 60), value)), 0.5, atol=1e-12)


@pytest.mark.parametrize(("kind", "channels"), [("uint8", 1), ("uint8", 3), ("uint16", 3), ("uint8", 4), ("uint16", 2)])
def test_pictures_of_any_kind_are_written_by_their_names(tmp_path, kind, channels):
    top = np.iinfo(kind).max
    gray = np.clip(0.3 + 0.05 * pattern(), 0, 1)
    codes = np.full((SIDE, SIDE, channels), top, kind)  # an alpha of ones is no colour
    colours = 3 if channels > 2 else 1
    codes[..., :colours] = np.round(top * gray)[..., None].astype(kind)
    write_codes(tmp_path / "a.png", codes)
    even_pictures([tmp_path / "a.png"], tmp_path / "even", threads=2)
    written = read_raw(tmp_path / "even" / "a.png")
    assert written.shape == (SIDE, SIDE, 1)
    np.testing.assert_allclose(written[..., 0] / 255, even_contrast(gray), atol=0.03)


def test_a_picture_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(DataError, match=r"missing\.png"):
        even_pictures([tmp_path / "missing.png"], tmp_path / "even", threads=1)


@pytest.mark.thorough
def test_cameras_of_dark_smooth_things_are_found_in_even_pictures_alone(tmp_path):
    """Paint that differs by a fiftieth of white: SIFT leaves out all of it."""
    pytest.importorskip("pycolmap")
    rng = np.random.default_rng(0)
    images = []
    for k, pose in enumerate(poses()):
        seen, _ = picture(pose, painted(), 400, 300, 520.0)
        gray = np.clip(0.12 + FAINT * (seen - 0.5) + rng.normal(0, 0.002, seen.shape), 0, 1)
        images.append(tmp_path / f"p{k}.png")
        write_codes(images[-1], np.round(255 * gray)[..., None].repeat(3, axis=2).astype(np.uint8))
    placed = {}
    for way in ("wide", "even", "auto"):
        work = tmp_path / way
        work.mkdir()
        try:
            motion = find_motion(images, {}, MotionSettings(matching=way), work)
            placed[way] = (len(motion.camera_to_world), motion.matching)
        except DataError:
            placed[way] = (0, "")
    assert placed["wide"][0] < COUNT
    assert placed["even"] == placed["auto"] == (COUNT, "even")
