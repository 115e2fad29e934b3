"""DTU's protocol on planes whose distance is known, with the mistakes that papers have made."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.meshes import write_ply
from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.evaluate.protocols.dtu import DtuTruth, cull, dtu_chamfer, points_of_mesh, read_truth, thin

PLANE = np.array([[0.0, 0, 0], [30, 0, 0], [30, 30, 0], [0, 30, 0]])
TWO = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
OFFSET = np.array([0.0, 0, 1.5])


@pytest.fixture(scope="module")
def truth():
    """A 30 mm square at z = 0, scanned at 0.25 mm; seen where x < 20; everything above the table at z = -5."""
    x, y = np.meshgrid(np.arange(0, 30, 0.25), np.arange(0, 30, 0.25))
    observed = np.zeros((17, 17, 17), bool)
    observed[:11] = True  # voxels of 2 mm, the box from -1: x up to 20
    return DtuTruth(
        np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1), observed, np.array([[-1.0, -1, -16], [31, 31, 16]]), 2.0,
        np.array([0.0, 0, 1, 5]),
    )  # fmt: skip


def test_a_shifted_plane_scores_its_shift_within_a_tenth_of_a_millimetre(truth):
    found = dtu_chamfer(PLANE + OFFSET, TWO, truth)
    assert found.d2s == pytest.approx(1.5, abs=0.02)
    assert found.s2d == pytest.approx(1.5, abs=0.02)
    assert found.chamfer == pytest.approx((found.d2s + found.s2d) / 2)
    assert found.scan_points == len(truth.points)
    assert 5000 < found.mesh_points < 30 * 20 / (np.pi * 0.1**2)  # no two closer than 0.2 mm
    assert dtu_chamfer(PLANE + OFFSET, TWO, truth) == found
    other = dtu_chamfer(PLANE + OFFSET, TWO, truth, seed=1)
    assert other != found
    assert other.chamfer == pytest.approx(found.chamfer, abs=5e-3)


def test_what_is_not_observed_counts_one_way_only(truth):
    # The square at 20 < x < 30 lifted by 6 mm: the mask hides it from d2s, but the scan below it looks for it in s2d.
    ends = np.concatenate([PLANE * [2 / 3, 1, 1], PLANE * [1 / 3, 1, 1] + [20, 0, 6]])
    found = dtu_chamfer(ends, np.concatenate([TWO, TWO + 4]), truth)
    assert found.d2s < 0.12
    assert found.s2d > 1
    every = DtuTruth(truth.points, np.ones_like(truth.observed), truth.box, truth.voxel, truth.plane)
    assert dtu_chamfer(ends, np.concatenate([TWO, TWO + 4]), every).d2s > 1


def test_points_below_the_table_and_distances_over_20_mm_are_left_out(truth):
    under = np.concatenate([truth.points, truth.points[::9] - [0, 0, 8]])
    more = DtuTruth(under, truth.observed, truth.box, truth.voxel, truth.plane)
    assert dtu_chamfer(PLANE, TWO, more).scan_points == len(truth.points)
    far = np.concatenate([PLANE, PLANE * 0.2 + [0, 0, 22]])
    tall = DtuTruth(
        truth.points, truth.observed.repeat(3, 2), truth.box + np.array([[0, 0, 0], [0, 0, 64]]), 2.0, truth.plane
    )
    with_far = dtu_chamfer(far, np.concatenate([TWO, TWO + 4]), tall)
    assert with_far.d2s == pytest.approx(dtu_chamfer(PLANE, TWO, tall).d2s, abs=5e-3)


def test_a_mesh_in_other_units_is_refused(truth):
    with pytest.raises(GeometryError, match="millimetres in DTU's world") as caught:
        dtu_chamfer(PLANE / 300 - 40, TWO, truth)
    assert "scale_mat_0" in str(caught.value)


def test_culling_takes_what_lies_outside_a_dilated_mask_and_keeps_what_a_view_does_not_see():
    mask = np.zeros((40, 60))
    mask[15:25, 20:30] = 1
    camera = np.array([[10.0, 0, 30, 0], [0, 10, 20, 0], [0, 0, 1, 0]])  # x, y at z = 1 to pixels
    columns = np.array([25.0, 37, 39, 75])  # in the mask; 8 and 10 pixels right of it; outside the picture
    points = np.stack([(columns - 30) / 10, np.zeros(4), np.ones(4)], 1)
    faces = np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3], [0, 1, 2]], np.int32)
    kept = cull(points, faces, mask[None], camera[None], radius=9)
    assert kept.tolist() == [[0, 0, 0], [1, 1, 1], [3, 3, 3]]
    assert [2, 2, 2] in cull(points, faces, mask[None], camera[None], radius=24).tolist()
    both = np.stack([mask, np.zeros_like(mask)])  # a second view whose mask is empty takes all it sees
    assert cull(points, faces, both, np.stack([camera, camera])).tolist() == [[3, 3, 3]]
    with pytest.raises(GeometryError, match="no face"):
        cull(points[:3], faces[:1], both[1:], camera[None])


def test_the_grid_covers_a_face_evenly_whatever_its_slant():
    for corner in ([0, 10, 0], [9, 10, 0], [4, 10, 3]):
        triangle = np.array([[0.0, 0, 0], [10, 0, 0], corner])
        points = points_of_mesh(triangle, np.array([[0, 1, 2]]), 0.2)
        area = np.linalg.norm(np.cross(triangle[1], triangle[2])) / 2
        assert len(points) == pytest.approx(area / 0.2**2, rel=0.06)
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert len(points_of_mesh(flat, np.array([[0, 1, 2]]), 0.2)) == 3


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 400), st.sampled_from([7, 50, 1000]))
def test_thinning_equals_one_point_after_another(seed, count, chunk):
    points = np.random.default_rng(seed).uniform(0, 1, (count, 3))
    kept: list[np.ndarray] = []
    for point in points[np.random.default_rng(seed).permutation(count)]:
        if all(np.linalg.norm(point - other) > 0.2 for other in kept):
            kept.append(point)
    np.testing.assert_array_equal(thin(points, 0.2, seed, chunk), np.array(kept))


def test_the_published_files_are_read_and_a_missing_one_is_named(tmp_path, truth):
    from scipy.io import savemat

    with pytest.raises(DataError, match="evaluation data does not exist") as caught:
        read_truth(tmp_path, 24)
    assert caught.value.where.endswith("stl024_total.ply")
    (tmp_path / "Points" / "stl").mkdir(parents=True)
    (tmp_path / "ObsMask").mkdir()
    write_ply(tmp_path / "Points" / "stl" / "stl024_total.ply", truth.points, np.zeros((0, 3), np.int32))
    mask = {"ObsMask": truth.observed.astype(np.uint8), "BB": truth.box, "Res": np.array([[truth.voxel]])}
    savemat(tmp_path / "ObsMask" / "ObsMask24_10.mat", mask)
    savemat(tmp_path / "ObsMask" / "Plane24.mat", {"P": truth.plane[:, None]})
    read = read_truth(tmp_path, 24)
    np.testing.assert_array_equal(read.observed, truth.observed)
    np.testing.assert_allclose(read.points, truth.points)
    assert read.voxel == 2.0
    savemat(tmp_path / "ObsMask" / "Plane24.mat", {"Q": truth.plane[:, None]})
    with pytest.raises(DataError, match="'P'"):
        read_truth(tmp_path, 24)
