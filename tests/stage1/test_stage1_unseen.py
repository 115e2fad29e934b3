"""What no photograph shows keeps its shape."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from exmesh_graph.stage1 import refine
from exmesh_graph.stage1.render import draw, surface_of
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.unseen import followed, unseen
from exmesh_graph.targets import prepare_targets
from exmesh_graph.testing import carrier, look_at, state, views
from exmesh_graph.types.edges import edges_of


@pytest.fixture(scope="module")
def from_above():
    """A ball, and pictures of it none of which shows its lower side."""
    ball = state()
    seen = views(ball, count=6)
    poses = np.stack([look_at([np.sin(k), 2.0, np.cos(k)]) for k in range(6)])
    return ball, replace(seen, camera_to_world=poses)


def drawn(ball, seen):
    """Linear colour over black and coverage float32 [N, H, W, 4]."""
    found = []
    for k in range(len(seen)):
        camera = torch.from_numpy(seen.intrinsics[k]), torch.from_numpy(seen.world_to_camera[k])
        picture = draw(surface_of(ball), *camera, seen.height, seen.width)
        found.append(torch.cat([picture.colour**2.2, picture.alpha[..., None]], -1).detach().numpy())
    return np.clip(np.stack(found), 0, 1).astype(np.float32)


def patch(side=12):
    """A flat square of even triangles, corners in order, and its edges."""
    rows, columns = np.indices((side, side))
    vertices = np.stack([columns, np.zeros_like(rows), rows], -1).reshape(-1, 3).astype(np.float32)
    corner = (rows * side + columns)[:-1, :-1].reshape(-1)
    faces = np.concatenate([np.stack([corner, corner + side, corner + 1], 1),
                            np.stack([corner + 1, corner + side, corner + side + 1], 1)])  # fmt: skip
    return vertices, edges_of(faces.astype(np.int32)).vertices


def test_vertices_of_faces_that_no_view_shows_are_found(from_above):
    ball, seen = from_above
    hidden = unseen(surface_of(ball), prepare_targets(seen)).numpy()
    height = np.asarray(ball.vertices)[:, 1]
    assert hidden[height < -0.45].all()
    assert not hidden[height > 0].any()


def test_one_view_alone_still_moves_what_it_shows(from_above):
    ball, seen = from_above
    hidden = unseen(surface_of(ball), prepare_targets(seen.subset([0]))).numpy()
    assert not hidden[np.asarray(ball.vertices)[:, 1] > 0.45].any()
    assert hidden[np.asarray(ball.vertices)[:, 1] < -0.45].all()


@pytest.mark.parametrize("move", ["shift", "turn", "stretch"])
def test_what_is_held_follows_its_surroundings(move):
    """A shift, a turn and a stretch of the rim are those of the whole: U of a linear map is 0 on even triangles."""
    vertices, edges = patch()
    held = ((vertices[:, [0, 2]] > 2.5) & (vertices[:, [0, 2]] < 8.5)).all(axis=1)
    maps = {
        "shift": np.eye(3),
        "turn": np.array([[1, 0.2, 0], [-0.2, 1, 0], [0, 0, 1.0]]),
        "stretch": np.diag([1.3, 1, 0.8]),
    }
    whole = (vertices @ maps[move].T + [0.1, 0.4, -0.2]).astype(np.float32)
    moved = np.where(held[:, None], vertices, whole)
    np.testing.assert_allclose(followed(moved, vertices, held, edges), whole, atol=1e-4)


def test_what_follows_moves_as_its_neighbours_do_and_no_further():
    """Against dense elimination, with a rim that moves at random."""
    vertices, edges = patch(8)
    held = ((vertices[:, [0, 2]] > 1.5) & (vertices[:, [0, 2]] < 5.5)).all(axis=1)
    shift = np.where(held[:, None], 0, np.random.default_rng(1).normal(0, 0.3, vertices.shape))
    graph = np.zeros((len(vertices), len(vertices)))
    graph[edges[:, 0], edges[:, 1]] = graph[edges[:, 1], edges[:, 0]] = 1
    mean = graph / graph.sum(1, keepdims=True)
    inner = np.eye(int(held.sum())) - mean[held][:, held]
    expected = np.linalg.solve(inner, mean[held][:, ~held] @ shift[~held])
    found = followed((vertices + shift).astype(np.float32), vertices, held, edges) - vertices
    np.testing.assert_allclose(found[held], expected, atol=1e-5)
    np.testing.assert_allclose(found[~held], shift[~held], atol=1e-6)
    assert (np.abs(found[held]).max(0) <= np.abs(shift[~held]).max(0)).all()


def test_a_part_without_seen_surroundings_stays():
    vertices, edges = patch(6)
    apart = np.concatenate([vertices, vertices + 20])
    both = np.concatenate([edges, edges + len(vertices)])
    held = np.arange(len(apart)) >= len(vertices)
    moved = apart.copy()
    moved[~held] += 1
    np.testing.assert_allclose(followed(moved, apart, held, both)[held], apart[held], atol=1e-5)


def test_smoothness_alone_bends_nothing():
    """A ball without its lower third: the flat side that no view shows stays flat; without holding it, it bends."""
    ball = state(carrier(rings=16, sectors=24))
    squashed = np.array(ball.vertices)
    squashed[:, 1] = np.maximum(squashed[:, 1], -0.25)
    start = replace(ball, vertices=squashed.astype(np.float32))
    poses = np.stack([look_at([np.sin(k), 2.0, np.cos(k)]) for k in range(6)])
    seen = replace(views(start, count=6), camera_to_world=poses)
    seen = replace(seen, images=drawn(start, seen)[..., :3], alpha=drawn(start, seen)[..., 3])
    flat = unseen(surface_of(start), prepare_targets(seen)).numpy() & (squashed[:, 1] == np.float32(-0.25))
    assert flat.sum() > 10
    bent = {}
    for hold in (True, False):
        new, _ = refine.refine(start, seen, RefineSettings(iterations=60, total_iterations=120, hold_unseen=hold))
        x, y, z = new.vertices[flat].T.astype(float)
        plane = np.column_stack([x, z, np.ones(len(x))])
        bent[hold] = np.abs(y - plane @ np.linalg.lstsq(plane, y, rcond=None)[0]).mean()
        assert np.abs(new.vertices - start.vertices)[~flat].max() > 1e-3
    assert bent[True] < 0.6 * bent[False], bent
