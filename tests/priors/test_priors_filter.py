"""What the filters drop from depth maps: against a slow reference, on a wall of known depth, and in init.tsdf."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from exmesh_nodes import init
from prior_scenes import wall

from exmesh_graph.errors import DataError
from exmesh_graph.priors.depth_filter import agreed, filtered, neighbours
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import DepthMaps


def spoiled(share: float = 0.1):
    """The wall's views and depth maps, the truth, and which depths were made wrong by a tenth and more."""
    views, truth = wall(5, 48)
    rng = np.random.default_rng(3)
    wrong = rng.uniform(size=truth.depth.shape) < share
    depth = np.where(wrong, truth.depth * rng.choice([0.8, 0.9, 1.1, 1.2], truth.depth.shape), truth.depth)
    return views, DepthMaps(truth.names, depth.astype(np.float32)), wrong


def votes_slowly(view: int, others, depth: np.ndarray, views, tolerance: float) -> np.ndarray:
    """How many of `others` show the point of each pixel of `view`, pixel by pixel."""
    height, width = depth.shape[1:]
    votes = np.zeros((height, width), int)
    for other in others:
        for row in range(height):
            for column in range(width):
                ray = np.linalg.inv(views.intrinsics[view]) @ [column + 0.5, row + 0.5, 1]
                point = views.camera_to_world[view] @ [*(depth[view, row, column] * ray), 1]
                there = np.linalg.inv(views.camera_to_world[other]) @ point
                x, y, z = views.intrinsics[other] @ there[:3]
                i, j = int(np.floor(y / z)), int(np.floor(x / z))
                if z > 0 and 0 <= i < height and 0 <= j < width:
                    votes[row, column] += abs(depth[other, i, j] - z) < tolerance * z
    return votes


def test_agreement_is_that_of_a_slow_reference() -> None:
    views, depths, _ = spoiled()
    stack = torch.from_numpy(depths.depth).double()
    cameras = torch.from_numpy(views.intrinsics), torch.from_numpy(views.world_to_camera)
    others = np.array([1, 3])
    votes = votes_slowly(2, others, depths.depth.astype(np.float64), views, 0.02)
    for needed in (1, 2):
        kept = agreed(2, others, stack, *cameras, needed, 0.02).numpy()
        assert np.array_equal(kept, np.where(votes >= needed, depths.depth[2], 0))
    assert 0.05 < (votes < 2).mean() < 0.6


def test_what_neighbours_contradict_is_dropped() -> None:
    views, depths, wrong = spoiled()
    kept = filtered(views, depths, agreeing=2, tolerance=0.02).depth > 0
    middle = np.s_[2, 8:-8, 8:-8]
    assert kept[wrong][:].mean() < 0.02
    assert kept[middle][~wrong[middle]].mean() > 0.9
    assert np.array_equal(filtered(views, depths).depth, depths.depth)


def test_grazing_surfaces_are_dropped_by_their_angle() -> None:
    """Each pixel passes or not as the known wall is seen there."""
    views, truth = wall(3, 48)
    normal = np.array([0.25, -0.3, -1.0]) / np.linalg.norm([0.25, -0.3, -1.0])
    rows, columns = np.indices((48, 48)) + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(views.intrinsics[0]).T
    rays = rays @ views.camera_to_world[0, :3, :3].T
    angle = np.degrees(np.arccos(np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1)))[1:-1, 1:-1]
    assert angle.min() < 15
    assert angle.max() > 25
    for limit in (15.0, 20.0, float(np.median(angle)), angle.max() + 1):
        kept = filtered(views, truth, incidence=limit).depth[0, 1:-1, 1:-1] > 0
        sure = np.abs(angle - limit) > 0.05
        assert np.array_equal(kept[sure], (angle < limit)[sure])


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_agreement_has_no_unit(scale: float) -> None:
    views, depths, _ = spoiled()
    poses = views.camera_to_world.copy()
    poses[:, :3, 3] *= scale
    large = filtered(replace(views, camera_to_world=poses), DepthMaps(depths.names, depths.depth * np.float32(scale)),
                     agreeing=2, tolerance=0.02)  # fmt: skip
    same = (large.depth > 0) == (filtered(views, depths, agreeing=2, tolerance=0.02).depth > 0)
    assert same.mean() > 0.999


def test_a_view_with_fewer_neighbours_asks_those_it_has() -> None:
    views, truth = wall(2, 32)
    assert [len(n) for n in neighbours(views.camera_to_world, 8)] == [1, 1]
    assert (filtered(views, truth, agreeing=3, tolerance=0.02).depth > 0).mean() > 0.4


def test_the_node_filters_before_it_fuses() -> None:
    views, depths, _ = spoiled(0.2)
    ctx = FakeContext()
    flat = np.array([0.25, -0.3, -1.0]) / np.linalg.norm([0.25, -0.3, -1.0])
    offset = -0.1 / np.linalg.norm([0.25, -0.3, -1.0])
    errors = []
    for filters in ({}, {"agreeing": 2, "tolerance": 0.02}):
        mesh = init.tsdf(ctx, views, depths, p=init.TsdfParams(resolution=48, masked=False, **filters)).mesh
        errors.append(np.abs(mesh.vertices @ flat - offset).mean())
    assert errors[1] < 0.3 * errors[0]


def test_depth_maps_of_other_views_are_refused() -> None:
    views, depths = wall(3, 16)
    with pytest.raises(DataError, match="not those of the views"):
        filtered(views, DepthMaps(depths.names, depths.depth[:, ::2]), agreeing=1)
