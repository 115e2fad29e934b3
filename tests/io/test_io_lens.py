"""Lenses that are other than they were taken for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exmesh_graph.io.lens import UNCHANGED, Changed, Lens, LensChange

CHANGES = st.builds(LensChange, st.floats(-0.1, 0.1), st.floats(-0.3, 0.3))


@given(CHANGES, st.lists(st.tuples(*[st.floats(-0.5, 0.5)] * 2), min_size=1))
def test_what_a_changed_lens_shows_comes_from_the_ray_that_is_found(change, rays):
    rays = np.array(rays)
    np.testing.assert_allclose(change.rays(change.shown(rays)), rays, atol=2e-6)


def test_an_unchanged_lens_shows_what_a_pinhole_does():
    rays = np.random.default_rng(0).uniform(-1, 1, (5, 2))
    np.testing.assert_array_equal(UNCHANGED.shown(rays), rays)
    np.testing.assert_array_equal(UNCHANGED.rays(rays), rays)


@pytest.mark.parametrize("growth", [0.0, 0.03, -0.05])
def test_a_pinhole_that_changes_is_brown_s_lens_of_one_term(growth):
    taken, change = Lens(90, 70, (100.0, 110.0), (44.0, 36.5)), LensChange(growth, -0.16)
    focal = (100 * np.exp(growth), 110 * np.exp(growth))
    true, changed = Lens(90, 70, focal, (44.0, 36.5), (-0.16,)), Changed(taken, change)
    rays = np.random.default_rng(0).uniform([-0.6, -0.6, 1.4], [0.6, 0.6, 2.6], (20, 3))
    np.testing.assert_allclose(changed.img_from_cam(rays), true.img_from_cam(rays), rtol=1e-12)
    np.testing.assert_allclose(changed.calibration_matrix(), true.calibration_matrix(), rtol=1e-12)
    assert (changed.width, changed.height) == (90, 70)
    matrices = np.stack([taken.calibration_matrix()] * 3)
    np.testing.assert_allclose(change.longer(matrices)[2], true.calibration_matrix(), rtol=1e-12)
    np.testing.assert_array_equal(matrices[2], taken.calibration_matrix())
