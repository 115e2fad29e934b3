"""The fused terms of a fit against the plain ones in float64, value and gradient."""

from dataclasses import replace

import pytest
import torch

from exmesh_graph.gpu.cores import cores
from exmesh_graph.losses import d_ssim, l1
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.splat.consistency import View, multi_view, single_view_normal
from exmesh_graph.splat.fused.draw import Planes
from exmesh_graph.splat.fused.terms import Terms, Weights, strongest
from exmesh_graph.splat.render import Render, render
from exmesh_graph.targets import prepare_targets
from tests.priors.prior_scenes import wall
from tests.splat.test_splat_terms import sheet

SIZE = 48


def scene(seed=0):
    """Targets of a wall, and planes of a sheet before it that is turned and dented, of the first two views."""
    views, _ = wall(3, SIZE)
    targets = prepare_targets(views)
    gaussians, unit = sheet()
    g = torch.Generator().manual_seed(seed)
    gaussians.means += 0.003 * torch.randn(len(gaussians), 1, generator=g, dtype=torch.float64) * unit
    gaussians.rotations += 0.05 * torch.randn(len(gaussians), 4, generator=g, dtype=torch.float64)
    gaussians.sh += 0.5 * torch.randn(len(gaussians), 1, 3, generator=g, dtype=torch.float64)
    gaussians.opacities[torch.rand(len(gaussians), generator=g) < 0.2] = -4
    found = []
    for i in range(2):
        drawing = render(gaussians, targets.intrinsics[i], targets.world_to_camera[i], SIZE, SIZE)
        planes = [t.detach().contiguous() for t in drawing[:4]]
        hole = torch.arange(SIZE) % 17 == 3
        planes[1] = torch.where(hole & hole[:, None], 0.1, planes[1])
        found.append((planes, view_of(targets, i)))
    return targets, found, gaussians


def view_of(targets, i, dtype=torch.float64):
    rays = pixel_rays(targets.intrinsics[i], SIZE, SIZE, targets.images.to(dtype))
    return View(targets.images[i].to(dtype), rays, targets.intrinsics[i], targets.world_to_camera[i])


def as_render(planes):
    return Render(*planes, drawn=None)


def single(planes):
    return Planes(*(t.float().contiguous() for t in planes))


def same(found, exact, part=1e-4):
    for a, b in zip(found, exact, strict=True):
        assert float((a - b).abs().mean()) <= part * float(b.abs().mean()) + 1e-12


@pytest.mark.parametrize("gained", [False, True])
@pytest.mark.parametrize("masked", [False, True])
def test_colour_and_coverage(gained, masked):
    targets, ((planes, _), _), _ = scene()
    targets = replace(targets, masked=torch.tensor([masked] * 3), _boxes={}, _ssim={})
    targets.alpha[0, :9] = 0  # so that the box is not the picture
    gain = torch.tensor([0.9, 1.0, 1.2]) if gained else None
    leaves = [t.clone().requires_grad_() for t in planes]
    image = leaves[0] if gain is None else leaves[0] * gain
    box, target = targets.box(0), targets.images[0].double()
    share = box.area / SIZE**2
    assert share < 1
    loss = 0.8 * l1(image, target) + 0.4 * share * d_ssim(box.crop(image), box.crop(target))
    if masked:
        loss = loss + 0.3 * l1(leaves[1], targets.alpha[0].double())
    exact = torch.autograd.grad(loss, leaves[:2], allow_unused=True, materialize_grads=True)
    terms = Terms(SIZE, SIZE)
    value, error = terms.colour(single(planes), targets, 0, Weights(0.2, 0.3), gain)
    assert value == pytest.approx(float(loss), rel=1e-5)
    assert error == pytest.approx(float((image - target).square().mean()), rel=1e-5)
    same(terms.to[:2], exact)


def test_normals_against_depth():
    _, ((planes, view), _), _ = scene()
    leaves = [t.clone().requires_grad_() for t in planes]
    loss = single_view_normal(as_render(leaves), view)
    exact = torch.autograd.grad(0.7 * loss, leaves[2:])
    terms = Terms(SIZE, SIZE)
    value = terms.normals(single(planes), single_view(view), 0.7, strongest(view.image))
    assert float(loss) > 0.01
    assert value == pytest.approx(float(loss), rel=1e-4)
    same(terms.to[2:], exact, part=1e-3)


def single_view(view):
    return View(view.image.float(), view.rays.float(), view.intrinsics, view.world_to_camera)


def test_a_neighbour():
    _, ((planes, view), (other_planes, other)), _ = scene()
    pixels = torch.randperm(SIZE * SIZE, generator=torch.Generator().manual_seed(0))[:1500]
    leaves = [t.clone().requires_grad_() for t in planes]
    geometric, photometric = multi_view(as_render(leaves), view, as_render(other_planes), other, pixels)
    assert float(geometric) > 1e-3
    assert float(photometric) > 1e-3
    for weights in ((1.0, 0.0), (0.0, 1.0), (0.3, 0.6)):
        loss = weights[0] * geometric + weights[1] * photometric
        exact = torch.autograd.grad(loss, leaves[2:], retain_graph=True)
        terms = Terms(SIZE, SIZE)
        terms.normals(single(planes), single_view(view), 0.0, strongest(view.image))
        found = terms.neighbour(
            single(planes), single_view(view), single(other_planes), single_view(other), pixels, weights
        )
        assert found == pytest.approx((float(geometric), float(photometric)), rel=1e-3)
        same(terms.to[2:], exact, part=5e-3)


def test_the_same_bytes_for_any_number_of_cores():
    targets, ((planes, view), (other_planes, other)), _ = scene()
    runs = []
    for count in (1, 1, 2, 3):
        with cores(count):
            terms = Terms(SIZE, SIZE)
            values = [terms.colour(single(planes), targets, 0, Weights(0.2, 0.3), None)]
            values.append(terms.normals(single(planes), single_view(view), 0.5, strongest(view.image)))
            values.append(
                terms.neighbour(
                    single(planes), single_view(view), single(other_planes), single_view(other),
                    torch.arange(SIZE * SIZE), (1.0, 1.0),
                )
            )  # fmt: skip
            runs.append((values, terms.to))
    for values, to in runs[1:]:
        assert values == runs[0][0]
        assert all(torch.equal(a, b) for a, b in zip(to, runs[0][1], strict=True))


@pytest.mark.parametrize("size", [(1, 1), (2, 7), (5, 3), (1, 40), (19, 33)])
def test_pictures_of_any_size_and_nothing_in_them(size):
    """Also what reads beside a pixel at the picture's rim: against float64, and all is finite."""
    height, width = size
    g = torch.Generator().manual_seed(1)
    intrinsics = torch.tensor([[40.0, 0.5, width / 2], [0, 42.0, height / 2], [0, 0, 1]]).double()
    pose = torch.eye(4).double()
    pose[2, 3] = 3
    moved = pose.clone()
    moved[:2, 3] = torch.tensor([0.1, 0.033])  # rows do not fall on rows, where rounding would decide
    waves = torch.sin(torch.arange(height)[:, None] * 0.9 + torch.arange(width) * 0.7)[..., None]
    image = (0.5 + 0.2 * waves * torch.tensor([1.0, 0.8, -0.3])).double()
    rays = pixel_rays(intrinsics, height, width, image)
    view, other = (View(image, rays, intrinsics, p) for p in (pose, moved))
    for covered in (0.0, 1.0):
        normal = torch.tensor([0.1, 0.05, -1.0]).double() + 0.01 * torch.randn(height, width, 3, generator=g).double()
        planes = [image, covered * torch.ones(height, width).double(), covered * normal,
                  -3 * covered * (1 + 0.001 * torch.randn(height, width, generator=g).double())]  # fmt: skip
        leaves = [t.clone().requires_grad_() for t in planes]
        pixels = torch.arange(height * width)
        loss = single_view_normal(as_render(leaves), view)
        if min(size) > 1:  # the plain form reads four depths
            loss = loss + sum(multi_view(as_render(leaves), view, as_render(planes), other, pixels))
        exact = torch.autograd.grad(loss, leaves[2:], allow_unused=True, materialize_grads=True) if covered else [
            torch.zeros_like(t) for t in leaves[2:]
        ]  # fmt: skip
        terms = Terms(height, width)
        value = terms.normals(single(planes), single_view(view), 1.0, strongest(image))
        value += sum(
            terms.neighbour(single(planes), single_view(view), single(planes), single_view(other), pixels, (1.0, 1.0))
        )
        assert value == pytest.approx(float(loss), rel=1e-3, abs=1e-7)
        same(terms.to[2:], exact, part=5e-3)
