"""Surface distances on spheres: what the cameras see, and all of it; and what relighting speed counts."""

import numpy as np
import pytest

from benchmarks.meshes import write_ply
from exmesh_graph.errors import GeometryError, NumericsError
from exmesh_graph.evaluate.protocols.nerf_synthetic import full_surface, visible_surface
from exmesh_graph.evaluate.protocols.speed import ply_bytes, relight_fps
from exmesh_graph.geometry.shapes import icosphere
from tests.io.io_scenes import look_at

K = np.array([[[80.0, 0, 32], [0, 80, 32], [0, 0, 1]]] * 6)
AXES = np.concatenate([np.eye(3), -np.eye(3)])
POSES = np.stack([look_at(4 * a, np.zeros(3), np.roll(a, 1)) for a in AXES])


def sphere(radius):
    vertices, faces = icosphere(3)
    return vertices * radius, faces


def test_a_grown_sphere_scores_its_gap_in_thousandths():
    ours, truth = sphere(1.01), sphere(1.0)
    seen = visible_surface(*ours, *truth, K, POSES, (64, 64), samples=4000)
    whole = full_surface(*ours, *truth, samples=4000)
    assert seen.chamfer == pytest.approx(10, rel=0.02)
    assert whole.chamfer == pytest.approx(10, rel=0.02)
    assert 1000 < seen.mesh_points < 4000
    assert seen == visible_surface(*ours, *truth, K, POSES, (64, 64), samples=4000)
    halved = visible_surface(*ours, *truth, K, POSES, (64, 64), unit=2, samples=4000)
    assert halved.chamfer == pytest.approx(seen.chamfer / 2)


def test_what_no_camera_sees_counts_on_the_whole_surface_only():
    outer, inner = sphere(1.0), sphere(0.5)
    both = np.concatenate([outer[0], inner[0]]), np.concatenate([outer[1], inner[1] + len(outer[0])])
    assert visible_surface(*outer, *both, K, POSES, (64, 64), samples=4000).chamfer < 1e-3
    assert full_surface(*outer, *both, samples=4000).chamfer > 20
    # Training cameras in place of the test ones: a bump on the side they do not see would go unnoticed.
    bump = outer[0] * np.where(outer[0][:, :1] < -0.8, 1.1, 1.0)
    all_round = visible_surface(bump, outer[1], *outer, K, POSES, (64, 64), samples=4000).chamfer
    one_side = visible_surface(bump, outer[1], *outer, K[:1], POSES[:1], (64, 64), samples=4000).chamfer
    assert all_round > 1
    assert one_side < 1e-3


def test_cameras_of_another_world_are_refused():
    away = POSES.copy()
    away[:, :3, 3] += 50
    with pytest.raises(GeometryError, match="in one world"):
        visible_surface(*sphere(1), *sphere(1), K, away, (64, 64), samples=100)


def test_relighting_speed_leaves_out_the_first_frame_and_shares_the_update():
    now = [0.0]

    def spend(seconds):
        now[0] += seconds

    def clock():
        return now[0]

    fps = relight_fps(lambda: spend(2.0), lambda i: spend(100.0 if i == 0 else 1.0), 5, clock=clock)
    assert fps == pytest.approx(4 / 6)
    with pytest.raises(NumericsError, match="two views"):
        relight_fps(lambda: None, lambda i: None, 1)


def test_the_size_of_a_ply_is_that_of_the_file(tmp_path):
    vertices, faces = sphere(1)
    write_ply(tmp_path / "a.ply", vertices, faces)
    assert ply_bytes(len(vertices), len(faces)) == (tmp_path / "a.ply").stat().st_size
