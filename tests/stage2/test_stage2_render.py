"""The forward renderer against closed forms."""

import dataclasses

import numpy as np
import pytest
import torch

from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.shading.specular import directional_albedo, reflectance_table
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.light.traced import traced_specular
from exmesh_graph.stage2.render import render_transport, render_under, render_views
from exmesh_graph.stage2.scene import Body, Lighting
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.surface import CarrierGeometry, texel_footprint


def _only_ball(asset):
    keep = (asset.vertices[asset.faces][:, :, 1] > -0.43).all(axis=1)
    return dataclasses.replace(asset, faces=asset.faces[keep], uv_faces=asset.uv_faces[keep])


def test_convex_body_in_a_uniform_sky(true_asset, cameras):
    """Every pixel: albedo + directional albedo of the specular lobe, times the sky's radiance."""
    ball = _only_ball(true_asset)
    color = np.full_like(ball.base_color, 0.4)
    ball = dataclasses.replace(ball, base_color=color, roughness=np.full_like(ball.roughness, 0.5))
    sky = np.full((16, 32, 3), 0.8, np.float32)
    light = render_transport(ball, 1, directions=512, points=500)
    views = render_views(ball, *(c[:2] for c in cameras), 40, 40, environment=sky, specular_samples=32, transport=light)
    inside = views.alpha > 0.99
    found = views.images[inside].mean(axis=0)
    table = directional_albedo(reflectance_table(), torch.linspace(0.2, 1, 50), torch.full((50,), 0.5), 0.04)
    low, high = 0.8 * (0.4 + float(table.min())), 0.8 * (0.4 + float(table.max()))
    assert low * 0.97 < found.min() <= found.max() < high * 1.03
    np.testing.assert_allclose(views.albedo[inside], 0.4, rtol=1e-4)
    np.testing.assert_allclose(views.roughness[inside], 0.5, rtol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(views.normal[inside], axis=-1), 1, rtol=1e-3)


def test_coverage_is_the_area_of_the_silhouette(true_asset, cameras):
    ball = _only_ball(true_asset)
    intrinsics, poses = (c[:1] for c in cameras)
    light = render_transport(ball, 0, directions=16, points=1)
    views = render_views(ball, intrinsics, poses, 40, 40, supersampling=4, specular_samples=1, transport=light)
    eye = poses[0][:3, 3] - [0, 0.1, 0]
    distance = np.linalg.norm(eye)
    focal = intrinsics[0, 0, 0]
    tangent = 0.5 / np.sqrt(distance**2 - 0.25)
    # a circle near the image centre: the ellipse's stretch 1 / cos(off-axis) is below half a percent here
    assert views.alpha[0].sum() == pytest.approx(np.pi * (focal * tangent) ** 2, rel=0.03)
    assert ((views.images > 0).any(-1) <= (views.alpha > 0)).all()


def test_occlusion_darkens_and_bounces_brighten(true_asset, cameras):
    some = [c[:1] for c in cameras]
    lit = {}
    for bounces in (0, 1, 3):
        light = render_transport(true_asset, bounces, directions=128, points=1500)
        lit[bounces] = render_views(true_asset, *some, 40, 40, transport=light).images.mean()
    assert lit[0] < lit[1] < lit[3]
    assert lit[3] - lit[1] < lit[1] - lit[0]


def test_one_trace_serves_all_lightings(true_asset, cameras):
    """Each picture is what a render of its own gives: another sky, a scaled base colour, no interreflection."""
    some = [c[:2] for c in cameras]
    light = render_transport(true_asset, 2, directions=64, points=500)
    sky, scale = true_asset.environment[:, ::-1].copy() * np.float32(2), np.array([0.5, 1.2, 3.0])
    scaled = np.clip(true_asset.base_color * scale.astype(np.float32), 0, 1)
    painted = dataclasses.replace(true_asset, base_color=scaled)
    lightings = [Lighting(), Lighting(sky, scale), Lighting(bounces=False), Lighting(sky)]
    found = render_under(Body(true_asset, light), *some, 40, 40, lightings)
    alone = [
        render_views(true_asset, *some, 40, 40, transport=light),
        render_views(painted, *some, 40, 40, environment=sky, transport=light),
        render_views(true_asset, *some, 40, 40, transport=dataclasses.replace(light, bounces=0)),
        render_views(true_asset, *some, 40, 40, environment=sky, transport=light),
    ]
    for ours, expected in zip(found, alone, strict=True):
        np.testing.assert_array_equal(ours.images, expected.images)
        np.testing.assert_array_equal(ours.normal, expected.normal)
    assert len({ours.images.mean() for ours in found}) == 4


def test_what_is_covered_more_leaves_the_noise_elsewhere_alone(true_asset, cameras):
    """A speck beside the object, drawn before it: all other pixels keep theirs."""
    some = [c[:1] for c in cameras]
    pose = some[1][0]
    speck = -0.9 * pose[:3, 1] + 0.08 * (np.array([[0, 0], [1, 0], [0, -1]]) @ pose[:3, :2].T)  # above, facing us
    count = len(true_asset.vertices)
    wider = dataclasses.replace(
        true_asset,
        vertices=np.concatenate([true_asset.vertices, speck.astype(np.float32)]),
        faces=np.concatenate([true_asset.faces, [[count, count + 1, count + 2]]]).astype(np.int32),
        uv_faces=np.concatenate([true_asset.uv_faces, true_asset.uv_faces[:1]]),
    )
    shown, other = (
        render_views(asset, *some, 40, 40, transport=render_transport(asset, 0, directions=64, points=2000))
        for asset in (true_asset, wider)
    )
    rest = (shown.alpha == other.alpha) & (shown.alpha > 0)
    assert 0 < (shown.alpha != other.alpha).sum() < 30
    moved = np.abs(other.images[rest] - shown.images[rest]).max(axis=1) > 1e-5
    assert moved.mean() < 0.02  # rays that meet the speck


def test_traced_specular_of_a_convex_body_in_a_uniform_sky_is_the_directional_albedo(true_asset, cameras):
    ball = _only_ball(true_asset)
    geometry = CarrierGeometry(ball)
    rng = np.random.default_rng(0)
    face = torch.from_numpy(rng.integers(0, len(ball.faces), 400))
    bary = torch.from_numpy(rng.dirichlet([1, 1, 1], 400).astype(np.float32))
    eye = torch.tensor([0.3, 1.5, 2.0])
    surface = geometry.samples(face, bary, eye)
    facing = (geometry.vertex_normals[geometry.faces[face]].mean(1) * (eye - surface.position)).sum(1) > 0.8
    surface = geometry.samples(face[facing], bary[facing], eye)
    roughness = torch.full((len(surface),), 0.45)
    found = traced_specular(
        surface,
        geometry.face_normals,
        roughness,
        torch.full((len(surface), 3), 0.04),
        Pyramid(torch.full((16, 32, 3), 2.0)),
        make_ray_tracer(ball.vertices, ball.faces),
        lambda face, bary: torch.zeros(len(face), 3),
        256,
        torch.rand(len(surface), 2, generator=torch.Generator().manual_seed(0)),
    )
    expected = 2.0 * directional_albedo(reflectance_table(), surface.n_v, roughness, 0.04)
    np.testing.assert_allclose(found[:, 0].numpy(), expected.numpy(), rtol=0.06)


def test_gbuffer_matches_projection_and_keeps_neighbours_on_one_surface(carrier, train_views, transport):
    model = Decomposition(
        carrier, train_views, transport, DecompositionSettings(texture_size=64, environment_height=16), "cpu"
    )
    geometry, texels, buffer = model.geometry, model.maps.texels, model.buffers[2]
    samples = buffer.samples(geometry)
    camera = train_views.world_to_camera[2]
    local = samples.position.double().numpy() @ camera[:3, :3].T + camera[:3, 3]
    image = local @ train_views.intrinsics[2].T
    image = image[:, :2] / image[:, 2:]
    centres = np.stack([buffer.pixel.numpy() % 40 + 0.5, buffer.pixel.numpy() // 40 + 0.5], 1)
    np.testing.assert_allclose(image, centres, atol=2e-3)
    jump = (samples.position[buffer.pairs[:, 0]] - samples.position[buffer.pairs[:, 1]]).norm(dim=1)
    assert float(jump.max()) < 0.5  # the ball's edge is farther than that from the slab behind it, or tilted away
    assert len(buffer.pairs) > len(buffer.pixel)
    index, weight = texel_footprint(samples.uv, 64)
    torch.testing.assert_close(texels[buffer.texel], index)
    torch.testing.assert_close(weight.sum(1), torch.ones(len(weight)))


def test_texel_convention_row_zero_is_the_top():
    index, weight = texel_footprint(torch.tensor([[0.5 / 8, 1 - 0.5 / 8], [3.5 / 8, 1 - 6.5 / 8]]), 8)
    for row, expected in ((0, 0), (1, 6 * 8 + 3)):
        assert int(index[row][weight[row].argmax()]) == expected
        assert float(weight[row].max()) == pytest.approx(1, abs=1e-5)
