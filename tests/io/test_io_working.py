"""Pictures made alike: orientation, formats, reduction, one size; and their masks with them."""

import struct
import sys

import numpy as np
import pytest
from PIL import Image, ImageOps
from scipy.ndimage import gaussian_filter

from exmesh_graph.errors import DataError, MissingLibraryError
from exmesh_graph.io.cameras import reduced_size
from exmesh_graph.io.formats import read_codes, read_header, turned
from exmesh_graph.io.images import read_mask, read_photo, read_raw, write_codes
from exmesh_graph.io.photos import photo_files
from exmesh_graph.io.reduce import area_means, reduced_codes
from exmesh_graph.io.settings import PhotosOptions
from exmesh_graph.io.working import common_size, prepare, upright


def codes(width, height, seed=0, channels=3, dtype=np.uint8):
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max + 1, (height, width, channels), dtype)


def save(path, pixels, orientation=1, **more):
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(pixels).save(path, exif=exif.tobytes(), **more)
    return path


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_what_pillow_makes_of_it(tmp_path, orientation):
    path = save(tmp_path / "a.png", codes(6, 4), orientation)
    header = read_header(path)
    assert header.orientation == orientation
    with Image.open(path) as picture:
        assert np.array_equal(turned(read_codes(path), orientation), np.asarray(ImageOps.exif_transpose(picture)))
    made = prepare([(path, None)] * 1, tmp_path / "w", 0)[0]
    assert np.array_equal(read_raw(made.image), turned(codes(6, 4), orientation))
    assert made.image.is_symlink() == (orientation == 1)
    assert made.quarter == 0


def test_the_fewer_of_portrait_and_landscape_lie_and_lose_nothing(tmp_path):
    listed = []
    for i, (size, orientation) in enumerate([((6, 4), 1), ((6, 4), 1), ((6, 4), 6), ((6, 4), 8), ((4, 6), 1)]):
        listed.append((save(tmp_path / f"{i}.png", codes(*size, seed=i), orientation), None))
    made = prepare(listed, tmp_path / "w", 0)
    assert common_size(made) == (4, 6)  # three of five are portraits
    assert [one.quarter for one in made] == [1, 1, 0, 0, 0]
    assert np.array_equal(read_raw(made[0].image), np.rot90(codes(6, 4, seed=0)))
    made = prepare(listed[:4], tmp_path / "v", 0)
    assert {one.size for one in made} == {(6, 4)}
    assert [one.quarter for one in made] == [0, 0, 1, -1]
    assert all(one.image.is_symlink() for one in made)  # turned upright and laid down again: as they are stored
    assert len({one.lens for one in made}) == 1


def test_a_lying_pose_stands_up_again():
    """A point seen at (x, y) of the upright picture is seen where `np.rot90` puts that pixel in the lying one."""
    x, y, width = 1.5, 0.5, 4
    probe = np.zeros((3, width))
    probe[int(y), int(x)] = 1
    for quarter in (1, -1):
        lying = np.rot90(probe, quarter)
        (row, column) = np.argwhere(lying)[0]
        ray = np.array([column + 0.5 - lying.shape[1] / 2, row + 0.5 - lying.shape[0] / 2, 1])
        standing = upright(np.eye(4), quarter)[:3, :3].T @ ray  # from the lying camera's axes to the upright one's
        assert standing[:2] == pytest.approx([x - width / 2, y - 1.5])


@pytest.mark.parametrize("stored", [True, False])
def test_masks_of_either_way_follow_their_picture(tmp_path, stored):
    picture = save(tmp_path / "a.png", codes(8, 6), 6)
    mask = codes(8, 6, seed=1)[..., :1]
    write_codes(tmp_path / "a_mask.png", np.ascontiguousarray(mask if stored else turned(mask, 6)))
    made = prepare([(picture, tmp_path / "a_mask.png")], tmp_path / "w", 0)[0]
    assert made.size == (6, 8)
    assert np.allclose(read_mask(made.mask), turned(mask, 6)[..., 0] / 255, atol=1e-5)
    write_codes(tmp_path / "a_mask.png", codes(7, 6)[..., :1])
    with pytest.raises(DataError, match="the mask is 7 x 6, its image 6 x 8"):
        prepare([(picture, tmp_path / "a_mask.png")], tmp_path / "v", 0)


@pytest.mark.parametrize("factor", [1.0, 1.7, 2.0, 3.3])
def test_area_means_are_integrals_over_each_new_pixel(factor):
    values = np.random.default_rng(0).random((23, 31, 2))
    width, height = reduced_size((31, 23), factor)
    got = area_means(values, factor)
    assert got.shape == (height, width, 2)
    left, top = (31 - width * factor) / 2, (23 - height * factor) / 2

    def overlap(start, length, count):
        low = start + factor * np.arange(count)[:, None]
        pixels = np.arange(length)[None]
        return np.clip(np.minimum(low + factor, pixels + 1) - np.maximum(low, pixels), 0, None) / factor

    want = np.einsum("yi,xj,ijc->yxc", overlap(top, 23, height), overlap(left, 31, width), values)
    assert np.abs(got - want).max() < 1e-6


def test_reduction_is_in_linear_light_and_colour_weighs_by_alpha(tmp_path):
    board = np.zeros((8, 8, 3), np.uint8)
    board[::2, ::2] = board[1::2, 1::2] = 255
    assert np.abs(reduced_codes(board, 2.0) / 65535 - 0.7354).max() < 1e-3  # sRGB of half the light, not 0.5
    half = np.dstack([np.full((4, 4, 3), 200, np.uint8), np.zeros((4, 4, 1), np.uint8)])
    half[:, 1::2] = 255, 0, 0, 255
    made = reduced_codes(half, 2.0)
    assert np.abs(made / 65535 - [1, 0, 0, 0.5]).max() < 1e-4  # what is transparent lends no colour


def test_large_pictures_are_reduced_with_masks_and_focal_length(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 26
    pixels = codes(60, 40)
    Image.fromarray(pixels).save(tmp_path / "a.png", exif=exif.tobytes())
    write_codes(tmp_path / "m.png", codes(60, 40, seed=2)[..., :1].copy())
    made = prepare([(tmp_path / "a.png", tmp_path / "m.png")], tmp_path / "w", 600 / 1e6)[0]
    assert made.size == (30, 20)
    assert made.scale == pytest.approx(0.5)
    assert made.focal == pytest.approx(26 / np.hypot(36, 24) * np.hypot(30, 20))
    want = read_photo(tmp_path / "a.png").rgb.reshape(20, 2, 30, 2, 3).mean((1, 3))
    assert np.abs(read_photo(made.image).rgb - want).max() < 1e-4
    mask = codes(60, 40, seed=2)[..., 0].reshape(20, 2, 30, 2).mean((1, 3)) / 255
    assert np.abs(read_mask(made.mask) - mask).max() < 1e-4
    assert prepare([(tmp_path / "a.png", None)], tmp_path / "v", 1.0)[0].image.is_symlink()


def test_names_with_spaces_stay_and_their_files_have_none(tmp_path):
    names = ["IMG (1).png", "IMG (2).png", "IMG%20(2).png"]
    for name in names:
        Image.new("RGB", (60, 40)).save(tmp_path / name)
    made = prepare([(tmp_path / name, None) for name in names], tmp_path / "w", 0)
    assert [one.name for one in made] == names
    files = [one.image.name for one in made]
    assert len(set(files)) == 3
    assert not any(" " in file for file in files)
    assert files == sorted(files, key=lambda file: names[files.index(file)])


def test_a_sharper_camera_is_reduced_until_it_just_holds_the_common_size(tmp_path):
    for i, size in enumerate([(60, 40), (60, 40), (120, 100)]):
        save(tmp_path / f"{i}.png", codes(*size, seed=i))
    made = prepare([(tmp_path / f"{i}.png", None) for i in range(3)], tmp_path / "w", 0)
    assert common_size(made) == (60, 40)
    assert made[2].size == (60, 50)
    assert made[2].lens != made[0].lens == made[1].lens


@pytest.mark.parametrize("orientation", [1, 6])
def test_heic_is_read_upright(tmp_path, orientation):
    heif = pytest.importorskip("pillow_heif", reason="pip install 'exmesh-graph[heif]'")
    smooth = np.zeros((64, 96, 3), np.uint8)
    smooth[:32, :48] = 220
    exif = Image.Exif()
    exif[0x0112] = orientation
    heif.from_pillow(Image.fromarray(smooth)).save(tmp_path / "a.heic", quality=95, exif=exif.tobytes())
    made = prepare([(tmp_path / "a.heic", None)], tmp_path / "w", 0)[0]
    want = turned(smooth, orientation)
    assert made.size == (want.shape[1], want.shape[0])
    assert np.abs(read_raw(made.image).astype(int) - want).mean() < 3
    (tmp_path / "b.heic").write_bytes((tmp_path / "a.heic").read_bytes()[:200])
    with pytest.raises(DataError, match=r"b\.heic.*cannot be decoded"):
        prepare([(tmp_path / "b.heic", None)], tmp_path / "v", 0)


@pytest.mark.parametrize("orientation", [1, 6])
def test_raw_is_developed_to_srgb_upright_whatever_its_brightest_pixel_is(tmp_path, orientation):
    pytest.importorskip("rawpy", reason="pip install 'exmesh-graph[raw]'")
    light = np.full((48, 64), 20000, np.uint16)
    light[:24, :32] = 60000
    write_dng(tmp_path / "a.dng", light, orientation)
    made = prepare([(tmp_path / "a.dng", None)], tmp_path / "w", 0)[0]
    want = turned(light[..., None], orientation) / 65535
    assert made.size == (want.shape[1], want.shape[0])
    got = read_photo(made.image).rgb
    flat = np.abs(want - gaussian_filter(want, 2, axes=(0, 1))) < 1e-3  # away from the edges, which are interpolated
    assert flat.mean() > 0.5
    assert np.abs(got - want)[flat[..., 0]].max() < 1e-3


def write_dng(path, bayer, orientation):
    """A smallest DNG 1.4: one strip of 16 bits, red top left, sRGB primaries, no white balance to apply."""
    short, long, text, byte, ratio, signed = 3, 4, 2, 1, 5, 10
    height, width = bayer.shape

    def numbers(code, *values):
        return struct.pack(f"<{len(values)}{code}", *values)

    matrix = [3.2404542, -1.5371385, -0.4985314, -0.9692660, 1.8760108, 0.0415560, 0.0556434, -0.2040259, 1.0572252]
    fractions = [x for value in matrix for x in (round(value * 10000), 10000)]
    tags = [
        (254, long, 1, numbers("I", 0)), (256, long, 1, numbers("I", width)), (257, long, 1, numbers("I", height)),
        (258, short, 1, numbers("H", 16)), (259, short, 1, numbers("H", 1)), (262, short, 1, numbers("H", 32803)),
        (271, text, 5, b"Some\0"), (272, text, 5, b"Made\0"), (273, long, 1, None),
        (274, short, 1, numbers("H", orientation)), (277, short, 1, numbers("H", 1)),
        (278, long, 1, numbers("I", height)), (279, long, 1, numbers("I", 2 * height * width)),
        (284, short, 1, numbers("H", 1)), (33421, short, 2, numbers("H", 2, 2)), (33422, byte, 4, bytes([0, 1, 1, 2])),
        (50706, byte, 4, bytes([1, 4, 0, 0])), (50707, byte, 4, bytes([1, 1, 0, 0])), (50708, text, 5, b"Made\0"),
        (50714, short, 1, numbers("H", 0)), (50717, long, 1, numbers("I", 65535)),
        (50721, signed, 9, numbers("i", *fractions)), (50728, ratio, 3, numbers("I", *[1, 1] * 3)),
        (50778, short, 1, numbers("H", 21)),
    ]  # fmt: skip
    after = 8 + 2 + 12 * len(tags) + 4
    pixels = after + sum(len(data) + len(data) % 2 for *_, data in tags if data and len(data) > 4)
    entries, beyond = b"", b""
    for tag, kind, count, data in tags:
        data = numbers("I", pixels) if data is None else data
        if len(data) > 4:
            value, beyond = numbers("I", after + len(beyond)), beyond + data + b"\0" * (len(data) % 2)
        else:
            value = data.ljust(4, b"\0")
        entries += struct.pack("<HHI", tag, kind, count) + value
    head = b"II*\0" + numbers("I", 8) + numbers("H", len(tags))
    path.write_bytes(head + entries + numbers("I", 0) + beyond + bayer.astype("<u2").tobytes())


@pytest.mark.parametrize(("ending", "module", "extra"), [("heic", "pillow_heif", "heif"), ("nef", "rawpy", "raw")])
def test_a_missing_extra_names_the_file_and_the_command(tmp_path, monkeypatch, ending, module, extra):
    monkeypatch.setitem(sys.modules, module, None)
    for i in range(3):
        (tmp_path / f"p{i}.{ending}").write_bytes(b"0")
    with pytest.raises(MissingLibraryError, match=rf"(?s)p0\.{ending}.*exmesh-graph\[{extra}\]"):
        photo_files(tmp_path, PhotosOptions())
