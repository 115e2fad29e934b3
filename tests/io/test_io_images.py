"""Pictures survive the file: values, straight alpha, orientation, bit depth, the same bytes each time."""

import time

import numpy as np
import pytest

from exmesh_graph.errors import DataError
from exmesh_graph.io.color import linear_to_srgb, srgb_to_linear
from exmesh_graph.io.images import (
    display,
    encode_rgba,
    read_image,
    read_mask,
    read_photo,
    read_raw,
    write_image,
)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize(
    ("name", "depth", "tolerance"),
    [("a.png", "uint8", 0.5 / 255), ("a.png", "uint16", 0.5 / 65535), ("a.exr", "half", 5e-4), ("a.exr", "float", 0)],
)
def test_round_trip(tmp_path, rng, channels, name, depth, tolerance):
    image = rng.random((5, 7, channels)).astype(np.float32)
    write_image(tmp_path / name, image, depth)
    back = read_image(tmp_path / name)
    assert back.shape == image.shape
    assert back.dtype == np.float32
    assert np.abs(back - image).max() <= tolerance + 1e-7


def test_png_colour_is_not_multiplied_by_alpha(tmp_path):
    image = np.zeros((2, 2, 4), np.float32)
    image[..., :3], image[..., 3] = 0.8, 0.25
    write_image(tmp_path / "a.png", image)
    assert read_image(tmp_path / "a.png")[0, 0] == pytest.approx([0.8, 0.8, 0.8, 0.25], abs=0.003)


def test_two_dimensional_arrays_are_not_transposed(tmp_path):
    image = np.zeros((4, 9), np.float32)
    image[1, 7] = 1
    write_image(tmp_path / "a.png", image)
    back = read_image(tmp_path / "a.png")
    assert back.shape == (4, 9, 1)
    assert back[1, 7, 0] == 1
    assert back.sum() == 1


def test_16_bit_values_stay_whole(tmp_path):
    image = np.array([[0, 1], [1234, 65535]], np.float64) / 65535
    write_image(tmp_path / "a.png", image, "uint16")
    assert read_raw(tmp_path / "a.png")[..., 0].tolist() == [[0, 1], [1234, 65535]]


def test_equal_pictures_are_equal_files_whenever_written(tmp_path, rng):
    image = rng.random((4, 4, 3))
    for name, depth in (("a.exr", "half"), ("a.png", "uint8")):
        write_image(tmp_path / name, image, depth)
        first = (tmp_path / name).read_bytes()
        time.sleep(1.1 if name == "a.exr" else 0)
        write_image(tmp_path / name, image, depth)
        assert (tmp_path / name).read_bytes() == first


def test_photo_is_linear_and_premultiplied(tmp_path):
    write_image(tmp_path / "a.png", np.full((2, 2, 4), 0.5))
    photo = read_photo(tmp_path / "a.png")
    value = 128 / 255
    assert photo.alpha[0, 0] == pytest.approx(value)
    assert photo.rgb[0, 0, 0] == pytest.approx(((value + 0.055) / 1.055) ** 2.4 * value, rel=1e-5)
    assert photo.clipped
    write_image(tmp_path / "a.exr", np.full((2, 2, 4), 0.5), "half")
    exr = read_photo(tmp_path / "a.exr")
    assert exr.rgb[0, 0, 0] == 0.5
    assert not exr.clipped


def test_photo_digest_knows_the_picture_not_the_name(tmp_path, rng):
    image = rng.random((4, 4, 3))
    for name in ("a.png", "b.png"):
        write_image(tmp_path / name, image)
    image[0, 0, 0] += 0.5
    write_image(tmp_path / "c.png", image)
    a, b, c = (read_photo(tmp_path / f"{n}.png").digest() for n in "abc")
    assert a == b != c


def test_encode_and_display_invert_reading(tmp_path, rng):
    alpha = rng.random((6, 5)).astype(np.float32)
    alpha[0] = 0
    rgb = (rng.random((6, 5, 3)) * alpha[..., None]).astype(np.float32)
    write_image(tmp_path / "a.png", encode_rgba(rgb, alpha), "uint16")
    photo = read_photo(tmp_path / "a.png")
    assert np.abs(photo.rgb - rgb).max() < 1e-4
    assert (
        np.abs(display(rgb, alpha) - linear_to_srgb(rgb / np.maximum(alpha, 1e-6)[..., None]) * alpha[..., None]).max()
        < 1e-6
    )


def test_srgb_curve():
    x = np.linspace(0, 1, 1001)
    assert np.abs(srgb_to_linear(linear_to_srgb(x)) - x).max() < 1e-6
    assert srgb_to_linear(np.array(0.5)) == pytest.approx(0.21404114)
    assert srgb_to_linear(np.array(0.04)) == pytest.approx(0.04 / 12.92)


def damaged(source, target, share):
    data = source.read_bytes()
    target.write_bytes(data[: int(len(data) * share)])


def test_unreadable_pictures_name_the_file(tmp_path, rng):
    with pytest.raises(DataError, match=r"nothing\.png.*does not exist"):
        read_image(tmp_path / "nothing.png")
    (tmp_path / "text.png").write_text("hello")
    with pytest.raises(DataError, match=r"text\.png.*cannot be decoded"):
        read_image(tmp_path / "text.png")
    for name, depth in (("whole.png", "uint8"), ("whole.exr", "half")):
        write_image(tmp_path / name, rng.random((64, 64, 3)), depth)
        damaged(tmp_path / name, tmp_path / f"cut_{name}", 0.5)
        with pytest.raises(DataError, match=f"cut_{name}.*cannot be decoded") as caught:
            read_image(tmp_path / f"cut_{name}")
        assert "fix:" in str(caught.value)


def test_values_that_are_not_finite_are_counted_and_placed(tmp_path):
    image = np.ones((4, 6, 3), np.float32)
    image[2, 5, 1] = np.nan
    image[3, 0] = np.inf
    write_image(tmp_path / "a.exr", image, "float")
    with pytest.raises(DataError, match=r"a\.exr: 2 pixels .* column 5, row 2"):
        read_photo(tmp_path / "a.exr")


@pytest.mark.parametrize("depth", ["uint8", "uint16"])
def test_gray_with_and_without_alpha_is_three_times_the_same_colour(tmp_path, rng, depth):
    gray, alpha = rng.random((5, 7, 1)), rng.random((5, 7, 1))
    for name, parts in (("gray", [gray]), ("both", [gray, alpha])):
        write_image(tmp_path / f"{name}.png", np.concatenate(parts, 2), depth)
        write_image(tmp_path / f"{name}_rgb.png", np.concatenate([gray] * 3 + parts[1:], 2), depth)
        found, colour = read_photo(tmp_path / f"{name}.png"), read_photo(tmp_path / f"{name}_rgb.png")
        for field in ("rgb", "alpha", "codes"):
            np.testing.assert_array_equal(getattr(found, field), getattr(colour, field))
        assert found.has_alpha == colour.has_alpha == (len(parts) == 2)


def test_mask_and_channel_checks(tmp_path, rng):
    write_image(tmp_path / "m.png", np.array([[0, 1], [0.5, 1]]))
    assert read_mask(tmp_path / "m.png")[0].tolist() == [0, 1]
    write_image(tmp_path / "two.exr", rng.random((2, 2, 2)), "float")
    with pytest.raises(DataError, match=r"2 channels"):
        read_photo(tmp_path / "two.exr")
    write_image(tmp_path / "five.exr", rng.random((2, 2, 5)), "float")
    with pytest.raises(DataError, match=r"5 channels"):
        read_photo(tmp_path / "five.exr")
    with pytest.raises(DataError, match="cannot be written"):
        write_image(tmp_path / "no" / "folder.png", rng.random((2, 2, 3)))
