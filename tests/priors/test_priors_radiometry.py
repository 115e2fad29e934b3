"""Vignetting: pairs of known places, equations against a dense reference, lenses that are known, doubt."""

from dataclasses import replace

import numpy as np
import pytest
from exmesh_nodes import data
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.io.scene import Scene
from exmesh_graph.io.train_size import reduced
from exmesh_graph.priors.patch_match.estimate import Stereo
from exmesh_graph.priors.radiometry import even as evenness
from exmesh_graph.priors.radiometry import pairs as pairing
from exmesh_graph.priors.radiometry import vignetting
from exmesh_graph.priors.radiometry.even import Lens, even, lenses_of
from exmesh_graph.priors.radiometry.pairs import Pairs, pairs_of, tangents_squared
from exmesh_graph.priors.radiometry.vignetting import TERMS, Vignetting, vignetting_of
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Frame, PointCloud
from tests.priors.prior_scenes import wall

NORMAL = np.array([0.25, -0.3, -1.0]) / np.linalg.norm([0.25, -0.3, -1.0])  # of `wall`, towards the cameras
SOURCES = np.array([[j for j in range(9) if j != k] for k in range(9)])


def drawn(law, views=12, count=6000, seed=0, outliers=0.1, spread=0.1):
    """Pairs of places at random in pictures of gains spread so, under V = law(s), s in [0, 1]; and the gains' logs."""
    random = np.random.default_rng(seed)
    gains = random.normal(0, spread, views)
    first = random.integers(0, views, count)
    second = (first + random.integers(1, views, count)) % views
    s, t = random.uniform(0, 1, (2, count))
    place = random.uniform(0.05, 0.4, count)
    noise = 0.02 * random.normal(size=(2, count))
    noise[1] += np.where(random.random(count) < outliers, random.normal(0, 0.7, count), 0)  # highlights
    light, other = (
        place * np.exp(gains[k] + n) * law(x) for k, n, x in zip((first, second), noise, (s, t), strict=True)
    )
    facing = random.uniform(0.2, 1, (2, count))
    return Pairs(first, second, light, other, 0.3 * s, 0.3 * t, *facing), gains - gains.mean()


def known(views, depths):
    """Stereo that found all of a wall."""
    normals = np.einsum("nji,j->ni", views.camera_to_world[:, :3, :3], NORMAL)[:, None, None].repeat(8, 1).repeat(8, 2)
    return Stereo(depths, normals, np.ones(0), ())


def paired(views, depths, sources):
    return pairs_of(views, depths, known(views, depths).normals, sources)


def darkened(views, corner):
    """The views through a lens whose V falls as cosines' fourth power, to `corner` in the corner of a picture."""
    images = np.asarray(views.images).copy()
    for k, image in enumerate(images):
        squared = tangents_squared(views.intrinsics[k], views.height, views.width)
        image *= ((1 + squared / squared.max() * (corner**-0.5 - 1)) ** -2)[..., None]
    return replace(views, images=images)


@settings(max_examples=12, deadline=None)
@given(st.floats(0.35, 0.85), st.sampled_from([0.0, 0.15]), st.integers(0, 99))
def test_a_lens_is_found_among_gains_and_highlights(corner, outliers, seed):
    def law(s):
        return (1 + s * (corner**-0.5 - 1)) ** -2

    pairs, gains = drawn(law, seed=seed, outliers=outliers)
    found = vignetting_of(pairs, 12)
    assert found.found
    s = np.linspace(0, 0.95, 20)
    np.testing.assert_allclose(found.at(0.3 * s), law(s), rtol=0.03)
    np.testing.assert_allclose(found.gains, gains, atol=0.02)
    assert 0 < found.error < 0.03


@pytest.mark.parametrize("law", [lambda s: np.ones_like(s), lambda s: 1 - 0.03 * s, lambda s: 1 + 0.3 * s])
def test_nothing_is_found_where_there_is_none_or_little_or_corners_are_bright(law):
    found = vignetting_of(drawn(law)[0], 12)
    assert not found.found
    assert (found.terms >= 0).all()


def test_what_few_views_say_is_in_doubt():
    """Each picture of a place that shines tells another story: the error is theirs, not that of so many pairs."""
    pairs, _ = drawn(lambda s: 1 - 0.3 * s, views=12, outliers=0)
    slopes = np.random.default_rng(1).normal(0, 1.5, 12)
    light = pairs.light * np.exp(slopes[pairs.first] * pairs.squared / 0.3)
    assert vignetting_of(replace(pairs, light=light), 12).error > 0.05


def test_what_turning_away_does_is_not_the_lens():
    """A lamp beside the camera; where a place turns away just as it goes outward, nobody can tell."""
    random = np.random.default_rng(4)
    pairs, _ = drawn(lambda s: 1 - 0.3 * s)
    lit = replace(pairs, light=pairs.light * pairs.facing**0.6, other=pairs.other * pairs.other_facing**0.6)
    assert vignetting_of(lit, 12).corner == pytest.approx(0.7, abs=0.02)
    none, _ = drawn(lambda s: np.ones_like(s))
    facing, other = (np.exp(-squared / 0.3 + 0.02 * random.normal(size=len(squared)))
                     for squared in (none.squared, none.other_squared))  # fmt: skip
    mixed = replace(none, light=none.light * facing, other=none.other * other, facing=facing, other_facing=other)
    assert not vignetting_of(mixed, 12).found


def test_too_few_pairs_and_pictures_tell_nothing():
    few = drawn(lambda s: 1 - 0.5 * s, count=400)[0]
    found = vignetting_of(few, 12)
    assert not found.found
    assert found.corner == 1
    assert not vignetting_of(few.of(np.zeros(len(few), bool)), 12).found
    views, depths = wall(count=3, size=96)
    assert lenses_of(views, known(views, depths)) == []


def test_the_equations_are_those_of_a_dense_least_squares():
    pairs, _ = drawn(lambda s: 1 - 0.4 * s, views=5, count=60, outliers=0)
    random = np.random.default_rng(3)
    weight, off = random.uniform(0, 1, 60), np.log(pairs.light / pairs.other)
    columns = vignetting._columns(pairs, 0.3)
    np.testing.assert_allclose(columns[:, 0], np.log(pairs.facing / pairs.other_facing))
    np.testing.assert_allclose(columns[:, 2], (pairs.other_squared**2 - pairs.squared**2) / 0.3**2)
    rows = np.zeros((60, 6 + TERMS))
    rows[np.arange(60), pairs.first] += 1
    rows[np.arange(60), pairs.second] -= 1
    rows[:, 5:] = columns
    curvature, slope = vignetting._equations(pairs, off, columns, weight, 5)
    np.testing.assert_allclose(curvature, rows.T @ (rows * weight[:, None]), atol=1e-12)
    np.testing.assert_allclose(slope, rows.T @ (weight * off), atol=1e-12)


def test_terms_are_the_best_of_all_that_are_not_negative():
    from scipy.optimize import lsq_linear

    random = np.random.default_rng(5)
    for _ in range(10):
        rows = random.normal(size=(40, 4 + TERMS))
        off = random.normal(size=40)
        found = vignetting._least(rows.T @ rows, rows.T @ off)
        bounds = np.r_[np.full(4, -np.inf), np.zeros(TERMS)], np.inf
        best = lsq_linear(rows, off, bounds=bounds, tol=1e-12).x
        np.testing.assert_allclose(found, best, atol=1e-4)


def test_pairs_show_the_same_places():
    views, depths = wall(count=9, size=240)
    pairs = paired(views, depths, SOURCES)
    assert len(pairs) > 5000
    assert set(zip(pairs.first, pairs.second, strict=True)) > {(4, 3), (4, 5)}
    assert (pairs.first != pairs.second).all()
    off = np.abs(np.log(pairs.light / pairs.other))
    assert np.median(off) < 0.02
    assert np.quantile(off, 0.95) < 0.1
    assert 0.4 < pairs.facing.min() < 0.9 < pairs.facing.max() <= 1
    swapped = pairs.of(pairs.first == 4)
    assert swapped.squared.max() <= tangents_squared(views.intrinsics[4], 240, 240).max()


def test_places_that_are_hidden_black_cut_off_or_without_depth_do_not_count():
    views, depths = wall(count=9, size=120)
    count = len(paired(views, depths, SOURCES))
    nearer = depths.depth.copy()
    nearer[3] *= 0.9  # something stands before the wall
    assert 3 not in paired(views, replace(depths, depth=nearer), SOURCES).second
    for value in (0.0, 1.0):
        images = views.images.copy()
        images[5] = value
        told = paired(replace(views, images=images), depths, SOURCES)
        assert 5 not in told.first
        assert 5 not in told.second
        assert 0 < len(told) < count
    assert len(paired(views, replace(depths, depth=0 * depths.depth), SOURCES)) == 0
    assert len(paired(views, depths, np.full((9, 8), -1))) == 0


def test_how_far_a_place_turns_away():
    random = np.random.default_rng(0)
    normals, places = random.normal(size=(2, 50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    told = pairing._cosine(normals, places)
    for normal, place, cosine in zip(normals, places, told, strict=True):
        angle = np.arccos(normal @ -place / np.sqrt(place @ place))
        assert cosine == pytest.approx(max(np.cos(angle), 0.1))


def test_a_picture_of_tangents():
    intrinsics = np.array([[50.0, 0, 10], [0, 40, 4], [0, 0, 1]])
    squared = tangents_squared(intrinsics, 8, 20)
    assert squared.shape == (8, 20)
    np.testing.assert_allclose(squared[6, 17], (7.5 / 50) ** 2 + (2.5 / 40) ** 2)


def test_a_lens_of_known_walls_is_taken_out(monkeypatch):
    monkeypatch.setattr(pairing, "CELL", 6)
    views, depths = wall(count=9, size=240)
    dark = darkened(views, 0.5)
    (lens,) = lenses_of(dark, known(dark, depths))
    assert lens.took(views).all()
    assert lens.vignetting.found
    assert "darker" in lens.vignetting.told
    light = even(dark, [lens])
    inner = np.s_[:, 20:-20, 20:-20]
    np.testing.assert_allclose(light.images[inner], views.images[inner], rtol=0.06)
    assert np.abs(light.images / views.images - 1)[inner].mean() < 0.02
    small = even(reduced(dark, 2), [lens])  # of another size
    np.testing.assert_allclose(small.images, reduced(light, 2).images, rtol=0.01)
    (none,) = lenses_of(views, known(views, depths))
    assert not none.vignetting.found
    assert even(views, [none]) is views


def test_of_many_pictures_some_are_asked(monkeypatch):
    asked = []

    def stereo(views, *given, **more):
        asked.append(len(views))
        return known(*wall(count=60, size=32))

    monkeypatch.setattr(evenness, "patch_match", stereo)
    views, _ = wall(count=70, size=32)
    lenses_of(views, None)
    lenses_of(views.subset(range(60)), None)
    lenses_of(views.subset(range(5)), None)
    assert asked == [60, 60]


def test_lenses_are_told_apart(monkeypatch):
    monkeypatch.setattr(pairing, "CELL", 6)
    views, depths = wall(count=18, size=160)
    order = np.r_[np.arange(0, 18, 2), np.arange(1, 18, 2)]
    views, depth = views.subset(order), depths.depth[order]
    dark = darkened(views, 0.4)
    images = np.concatenate([dark.images[:9], views.images[9:]])
    intrinsics = views.intrinsics.copy()
    cropped = images[9:, 20:-20, 20:-20]
    intrinsics[9:, :2] *= 160 / 120  # a longer lens: the middle of the picture, enlarged
    intrinsics[9:, :2, 2] -= 20 * 160 / 120
    rows = ((np.arange(160) + 0.5) * 120 / 160).astype(int)
    images = np.concatenate([images[:9], cropped[:, rows][:, :, rows]])
    depth = np.concatenate([depth[:9], depth[9:, 20:-20, 20:-20][:, rows][:, :, rows]])
    mixed = replace(views, images=images, intrinsics=intrinsics)
    one, two = lenses_of(mixed, known(mixed, replace(depths, names=views.names, depth=depth)))
    assert one.took(mixed).tolist() == [True] * 9 + [False] * 9
    assert (one.took(mixed) != two.took(mixed)).all()
    assert (one.vignetting.found, two.vignetting.found) == (True, False)
    light = even(mixed, [one, two])
    np.testing.assert_array_equal(light.images[9:], mixed.images[9:])
    assert (light.images[:9] > mixed.images[:9]).mean() > 0.9


def test_what_is_cut_off_stays_so():
    views, _ = wall(count=2, size=32)
    bright = replace(views, images=np.ones_like(views.images), alpha=np.full_like(views.alpha, 0.75))
    lens = Lens(32 / views.intrinsics[0, 0, 0], Vignetting(np.array([0.7, 0.0, 0.0]), 0.05, 0.01, np.zeros(2)))
    np.testing.assert_array_equal(even(bright, [lens]).images, 0.75)
    linear = even(replace(bright, clipped=False), [lens])
    assert linear.images.max() > 1.5
    assert linear.images.dtype == np.float32
    np.testing.assert_array_equal(even(bright, [lens]).alpha, bright.alpha)


@pytest.mark.parametrize(("parameter", "dark", "found"), [(True, 0.4, True), (False, 0.4, False), (True, 1.0, False)])
def test_photographs_lose_their_vignetting_where_they_show_some(monkeypatch, tmp_path, parameter, dark, found):
    monkeypatch.setattr(pairing, "CELL", 4)
    views, _ = wall(count=9, size=160)
    shown = darkened(views, dark)
    scene = Scene(shown.subset(range(1, 9)), replace(shown.subset([0]), split="test"), Frame(np.eye(4), np.eye(4)))
    context, figures, nothing = FakeContext(scratch=tmp_path), {}, np.zeros((0, 3), np.float32)
    p = data.PhotosParams(path=tmp_path, vignetting=parameter)
    after = data._compared(context, scene, None, PointCloud(nothing, nothing), figures, p, False, parameter)
    assert found == any("vignetting taken out of 9 pictures" in line for line in context.lines)
    assert (figures.get("vignetting", 0) > 0.2) == found
    assert ("vignetting" in figures) == parameter
    for one, before in ((after.train, scene.train), (after.test, scene.test)):
        assert (one is before) != found
    if found:
        errors = [np.abs(one.images / views.images[:1] - 1).mean() for one in (after.test, scene.test)]
        assert errors[0] < 0.3 * errors[1]
