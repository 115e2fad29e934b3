"""Outlines on edges of a picture, across an object, and out in the open."""

import numpy as np
import pytest

from exmesh_graph.masks.edges import better_parts, on_edges


def scene() -> tuple[np.ndarray, np.ndarray]:
    """(display colours [1, 64, 64, 3], mask [1, 64, 64]): a red square before blue."""
    true = np.zeros((1, 64, 64), bool)
    true[:, 16:48, 16:48] = True
    noise = np.random.default_rng(0).normal(0, 0.01, (1, 64, 64, 3))
    return np.where(true[..., None], (0.8, 0.2, 0.1), (0.2, 0.3, 0.7)) + noise, true


def test_the_true_outline_beats_one_across_the_object_and_one_that_has_leaked():
    shown, true = scene()
    half, leaked = true.copy(), true.copy()
    half[:, :, 32:] = False
    leaked[:, 30:60, 40:60] = True
    assert on_edges(shown, true) > 0.99
    assert on_edges(shown, half) == pytest.approx(2 / 3, abs=0.05)  # its sides are 32, 16, 32 and 16 long
    assert on_edges(shown, leaked) < 0.75


def test_a_pictures_border_does_not_count_nor_does_an_empty_mask():
    shown, true = scene()
    cut = true[:, 16:48]
    assert on_edges(shown[:, 16:48], cut) > 0.99
    assert on_edges(shown, np.zeros_like(true)) == on_edges(shown, np.ones_like(true)) == 0.0


def test_of_what_a_step_changes_the_parts_that_are_better_are_taken():
    """In one view it mends a bite and leaks beside it, in the other it bites the same piece off."""
    shown, true = scene()
    shown, true = np.repeat(shown, 2, axis=0), np.repeat(true, 2, axis=0)
    masks, changed = true.copy(), true.copy()
    masks[0, 36:48, 16:30] = False
    changed[0, 20:30, 48:56] = True
    changed[1, 36:48, 16:30] = False
    before = masks.copy()
    np.testing.assert_array_equal(better_parts(shown, masks, changed), true)
    np.testing.assert_array_equal(masks, before)
    np.testing.assert_array_equal(better_parts(shown, true, true), true)
    none = np.zeros_like(true)
    np.testing.assert_array_equal(better_parts(shown, none, true), none)  # without an outline nothing compares
