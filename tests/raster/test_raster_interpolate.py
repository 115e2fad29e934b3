"""Barycentric coordinates, interpolation and the fused shading kernel."""

import pytest
import torch

from benchmarks.stability.scenes import camera, icosphere, soup
from exmesh_graph.raster import barycentrics, interpolate, project, rasterize, rasterize_projected, shade
from exmesh_graph.raster.interpolate import shade_reference


def scene(seed: int = 0, size: int = 24):
    """A sphere with a random per-corner UV map, seen at an angle: tensors of `shade`, float64."""
    g = torch.Generator().manual_seed(seed)
    vertices, faces = icosphere(1)
    intrinsics, pose = camera(size, size, turn=0.3, shift=(2.0, -1.0))
    projected = project(vertices, intrinsics, pose)
    uvs = torch.rand(3 * len(faces), 2, generator=g, dtype=torch.float64) * 0.3 + 0.35
    uv_faces = torch.arange(3 * len(faces)).reshape(-1, 3)
    texture = torch.rand(9, 13, 3, generator=g, dtype=torch.float64)
    face_id = rasterize_projected(projected, faces, size, size).face_id
    return projected, faces, uvs, uv_faces, texture, face_id


def test_barycentrics_equal_the_fragments():
    vertices, faces = soup(30, 0.6, seed=4)
    intrinsics, pose = camera(40, 30, turn=0.7, shift=(3.0, 9.0))
    got = rasterize(vertices, faces, intrinsics, pose, 30, 40)
    pixels = torch.nonzero(got.face_id.view(-1) >= 0)[:, 0]
    projected = project(vertices.double(), intrinsics, pose)
    bary = barycentrics(projected, faces, got.face_id.view(-1)[pixels], pixels, 40)
    assert torch.allclose(bary.float(), got.bary.view(-1, 3)[pixels], atol=2e-3)
    assert torch.allclose(bary.sum(1), torch.ones(len(bary), dtype=torch.float64))


def test_interpolating_positions_gives_the_point_under_the_pixel():
    """Perspective-correct: the interpolated world position projects back to the pixel's centre."""
    vertices, faces = soup(30, 0.8, seed=1)
    intrinsics, pose = camera(40, 30)
    got = rasterize(vertices, faces, intrinsics, pose, 30, 40)
    points = interpolate(vertices, faces, got.face_id, got.bary)
    seen = got.face_id >= 0
    x, y, z = project(points[seen], intrinsics, pose).unbind(1)
    rows, columns = torch.nonzero(seen, as_tuple=True)
    assert torch.allclose(x / z, columns + 0.5, atol=2e-2)
    assert torch.allclose(y / z, rows + 0.5, atol=2e-2)
    assert torch.allclose(z, got.depth[seen], rtol=1e-4)
    assert bool((points[~seen] == 0).all())


@pytest.mark.thorough
def test_gradients_of_barycentrics_and_interpolation():
    projected, faces, uvs, uv_faces, _, face_id = scene(size=8)
    flat = face_id.view(-1)
    pixels = torch.nonzero(flat >= 0)[:, 0]

    def attributes(p, a):
        bary = barycentrics(p, faces, flat[pixels], pixels, 8)
        return interpolate(a, uv_faces, flat[pixels], bary)

    projected.requires_grad_()
    uvs.requires_grad_()
    assert torch.autograd.gradcheck(attributes, (projected, uvs))


@pytest.mark.thorough
def test_gradients_of_the_shading_reference():
    projected, faces, uvs, uv_faces, texture, face_id = scene(size=8)

    def image(p, t):
        return shade(p, faces, uvs, uv_faces, t, face_id)

    assert torch.autograd.gradcheck(image, (projected.requires_grad_(), texture.requires_grad_()), eps=1e-7)


def test_fused_shading_equals_the_reference_in_value_and_gradient():
    projected, faces, uvs, uv_faces, texture, face_id = scene()
    weight = torch.randn(24, 24, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(8))
    results = {}
    for name, of, dtype in (("fused", shade, torch.float32), ("reference", shade_reference, torch.float64)):
        p, t = (x.to(dtype).requires_grad_() for x in (projected.detach(), texture.detach()))
        image = of(p, faces, uvs.to(dtype), uv_faces, t, face_id)
        results[name] = (image, *torch.autograd.grad((image * weight.to(dtype)).sum(), (p, t)))
    for got, want in zip(results["fused"], results["reference"], strict=True):
        scale = want.detach().abs().max()
        assert float((got - want).detach().abs().max() / scale) < 2e-4
        assert float(scale) > 0.1


def test_shading_without_uv_gradient_leaves_the_vertices_alone():
    projected, faces, uvs, uv_faces, texture, face_id = scene()
    texture = texture.float().requires_grad_()
    image = shade(projected.float(), faces, uvs, uv_faces, texture, face_id)
    assert bool((image[face_id < 0] == 0).all())
    (gradient,) = torch.autograd.grad(image.sum(), texture)
    assert float(gradient.sum()) == pytest.approx(3 * int((face_id >= 0).sum()), rel=1e-5)


@pytest.mark.parametrize("of", [shade, shade_reference])
def test_an_empty_mesh_gives_a_black_image(of):
    empty = torch.zeros(0, 3)
    image = of(
        empty,
        torch.zeros(0, 3, dtype=torch.int32),
        torch.zeros(0, 2),
        torch.zeros(0, 3, dtype=torch.int32),
        torch.rand(4, 4, 3, requires_grad=True),
        torch.full((5, 6), -1, dtype=torch.int32),
    )
    assert image.shape == (5, 6, 3)
    assert float(image.abs().sum()) == 0
    image.sum().backward()


def test_the_sparse_texture_gradient_of_shading_is_the_dense_one_without_the_unseen_texels():
    projected, faces, uvs, uv_faces, texture, face_id = scene()
    weight = torch.randn(24, 24, 3, generator=torch.Generator().manual_seed(8))
    gradients = []
    for sparse in (False, True):
        p, t = projected.float().requires_grad_(), texture.float().requires_grad_()
        image = shade(p, faces, uvs.float(), uv_faces, t, face_id, sparse=sparse)
        gradients.append(torch.autograd.grad((image * weight).sum(), (p, t)))
    assert gradients[1][1].is_sparse
    assert gradients[1][1]._nnz() < 9 * 13
    assert torch.equal(gradients[0][0], gradients[1][0])
    assert torch.allclose(gradients[0][1], gradients[1][1].to_dense(), atol=1e-6)
