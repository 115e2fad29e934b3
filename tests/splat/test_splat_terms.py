"""Depth and normals of blended planes, and what Gaussians must agree on, against planes that are known."""

import numpy as np
import pytest
import torch
from scipy.ndimage import minimum_filter

from exmesh_graph.priors.depth_filter import normals_of_depth
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.splat.consistency import View, edge_weight, flattening, multi_view, patch_mismatch, single_view_normal
from exmesh_graph.splat.depths import depth_maps, middle_planes
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.pictures import nearest_views
from exmesh_graph.splat.render import plane_depth, render
from exmesh_graph.splat.settings import DepthSettings
from exmesh_graph.targets import prepare_targets
from tests.priors.prior_scenes import wall
from tests.splat.splat_scenes import camera

NORMAL = np.array([0.25, -0.3, -1.0])
OFFSET = -0.1


def sheet(opacity=3.0, side=60, dtype=torch.float64):
    """Flat Gaussians on the wall of `prior_scenes`, and their common unit normal."""
    unit = torch.from_numpy(NORMAL / np.linalg.norm(NORMAL))
    across = torch.linalg.cross(torch.tensor([0, 1.0, 0]).double(), unit)
    across = across / across.norm()
    down = torch.linalg.cross(unit, across)
    line = torch.linspace(-1.6, 1.6, side, dtype=torch.float64)
    u, v = torch.meshgrid(line, line, indexing="ij")
    origin = unit * OFFSET / np.linalg.norm(NORMAL)
    means = origin + u.reshape(-1, 1) * across + v.reshape(-1, 1) * down
    half = unit + torch.tensor([0, 0, 1.0 + 1e-9]).double()
    turn = torch.cat([torch.zeros(1).double(), half]).expand(len(means), 4)
    scales = torch.tensor([0.05, 0.05, 1e-3]).log().double().expand(len(means), 3)
    opacities = torch.full((len(means),), opacity).double()
    made = Gaussians(means, scales, turn, opacities, torch.zeros(len(means), 1, 3).double())
    return made.map(lambda t: t.to(dtype).contiguous()), unit


def wall_view(views, i, dtype=torch.float64):
    targets = prepare_targets(views)
    rays = pixel_rays(targets.intrinsics[i], views.height, views.width, targets.images.to(dtype))
    return View(targets.images[i].to(dtype), rays, targets.intrinsics[i], targets.world_to_camera[i])


@pytest.mark.parametrize("opacity", [3.0, -1.0])
def test_depth_lies_on_the_plane_however_transparent(opacity):
    gaussians, unit = sheet(opacity)
    views, truth = wall(3, 48)
    view = wall_view(views, 0)
    drawing = render(gaussians, view.intrinsics, view.world_to_camera, 48, 48)
    depth, valid = plane_depth(drawing.normal, drawing.distance, drawing.alpha, view.rays)
    assert bool(valid.all())
    assert torch.allclose(depth, torch.from_numpy(truth.depth[0]).double(), rtol=1e-6)
    normals, inner = normals_of_depth(depth, valid, view.rays)
    assert torch.allclose(normals[inner], view.world_to_camera[:3, :3] @ unit, atol=1e-6)
    assert int(inner.sum()) == 46 * 46
    assert float(single_view_normal(drawing, view)) < 1e-6
    middle, distance = middle_planes(gaussians, drawing, view.world_to_camera)
    again, _ = plane_depth(middle, distance, drawing.alpha, view.rays)
    assert torch.allclose(again, depth, rtol=1e-6)


def test_what_has_no_depth():
    rays = pixel_rays(torch.eye(3), 2, 2, torch.zeros(1))
    normal = torch.tensor([[[0, 0, -1.0], [0, 0, -1.0]], [[1, 0, -1.0], [0, 0, 0]]])
    distance = torch.tensor([[-2.0, -2.0], [-2.0, 0.0]])
    alpha = torch.tensor([[1.0, 0.4], [1.0, 1.0]])
    depth, valid = plane_depth(normal, distance, alpha, rays)
    assert valid.tolist() == [[True, False], [True, False]]
    assert depth[~valid].abs().sum() == 0
    normals, inner = normals_of_depth(torch.zeros(5, 5), torch.ones(5, 5, dtype=torch.bool), torch.ones(5, 5, 3))
    assert not inner.any()
    assert torch.isfinite(normals).all()


def test_edge_weight_is_safe_on_flat_pictures():
    assert torch.equal(edge_weight(torch.full((9, 9, 3), 0.3)), torch.ones(9, 9))
    noise = 1e-4 * torch.rand(9, 9, 3, generator=torch.Generator().manual_seed(0))
    assert float(edge_weight(noise).min()) > 0.98
    step = torch.zeros(9, 9, 3)
    step[:, 5:] = 1
    assert edge_weight(step)[4, [2, 4, 5]].tolist() == [1, 0, 0]
    assert edge_weight(torch.zeros(2, 5, 3)).shape == (2, 5)


def test_neighbours_that_agree_cost_nothing_and_a_moved_plane_does():
    views, _ = wall(3, 48)
    view, other = wall_view(views, 0), wall_view(views, 1)
    pixels = torch.arange(48 * 48)
    gaussians, unit = sheet()

    def terms(shift):
        moved = Gaussians(**{**gaussians.tensors(), "means": gaussians.means + shift * unit})
        drawings = [render(moved, v.intrinsics, v.world_to_camera, 48, 48) for v in (view, other)]
        return multi_view(drawings[0], view, drawings[1], other, pixels)

    geometric, photometric = terms(0.0)
    assert float(geometric) < 1e-4
    assert float(photometric) < 2e-3
    assert [float(terms(s)[1]) for s in (0.05, -0.05)] > [20 * float(photometric)] * 2


def test_photometric_gradient_is_that_of_finite_differences():
    views, _ = wall(3, 48)
    view, other = wall_view(views, 0), wall_view(views, 1)
    relative = other.world_to_camera @ torch.linalg.inv(view.world_to_camera)
    linear, offset = other.intrinsics @ relative[:3, :3], other.intrinsics @ relative[:3, 3]
    unit = view.world_to_camera[:3, :3] @ torch.from_numpy(NORMAL / np.linalg.norm(NORMAL))
    origin = view.world_to_camera[:3, 3]
    distance = OFFSET / np.linalg.norm(NORMAL) + unit @ origin
    pixels = torch.tensor([20 * 48 + 20, 30 * 48 + 15, 2])
    plane = (unit / (distance + 0.02)).expand(3, 3).clone().requires_grad_()
    value, compared = patch_mismatch(view, other, plane, pixels, linear, offset)
    assert compared.tolist() == [True, True, False]
    gradient = torch.autograd.grad(value.sum(), plane)[0]
    step = torch.randn(3, 3, generator=torch.Generator().manual_seed(0)).double()
    ends = [patch_mismatch(view, other, plane + h * step, pixels, linear, offset)[0].sum() for h in (1e-7, -1e-7)]
    assert float((ends[0] - ends[1]) / 2e-7) == pytest.approx(float((gradient * step).sum()), rel=1e-3)


def test_a_flat_wall_has_nothing_to_compare():
    """Textureless pictures: no photometric term, no NaN."""
    views, _ = wall(3, 48)
    view, other = (v._replace(image=torch.full_like(v.image, 0.5)) for v in (wall_view(views, 0), wall_view(views, 1)))
    gaussians, _ = sheet()
    leaves = gaussians.map(lambda t: t.requires_grad_())
    drawing = render(leaves, view.intrinsics, view.world_to_camera, 48, 48)
    fixed = render(gaussians.map(lambda t: t.detach()), other.intrinsics, other.world_to_camera, 48, 48)
    geometric, photometric = multi_view(drawing, view, fixed, other, torch.arange(48 * 48))
    assert float(photometric.detach()) == 0
    (geometric + photometric + single_view_normal(drawing, view)).backward()
    assert torch.isfinite(leaves.means.grad).all()


def test_flattening_is_the_mean_thickness():
    scales = torch.tensor([[0.1, 0.2, 0.3], [0.5, 0.4, 0.6]]).log()
    assert float(flattening(scales, torch.tensor([True, True]))) == pytest.approx(0.25)
    assert float(flattening(scales, torch.tensor([False, False]))) == 0


def test_depth_maps_and_their_filters():
    gaussians, _ = sheet(dtype=torch.float32)
    views, truth = wall(5, 48)
    targets = prepare_targets(views)
    maps, share = depth_maps(gaussians, targets, DepthSettings(outward=0))
    assert maps.names == views.names
    assert share > 0.9
    seen = maps.depth > 0
    assert np.allclose(maps.depth[seen], truth.depth[seen], rtol=1e-4)
    nearer = depth_maps(gaussians, targets, DepthSettings(outward=2))[0].depth
    rays = pixel_rays(targets.intrinsics[0], 48, 48, torch.zeros(1)).numpy()
    towards = targets.world_to_camera[0, :3, :3].numpy() @ NORMAL / np.linalg.norm(NORMAL)
    moved = (nearer - maps.depth)[0] * (rays @ towards)
    pixel = truth.depth[0] / float(targets.intrinsics[0, 0, 0])
    inside = minimum_filter(seen[0], 5, mode="constant")  # where the normal is known from the neighbours' depths
    assert inside.sum() > 800
    assert np.allclose((moved / pixel)[inside], 2, atol=0.02)
    assert not (depth_maps(gaussians, targets, DepthSettings(incidence=0.01))[0].depth > 0).any()
    stray = torch.tensor([[0.1, 0.0, -1.2]])
    floating = Gaussians(
        torch.cat([gaussians.means, stray]), torch.cat([gaussians.scales, torch.full((1, 3), 0.05).log()]),
        torch.cat([gaussians.rotations, torch.tensor([[1.0, 0, 0, 0]])]),
        torch.cat([gaussians.opacities, torch.tensor([6.0])]), torch.cat([gaussians.sh, torch.zeros(1, 1, 3)]),
    )  # fmt: skip
    errors = []
    for agreeing in (0, 5):
        depth = depth_maps(floating, targets, DepthSettings(agreeing=agreeing, tolerance=1e-3))[0].depth
        errors.append(int(((np.abs(depth - truth.depth) > 0.3) & (depth > 0)).sum()))
    assert errors[0] > 50
    assert errors[1] < errors[0] / 10


def test_neighbours_are_the_nearest_in_direction():
    poses = torch.stack([camera(turn=t)[1] for t in (0.0, 0.2, 0.5, 1.0, 3.0, 0.0)])
    found = nearest_views(poses)
    assert found[0].tolist() == [1, 2]  # not itself, not the one at the same place, not beyond 45 degrees
    assert found[4].tolist() == []
