"""Hard scenes for visibility and antialiasing: doubled surfaces, far places, odd cameras, tiny textures."""

import pytest
import torch

from benchmarks.stability.scenes import camera, coverage, icosphere, soup
from exmesh_graph.raster import (
    antialias,
    edge_table,
    find_silhouette,
    project,
    rasterize,
    rasterize_projected,
    shade,
)
from exmesh_graph.raster.rasterize import NEAR


def picture_and_gradient(vertices, faces, intrinsics, pose, height, width, weight):
    """Antialiased coverage and position colours, and the gradient of a weighted sum in the vertices."""
    start = vertices.clone().requires_grad_()
    colours = 0.5 + 0.4 * vertices.detach() / vertices.detach().abs().max()
    image = coverage(start, faces, intrinsics, pose, height, width, colours)
    (gradient,) = torch.autograd.grad((image * weight).sum(), start)
    return image.detach(), gradient


@pytest.mark.parametrize("copies", ["duplicated faces", "coincident sheets"])
def test_a_doubled_surface_looks_like_a_single_one(copies):
    """Edges that lie on the surface behind them are no silhouettes; what moves both sheets moves the outline once."""
    unit, faces = icosphere(3)
    vertices = (0.9 * unit).float()
    intrinsics, pose = camera(96, 96, turn=0.3)
    weight = torch.rand(96, 96, 4, generator=torch.Generator().manual_seed(0))
    single, gradient = picture_and_gradient(vertices, faces, intrinsics, pose, 96, 96, weight)
    if copies == "duplicated faces":
        both = (vertices, torch.cat([faces, faces]))
    else:
        both = (torch.cat([vertices, vertices]), torch.cat([faces, faces + len(vertices)]))
    image, moved = picture_and_gradient(*both, intrinsics, pose, 96, 96, weight)
    assert torch.allclose(image, single, atol=1e-5)
    assert torch.allclose(moved.view(-1, len(vertices), 3).sum(0), gradient, atol=1e-3 * float(gradient.abs().max()))


def test_a_thin_bar_before_the_surface_keeps_its_own_outline():
    """Behind the bar's edge lies the ball, and before the ball's outline lies the bar: each pair has one owner."""
    unit, faces = icosphere(3)
    bar = torch.tensor([[-0.45, -2.0, -1.5], [-0.35, -2.0, -1.5], [0.45, 2.0, -1.5], [0.35, 2.0, -1.5]])
    quad = torch.tensor([[0, 1, 2], [0, 2, 3]])
    intrinsics, pose = camera(128, 128)
    whole = torch.cat([(0.9 * unit).float(), bar])
    colours = torch.cat([torch.zeros(len(unit), 1), torch.ones(4, 1)])
    offset = torch.zeros(1, requires_grad=True)
    moved = torch.cat([whole[: len(unit)], bar + offset * torch.tensor([1.0, 0, 0])])
    image = coverage(moved, torch.cat([faces, quad + len(unit)]), intrinsics, pose, 128, 128, colours)
    columns = torch.arange(128) + 0.5
    (gradient,) = torch.autograd.grad((image[..., 1] * columns).sum(), offset)
    focal, depth = float(intrinsics[0, 0]), 3.7 - 1.5
    width, rows = 0.1 * focal / depth, 128  # the bar reaches over the whole picture
    assert float(image[..., 1].sum().detach()) == pytest.approx(width * rows, rel=0.02)
    assert float(gradient) == pytest.approx(width * rows * focal / depth, rel=0.03)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_coverage_and_its_gradient_scale_with_the_scene(scale):
    unit, faces = icosphere(3)
    vertices = 0.9 * unit
    results = []
    for factor in (1.0, scale):
        intrinsics, pose = camera(96, 96, turn=0.3)
        pose[:3, 3] *= factor
        results.append(picture_and_gradient((factor * vertices).float(), faces, intrinsics, pose, 96, 96, 1.0))
    (image, gradient), (scaled, small) = results
    assert torch.allclose(scaled, image, atol=1e-3)
    assert torch.allclose(small * scale, gradient, atol=0.02 * float(gradient.abs().max()))


def test_far_from_the_origin_the_picture_stays():
    """An object of size 1 at 1e3 units: float32 positions are 6e-5 apart there, a hundredth of a pixel."""
    unit, faces = icosphere(3)
    there = torch.tensor([1e3, -400.0, 700.0], dtype=torch.float64)
    intrinsics, pose = camera(96, 96, turn=0.3)
    moved = pose.clone()
    moved[:3, 3] -= pose[:3, :3] @ there
    near, _ = picture_and_gradient((0.9 * unit).float(), faces, intrinsics, pose, 96, 96, 1.0)
    far = coverage((0.9 * unit + there).float(), faces, intrinsics, moved, 96, 96)
    assert float((far[..., 0] - near[..., 0]).abs().mean()) < 2e-3
    assert float(far[..., 0].sum()) == pytest.approx(float(near[..., 0].sum()), rel=1e-3)


@pytest.mark.parametrize("place", [(0, 0), (60, 0), (13, 35)])
def test_a_crop_is_the_same_camera_with_its_principal_point_moved(place):
    """Wide and tall cut-outs of a picture, the principal point far outside some of them."""
    unit, faces = icosphere(3)
    vertices = (0.9 * unit).float()
    left, top = place
    intrinsics, pose = camera(128, 96, turn=0.2)
    whole, _ = picture_and_gradient(vertices, faces, intrinsics, pose, 96, 128, 1.0)
    height, width = 61, 52
    cut = intrinsics.clone()
    cut[0, 2] -= left
    cut[1, 2] -= top
    part, _ = picture_and_gradient(vertices, faces, cut, pose, height, width, 1.0)
    # the outermost pixels lack the neighbours that the silhouette blends with
    inner = (slice(1, -1), slice(1, -1))
    want = whole[top : top + height, left : left + width]
    assert float((part - want)[inner].abs().max()) < 5e-3
    assert float(want[..., 0].mean()) > 0.1


def test_from_inside_a_closed_surface_there_is_no_silhouette():
    unit, faces = icosphere(2)
    intrinsics, pose = camera(40, 30, distance=0.3, focal=20.0)
    image, gradient = picture_and_gradient(unit.float(), faces, intrinsics, pose, 30, 40, 1.0)
    assert bool((image[..., 0] == 1).all())
    assert bool(torch.isfinite(gradient).all())


def test_slivers_have_finite_gradients():
    """Triangles a thousandth as wide as long, some seen edge-on."""
    g = torch.Generator().manual_seed(2)
    base, along = torch.rand(40, 3, generator=g) * 2 - 1, torch.randn(40, 3, generator=g)
    tip = base + 0.5 * along + 1e-3 * torch.randn(40, 3, generator=g)
    vertices = torch.cat([base, base + along, tip])
    faces = torch.arange(120).reshape(3, 40).T.contiguous()
    intrinsics, pose = camera(64, 64)
    image, gradient = picture_and_gradient(vertices, faces, intrinsics, pose, 64, 64, 1.0)
    assert bool(torch.isfinite(image).all())
    assert bool(torch.isfinite(gradient).all())
    assert float(gradient.abs().max()) > 0


def test_a_texture_of_one_texel_is_one_colour_without_a_uv_gradient():
    unit, faces = icosphere(1)
    intrinsics, pose = camera(24, 24)
    projected = project(unit.float(), intrinsics, pose).requires_grad_()
    fragments = rasterize_projected(projected, faces, 24, 24)
    texture = torch.tensor([[[0.2, 0.5, 0.9]]], requires_grad=True)
    uvs = torch.rand(len(unit), 2, generator=torch.Generator().manual_seed(0))
    image = shade(projected, faces, uvs, faces, texture, fragments.face_id)
    seen = fragments.face_id >= 0
    assert torch.allclose(image[seen], texture[0, 0].expand(int(seen.sum()), 3))
    by_position, by_texel = torch.autograd.grad(image.sum(), (projected, texture))
    assert float(by_position.abs().max()) == 0
    assert by_texel.flatten().tolist() == pytest.approx([float(seen.sum())] * 3)


def test_a_tall_image_is_not_a_wide_one():
    """Rows and columns are not mixed up: a picture with x and y exchanged is the transposed one."""
    unit, faces = icosphere(2)
    vertices = (unit * torch.tensor([0.9, 0.5, 0.7], dtype=torch.float64)).float()
    k = torch.tensor([[70.0, 0, 20], [0, 90, 41], [0, 0, 1]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[2, 3] = 3.0
    tall = rasterize(vertices, faces, k, pose, 80, 37)
    turned = k[[1, 0, 2]][:, [1, 0, 2]]
    wide = rasterize(vertices[:, [1, 0, 2]], faces, turned, pose, 37, 80)
    assert float((wide.face_id == tall.face_id.T).float().mean()) > 0.999
    assert float((tall.depth.T - wide.depth).abs().median()) < 1e-5


def silhouette_of(vertices, faces, intrinsics, pose, height, width):
    projected = project(vertices, intrinsics, pose)
    fragments = rasterize_projected(projected, faces, height, width)
    return projected, fragments, find_silhouette(projected, edge_table(faces), fragments)


@pytest.mark.parametrize("turn", [0.0, 0.35])
@pytest.mark.parametrize("start", [-6.0, 0.02, 0.4])
def test_a_road_from_behind_the_camera_has_the_gradient_of_its_edges(start, turn):
    """Its long edges cross the near plane; the exact area is that of the finely sampled road."""
    size, near = 96, 0.05
    intrinsics, pose = camera(size, size, distance=0.0, turn=turn, focal=60.0)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])

    def road(width):
        corner = torch.tensor([[-1.0, 0.5, start], [1, 0.5, start], [1, 0.5, 30], [-1, 0.5, 30]], dtype=torch.float64)
        return corner * torch.stack([width, torch.ones_like(width), torch.ones_like(width)])

    def area_at(width):
        fine = torch.diag(torch.tensor([16.0, 16, 1], dtype=torch.float64)) @ intrinsics
        fragments = rasterize(road(width), faces, fine, pose, 16 * size, 16 * size, near=near)
        return float((fragments.face_id >= 0).sum()) / 256

    width = torch.tensor(0.31, dtype=torch.float64, requires_grad=True)
    projected = project(road(width), intrinsics, pose)
    fragments = rasterize_projected(projected, faces, size, size, near=near)
    silhouette = find_silhouette(projected, edge_table(faces), fragments, near=near)
    covered = (fragments.face_id >= 0).double()[..., None]
    area = antialias(covered, projected, silhouette).sum()
    area.backward()
    exact = (area_at(width.detach() + 0.02) - area_at(width.detach() - 0.02)) / 0.04
    assert float(area.detach()) == pytest.approx(area_at(width.detach()), rel=0.01)
    assert float(width.grad) == pytest.approx(exact, rel=0.02)


def test_of_an_edge_across_the_near_plane_only_the_piece_before_it_counts():
    vertices, faces = soup(60, 0.8, seed=11)
    intrinsics, pose = camera(64, 64, distance=0.1, focal=40.0)
    projected, _, found = silhouette_of(vertices, faces, intrinsics, pose, 64, 64)
    before = (projected[found.ends][..., 2] > NEAR).sum(1)
    assert int((before == 1).sum()) > 20
    assert int((before == 0).sum()) == 0
    start = vertices.clone().requires_grad_()
    coverage(start, faces, intrinsics, pose, 64, 64).sum().backward()
    assert bool(torch.isfinite(start.grad).all())


def test_a_patch_on_a_plane_makes_no_silhouette():
    """Coplanar sheets, a little turned from the image plane: between them depths differ by rounding only."""
    plane = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    quad = torch.tensor([[0, 1, 2], [0, 2, 3]])
    vertices, faces = torch.cat([0.37 * plane, plane]), torch.cat([quad, quad + 4])
    intrinsics, pose = camera(96, 96, turn=0.03)
    _, fragments, found = silhouette_of(vertices, faces, intrinsics, pose, 96, 96)
    covered = fragments.face_id.view(-1) >= 0
    assert len(found.first) > 100
    assert bool((covered[found.first] != covered[found.second]).all())


def test_a_hair_between_pixel_centres_does_not_take_over_the_outline():
    """A ring far thinner than a pixel stands before the ball's outline: the outline keeps its gradient."""
    unit, faces = icosphere(4)
    vertices = (0.9 * unit).float()
    intrinsics, pose = camera(128, 128)
    angle = torch.linspace(0, 2 * torch.pi, 400)[:-1]
    # the cone through the ball's outline, half-way to the camera
    tangent = 0.9 / (3.7**2 - 0.9**2) ** 0.5
    ring = torch.stack([angle.cos(), angle.sin(), torch.zeros_like(angle)], dim=1) * tangent * 1.85
    ring[:, 2] = 1.85 - 3.7
    i = torch.arange(len(ring))
    after, outer = (i + 1) % len(ring), i + len(ring)
    strip = torch.cat([torch.stack([i, after, outer], 1), torch.stack([after, after + len(ring), outer], 1)])
    hair = torch.cat([ring, ring * torch.tensor([1.00001, 1.00001, 1.0])])
    gradients = []
    for more in (torch.zeros(0, 3), hair):
        start = vertices.clone().requires_grad_()
        f = torch.cat([faces, strip + len(vertices)]) if len(more) else faces
        area = coverage(torch.cat([start, more]), f, intrinsics, pose, 128, 128).sum()
        gradients.append(float((torch.autograd.grad(area, start)[0] * unit).sum()))
    assert gradients[1] == pytest.approx(gradients[0], rel=0.02)
