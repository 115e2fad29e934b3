"""Matches along epipolar lines: against all pairs written out, and against COLMAP's own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.io.guided import match_guided, matches_along
from exmesh_graph.io.images import write_image


def written_out(first, second, one, other, matrix, near, flat):
    """One pair of features at a time, in float64."""
    cosines = np.full((len(first), len(second)), -2.0)
    lengths = [np.linalg.norm(part.astype(float), axis=1) for part in (one, other)]
    for i, a in enumerate(np.c_[first, np.ones(len(first))]):
        for j, b in enumerate(np.c_[second, np.ones(len(second))]):
            line, back = matrix @ a, matrix.T @ b
            if flat:
                off = np.linalg.norm(line[:2] / line[2] - b[:2])
            else:
                off = abs(b @ line) / np.sqrt((line[:2] ** 2).sum() + (back[:2] ** 2).sum())
            if off <= near:
                cosines[i, j] = one[i].astype(float) @ other[j].astype(float) / lengths[0][i] / lengths[1][j]
    found = set()
    for i in range(len(first)):
        j = int(cosines[i].argmax())
        rows, columns = np.sort(cosines[i])[::-1], np.sort(cosines[:, j])[::-1]
        angles = np.arccos(np.clip([rows[0], *rows[1:2], columns[0], *columns[1:2]], -1, 1))
        nearest = cosines[:, j].argmax() == i and angles[0] <= 0.7
        clear = all(
            angles[0] < 0.8 * second for second in [*angles[1:2][: len(rows) > 1], *angles[-1:][: len(columns) > 1]]
        )
        if nearest and clear:
            found.add((i, j))
    return found


def scene(rng, count, flat, kinds=0):
    """(places and descriptors of features in two pictures, the second's as noisy copies in another order, matrix)."""
    points = np.c_[rng.uniform(-1, 1, (count, 2)), np.zeros(count) if flat else rng.uniform(-0.5, 0.5, count)] + [
        [0, 0, 4]
    ]
    turn = np.linalg.qr(rng.normal(size=(3, 3)) * 0.2 + np.eye(3))[0]
    turn *= np.sign(np.diag(turn))[:, None]
    shift = np.array([0.4, 0.1, 0.2])
    k = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    here, there = points, points @ turn.T + shift
    first, second = (p @ k.T for p in (here, there))
    first, second = first[:, :2] / first[:, 2:], second[:, :2] / second[:, 2:]
    across = np.array([[0, -shift[2], shift[1]], [shift[2], 0, -shift[0]], [-shift[1], shift[0], 0]])
    inverse = np.linalg.inv(k)
    matrix = inverse.T @ across @ turn @ inverse
    if flat:
        matrix = k @ (turn + np.outer(shift, [0, 0, 1]) / 4) @ inverse
    kinds = rng.integers(0, 256, (kinds or max(1, count // 2), 128))  # of two of a kind only the place tells
    which = np.arange(count) % len(kinds)
    one, other = (
        np.clip(kinds[which] + rng.normal(0, 9, (count, 128)), 0, 255).round().astype(np.uint8) for _ in range(2)
    )
    order = rng.permutation(count)
    return first, second[order] + rng.normal(0, 0.5, (count, 2)), one, other[order], matrix, order


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 90), st.booleans())
def test_matches_are_those_of_all_pairs_written_out(seed, count, flat):
    first, second, one, other, matrix, _ = scene(np.random.default_rng(seed), count, flat)
    found = matches_along(first, second, one, other, matrix, 4.0, flat=flat)
    assert {(int(i), int(j)) for i, j in found} == written_out(first, second, one, other, matrix, 4.0, flat)


@pytest.mark.parametrize("flat", [False, True])
def test_features_that_look_alike_are_told_apart_by_their_place(flat):
    first, second, one, other, matrix, order = scene(np.random.default_rng(3), 80, flat)
    found = matches_along(first, second, one, other, matrix, 4.0, flat=flat)
    right = (order[found[:, 1]] == found[:, 0]).mean()
    assert len(found) > 40
    assert right > 0.9
    assert len(matches_along(first, second, one, other, matrix, 1e5, flat=flat)) < 10  # anywhere: twins are not clear


def test_no_features_have_no_matches():
    nothing, some = np.zeros((0, 2)), np.ones((3, 2))
    described = np.eye(3, 128, dtype=np.uint8)
    for first, second, one, other in (
        (nothing, some, described[:0], described),
        (some, nothing, described, described[:0]),
    ):
        assert matches_along(first, second, one, other, np.eye(3), 4.0).shape == (0, 2)


def test_colmaps_own_guided_matches_are_found_and_hardly_any_more(tmp_path):
    colmap = pytest.importorskip("pycolmap", reason="pip install 'exmesh-graph[photos]'")
    sides = {}
    for guided in (True, False):
        (tmp_path / str(guided)).mkdir()
        sides[guided] = database(colmap, tmp_path / str(guided), guided=guided)
    before = read(colmap, sides[False])
    match_guided(colmap, sides[False], threads=2)
    theirs, ours = read(colmap, sides[True]), read(colmap, sides[False])
    assert len(theirs) == 2
    assert ours.keys() == theirs.keys()
    assert sum(map(len, theirs.values())) > 1.2 * sum(map(len, before.values()))
    both = sum(len(theirs[pair] & ours[pair]) for pair in theirs)
    assert both > 0.99 * sum(map(len, theirs.values()))
    assert both > 0.9 * sum(map(len, ours.values()))
    again = database(colmap, tmp_path, guided=False)
    match_guided(colmap, again, threads=1)
    assert read(colmap, again) == ours


def database(colmap, folder, *, guided):
    """Two pairs of pictures, of a scene with depth and of a flat one, with features of two thirds of which each has a
    twin elsewhere; matched."""
    colmap.logging.minloglevel = 3
    pictures = folder / "pictures"
    pictures.mkdir()
    names = [f"{k}.png" for k in range(4)]
    for name in names:
        write_image(pictures / name, np.zeros((240, 320, 3), np.float32))
    file = folder / "database.db"
    colmap.Database.open(file).close()
    reader = colmap.ImageReaderOptions()
    reader.camera_model, reader.camera_params = "SIMPLE_RADIAL", "300,160,120,0"
    colmap.import_images(file, pictures, options=reader, camera_mode=colmap.CameraMode.SINGLE, image_names=names)
    opened = colmap.Database.open(file)
    for k, flat in enumerate((False, True)):
        first, second, one, other, _, _ = scene(np.random.default_rng(7 + k), 240, flat, kinds=160)
        for name, places, found in ((names[2 * k], first, one), (names[2 * k + 1], second, other)):
            number = opened.read_image_with_name(name).image_id
            opened.write_keypoints(number, places.astype(np.float32))
            whole = found.astype(float)
            data = np.round(512 * whole / np.linalg.norm(whole, axis=1, keepdims=True)).clip(0, 255).astype(np.uint8)
            described = colmap.FeatureDescriptors(type=colmap.FeatureExtractorType.SIFT, data=data)
            opened.write_descriptors(number, described)
    opened.close()
    listed = folder / "pairs.txt"
    listed.write_text("0.png 1.png\n2.png 3.png\n", encoding="utf-8")
    matching, verify, pairing = (
        colmap.FeatureMatchingOptions(),
        colmap.TwoViewGeometryOptions(),
        colmap.ImportedPairingOptions(),
    )
    matching.num_threads, matching.guided_matching, pairing.match_list_path = 1, guided, listed
    verify.ransac.random_seed, verify.ransac.num_threads = 0, 1
    colmap.match_image_pairs(
        file, matching_options=matching, verification_options=verify, pairing_options=pairing, device=colmap.Device.cpu
    )
    return file


def read(colmap, file):
    """Verified matches by pair."""
    opened = colmap.Database.open(file)
    try:
        return {
            pair: {(int(i), int(j)) for i, j in np.asarray(one.inlier_matches).reshape(-1, 2)}
            for pair, one in zip(*opened.read_two_view_geometries(), strict=True)
            if len(one.inlier_matches)
        }
    finally:
        opened.close()
