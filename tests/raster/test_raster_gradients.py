"""Gradients of the picture against finite differences of finely sampled pictures, in float64, and analytic areas."""

import math

import pytest
import torch

from benchmarks.stability.scenes import (
    at_scale,
    camera,
    coverage,
    cube_with_a_chart_per_face,
    derivatives,
    disc,
    random_bodies,
    random_layers,
    smooth_image,
)
from exmesh_graph.raster import (
    antialias,
    edge_table,
    find_silhouette,
    project,
    rasterize_projected,
    shade,
)

SIZE = 160


def check(pairs) -> None:
    """Over all scenes and directions: 5 % for coverage, 10 % for colour, and neither too long nor too short."""
    analytic, numeric = (torch.cat(side) for side in zip(*pairs, strict=True))
    of_coverage, of_colour = ((analytic - numeric).norm(dim=0) / numeric.norm(dim=0)).tolist()
    assert of_coverage < 0.05
    assert of_colour < 0.10
    slope = (analytic * numeric).sum(0) / numeric.square().sum(0)
    assert slope.tolist() == pytest.approx([1.0, 1.0], abs=0.04)


@pytest.mark.parametrize("kind", [random_bodies, random_layers])
def test_random_scenes_of_parts_that_hide_each_other(kind):
    """Outer outlines and depth discontinuities inside the picture; bodies from 80 to 5120 faces each."""

    def one(seed):
        scene = kind(seed, (1, 2, 4)[seed % 3]) if kind is random_bodies else kind(seed)
        vertices, faces, colours, owner = scene
        intrinsics, pose = camera(SIZE, SIZE, turn=0.2 * seed - 0.3, shift=(5.0, -3.0))

        def draw(v, scale):
            return coverage(v, faces, at_scale(intrinsics, scale), pose, scale * SIZE, scale * SIZE, colours)

        return derivatives(draw, vertices, owner, seed, SIZE)

    check([one(seed) for seed in range(5)])


def test_uv_seams_at_every_edge_change_no_gradient():
    vertices, faces, uvs, uv_faces, texture, colours = cube_with_a_chart_per_face()
    intrinsics, pose = camera(SIZE, SIZE, turn=0.5)
    tilt = torch.eye(4, dtype=torch.float64)
    tilt[1:3, 1:3] = torch.tensor([[0.9, -0.4359], [0.4359, 0.9]], dtype=torch.float64)
    pose = pose @ tilt

    def textured(v, scale):
        projected = project(v, at_scale(intrinsics, scale), pose)
        fragments = rasterize_projected(projected, faces, scale * SIZE, scale * SIZE)
        colour = shade(projected, faces, uvs, uv_faces, texture, fragments.face_id)
        layers = torch.cat([(fragments.face_id >= 0).double()[..., None], colour], dim=-1)
        return antialias(layers, projected, find_silhouette(projected, edge_table(faces), fragments))

    start = vertices.clone().requires_grad_()
    by_texture = textured(start, 1)
    by_vertex = coverage(start, faces, intrinsics, pose, SIZE, SIZE, colours)
    assert torch.allclose(by_texture, by_vertex, atol=1e-9)
    weight = smooth_image(SIZE, SIZE, 4, 3)
    gradients = [torch.autograd.grad((image * weight).sum(), start)[0] for image in (by_texture, by_vertex)]
    assert torch.allclose(*gradients, atol=1e-6 * float(gradients[1].abs().max()))
    check([derivatives(textured, vertices, torch.zeros(8, dtype=torch.int64), 0, SIZE)])


@pytest.mark.parametrize("rings", [4, 8, 16, 32, 64])
def test_area_of_a_disc_and_its_derivative(rings):
    """Flat, facing the camera, cut into 6 rings^2 faces: from 100 pixels a face to 0.4."""
    size = 128
    radius_in_pixels = 56.0
    vertices, faces = disc(rings)
    intrinsics = torch.tensor([[size, 0, size / 2 + 0.2], [0, size, size / 2 - 0.3], [0, 0, 1]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[2, 3] = 2.0
    radius = torch.tensor(radius_in_pixels * 2 / size, requires_grad=True)
    area = coverage(vertices.float() * radius, faces, intrinsics, pose, size, size).sum()
    area.backward()
    corners = 6 * rings
    polygon = 0.5 * corners * math.sin(2 * math.pi / corners)
    pixels_per_unit = size / 2
    assert len(faces) == 6 * rings**2
    assert float(area.detach()) == pytest.approx(polygon * radius_in_pixels**2, rel=2e-3)
    assert float(radius.grad) == pytest.approx(2 * polygon * radius_in_pixels * pixels_per_unit, rel=0.01)
