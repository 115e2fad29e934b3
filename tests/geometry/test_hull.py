"""The visual hull against shapes whose silhouettes are known exactly."""

from pathlib import Path

import numpy as np
import pytest

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.geometry.adjacency import signed_volume
from exmesh_graph.geometry.clean import taubin
from exmesh_graph.geometry.close_ups import close_ups, cuts_off
from exmesh_graph.geometry.hull import (
    Grid,
    SilhouetteField,
    shown_resolution,
    silhouette_distance,
    surface,
    visual_hull,
)
from exmesh_graph.geometry.soundness import inspect
from exmesh_graph.gpu.cores import cores

SAMPLE = Path(__file__).parents[2] / "graphs" / "samples" / "spot"


def camera(eye, size, fov=0.6):
    """(K, world-to-camera) looking at the origin, x right, y down."""
    z = -eye / np.linalg.norm(eye)
    x = np.cross(z, [0.0, 1, 0] if abs(z[1]) < 0.9 else [1.0, 0, 0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z])
    pose[:3, 3] = -pose[:3, :3] @ eye
    f = 0.5 * size / np.tan(fov / 2)
    return np.array([[f, 0, size / 2], [0, f, size / 2], [0, 0, 1]]), pose


def sphere_masks(count, size, radius, seed=0, samples=4):
    """alpha [N, H, W] by supersampling, K, world-to-camera of a sphere at the origin seen from all around."""
    i = np.arange(count) + 0.5
    y, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    eyes = 4 * np.stack([np.cos(turn) * np.sqrt(1 - y * y), y, np.sin(turn) * np.sqrt(1 - y * y)], axis=1)
    ks, poses, masks = [], [], []
    for eye in eyes:
        k, pose = camera(eye, size)
        steps = (np.arange(size * samples) + 0.5) / samples
        px, py = np.meshgrid(steps, steps)
        d = np.stack([px, py, np.ones_like(px)], axis=-1) @ np.linalg.inv(k).T @ pose[:3, :3]
        b, c = 2 * (d @ eye), eye @ eye - radius**2
        hit = b * b - 4 * (d * d).sum(-1) * c > 0
        masks.append(hit.reshape(size, samples, size, samples).mean((1, 3)))
        ks.append(k)
        poses.append(pose)
    return np.stack(masks).astype(np.float32), np.stack(ks), np.stack(poses)


def test_silhouette_distance_of_a_disc():
    size, radius = 64, 20.3
    x, y = np.meshgrid(np.arange(size) + 0.5 - 31.7, np.arange(size) + 0.5 - 32.4)
    r = np.hypot(x, y)
    alpha = np.clip(radius - r + 0.5, 0, 1)
    error = silhouette_distance(alpha) - (radius - r)
    assert np.abs(error).max() < 0.75
    rim = np.abs(radius - r) < 0.45
    assert np.abs(error[rim]).max() < 1e-6


def test_silhouette_distance_of_full_and_empty_masks():
    assert (silhouette_distance(np.ones((4, 4))) > 4).all()
    assert (silhouette_distance(np.zeros((4, 4))) < -4).all()


@pytest.mark.thorough
@pytest.mark.parametrize("radius", [0.35, 0.9])
def test_sphere(radius):
    field = SilhouetteField.from_masks(*sphere_masks(30, 96, radius))
    vertices, faces = visual_hull(field, resolution=64)
    r = np.linalg.norm(vertices, axis=1)
    pixel = 4 * 2 * np.tan(0.3) / 96
    assert r.min() > radius - 0.35 * pixel  # never cuts into the object by more than the masks' own accuracy
    assert np.median(r) < radius + 0.5 * pixel
    found = inspect(vertices, faces)
    assert found.closed
    assert found.turned_edges == found.pinched_vertices == found.flat_faces == found.duplicate_faces == 0
    assert signed_volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.08)
    assert len(vertices) - 3 * len(faces) // 2 + len(faces) == 2


def test_band_gives_the_same_surface_as_evaluating_every_point():
    field = SilhouetteField.from_masks(*sphere_masks(12, 64, 0.6))
    vertices, _ = visual_hull(field, resolution=48)
    assert np.abs(field(vertices)).max() < 0.01
    grid = Grid.over(np.full(3, -1.05), np.full(3, 1.05), 70)
    full, _ = surface(field(grid.points()).reshape(grid.shape), grid)
    for axis in range(3):
        assert full[:, axis].min() == pytest.approx(vertices[:, axis].min(), abs=0.01)
        assert full[:, axis].max() == pytest.approx(vertices[:, axis].max(), abs=0.01)


@pytest.mark.thorough
@pytest.mark.parametrize("wrong_masks", [0, 1, 3, 8])
@pytest.mark.parametrize("size", [48, 1])
def test_the_kernel_gives_what_numpy_gives(wrong_masks, size):
    """Points in and out of the pictures, on a camera's plane and behind cameras; pictures of one pixel too."""
    alpha, intrinsics, poses = sphere_masks(9, size, 0.6)
    alpha = alpha if size > 1 else np.ones_like(alpha)
    field = SilhouetteField.from_masks(alpha, intrinsics, poses, wrong_masks=wrong_masks)
    points = np.random.default_rng(0).uniform(-1, 1, (50000, 3)) * np.repeat([1, 20], 25000)[:, None]
    points[0] = np.linalg.inv(poses[0])[:3, 3]
    plain = field.plain(points)
    with cores(1):
        values = field(points)
    finite = np.isfinite(plain)
    assert 0.5 < finite.mean() <= 1
    assert values[finite] == pytest.approx(plain[finite], rel=2e-4, abs=2e-5)
    assert (values[~finite] == plain[~finite]).all()
    for count in (2, 3):
        with cores(count):
            assert np.array_equal(field(points), values, equal_nan=True)
    floored = field(points, floor=-0.05)
    above = plain >= -0.049
    assert np.array_equal(floored[above], values[above])
    assert (floored[plain < -0.051] < -0.049).all()


def test_field_is_the_lowest_vote_in_world_units():
    """Reference: one point and one view at a time, straight from the definition."""
    alpha, k, pose = sphere_masks(5, 48, 0.6)
    points = np.random.default_rng(1).uniform(-0.9, 0.9, (80, 3))
    for wrong_masks in (0, 1, 2):
        field = SilhouetteField.from_masks(alpha, k, pose, wrong_masks=wrong_masks)
        expected = []
        for point in points:
            votes = []
            for view in range(5):
                x, y, z = pose[view, :3, :3] @ point + pose[view, :3, 3]
                u, v = k[view, 0, 0] * x / z + k[view, 0, 2] - 0.5, k[view, 1, 1] * y / z + k[view, 1, 2] - 0.5
                c, r = int(np.floor(u)), int(np.floor(v))
                d = silhouette_distance(alpha[view])[r : r + 2, c : c + 2]
                w = np.outer([1 - (v - r), v - r], [1 - (u - c), u - c])
                votes.append((d * w).sum() * z / k[view, 0, 0])
            expected.append(sorted(votes)[wrong_masks])
        values, expected = field(points), np.array(expected)
        near = expected > -0.2  # a sixth of the silhouette: what lies farther off may be said to be farther still
        assert near.sum() > 20
        assert values[near] == pytest.approx(expected[near], abs=2e-5)
        assert (values <= expected + 2e-5).all()


def test_far_parts_of_a_mask_are_left_out():
    """A small object in a large picture: as many distances as around it, and the same hull."""
    alpha, k, pose = sphere_masks(6, 48, 0.6)
    wide = np.pad(alpha, ((0, 0), (70, 30), (20, 90)))
    moved = k.copy()
    moved[:, 0, 2] += 20
    moved[:, 1, 2] += 70
    near, far = SilhouetteField.from_masks(alpha, k, pose), SilhouetteField.from_masks(wide, moved, pose)
    assert max(far.distances.shape[1:]) < 64
    points = np.random.default_rng(1).uniform(-0.7, 0.7, (200, 3))
    assert far(points) == pytest.approx(near(points), abs=1e-5)


def test_where_an_edge_cuts_the_silhouette_the_object_goes_on():
    alpha, k, pose = sphere_masks(6, 48, 0.6)
    cut = k.copy()
    cut[:, 0, 2] -= 24
    points = np.random.default_rng(2).uniform(-0.3, 0.3, (100, 3))
    assert (SilhouetteField.from_masks(alpha[:, :, 24:], cut, pose)(points) > 0).all()


def test_one_wrong_mask_is_outvoted():
    alpha, k, pose = sphere_masks(20, 64, 0.6)
    alpha[3] = 0
    alpha[3, :8, :8] = 1
    with pytest.raises(DataError, match="no common part"):
        visual_hull(SilhouetteField.from_masks(alpha, k, pose), resolution=32)
    vertices, _ = visual_hull(SilhouetteField.from_masks(alpha, k, pose, wrong_masks=1), resolution=48)
    assert np.median(np.linalg.norm(vertices, axis=1)) == pytest.approx(0.6, abs=0.04)


def test_outside_the_image_the_object_goes_on_only_where_it_touches_the_border():
    alpha = np.zeros((1, 10, 10), np.float32)
    alpha[0, 4:6, 5:] = 1  # touches the right border
    k = np.array([[[10.0, 0, 5], [0, 10, 5], [0, 0, 1]]])
    field = SilhouetteField.from_masks(alpha, k, np.eye(4)[None])
    right, left, below, behind = field(np.array([[0.8, 0, 1], [-0.8, 0, 1], [0, 0.8, 1], [0, 0, -1.0]]))
    assert right > 0
    assert left < -0.3
    assert below < -0.3
    assert np.isinf(behind)


def test_open_cone_is_capped():
    """One view leaves the depth open: the search box closes the hull."""
    alpha, k, pose = sphere_masks(1, 48, 0.4)
    vertices, faces = visual_hull(SilhouetteField.from_masks(alpha, k, pose), resolution=32)
    assert inspect(vertices, faces).closed
    assert np.abs(vertices).max() < 1.3


@pytest.mark.parametrize(("focal", "expected"), [(100, 64), (400, 128), (4000, 192)])
def test_a_voxel_spans_five_quarters_of_a_pixel(focal, expected):
    """1.6 across at a distance of 4: 0.4 f pixels."""
    pose = np.eye(4)
    pose[2, 3] = 4
    intrinsics = np.array([[focal, 0, 2], [0, focal, 2], [0, 0, 1.0]])
    field = SilhouetteField(np.ones((3, 4, 4), np.float32), np.stack([intrinsics] * 3), np.stack([pose] * 3))
    assert shown_resolution(field, np.array([-0.2, -0.8, -0.5]), np.array([0.2, 0.8, 0.5])) == expected


def test_bad_views():
    alpha, k, pose = sphere_masks(3, 32, 0.5)
    with pytest.raises(DataError, match="there are none"):
        SilhouetteField.from_masks(alpha[:0], k[:0], pose[:0])
    alpha[1] = 0.3
    with pytest.raises(DataError, match=r"b: the mask is empty"):
        SilhouetteField.from_masks(alpha, k, pose, names=("a", "b", "c"))
    with pytest.raises(DataError, match="no view to decide"):
        SilhouetteField.from_masks(alpha[:1], k[:1], pose[:1], wrong_masks=1)
    with pytest.raises(GeometryError, match="empty"):
        surface(np.full((4, 4, 4), -1.0), Grid(np.zeros(3), 1.0, (4, 4, 4)))


def test_surface_of_values_that_are_exactly_zero():
    """A plane through grid points: no face without area, still closed."""
    grid = Grid.over(np.full(3, -1.0), np.full(3, 1.0), 8)
    values = np.minimum(0.5 - np.abs(grid.points()).max(1), 0.75).reshape(grid.shape)
    assert (values == 0).any()
    vertices, faces = surface(values, grid)
    found = inspect(vertices, faces)
    assert found.closed
    assert found.duplicate_faces == found.turned_edges == 0


def test_taubin_smooths_without_shrinking():
    field = SilhouetteField.from_masks(*sphere_masks(30, 96, 0.8))
    vertices, faces = visual_hull(field, resolution=40)
    rough = vertices + 0.01 * np.random.default_rng(0).normal(size=vertices.shape).astype(np.float32)
    smooth = taubin(rough, faces, 10)
    spread_of = lambda x: np.linalg.norm(x, axis=1).std()  # noqa: E731
    assert spread_of(smooth) < 0.6 * spread_of(rough)
    assert signed_volume(smooth, faces) == pytest.approx(signed_volume(vertices, faces), rel=0.02)
    assert np.array_equal(taubin(rough, faces, 0), rough)


@pytest.mark.thorough
def test_sample_scene_hull_is_close_to_the_true_mesh():
    from exmesh_graph.evaluate.metrics.mesh import chamfer
    from exmesh_graph.io.blender import load_blender
    from exmesh_graph.io.settings import BlenderOptions

    scene = load_blender(SAMPLE, BlenderOptions())
    views, truth = scene.train, scene.truth
    field = SilhouetteField.from_masks(views.alpha, views.intrinsics, views.world_to_camera)
    vertices, faces = visual_hull(field, resolution=96)
    result = chamfer(taubin(vertices, faces, 10), faces, truth.mesh_vertices, truth.mesh_faces, samples=10_000)
    radius = 1.2 / np.cbrt(np.linalg.det(scene.frame.scene_from_normalised[:3, :3]))
    assert result.chamfer / radius < 2.2e-3


def _two_balls(count, size, close):
    """As `sphere_masks`, of balls at x = -0.7 and 0.7; views after the first `close` are pictures of one of them, in
    whose middle it stands, so that the other lies beyond an edge or is cut by it."""
    i = np.arange(count) + 0.5
    y, turn = 0.8 - 1.6 * i / count, np.pi * (1 + 5**0.5) * i
    eyes = 4 * np.stack([np.cos(turn) * np.sqrt(1 - y * y), y, np.sin(turn) * np.sqrt(1 - y * y)], axis=1)
    ks, poses, masks = [], [], []
    for number, eye in enumerate(eyes):
        k, pose = camera(eye, size)
        if number >= close:
            k[[0, 1], [0, 1]] *= 2.5
            at = k @ (pose[:3] @ [0.7 - 1.4 * (number % 2), 0, 0, 1])
            k[:2, 2] += 0.5 * size - at[:2] / at[2] + [0.2 * size, 0]
        px, py = np.meshgrid(*[(np.arange(size * 4) + 0.5) / 4] * 2)
        d = np.stack([px, py, np.ones_like(px)], axis=-1) @ np.linalg.inv(k).T @ pose[:3, :3]
        hit = np.zeros(px.shape, bool)
        for middle in (-0.7, 0.7):
            to = eye - [middle, 0, 0]
            hit |= (2 * (d @ to)) ** 2 - 4 * (d * d).sum(-1) * (to @ to - 0.45**2) > 0
        masks.append(hit.reshape(size, 4, size, 4).mean((1, 3)))
        ks.append(k)
        poses.append(pose)
    return np.stack(masks).astype(np.float32), np.stack(ks), np.stack(poses)


def test_close_ups_say_nothing_of_what_lies_beyond_their_edges():
    masks, ks, poses = _two_balls(24, 64, 8)
    crossed = np.array([cuts_off(mask >= 0.5) for mask in masks])
    assert not crossed[:8].any()
    assert crossed[8:].mean() > 0.5
    whole, both = (SilhouetteField.from_masks(masks[:n], ks[:n], poses[:n]) for n in (8, 24))
    middles = np.array([[-0.7, 0, 0], [0.7, 0, 0]])
    assert (both(middles) > 0.3).all()
    np.testing.assert_allclose(both(middles), both.plain(middles), atol=1e-5)
    # they say more of what they show, and take nothing away: both balls are there, nearer to their size
    volume = 2 * 4 / 3 * np.pi * 0.45**3
    found = [signed_volume(*visual_hull(field, resolution=64)) / volume for field in (whole, both)]
    assert 0.98 < found[1] < found[0]
    inside = 0.97 * 0.45 * np.random.default_rng(0).normal(size=(400, 3))
    inside /= np.maximum(np.linalg.norm(inside, axis=1, keepdims=True) / (0.97 * 0.45), 1)
    assert (both(np.concatenate([inside + middle for middle in middles])) > -0.01).all()


def test_where_no_view_is_whole_what_lies_beyond_an_edge_is_bounded_as_before():
    masks, _, _ = _two_balls(24, 64, 8)
    cut = np.array([cuts_off(mask >= 0.5) for mask in masks])
    assert close_ups(cut).sum() == cut.sum() > 3
    few = np.array([True, True, False, False, True])
    assert not close_ups(few).any()
    assert close_ups(np.append(few, False)).tolist() == [True, True, False, False, True, False]
