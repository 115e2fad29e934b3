"""Batches of views, tiles of large faces, sizes at the limits."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.stability.scenes import camera, icosphere, soup
from exmesh_graph.gpu.limits import check_size
from exmesh_graph.raster import (
    antialias,
    barycentrics,
    edge_table,
    find_silhouette,
    project,
    rasterize,
    rasterize_projected,
    sample_texture,
    shade,
    uv_footprint,
)
from exmesh_graph.raster.interpolate import shade_reference


def cameras(width, height):
    each = [camera(width, height, turn=t, shift=(4.0 * t, -2.0)) for t in (0.0, 0.4, 1.3)]
    return torch.stack([k for k, _ in each]), torch.stack([pose for _, pose in each])


def test_a_batch_of_views_is_the_views_one_by_one():
    height, width = 30, 44
    unit, faces = icosphere(2)
    table = edge_table(faces)
    intrinsics, poses = cameras(width, height)
    uvs = torch.rand(len(unit), 2, generator=torch.Generator().manual_seed(0))
    texture = torch.rand(16, 16, 3, generator=torch.Generator().manual_seed(1))
    weight = torch.randn(3, height, width, 4, generator=torch.Generator().manual_seed(2))

    def picture(projected, texture):
        fragments = rasterize_projected(projected, faces, height, width)
        colour = shade(projected, faces, uvs, faces, texture, fragments.face_id)
        layers = torch.cat([colour, (fragments.face_id >= 0).float()[..., None]], dim=-1)
        return antialias(layers, projected, find_silhouette(projected, table, fragments))

    results = []
    for together in (True, False):
        vertices, texels = (0.9 * unit).float().requires_grad_(), texture.clone().requires_grad_()
        if together:
            projected = project(vertices, intrinsics, poses)
            image = picture(projected, texels)
        else:
            each = [project(vertices, k, pose) for k, pose in zip(intrinsics, poses, strict=True)]
            projected = torch.stack(each)
            image = torch.stack([picture(p, texels) for p in each])
        results.append((projected, image, *torch.autograd.grad((image * weight).sum(), (vertices, texels))))
    assert results[0][1].shape == (3, height, width, 4)
    for got, want in zip(*results, strict=True):
        assert torch.allclose(got, want, atol=1e-4 * float(want.detach().abs().max()))


def test_one_camera_is_shared_by_a_batch_of_poses():
    vertices, faces = soup(20, 0.5, seed=0)
    intrinsics, poses = cameras(16, 12)
    got = rasterize(vertices, faces, intrinsics[0], poses, 12, 16)
    for k, pose in enumerate(poses):
        want = rasterize(vertices, faces, intrinsics[0], pose, 12, 16)
        assert (got.face_id[k] == want.face_id).float().mean() > 0.99
        assert got.bary[k].shape == want.bary.shape


def test_pixels_of_a_batch_are_numbered_through():
    """Barycentrics, uv derivatives and the reference shading take flat pixels of all views together."""
    height, width = 10, 14
    unit, faces = icosphere(1)
    intrinsics, poses = cameras(width, height)
    projected = project(unit, intrinsics, poses)
    fragments = rasterize_projected(projected, faces, height, width)
    flat = fragments.face_id.view(-1)
    pixels = torch.nonzero(flat >= 0)[:, 0]
    bary = barycentrics(projected, faces, flat[pixels], pixels, width, height)
    assert torch.allclose(bary.float(), fragments.bary.view(-1, 3)[pixels], atol=1e-4)
    uvs = torch.rand(len(unit), 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    slopes = uv_footprint(projected, faces, uvs, faces, flat[pixels], pixels, width, height)
    last = pixels // (height * width) == 2
    local = pixels[last] - 2 * height * width
    alone = uv_footprint(projected[2], faces, uvs, faces, flat[pixels][last], local, width)
    assert torch.equal(slopes[last], alone)
    texture = torch.rand(5, 5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    image = shade_reference(projected, faces, uvs, faces, texture, fragments.face_id)
    one = shade_reference(projected[1], faces, uvs, faces, texture, fragments.face_id[1])
    assert torch.equal(image[1], one)
    with pytest.raises(ValueError, match="height"):
        barycentrics(projected, faces, flat[pixels], pixels, width)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    size=st.sampled_from([0.05, 0.5, 3.0, 30.0]),
    above=st.sampled_from([1, 7, 256, 2000]),
    cull=st.booleans(),
)
def test_tiles_of_large_faces_change_nothing(seed, size, above, cull):
    """Also where faces reach far outside the picture and behind the camera."""
    vertices, faces = soup(40, size, seed)
    intrinsics, pose = camera(75, 50, turn=0.4, shift=(7.0, -4.0))
    projected = project(vertices, intrinsics, pose)
    whole = rasterize_projected(projected, faces, 50, 75, cull_back=cull, large_face=0)
    tiled = rasterize_projected(projected, faces, 50, 75, cull_back=cull, large_face=above)
    for a, b in zip(whole, tiled, strict=True):
        assert torch.equal(a, b)


def test_sizes_beyond_the_index_are_refused_before_anything_is_allocated():
    check_size(faces=2**31 - 1, pixels=2**31 - 1)
    with pytest.raises(ValueError, match="2147483648 faces in one view"):
        check_size(faces=2**31)
    vertices, faces = soup(1, 0.5, seed=0)
    with pytest.raises(ValueError, match="pixels in one view"):
        rasterize_projected(vertices, faces, 2**16, 2**16)
    with pytest.raises(ValueError, match="values in one view"):
        sample_texture(torch.zeros(1, 1, 4), torch.zeros(1, 2).expand(2**30, 2))


@pytest.mark.parametrize("index", [-1, 3, 2**20])
def test_indices_outside_the_mesh_are_refused_not_read(index):
    vertices, faces = soup(1, 0.5, seed=0)
    bad = torch.tensor([[0, 1, index]])
    with pytest.raises(IndexError, match="faces hold indices"):
        rasterize_projected(vertices, bad, 4, 4)
    face_id = torch.zeros(2, 2, dtype=torch.int32)
    with pytest.raises(IndexError, match="uv_faces hold indices"):
        shade(vertices, faces, torch.zeros(3, 2), bad, torch.zeros(2, 2, 3), face_id)


@pytest.mark.thorough
@pytest.mark.parametrize("kernels", ["visibility", "texture", "silhouette"])
def test_the_same_kernels_compile_for_cuda(kernels, tmp_path):
    """To PTX, which takes no CUDA device."""
    from exmesh_graph.gpu.warp_runtime import warp
    from exmesh_graph.raster import runtime

    wp = warp()
    if not hasattr(wp, "compile_aot_module"):
        pytest.skip("this version of Warp cannot compile ahead of time")
    wp.compile_aot_module(runtime.kernels(kernels), arch=80, module_dir=str(tmp_path), use_ptx=True)
    assert [path.suffix for path in tmp_path.glob("*.ptx")] == [".ptx"]


@pytest.mark.parametrize("near", [0.0, -1.0, float("nan"), float("inf")])
def test_a_near_plane_must_lie_before_the_camera(near):
    vertices, faces = soup(1, 0.5, seed=0)
    with pytest.raises(ValueError, match="near plane"):
        rasterize_projected(vertices, faces, 4, 4, near=near)


def test_the_key_keeps_faces_with_numbers_of_32_bits_apart():
    """Depth above, face below: the largest face index loses a tie to a smaller one and wins when nearer."""
    from exmesh_graph.gpu.warp_runtime import warp

    warp()
    largest = 2**31 - 1
    depth = torch.tensor([1.0, 1.0, 0.99999994]).view(torch.int32).long()
    face = torch.tensor([largest, largest - 1, largest])
    keys = (depth << 32) | face
    assert int(keys.argmin()) == 2
    assert int(keys[1]) < int(keys[0])
    assert (keys & 0xFFFFFFFF).tolist() == face.tolist()
    assert bool((keys >= 0).all())
