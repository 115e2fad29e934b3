"""The object by what it hides of the table: a ball that no depth is known of."""

from dataclasses import replace

import numpy as np
import pytest

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.masks.agreement import overlap
from exmesh_graph.masks.drawn import drawn_outlines
from exmesh_graph.masks.ground import object_on_ground
from exmesh_graph.masks.plane import Plane
from exmesh_graph.testing import depth_maps, look_at
from exmesh_graph.types import Mesh, Views

FLOOR, RADIUS, SIZE = -0.3, 0.3, 64
TABLE = Plane(np.array([0.0, 1.0, 0.0]), FLOOR, 0.5, 0.1)


@pytest.fixture(scope="module")
def standing_ball():
    """Sixteen views of a ball on a square, the square's depth where no ball is before it, and the ball's outlines."""
    turns = 2 * np.pi * np.arange(16) / 16
    high = np.where(np.arange(16) % 2, 1.2, 2.0)
    eyes = 2.4 * np.stack([np.sin(turns), high / 2, np.cos(turns)], axis=1)
    k = np.repeat(np.array([[[1.4 * SIZE, 0, SIZE / 2], [0, 1.4 * SIZE, SIZE / 2], [0, 0, 1]]]), 16, axis=0)
    blank = np.ones((16, SIZE, SIZE), np.float32)
    views = Views(tuple(f"v{i}" for i in range(16)), np.repeat(blank[..., None], 3, -1), blank, k,
                  np.stack([look_at(eye) for eye in eyes]), "train", has_masks=False)  # fmt: skip
    square = np.array([[-3, FLOOR, -3], [3, FLOOR, -3], [3, FLOOR, 3], [-3, FLOOR, 3]], np.float32)
    ground = Mesh(square, np.array([[0, 2, 1], [0, 3, 2]], np.int32))
    ball = icosphere(3, RADIUS)
    shown = drawn_outlines(*ball, views)
    depths = depth_maps(ground, views)
    return views, replace(depths, depth=np.where(shown, np.float32(0), depths.depth)), shown


def closer(pose):
    return np.block([[pose[:3, :3], 0.5 * pose[:3, 3:]], [pose[3:]]])


@pytest.mark.parametrize("mirrored", [False, True])
def test_what_hides_the_table_is_the_object(standing_ball, mirrored):
    """Also where stereo gives the object the depth of what it mirrors, far behind its surface."""
    views, depths, shown = standing_ball
    if mirrored:
        behind = np.linalg.norm(views.camera_to_world[:, :3, 3], axis=1)[:, None, None]
        depths = replace(depths, depth=np.where(shown, behind, depths.depth).astype(np.float32))
    rng = np.random.default_rng(0)  # a hundredth of the table has no depth, and one view sees a fold in the table
    holes = np.where(rng.random(shown.shape) < 0.01, np.float32(0), depths.depth)
    holes[3, :, : SIZE // 2] = np.where(shown[3, :, : SIZE // 2], holes[3, :, : SIZE // 2], 0)
    found = object_on_ground(views, replace(depths, depth=holes), TABLE, 0.03, 0.05)
    assert np.median(overlap(drawn_outlines(found.vertices, found.faces, views), shown)) > 0.85
    assert found.vertices[:, 1].min() > FLOOR - 0.02
    assert found.removed
    assert found.apart > 0.95
    near = replace(views, camera_to_world=np.stack([closer(pose) for pose in views.camera_to_world]))
    with_ball = object_on_ground(near, replace(depths, depth=0 * depths.depth), TABLE, 0.03, 0.05)
    assert with_ball.apart < 0.5  # what fills all pictures goes on beyond them


def test_a_base_is_no_table_and_a_bare_table_bears_nothing(standing_ball):
    views, depths, _ = standing_ball
    with pytest.raises(GeometryError, match="does not go on"):
        object_on_ground(views, depths, replace(TABLE, under=0.95), 0.03, 0.05)
    whole = depth_maps(Mesh(np.array([[-3, FLOOR, -3], [3, FLOOR, -3], [0, FLOOR, 5]], np.float32),
                            np.array([[0, 2, 1]], np.int32)), views)  # fmt: skip
    with pytest.raises(GeometryError, match="0 views show something"):
        object_on_ground(views, whole, TABLE, 0.03, 0.05)
