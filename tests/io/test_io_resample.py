"""Colours between pixels: kernels against SciPy's interpolation."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from exmesh_graph.io.resample import bilinear, cubic


@pytest.mark.parametrize("shape", [(7, 9, 3), (5, 4, 4), (6, 1, 1), (1, 6, 2), (1, 1, 3)])
def test_bilinear_colours_are_those_of_scipy(shape):
    random = np.random.default_rng(0)
    picture = random.uniform(size=shape).astype(np.float32)
    places = random.uniform(-1.5, 10, (2, 40, 5))
    places[:, 0, 0], places[:, 0, 1] = 0, (shape[0] - 1, shape[1] - 1)  # the corners count as inside
    places[:, 0, 2] = shape[0] - 1 + 1e-9, 0
    ours = bilinear(picture, places)
    plain = [map_coordinates(c, places, order=1, cval=np.nan) for c in np.moveaxis(picture, -1, 0)]
    assert ours.shape == (40, 5, shape[2])
    assert np.isfinite(ours[0, :2]).all()
    assert np.isnan(ours[0, 2]).all()
    np.testing.assert_allclose(ours, np.stack(plain, axis=-1), rtol=1e-5, atol=1e-6)


def test_beside_what_is_unknown_nothing_is_known():
    picture = np.ones((6, 6, 3), np.float32)
    picture[2, 3] = np.nan
    rows, columns = np.meshgrid(np.arange(0.5, 5), np.arange(0.5, 5), indexing="ij")
    known = np.isfinite(bilinear(picture, np.stack([rows, columns]))[..., 0])
    assert not known[1:3, 2:4].any()
    assert known.sum() == 25 - 4


def test_of_no_places_there_is_nothing():
    assert bilinear(np.ones((3, 3, 2), np.float32), np.zeros((2, 0))).shape == (0, 2)
    assert cubic(np.ones((3, 3, 2), np.float32), np.zeros((2, 0))).shape == (0, 2)


@pytest.mark.parametrize("shape", [(17, 23, 3), (5, 4, 4), (6, 1, 1), (1, 6, 2), (1, 1, 3)])
def test_cubic_colours_are_those_of_scipy(shape):
    random = np.random.default_rng(0)
    picture = random.uniform(size=shape).astype(np.float32)
    places = random.uniform(-3, 25, (2, 300))
    plain = [map_coordinates(c, places, order=3, mode="nearest") for c in np.moveaxis(picture, -1, 0)]
    np.testing.assert_allclose(cubic(picture, places), np.stack(plain, axis=-1), atol=3e-6)
    inside = np.stack(np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij"))
    np.testing.assert_allclose(cubic(picture, inside), picture, atol=3e-6)  # through the pixels themselves
