"""PatchMatch stereo: the kernels against plain references, the same bytes on any cores, and depth of known walls."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from exmesh_nodes import prior
from pydantic import ValidationError

from exmesh_graph.errors import DataError
from exmesh_graph.gpu.cores import cores
from exmesh_graph.priors.patch_match.agree import agreed_planes, normals_of
from exmesh_graph.priors.patch_match.estimate import patch_match, pyramid
from exmesh_graph.priors.patch_match.layout import level_of, planes_of, state_of
from exmesh_graph.priors.patch_match.propagate import Comparison, iterate
from exmesh_graph.priors.patch_match.reference import Scene, agreement, half_iteration, plane_cost
from exmesh_graph.priors.patch_match.sources import choose_sources, scene_samples, search_bounds, transfers
from exmesh_graph.priors.patch_match.start import begin_at_points, enlarged, finer
from exmesh_graph.priors.settings import PatchMatchSettings
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import PointCloud
from tests.priors.prior_scenes import wall

SMALL = PatchMatchSettings(sources=3, best=2, step=1)


def compared(size=(16, 19), weight=0.0, seed=0, flat=False, radius=2, step=1):
    """Grey pictures with masks, flat parts and a border nearby, planes of all tilts, and what the kernel takes."""
    views, _ = wall(count=4, size=26)
    random = np.random.default_rng(seed)
    height, width = size
    base = random.integers(0, 256, (4, height, width)).astype(float)
    smooth = (base + np.roll(base, 1, 1) + np.roll(base, 1, 2) + np.roll(base, (1, 1), (1, 2))) / 4
    grey = np.round(smooth)
    grey[:, 4:12, 3:12] = 90  # flat
    if flat:
        grey[:] = 90
    inside = random.random(grey.shape) > 0.1
    inside[:, :, -3:] = False
    chosen = np.array([[1, 2, -1], [0, 2, 3], [3, 1, 0], [2, -1, -1]], np.int32)
    matrices = transfers(views.intrinsics, views.world_to_camera, chosen)
    bounds = search_bounds(views.intrinsics, views.world_to_camera, chosen, matrices)
    w = random.uniform(0.24, 0.8, grey.shape)
    slopes = random.normal(size=(2, *grey.shape)) * random.choice([0.2, 1.0, 6.0], grey.shape) * w / 44  # 6: grazing
    planes = np.stack([w, *slopes, np.full_like(w, 2.0)], axis=1).astype(np.float32)
    found = planes[:, :3] * inside[:, None]
    scene = Scene(grey, inside, matrices, chosen, bounds, 2, radius, step, found, weight)
    comparison = Comparison(*(torch.from_numpy(a) for a in (matrices, chosen, bounds)), 2, radius, step, 0)
    level = level_of(torch.from_numpy(grey / 255).float(), torch.from_numpy(inside))
    return scene, comparison, level, planes


@pytest.mark.thorough
@pytest.mark.parametrize("case", [{}, {"weight": 0.3}, {"flat": True}, {"radius": 3, "step": 2, "seed": 5}])
def test_the_cost_of_a_plane_is_that_of_the_reference(case):
    """Beyond the border, outside masks, flat windows, grazing planes and views without a source are among them."""
    scene, comparison, level, planes = compared(**case)
    bounds = comparison.bounds.clone()
    bounds[:, 0], bounds[:, 1] = 2.0, 1.0  # no plane may be taken: only the costs of those at hand are found
    state = state_of(torch.from_numpy(planes), level.inside)
    iterate(level, state, replace(comparison, bounds=bounds), turn=0, sizes=(-1, 0), weight=scene.weight, refresh=True)
    made = planes_of(state, level.width).numpy()
    wanted = {
        (v, r, c): plane_cost(scene, v, c, r, planes[v, :3, r, c]) for v, r, c in np.argwhere(scene.inside).tolist()
    }
    off = np.array([abs(made[v, 3, r, c] - cost) for (v, r, c), cost in wanted.items()])
    assert np.quantile(off, 0.995) < 2e-3  # a point on a mask's edge may fall on either side of it
    assert np.median(off) < 1e-5
    refuted = 2 + 3 * scene.weight
    costs = np.array(list(wanted.values()))
    assert (costs > 0.99 * refuted).any() or case.get("flat")
    assert ((costs > 0.5) & (costs < 1.5)).sum() > 100
    assert np.array_equal(made[:, :3][:, :, scene.inside.any(0)] != 0, planes[:, :3][:, :, scene.inside.any(0)] != 0)
    assert (made[:, 3][~scene.inside] > 1e8).all()


@pytest.mark.thorough
@pytest.mark.parametrize("weight", [0.0, 0.3])
def test_half_an_iteration_is_that_of_the_reference(weight):
    scene, comparison, level, planes = compared(weight=weight)
    for v, r, c in np.argwhere(scene.inside):
        planes[v, 3, r, c] = plane_cost(scene, v, c, r, planes[v, :3, r, c])
    state = state_of(torch.from_numpy(planes), level.inside)
    iterate(level, state, comparison, turn=0, sizes=(-1, 0), weight=weight)
    made = planes_of(state, level.width).numpy()
    red = half_iteration(scene, planes, 0)
    both = half_iteration(scene, red, 1)
    inside = scene.inside
    same = np.isclose(made[:, 3], both[:, 3], atol=2e-3)[inside]
    assert same.mean() > 0.995
    assert np.isclose(made, both, rtol=1e-3, atol=1e-4).all(axis=1)[inside].mean() > 0.98
    assert (both[:, 3] < planes[:, 3])[inside].mean() > 0.5  # most took a better plane
    assert (made[:, 3] <= planes[:, 3] + 2e-3)[inside].all()


def test_agreement_is_that_of_the_reference():
    views, truth = wall(count=4, size=24)
    random = np.random.default_rng(0)
    chosen = choose_sources(views.intrinsics, views.camera_to_world, 24, 24, 3)
    matrices = transfers(views.intrinsics, views.world_to_camera, chosen)
    w = 1 / truth.depth * (1 + random.choice([0, 0.004, 0.3], truth.depth.shape))  # right, nearly so, and wrong
    down, across = np.gradient(1 / truth.depth, axis=(1, 2))
    planes = np.stack([w, across, down], axis=1).astype(np.float32)
    planes[:, 0, :3] = 0
    normals = normals_of(torch.from_numpy(planes), torch.from_numpy(views.intrinsics))
    world = torch.einsum("nhwj,njk->nhwk", normals, torch.from_numpy(views.world_to_camera[:, :3, :3]).float())
    kept, votes = agreed_planes(
        torch.from_numpy(planes), world.contiguous(), torch.from_numpy(matrices), torch.from_numpy(chosen),
        needed=2, tolerance=0.01,
    )  # fmt: skip
    differ = 0
    for view, row, column in np.ndindex(4, 24, 24):
        values = agreement(planes, world.numpy(), matrices, chosen, view, column, row, tolerance=0.01)
        own = float(planes[view, 0, row, column])
        want = np.mean([own, *values]) if own > 0 and len(values) >= min(2, (chosen[view] >= 0).sum()) else 0.0
        differ += len(values) != int(votes[view, row, column]) or abs(want - float(kept[view, row, column])) > 1e-6
    assert differ <= 4  # points on the line between two pixels
    assert 200 < (kept > 0).sum() < 1800
    # the plane of the wall: its normal, in the world, at every pixel
    want = np.array([0.25, -0.3, -1.0]) / np.linalg.norm([0.25, -0.3, -1.0])
    cosine = np.abs(world.numpy()[:, 4:-2, 2:-2] @ want)
    assert np.median(cosine) > 0.98


def test_any_number_of_cores_gives_the_same_bytes():
    views, _ = wall(count=4, size=50)
    results = []
    for count in (1, 2, 3):
        with cores(count):
            made = patch_match(views, SMALL)
        results.append((made.depths.depth.tobytes(), made.normals.tobytes(), made.confidence.tobytes()))
    assert results[0] == results[1] == results[2]
    assert patch_match(views, SMALL, seed=1).depths.depth.tobytes() != results[0][0]


@pytest.mark.parametrize("step", [1, 2])
def test_depth_of_a_painted_wall(step):
    views, truth = wall(size=96)
    steps = []
    made = patch_match(views, SMALL.replaced(step=step), progress=lambda *at: steps.append(at))
    found = made.depths.depth > 0
    error = np.abs(made.depths.depth - truth.depth)[found] / truth.depth[found]
    assert found.mean() > 0.7
    assert np.median(error) < 0.0015
    assert np.quantile(error, 0.95) < 0.01
    assert made.depths.names == views.names
    assert steps[-1][0] == steps[-1][1] == len(steps)
    assert (made.confidence[~found] == 0).all()
    assert np.median(made.confidence[found]) > 0.9
    assert made.normals.shape == (5, 96, 96, 3)
    wanted = views.world_to_camera[:, :3, :3] @ (np.array([0.25, -0.3, -1.0]) / np.linalg.norm([0.25, -0.3, -1.0]))
    for one, normal, there in zip(made.normals, wanted, found, strict=True):
        assert np.degrees(np.arccos(np.clip(one[there] @ normal, -1, 1))).mean() < 12


def test_where_nothing_is_painted_little_is_claimed_and_nothing_far_off():
    views, truth = wall(size=96, flat_half=True)
    depths = patch_match(views, SMALL.replaced(min_score=0.5)).depths.depth
    found = depths > 0
    assert 0.2 < found.mean() < 0.75
    assert np.quantile(np.abs(depths - truth.depth)[found], 0.95) < 0.05


def test_reduced_pictures_masks_and_points():
    views, truth = wall(size=97)
    alpha = np.ones_like(views.alpha)
    alpha[:, :, :30] = 0
    alpha[0] = 1  # a view without a mask
    masked = replace(views, alpha=alpha, has_masks=True)
    depths = patch_match(masked, SMALL.replaced(side=48)).depths.depth  # a third
    assert depths.shape == (5, 97, 97)
    assert (depths[1:, :, :30] == 0).all()
    assert (depths[:, 96] == 0).all()  # the row that 3 does not divide
    found = depths > 0
    assert found[:, :96, 30:96].mean() > 0.6
    assert np.median(np.abs(depths - truth.depth)[found]) < 0.01
    random = np.random.default_rng(0)
    cloud = np.concatenate([random.uniform(-0.3, 0.3, (200, 3)), [[50, 0, 0], [np.nan, 0, 0], [0, 0, -2.5]]])
    cloud[:200, 2] = 0.25 * cloud[:200, 0] - 0.3 * cloud[:200, 1] + 0.1
    points = PointCloud(cloud.astype(np.float32), np.zeros((203, 3), np.float32))
    guided = patch_match(views, SMALL, points=points).depths.depth
    assert np.median(np.abs(guided - truth.depth)[guided > 0]) < 0.005


def test_points_say_where_the_search_begins():
    views, truth = wall(count=2, size=32)
    planes = torch.full((2, 4, 32, 32), 0.5)
    rays = np.array([10.5, 20.5, 1]) @ np.linalg.inv(views.intrinsics[0]).T
    point = views.camera_to_world[0] @ np.append(rays * truth.depth[0, 20, 10], 1)
    begin_at_points(planes, point[None, :3], views.intrinsics, views.world_to_camera,
                    torch.tensor([[0.1, 2.0, 1, 50]] * 2))  # fmt: skip
    assert float(planes[0, 0, 20, 10]) == pytest.approx(1 / truth.depth[0, 20, 10], rel=1e-5)
    assert float(planes[0, 0, 20, 11]) == float(planes[0, 0, 20, 10])  # 1.6 pixels around
    assert (planes[0, 0] != 0.5).sum() == 9
    before = planes.clone()
    begin_at_points(planes, np.array([[0, 0, 90.0]]), views.intrinsics, views.world_to_camera,
                    torch.tensor([[0.1, 2.0, 1, 50]] * 2))  # fmt: skip
    assert torch.equal(planes, before)


@pytest.mark.parametrize("size", [(5, 7), (8, 16), (13, 18)])
def test_layouts_hold_every_pixel_once(size):
    height, width = size
    planes = torch.rand(3, 4, height, width)
    inside = torch.rand(3, height, width) > 0.3
    back = planes_of(state_of(planes, inside.int()), width)
    assert torch.equal(back[:, :3], planes[:, :3])
    assert torch.equal(back[:, 3][inside], planes[:, 3][inside])
    assert (back[:, 3][~inside] > 1e8).all()


def test_planes_go_on_from_level_to_level():
    x, y = torch.arange(6) + 0.5, torch.arange(4)[:, None] + 0.5
    plane = 0.5 + 0.02 * x - 0.03 * y
    coarse = torch.stack([plane, torch.full_like(plane, 0.02), torch.full_like(plane, -0.03), plane])[None]
    fine = finer(coarse, 9, 12)  # an odd height: the last row goes on from the row before
    fx, fy = (torch.arange(12) + 0.5) / 2, (torch.arange(9)[:, None] + 0.5) / 2
    assert torch.allclose(fine[0, 0], 0.5 + 0.02 * fx - 0.03 * fy, atol=1e-6)
    assert fine[0, 1:3, 0, 0].tolist() == pytest.approx([0.01, -0.015])
    large = enlarged(plane, coarse[0, 1:3], 13, 18, 3)
    lx, ly = (torch.arange(18) + 0.5) / 3, (torch.arange(12)[:, None] + 0.5) / 3
    assert torch.allclose(large[:12], 0.5 + 0.02 * lx - 0.03 * ly, atol=1e-6)
    assert (large[12] == 0).all()


def test_levels_are_means_over_what_masks_hold():
    grey, inside = torch.rand(2, 97, 100), torch.rand(2, 97, 100) > 0.4
    levels = pyramid(grey, inside)
    assert [tuple(picture.shape[1:]) for picture, _ in levels] == [(24, 25), (48, 50), (97, 100)]
    held = inside[0, 10:12, 20:22]
    small, shown = levels[1]
    assert bool(shown[0, 5, 10]) == (held.float().mean() >= 0.5)
    if held.any():
        assert float(small[0, 5, 10]) == pytest.approx(float(grey[0, 10:12, 20:22][held].mean()), rel=1e-5)
    assert len(pyramid(torch.rand(1, 40, 40), torch.ones(1, 40, 40).bool())) == 1


def test_sources_are_about_fifteen_degrees_away_and_show_the_same():
    turns = np.radians([0, 2, 14, 17, 30, 80, 15])
    poses = np.repeat(np.eye(4)[None], 7, axis=0)
    poses[:, 0, 3], poses[:, 2, 3] = 3 * np.sin(turns), -3 * np.cos(turns)
    for pose, turn in zip(poses, turns, strict=True):
        pose[:3, :3] = [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
    poses[6, :3, :3] = [[-1, 0, 0], [0, 1, 0], [0, 0, -1]]  # looks away
    k = np.repeat(np.array([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]])[None], 7, axis=0)
    found = choose_sources(k, poses, 100, 100, 4)
    assert found[0].tolist()[:2] == [2, 3]
    assert 5 not in found[0]
    assert found[5].tolist() == [4, -1, -1, -1] or found[5].tolist() == [-1] * 4
    assert found[6].tolist() == [-1] * 4
    assert not (found == 6).any()
    assert len(scene_samples(np.full((40, 3), np.nan))) == 512


def test_node_warns_of_a_view_without_another_and_refuses():
    views, _ = wall(count=4, size=40)
    far = views.camera_to_world.copy()
    far[3, :3, 3] = [40, 40, 40]  # sees nothing that others see
    context = FakeContext()
    p = prior.PatchMatchParams(sources=3, step=1)
    out = prior.patch_match(context, replace(views, camera_to_world=far), p=p).depths
    assert (out.depth[3] == 0).all()
    assert (out.depth[:3] > 0).any()
    assert "w3" in context.warnings[0]
    assert "no depth" in context.warnings[0]
    assert context.lines[0].startswith("depth in")
    assert "confidence" in context.lines[1]
    with pytest.raises(ValidationError, match="no middle sample: write 5"):
        p.replaced(window=4)
    with pytest.raises(DataError, match="no parallax"):
        patch_match(views.subset([0]), SMALL)
