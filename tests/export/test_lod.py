"""Levels of detail: baked normals, smaller maps, the size that the views can see."""

from dataclasses import replace

import numpy as np
import pytest
from usd_example import SIZE, example_asset, tilted_normals

from exmesh_graph.edit.cameras import orbit
from exmesh_graph.errors import DataError
from exmesh_graph.export.lod import baked_normals, footprint_size, reduced, resized
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.types import Asset, Views
from exmesh_graph.uv.unwrap import unwrap


@pytest.fixture(scope="module")
def sphere():
    vertices, faces = icosphere(4)
    uvs, corners = unwrap(vertices.astype(np.float32), faces.astype(np.int32), 128)[:2]
    return Asset(
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.int32),
        uvs=uvs,
        uv_faces=corners,
        texture=np.zeros((2, 2, 3), np.float32),
        base_color=np.full((128, 128, 3), 0.5, np.float32),
        roughness=np.full((128, 128), 0.5, np.float32),
        seen=np.ones((128, 128), bool),
        environment=np.ones((4, 8, 3), np.float32),
    )


@pytest.mark.thorough
def test_baking_onto_itself_gives_back_the_map(sphere):
    flat = baked_normals(sphere, sphere)
    assert np.abs(flat - [0, 0, 1]).max() < 1e-5
    rng = np.random.default_rng(0)
    bumps = np.concatenate([rng.uniform(-0.4, 0.4, (128, 128, 2)), np.ones((128, 128, 1))], axis=-1)
    bumps = (bumps / np.linalg.norm(bumps, axis=-1, keepdims=True)).astype(np.float32)
    back = baked_normals(replace(sphere, normal=bumps), sphere)
    inside = (back != [0, 0, 1]).any(axis=-1)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(back[inside], bumps[inside], atol=1e-4)


def test_a_coarse_sphere_with_baked_normals_shades_like_the_fine_one(sphere):
    from exmesh_graph.export.lod import _fine_normals

    low = reduced(sphere, 800)
    assert len(low.faces) <= 800 < len(sphere.faces)
    fine, inside = _fine_normals(sphere, 128)

    def miss(asset):
        coarse, also = _fine_normals(asset, 128)
        both = inside & also
        lengths = np.linalg.norm(fine[both], axis=-1) * np.linalg.norm(coarse[both], axis=-1)
        return float(np.mean(1 - (fine * coarse)[both].sum(-1) / lengths))

    assert miss(low) < 1e-4
    assert miss(replace(low, normal=None)) > 10 * miss(low)


def test_smaller_maps_are_means_of_what_lies_in_charts():
    asset = example_asset(normal=tilted_normals(), seen=np.zeros((SIZE, SIZE), bool))
    from exmesh_graph.uv.raster import coverage_counts

    outside = coverage_counts(asset.uvs, asset.uv_faces, SIZE) == 0
    asset.base_color[outside] = [1, 0, 1]  # must not bleed in
    asset.base_color[~outside] = [0.2, 0.4, 0.1]
    small = resized(asset, SIZE // 4)
    assert small.base_color.shape == (8, 8, 3)
    reached = ~outside.reshape(8, 4, 8, 4).all(axis=(1, 3))
    np.testing.assert_allclose(small.base_color[reached], np.tile([0.2, 0.4, 0.1], (reached.sum(), 1)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(small.normal, axis=-1), 1, atol=1e-5)
    assert resized(asset, SIZE) is asset
    with pytest.raises(DataError, match="cannot be reduced to 7"):
        resized(asset, 7)


def test_the_footprint_halves_with_the_pictures(sphere):
    large = replace(
        sphere,
        base_color=np.zeros((2048, 2048, 3), np.float32),
        roughness=np.zeros((2048, 2048), np.float32),
        seen=np.ones((2048, 2048), bool),
        normal=None,
        metallic=None,
        confidence=None,
    )
    sizes = []
    for pixels in (64, 128, 256):
        intrinsics, pose = orbit(6, pixels, pixels)
        blank = np.zeros((6, pixels, pixels), np.float32)
        views = Views(tuple("abcdef"), np.zeros((6, pixels, pixels, 3), np.float32), blank, intrinsics, pose, "train")
        sizes.append(footprint_size(large, views))
    assert sizes[1:] == [2 * sizes[0], 4 * sizes[0]]
    assert footprint_size(sphere, views) == 128  # never above what there is
