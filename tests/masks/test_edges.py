"""Outlines on edges of a picture, across an object, and out in the open."""

import numpy as np
import pytest

from exmesh_graph.masks.edges import on_edges


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
