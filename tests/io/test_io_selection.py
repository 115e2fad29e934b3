"""Blurred pictures and repetitions are left out by name, and nothing of a set that has neither."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift, uniform_filter1d

from exmesh_graph.errors import DataError
from exmesh_graph.io.images import write_image
from exmesh_graph.io.photos import place_photos
from exmesh_graph.io.selection import choose, displacement, grey_of, sharpness
from exmesh_graph.io.settings import PhotosOptions


def scene(seed=0, width=120, height=90):
    """A picture with detail of all sizes, as photographs have it (1/f)."""
    rng = np.random.default_rng(seed)
    parts = [2**k * gaussian_filter(rng.normal(size=(height, width)), 0.7 * 2**k) for k in range(5)]
    grey = np.sum(parts, axis=0)
    return np.clip(0.5 + 0.18 * grey / grey.std(), 0, 1).astype(np.float32)


def write(folder, pictures):
    files = []
    for k, grey in enumerate(pictures):
        files.append(folder / f"p{k:02d}.png")
        write_image(files[-1], np.repeat(grey[..., None], 3, axis=2))
    return files


def test_a_third_blurred_goes_and_a_sharp_set_stays(tmp_path):
    noisy = [scene(k) + np.random.default_rng(k).normal(0, 0.01, (90, 120)) for k in range(12)]
    lit = [(0.3 + 0.06 * k) * grey for k, grey in enumerate(noisy)]  # neither light nor contrast is sharpness
    assert choose(write(tmp_path, lit), 0.4, 0.002) == ([], [])
    for k in (1, 6):
        lit[k] = gaussian_filter(lit[k], 2)
    for k in (2, 9):
        lit[k] = uniform_filter1d(lit[k], 7, axis=1)  # the camera moved
    files = write(tmp_path, lit)
    assert choose(files, 0.4, 0.002) == ([1, 2, 6, 9], [])
    assert choose(files, 0.0, 0.002) == ([], [])


def test_a_set_that_is_soft_throughout_is_not_blurred_beside_itself(tmp_path):
    files = write(tmp_path, [gaussian_filter(scene(k), 2) for k in range(5)])
    assert choose(files, 0.4, 0.0) == ([], [])


def test_of_what_repeats_its_neighbour_the_sharper_stays(tmp_path):
    rng = np.random.default_rng(5)
    views = [scene(k) for k in range(3)]
    again = 0.9 * views[1] + rng.normal(0, 0.005, views[1].shape)  # a second shot, a little darker
    softer = gaussian_filter(views[2], 0.45)
    files = write(tmp_path, [views[0], views[1], again, softer, views[2], views[0]])
    soft, twins = choose(files, 0.0, 0.002)
    assert soft == []
    assert len(twins) == 2
    assert twins[0] in (1, 2)
    assert twins[1] == 3
    assert choose(files, 0.4, 0.0) == ([], [])


@pytest.mark.parametrize("pixels", [0.3, 0.6, 1.0])
def test_displacement_is_in_shares_of_the_width_from_below(pixels):
    smooth = gaussian_filter(scene(3), 1.5)
    moved = shift(smooth, (0, pixels), order=3, mode="nearest")
    got = displacement(smooth, moved) * smooth.shape[1]
    assert 0.3 * pixels < got < 1.1 * pixels
    still = smooth.copy()
    still[30:60, 40:80] = moved[30:60, 40:80]  # a turntable: a tenth of the picture moves
    assert displacement(smooth, still) * smooth.shape[1] > 0.2 * pixels


def test_what_shows_nothing_is_not_judged(tmp_path):
    flat = np.full((20, 30), 0.5, np.float32)
    assert np.isnan(sharpness(flat))
    assert np.isnan(displacement(flat, flat))
    assert np.isnan(displacement(flat, flat.T))
    assert choose(write(tmp_path, [flat] * 3), 0.4, 0.002) == ([], [])


def test_grey_is_the_mean_over_whole_blocks():
    codes = np.random.default_rng(0).integers(0, 65536, (21, 33, 4), np.uint16)
    want = codes[:20, :32, :3].reshape(10, 2, 16, 2, 3).mean((1, 3, 4)) / 65535
    assert np.abs(grey_of(codes, 17) - want).max() < 1e-6


def test_too_few_that_differ_is_an_error_that_counts_them(tmp_path):
    write(tmp_path, [scene()] * 4)
    (tmp_path / "w").mkdir()
    with pytest.raises(DataError, match=r"of 4 pictures 0 are blurred and 3 repeat"):
        place_photos(tmp_path, PhotosOptions(), tmp_path / "w")
