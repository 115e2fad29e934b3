"""The edge scan: covered area and its gradient, finite differences, edge tables."""

import pytest
import torch
from scipy.spatial import ConvexHull

from benchmarks.stability.scenes import camera, coverage, icosphere, smooth_field, smooth_image
from exmesh_graph.raster import (
    antialias,
    edge_table,
    find_silhouette,
    project,
    rasterize_projected,
)


def outline_area(vertices, intrinsics, pose) -> float:
    """Exact image area of a convex body."""
    projected = project(vertices, intrinsics, pose)
    return ConvexHull((projected[:, :2] / projected[:, 2:]).numpy()).volume


@pytest.mark.parametrize("level", [2, 3, 4, 5, 6])
def test_area_of_a_sphere_and_its_derivative(level):
    """From 109 pixels a face to 0.4: the gradient must not fade as faces shrink below pixels."""
    unit, faces = icosphere(level)
    intrinsics, pose = camera(256, 256)
    step = 1e-4
    exact = (
        outline_area(unit * (0.9 + step), intrinsics, pose) - outline_area(unit * (0.9 - step), intrinsics, pose)
    ) / (2 * step)
    radius = torch.tensor(0.9, requires_grad=True)
    area = coverage(unit.float() * radius, faces, intrinsics, pose, 256, 256).sum()
    area.backward()
    assert float(area) == pytest.approx(outline_area(unit * 0.9, intrinsics, pose), rel=1e-4)
    assert float(radius.grad) == pytest.approx(exact, rel=0.01)


@pytest.mark.thorough
@pytest.mark.parametrize("level", [3, 5])
def test_gradients_against_finite_differences(level):
    """Smooth displacements of a bumpy body, smooth image weights; steps of about 0.4 pixels."""
    unit, faces = icosphere(level)
    vertices = unit * (0.85 + 0.12 * smooth_field(unit, seed=50)[:, :1].clamp(-1, 1))
    colours = 0.5 + 0.3 * smooth_field(vertices, seed=60)
    intrinsics, pose = camera(160, 160, turn=0.5)
    step = 0.006
    for channel, bound in ((slice(0, 1), 0.05), (slice(1, 4), 0.10)):
        analytic, numeric = [], []
        for seed in range(8):
            field = smooth_field(unit, seed)
            weight = smooth_image(160, 160, 4, seed + 100)[..., channel]

            def loss(v, weight=weight, channel=channel):
                return (coverage(v, faces, intrinsics, pose, 160, 160, colours)[..., channel] * weight).sum()

            start = vertices.clone().requires_grad_()
            (gradient,) = torch.autograd.grad(loss(start), start)
            analytic.append((gradient * field).sum())
            with torch.no_grad():
                numeric.append((loss(vertices + step * field) - loss(vertices - step * field)) / (2 * step))
        analytic, numeric = torch.stack(analytic), torch.stack(numeric)
        assert float((analytic - numeric).norm() / numeric.norm()) < bound


def test_a_plane_has_silhouettes_at_its_border_only():
    n = 9
    x, y = torch.meshgrid(torch.linspace(-0.8, 0.8, n), torch.linspace(-0.8, 0.8, n), indexing="ij")
    vertices = torch.stack([x, y, torch.zeros_like(x)], dim=-1).reshape(-1, 3)
    corner = (torch.arange(n - 1)[:, None] * n + torch.arange(n - 1)).reshape(-1)
    faces = torch.cat(
        [
            torch.stack([corner, corner + n, corner + 1], dim=1),
            torch.stack([corner + 1, corner + n, corner + n + 1], dim=1),
        ]
    )
    table = edge_table(faces)
    assert int((table.opposite[:, 1] < 0).sum()) == 4 * (n - 1)
    intrinsics, pose = camera(64, 64)
    projected = project(vertices, intrinsics, pose)
    fragments = rasterize_projected(projected, faces, 64, 64)
    found = find_silhouette(projected, table, fragments)
    covered = fragments.face_id.view(-1) >= 0
    assert len(found.first) > 100
    assert bool((covered[found.first] != covered[found.second]).all())


def test_an_inner_silhouette_before_another_surface():
    """A small square before a large one of another colour: the small one's area moves with its scale."""
    square = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    quad = torch.tensor([[0, 1, 2], [0, 2, 3]])
    faces = torch.cat([quad, quad + 4])
    colours = torch.tensor([[0.0]] * 4 + [[1.0]] * 4)
    intrinsics, pose = camera(96, 96)
    scale = torch.tensor(0.4, requires_grad=True)
    vertices = torch.cat([square + torch.tensor([0, 0, 0.5]), square * scale + torch.tensor([0, 0, -0.5])])
    image = coverage(vertices, faces, intrinsics, pose, 96, 96, colours)
    area = image[..., 1].sum()
    (gradient,) = torch.autograd.grad(area, scale)
    focal = intrinsics[0, 0] * intrinsics[1, 1]
    exact = 4 * focal / 3.2**2
    assert float(area) == pytest.approx(float(exact) * 0.4**2, rel=5e-3)
    assert float(gradient) == pytest.approx(float(exact) * 2 * 0.4, rel=0.02)


def test_edge_tables_of_closed_open_and_crowded_meshes():
    _, faces = icosphere(1)
    table = edge_table(faces)
    assert len(table.edges) == len(faces) * 3 // 2
    assert bool((table.opposite >= 0).all())
    assert len(edge_table(faces[:0]).edges) == 0
    three = torch.tensor([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    table = edge_table(three)
    crowded = table.opposite[(table.edges == torch.tensor([0, 1])).all(dim=1)]
    assert crowded.tolist() == [[2, 3], [3, 4]]


def test_nothing_visible_and_edges_behind_the_camera():
    unit, faces = icosphere(1)
    intrinsics, pose = camera(32, 32, distance=-5.0)
    image = coverage(unit.float().requires_grad_(), faces, intrinsics, pose, 32, 32)
    assert float(image.detach().abs().sum()) == 0
    intrinsics, pose = camera(32, 32, distance=0.9, focal=20.0)
    vertices = unit.float().requires_grad_()
    coverage(vertices, faces, intrinsics, pose, 32, 32).sum().backward()
    assert bool(torch.isfinite(vertices.grad).all())


def test_same_gradient_bytes_on_repeat():
    unit, faces = icosphere(4)
    intrinsics, pose = camera(128, 128)
    gradients = []
    for _ in range(2):
        vertices = unit.float().requires_grad_()
        coverage(vertices, faces, intrinsics, pose, 128, 128).sum().backward()
        gradients.append(vertices.grad)
    assert torch.equal(*gradients)


@pytest.mark.parametrize("distance", [3.7, 1000.0])
def test_through_a_long_lens_an_inner_silhouette_keeps_its_gradient(distance):
    """A thousand diameters away a hundredth of the depth is ten diameters; the scene's extent mends that."""
    square = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    quad = torch.tensor([[0, 1, 2], [0, 2, 3]])
    faces = torch.cat([quad, quad + 4])
    focal = 1.37 * 96 * distance / 3.7
    intrinsics, pose = camera(96, 96, distance=distance, focal=focal)
    scale = torch.tensor(0.4, requires_grad=True)
    vertices = torch.cat([square + torch.tensor([0, 0, 0.1]), square * scale - torch.tensor([0, 0, 0.1])])
    projected = project(vertices, intrinsics, pose)
    fragments = rasterize_projected(projected, faces, 96, 96)
    found = find_silhouette(projected, edge_table(faces), fragments, extent=2.8)
    area = antialias((fragments.face_id >= 2).float()[..., None], projected, found).sum()
    (gradient,) = torch.autograd.grad(area, scale, retain_graph=True)
    exact = 4 * float(intrinsics[0, 0] * intrinsics[1, 1]) / (distance - 0.1) ** 2
    assert float(gradient) == pytest.approx(exact * 2 * 0.4, rel=0.02)
    if distance > 100:
        found = find_silhouette(projected, edge_table(faces), fragments)
        area = antialias((fragments.face_id >= 2).float()[..., None], projected, found).sum()
        assert float(torch.autograd.grad(area, scale)[0]) == 0
