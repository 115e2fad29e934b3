"""Pictures in files: the same bits as in memory, one at a time, through the loader, the store and the solvers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exmesh_graph.errors import DataError
from exmesh_graph.testing import check_codec
from exmesh_graph.types import Views, pictures
from exmesh_graph.types.pictures import PictureFiles, Pictures, integer_codes, kept_in

RNG = np.random.default_rng(3)
CURVE = {"|u1": (RNG.random(256) ** 2).astype(np.float32), "<u2": RNG.random(65536).astype(np.float32)}
SHAPE = (6, 5)


def _bits(values: np.ndarray) -> bytes:
    return np.ascontiguousarray(values).tobytes()


def _codes(top: int, channels: int) -> np.ndarray:
    return RNG.integers(0, top + 1, (*SHAPE, channels)).astype(np.uint8 if top == 255 else np.uint16)


def _values(codes: np.ndarray) -> np.ndarray:
    values = np.take(CURVE[codes.dtype.str], codes[..., :3])
    if codes.shape[2] == 4:
        values = values * (codes[..., 3].astype(np.float32) / np.float32(np.iinfo(codes.dtype).max))[..., None]
    return values


@pytest.fixture
def stack(tmp_path: Path) -> tuple[Pictures, list[np.ndarray]]:
    """One of each kind: 8 and 16 bits, with and without alpha, halves, floats."""
    given = [_codes(255, 3), _codes(255, 4), _codes(65535, 3), _codes(65535, 4), None, None]
    values = [_values(codes) for codes in given if codes is not None]
    values += [RNG.random((*SHAPE, 3)).astype(np.float16).astype(np.float32), RNG.random((*SHAPE, 3), np.float32)]
    with kept_in(tmp_path):
        files = PictureFiles((6, *SHAPE, 3), CURVE)
    for number, picture in enumerate(values):
        files.put(number, picture, given[number])
    return files.stack(), values


def test_every_kind_of_picture_comes_back_to_the_bit(stack):
    found, values = stack
    assert [_bits(picture) for picture in found] == [_bits(picture) for picture in values]
    assert [found.codes(k).dtype.str for k in range(6)] == ["|u1", "|u1", "<u2", "<u2", "<f2", "<f4"]
    assert _bits(np.asarray(found)) == _bits(np.stack(values))
    assert (found.shape, found.ndim, found.dtype, len(found)) == ((6, *SHAPE, 3), 4, np.float32, 6)


def test_codes_that_do_not_give_the_values_are_not_kept(tmp_path):
    """A picture that was masked, resampled or changed after decoding keeps its floats."""
    codes = _codes(255, 3)
    changed = _values(codes) * np.float32(1.0000001)
    with kept_in(tmp_path):
        files = PictureFiles((1, *SHAPE, 3), CURVE)
    files.put(0, changed, codes)
    assert _bits(files.stack()[0]) == _bits(changed)
    assert integer_codes(np.full(SHAPE, 0.123456, np.float32)) is None


def test_a_mask_of_ones_takes_no_room(tmp_path):
    with kept_in(tmp_path):
        files = PictureFiles((1, *SHAPE), {"|u1": np.arange(256, dtype=np.float32) / np.float32(255)})
    files.put(0, np.ones(SHAPE, np.float32), integer_codes(np.ones(SHAPE, np.float32)))
    mask = files.stack()
    assert mask.codes(0).shape == (1, 1)
    assert _bits(mask[0]) == _bits(np.ones(SHAPE, np.float32))


def test_part_of_a_stack_is_a_stack(stack):
    found, values = stack
    for rows in ([3, 1], np.array([0, 5]), np.arange(6) % 2 == 0):
        expected = np.stack(values)[rows]
        assert isinstance(found[rows], Pictures)
        assert _bits(np.asarray(found[rows])) == _bits(expected)
    assert _bits(np.asarray(found[1:3].joined(found[:1]))) == _bits(np.stack([values[1], values[2], values[0]]))
    with pytest.raises(IndexError, match=r"pictures\[i\]"):
        found[:, :2]


def test_views_in_files_travel_as_others_do(stack, tmp_path):
    found, values = stack
    count = len(values)
    with kept_in(tmp_path):
        masks = PictureFiles((count, *SHAPE), {"|u1": np.arange(256, dtype=np.float32) / np.float32(255)})
    alphas = [(_codes(255, 1)[..., 0] / np.float32(255)).astype(np.float32) for _ in range(count)]
    for number, alpha in enumerate(alphas):
        masks.put(number, alpha, integer_codes(alpha))
    names = tuple("abcdef")
    views = Views(names, found, masks.stack(), np.zeros((count, 3, 3)), np.zeros((count, 4, 4)), "train")
    assert views.in_files
    assert views.read_back
    assert views.masked.all()
    check_codec(views, tmp_path / "codec")
    part = views.subset([4, 2])
    (tmp_path / "part").mkdir()
    part.save(tmp_path / "part")
    again = Views.load(tmp_path / "part")
    assert _bits(np.asarray(again.images)) == _bits(np.stack([values[4], values[2]]))
    assert _bits(np.asarray(again.alpha)) == _bits(np.stack([alphas[4], alphas[2]]))


def test_a_stack_of_another_size_is_refused(stack):
    found, _ = stack
    with pytest.raises(DataError, match="alpha"):
        Views(
            tuple("abcdef"), found, np.zeros((6, 2, 2), np.float32), np.zeros((6, 3, 3)), np.zeros((6, 4, 4)), "train"
        )


def test_a_damaged_picture_is_named(stack):
    found, _ = stack
    found.files[2].write_bytes(found.files[2].read_bytes()[:-7])
    with pytest.raises(DataError, match="cannot be read back"):
        found[2]


def test_a_full_disk_is_told_before_any_picture_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 10})())
    with kept_in(tmp_path), pytest.raises(DataError, match="disk are free"):
        PictureFiles((1, *SHAPE, 3), CURVE)
