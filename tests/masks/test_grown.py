"""Pixels beside a mask that may be the object's: by colour, against a table, and where colours say nothing."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.color import rgb2lab

from exmesh_graph.masks import grown
from exmesh_graph.masks.grown import maybe_shown


def picture(rng, *, ground=(0.2, 0.3, 0.7), thing=(0.8, 0.2, 0.1)):
    """(display colours [1, 48, 48, 3], true mask [1, 48, 48]): a noisy square before a noisy ground."""
    true = np.zeros((1, 48, 48), bool)
    true[:, 14:34, 14:34] = True
    colours = np.where(true[..., None], thing, ground) + rng.normal(0, 0.02, (1, 48, 48, 3))
    return colours.clip(0, 1).astype(np.float32), true


def test_the_rest_of_a_square_is_found_and_its_ground_is_not():
    shown, true = picture(np.random.default_rng(0))
    part = true.copy()
    part[:, :, 27:] = False
    more = maybe_shown(shown, part)
    assert (more & true).sum() > 0.98 * true.sum()
    assert (more & ~true).sum() < 0.02 * true.sum()


def test_a_square_of_which_most_is_missing_grows_by_a_ring_far_beyond():
    rng = np.random.default_rng(4)
    true = np.zeros((1, 128, 128), bool)
    true[:, 20:100, 20:100] = True
    colours = np.where(true[..., None], (0.8, 0.7, 0.6), (0.2, 0.3, 0.4)) + rng.normal(0, 0.02, (1, 128, 128, 3))
    part = true.copy()
    part[:, :, 60:] = False  # the ring just beyond what is grown shows the square as well
    shown = colours.clip(0, 1).astype(np.float32)
    assert (maybe_shown(shown, part) == part).all()
    assert maybe_shown(shown, part, part=0.0)[:, 30:90, 60:68].mean() < 0.1  # the far ring shows some of it
    more = maybe_shown(shown, part, part=0.05)
    assert more[:, 30:90, 60:68].mean() > 0.5  # one view's guess has holes, which the hull of all fills
    assert (more & ~true).sum() < 0.02 * part.sum()


def test_a_ground_of_the_same_colour_says_nothing():
    shown, true = picture(np.random.default_rng(1), thing=(0.2, 0.3, 0.7))
    part = true.copy()
    part[:, :, 27:] = False
    assert (maybe_shown(shown, part) == part).all()


def test_the_tables_own_picture_overrules_colour():
    shown, true = picture(np.random.default_rng(2))
    part = true.copy()
    part[:, :, 27:] = False
    table = np.where(true, 0.999, 0.5)
    assert (maybe_shown(shown, part, table) == part).all()


def test_masks_that_are_empty_full_or_tiny_stay():
    shown, _ = picture(np.random.default_rng(3))
    for mask in (np.zeros((1, 48, 48), bool), np.ones((1, 48, 48), bool)):
        assert (maybe_shown(shown, mask) == mask).all()
    speck = np.zeros((1, 48, 48), bool)
    speck[0, 20, 20] = True
    assert (maybe_shown(shown, speck) == speck).all()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000))
def test_chances_against_distances_written_out(seed):
    """One pixel at a time, all distances sorted, against the trees."""
    rng = np.random.default_rng(seed)
    shown, true = picture(rng, thing=(0.35, 0.3, 0.5))
    part = true.copy()
    part[:, :, 27:] = False
    lab = np.stack([rgb2lab(one) for one in shown]).astype(np.float32)
    beside, around, _ = grown._rings(part[0])
    own = grown.binary_erosion(part[0], iterations=2)

    def off(there, colour):
        return np.sort(np.linalg.norm(there.astype(float) - np.round(colour), axis=1))[:5].mean()  # whole CIELAB units

    count = min(around.sum(), own.sum())
    out, mine = (part[:: max(1, -(-len(part) // count))] for part in (lab[0][around], lab[0][own]))
    here = np.stack([one for one in mine if off(out, one) > 3])
    expected = []
    for colour in lab[0][beside]:
        near, far = off(here, colour), off(out, colour)
        expected.append((far + 1e-2) / (near + far + 2e-2))
    got = grown._colour(lab[0], own, lab[0][own], around, beside)
    np.testing.assert_allclose(got, expected, rtol=1e-4)
