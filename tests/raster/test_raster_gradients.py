"""UV seams change no gradient. Random scenes, discs and spheres are rows of benchmarks/stability, run as tests too."""

import pytest
import torch

from benchmarks.stability.scenes import (
    at_scale,
    camera,
    coverage,
    cube_with_a_chart_per_face,
    derivatives,
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


def check(analytic: torch.Tensor, numeric: torch.Tensor) -> None:
    """Over all directions: 5 % for coverage, 10 % for colour, and neither too long nor too short."""
    of_coverage, of_colour = ((analytic - numeric).norm(dim=0) / numeric.norm(dim=0)).tolist()
    assert of_coverage < 0.05
    assert of_colour < 0.10
    slope = (analytic * numeric).sum(0) / numeric.square().sum(0)
    assert slope.tolist() == pytest.approx([1.0, 1.0], abs=0.04)


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
    check(*derivatives(textured, vertices, torch.zeros(8, dtype=torch.int64), 0, SIZE))
