"""The same picture and the same gradients on CUDA as on the CPU."""

import pytest
import torch

from benchmarks.stability.scenes import camera, icosphere, soup
from exmesh_graph.raster import (
    antialias,
    edge_table,
    find_silhouette,
    mip_pyramid,
    project,
    rasterize_projected,
    sample_mipmap,
    sample_texture,
    shade,
)

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device that torch can use; found none"),
]


def scenes():
    unit, faces = icosphere(4)
    yield "sphere", (0.9 * unit).float(), faces
    for size in (0.05, 0.5, 30.0):
        yield f"triangles of size {size}", *soup(200, size, seed=1)


@pytest.mark.parametrize("scene", list(scenes()), ids=lambda s: s[0])
@pytest.mark.parametrize("cull", [False, True])
def test_visibility(scene, cull):
    """Tiles are in use on CUDA. Arithmetic is the same but for the last bits of divisions, which may decide ties."""
    _, vertices, faces = scene
    intrinsics, pose = camera(200, 150, turn=0.4, shift=(7.0, -4.0))
    projected = project(vertices, intrinsics, pose)
    here = rasterize_projected(projected, faces, 150, 200, cull_back=cull)
    there, again = (rasterize_projected(projected.cuda(), faces.cuda(), 150, 200, cull_back=cull) for _ in range(2))
    same = here.face_id == there.face_id.cpu()
    assert float(same.float().mean()) > 0.999
    assert torch.allclose(here.depth[same], there.depth.cpu()[same], rtol=1e-5)
    assert torch.allclose(here.bary[same], there.bary.cpu()[same], atol=1e-3)
    for a, b in zip(there, again, strict=True):
        assert torch.equal(a, b)


def test_tiles_of_large_faces_change_nothing_on_cuda():
    vertices, faces = soup(200, 30.0, seed=1)
    intrinsics, pose = camera(200, 150)
    projected = project(vertices, intrinsics, pose).cuda()
    whole, tiled = (rasterize_projected(projected, faces.cuda(), 150, 200, large_face=n) for n in (0, 256))
    for a, b in zip(whole, tiled, strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("batch", [False, True])
def test_shading_and_antialiasing_in_value_and_gradient(batch):
    unit, faces = icosphere(4)
    size = 128
    each = [camera(size, size, turn=t) for t in (0.0, 0.7)]
    intrinsics, poses = (torch.stack(c) for c in zip(*each, strict=True)) if batch else each[0]
    uvs = torch.rand(len(unit), 2, generator=torch.Generator().manual_seed(0)) * 0.1 + 0.4
    texture = torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(1))
    results = []
    for device in ("cpu", "cuda"):
        vertices = (0.9 * unit).float().to(device).requires_grad_()
        texels = texture.to(device).requires_grad_()
        f = faces.to(device)
        projected = project(vertices, intrinsics, poses)
        fragments = rasterize_projected(projected, f, size, size)
        colour = shade(projected, f, uvs.to(device), f, texels, fragments.face_id)
        layers = torch.cat([colour, (fragments.face_id >= 0).float()[..., None]], dim=-1)
        image = antialias(layers, projected, find_silhouette(projected, edge_table(f), fragments))
        weight = torch.randn(image.shape, generator=torch.Generator().manual_seed(2)).to(device)
        results.append([image.detach(), *torch.autograd.grad((image * weight).sum(), (vertices, texels))])
    for a, b in zip(*results, strict=True):
        error = (a - b.cpu()).abs()
        assert float(error.mean()) < 2e-3 * float(a.abs().mean())


@pytest.mark.parametrize("wrap", ["clamp", "repeat", "mirror"])
@pytest.mark.parametrize("sparse", [False, True])
def test_texture_lookup_in_value_and_gradient(wrap, sparse):
    g = torch.Generator().manual_seed(0)
    texture, uv = torch.rand(33, 20, 3, generator=g), torch.rand(500, 2, generator=g) * 3 - 1
    results = []
    for device in ("cpu", "cuda"):
        t, q = texture.to(device).requires_grad_(), uv.to(device).requires_grad_()
        value = sample_texture(t, q, wrap=wrap, sparse=sparse)
        by_texture, by_uv = torch.autograd.grad(value.square().sum(), (t, q))
        results.append([value.detach(), by_texture.to_dense(), by_uv])
    for a, b in zip(*results, strict=True):
        assert torch.allclose(a, b.cpu(), rtol=1e-3, atol=1e-3)


def test_mip_maps():
    g = torch.Generator().manual_seed(0)
    pyramid, uv, level = mip_pyramid(torch.rand(32, 32, 3, generator=g)), torch.rand(500, 2, generator=g), 5.0
    levels = torch.rand(500, generator=g) * level
    here = sample_mipmap(pyramid, uv, levels)
    there = sample_mipmap([t.cuda() for t in pyramid], uv.cuda(), levels.cuda())
    assert torch.allclose(here, there.cpu(), atol=1e-4)
