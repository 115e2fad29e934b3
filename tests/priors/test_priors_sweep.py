"""The plane sweep: against a slow reference, on a wall of known depth, at every scale of its inputs."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from exmesh_nodes import prior
from prior_scenes import wall
from pydantic import ValidationError

from exmesh_graph.errors import DataError
from exmesh_graph.priors.depth_filter import neighbours
from exmesh_graph.priors.plane_sweep import plane_sweep, search_depths
from exmesh_graph.priors.settings import SweepSettings
from exmesh_graph.targets import prepare_targets
from exmesh_graph.testing import FakeContext


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def slowly(view, others, targets, grey, settings) -> np.ndarray:
    """The same search, pixel by pixel and window by window, in float64."""
    height, width = targets.height, targets.width
    poses = [np.linalg.inv(w.numpy()) for w in targets.world_to_camera]
    k = [m.numpy() for m in targets.intrinsics]
    distance = np.linalg.norm(poses[view][:3, 3])
    inverse = np.linspace(1 / max(distance - 1, 0.1 * distance), 1 / (distance + 1), settings.planes)
    image = grey.double().numpy()
    y, x = np.indices((height, width)) + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(k[view]).T
    scores = np.full((len(others), settings.planes, height, width), -1.0)
    for n, other in enumerate(others):
        for p, one in enumerate(inverse):
            points = np.einsum("ij,hwj->hwi", poses[view][:3, :3], rays / one) + poses[view][:3, 3]
            there = np.einsum("ij,hwj->hwi", np.linalg.inv(poses[other])[:3, :3], points - poses[other][:3, 3])
            pixel = there @ k[other].T
            px, py = pixel[..., 0] / pixel[..., 2], pixel[..., 1] / pixel[..., 2]
            fx, fy = np.clip(px - 0.5, 0, width - 1), np.clip(py - 0.5, 0, height - 1)
            j, i = np.minimum(fx.astype(int), width - 2), np.minimum(fy.astype(int), height - 2)
            a, b = fx - j, fy - i
            o = image[other]
            seen = (1 - b) * ((1 - a) * o[i, j] + a * o[i, j + 1]) + b * ((1 - a) * o[i + 1, j] + a * o[i + 1, j + 1])
            for row in range(height):
                for column in range(width):
                    if not (0.5 < px[row, column] < width - 0.5 and 0.5 < py[row, column] < height - 0.5):
                        continue
                    r = settings.window // 2
                    part = np.s_[max(row - r, 0) : row + r + 1, max(column - r, 0) : column + r + 1]
                    one_window, other_window = image[view][part].ravel(), seen[part].ravel()
                    spread = one_window.var() * other_window.var()
                    shared = (one_window * other_window).mean() - one_window.mean() * other_window.mean()
                    scores[n, p, row, column] = shared / np.sqrt(max(spread, 1e-8))
    return np.sort(scores, axis=0)[::-1][: (len(others) + 1) // 2].mean(axis=0)


def test_the_search_is_that_of_a_slow_reference():
    views, _ = wall(count=3, size=18)
    targets = prepare_targets(views)
    grey = targets.images.mean(dim=-1)
    settings = SweepSettings(planes=9, window=5, downscale=1, min_score=0.3)
    others = np.array([0, 2])
    found = search_depths(1, others, targets, grey, settings).numpy()
    best = slowly(1, others, targets, grey, settings)
    inverse = np.linspace(1 / 1.5, 1 / 3.5, 9)
    checked = 0
    for row in range(18):
        for column in range(18):
            of = best[:, row, column]
            top = int(of.argmax())
            if found[row, column] == 0:
                continue
            low, middle, high = of[top - 1 : top + 2]
            shift = 0.5 * (low - high) / (low - 2 * middle + high)
            want = 1 / (inverse[top] + shift * (inverse[1] - inverse[0]))
            assert found[row, column] == pytest.approx(want, rel=2e-3)
            checked += 1
    assert checked > 100
    # what was left out was uncertain: a low score, or a best depth at the end of the search
    left = found == 0
    assert ((best.max(0)[left] < 0.31) | np.isin(best.argmax(0)[left], (0, 8))).all()


def test_depth_of_a_painted_wall():
    views, truth = wall()
    settings = SweepSettings(planes=48, neighbours=2, window=7, downscale=1)
    depths = plane_sweep(views, settings)
    found = depths.depth > 0
    error = np.abs(depths.depth - truth.depth)[found] / truth.depth[found]
    assert found.mean() > 0.5
    assert np.median(error) < 0.003
    assert np.quantile(error, 0.95) < 0.02
    assert depths.names == views.names
    assert depths.units == "normalised"
    again = plane_sweep(views, settings)
    assert again.depth.tobytes() == depths.depth.tobytes()


def test_where_nothing_is_painted_nothing_is_claimed():
    views, truth = wall(flat_half=True)
    depths = plane_sweep(views, SweepSettings(planes=48, neighbours=2, window=7, downscale=1)).depth
    rows, columns = np.indices(depths.shape[1:]) + 0.5
    for i in range(len(views)):
        rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(views.intrinsics[i]).T
        x = ((truth.depth[i][..., None] * rays) @ views.camera_to_world[i][:3, :3].T + views.camera_to_world[i][:3, 3])[
            ..., 0
        ]
        assert (depths[i][x < -0.1] == 0).all()  # more than a window away from the paint
        assert (depths[i][x > 0.1] > 0).mean() > 0.4


def test_reduced_pictures_and_masks():
    views, truth = wall(size=65)
    alpha = np.ones_like(views.alpha)
    alpha[:, :, :30] = 0
    masked = replace(views, alpha=alpha, has_masks=True)
    depths = plane_sweep(masked, SweepSettings(planes=32, neighbours=2, window=5, downscale=2))
    assert depths.depth.shape == (5, 65, 65)
    assert (depths.depth[:, :, :30] == 0).all()
    assert (depths.depth[:, 64] == 0).all()  # the row that 2 does not divide
    found = depths.depth > 0
    assert np.median(np.abs(depths.depth - truth.depth)[found]) < 0.03


def test_neighbours_are_about_ten_degrees_away():
    turns = np.radians([0, 2, 9, 11, 30, 80])
    poses = np.repeat(np.eye(4)[None], 6, axis=0)
    poses[:, 0, 3], poses[:, 2, 3] = 3 * np.sin(turns), 3 * np.cos(turns)
    found = neighbours(poses, 3)
    assert found[0].tolist() == [3, 2, 4]
    assert found[5].tolist() == []  # nobody within 45 degrees


def test_node_and_its_refusals():
    views, _ = wall(count=3, size=32)
    context = FakeContext()
    p = prior.SweepParams(planes=24, neighbours=2, window=5, downscale=1, device="cpu")
    depths = prior.plane_sweep(context, views, p=p).depths
    assert depths.depth.shape == (3, 32, 32)
    assert context.steps[-1] == (3, 3)
    assert "depth in" in context.lines[0]
    with pytest.raises(ValidationError, match="no middle pixel: write 5"):
        p.replaced(window=4)
    one = replace(
        views, names=views.names[:1], images=views.images[:1], alpha=views.alpha[:1],
        intrinsics=views.intrinsics[:1], camera_to_world=views.camera_to_world[:1],
    )  # fmt: skip
    with pytest.raises(DataError, match="no parallax"):
        plane_sweep(one, SweepSettings())
