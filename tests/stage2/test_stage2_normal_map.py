"""Normal maps: diffuse light under bent normals against quadrature, flat maps change nothing, bumps are recovered."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.shading import envmap
from exmesh_graph.shading.operators import LightTransport, VectorTransport
from exmesh_graph.shading.transport import trace_transport, with_bounces
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.objective import weighted_terms
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.surface import CarrierGeometry, TangentFrames, bent, bent_irradiance, normals_of, slopes_of
from exmesh_graph.types import Views
from tests.stage2.conftest import SIZE

SETTINGS = DecompositionSettings(
    texture_size=64, environment_height=16, iterations=240, material_rate=0.1, environment_rate=0.3, factor_rate=0.06,
    ssim_weight=0.0, material_weight=0.003, environment_weight=0.001, chroma_weight=0.0, indirect_ramp=10,
    corrections=2, correction_samples=8, normal_map=True,
)  # fmt: skip


def _slopes(size):
    """Bumps of up to 23 degrees, in the normal map alone."""
    v, u = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij")
    return 0.3 * np.stack([np.sin(30 * u), np.cos(25 * v)], -1)


@pytest.mark.parametrize("bounces", [0, 2])
def test_light_under_bent_normals_equals_quadrature(transport, bounces):
    """Every direction above both horizons: exact. Else off by what lies between them, of second order in the angle."""
    light = transport if bounces else dataclasses.replace(transport, bounces=0, gather_start=None)
    operators = LightTransport(light)
    vectors = VectorTransport(operators)
    generator = torch.Generator().manual_seed(0)
    radiance = torch.rand(len(light.directions), 3, generator=generator)
    sent = torch.rand(len(light.points), 3, generator=generator) if bounces else None
    # what arrives along each direction: from the sky where it is free, from the mesh's points where it is blocked
    bits = np.unpackbits(light.visible, axis=1, count=len(light.directions), bitorder="little")
    arriving = bits[:, :, None] * radiance.numpy()[None]
    if sent is not None:
        from exmesh_graph.shading.lattice import locate

        bary = np.concatenate([1 - light.hit_bary.sum(1, keepdims=True), light.hit_bary], axis=1)
        point, weight = locate(light, light.hit_face, bary)
        back = (sent.numpy()[point] * weight[..., None]).sum(1) * 4 * math.pi / len(light.directions)
        np.add.at(arriving, (light.hit_point, light.hit_direction), back)
    smooth = light.normals.astype(np.float64)
    above = smooth @ light.directions.T > 0

    def quadrature(normal, clipped):
        cosine = normal @ light.directions.T
        return (np.where(above, np.maximum(cosine, 0) if clipped else cosine, 0)[..., None] * arriving).sum(1)

    turn = np.random.default_rng(1).normal(size=smooth.shape)
    turn -= (turn * smooth).sum(1, keepdims=True) * smooth
    flat = torch.from_numpy(quadrature(smooth, True)).float()
    vector = vectors.vector(radiance, sent)
    errors = []
    for angle in (0.0, 0.1, 0.2):
        mapped = math.cos(angle) * smooth + math.sin(angle) * turn / np.linalg.norm(turn, axis=1, keepdims=True)
        found = bent_irradiance(flat, vector, *(torch.from_numpy(n).float() for n in (smooth, mapped))).numpy()
        np.testing.assert_allclose(found, np.maximum(quadrature(mapped, False), 0), rtol=2e-4, atol=2e-4)
        errors.append(np.abs(found - quadrature(mapped, True)).mean() / flat.mean().item())
    assert errors[0] < 1e-6
    assert errors[1] < 0.004
    assert errors[2] < 0.016


def test_bent_normals_follow_the_frame(carrier):
    geometry, frames = CarrierGeometry(carrier), TangentFrames(carrier)
    face = torch.arange(len(carrier.faces))
    bary = torch.full((len(face), 3), 1 / 3)
    surface = geometry.samples(face, bary, torch.tensor([0.3, 2.0, 0.5]))
    frame = frames.at(geometry, face, bary)
    same = bent(surface, frame, torch.zeros(len(face), 2))
    for name in ("normal", "reflected", "n_v"):
        torch.testing.assert_close(getattr(same, name), getattr(surface, name), atol=2e-6, rtol=0)
    wild = torch.randn(len(face), 2, generator=torch.Generator().manual_seed(0)) * 20
    turned = bent(surface, frame, wild.requires_grad_())
    assert float((turned.normal.detach().norm(dim=-1) - 1).abs().max()) < 1e-5
    assert float(turned.n_v.detach().min()) > 0
    (turned.reflected.sum() + turned.n_v.sum()).backward()
    assert bool(torch.isfinite(wild.grad).all())
    tilted = bent(surface, frame, torch.tensor([[0.2, 0.0]]).expand(len(face), 2))
    facing = surface.n_v > 0.3
    rise = ((tilted.normal - surface.normal) * frame[0]).sum(-1)[facing]
    assert float(rise.median()) == pytest.approx(0.2 / math.hypot(1, 0.2), abs=0.01)
    assert float((rise > 0.1).float().mean()) > 0.9  # not where charts run together at the ball's poles


def test_a_mirror_seen_from_above_reflects_the_pole_with_finite_gradients(carrier):
    """Longitude has no derivative at the poles of the sky."""
    geometry, frames = CarrierGeometry(carrier), TangentFrames(carrier)
    face = torch.tensor([len(carrier.faces) - 1])  # of the slab, which faces up
    bary = torch.full((1, 3), 1 / 3)
    below = geometry.samples(face, bary, torch.tensor([0.0, 5.0, 0.0])).position[0]
    surface = geometry.samples(face, bary, below + torch.tensor([0.0, 5.0, 0.0]))
    slopes = torch.zeros(1, 2, requires_grad=True)
    u, v = envmap.uv_of(bent(surface, frames.at(geometry, face, bary), slopes).reflected)
    (u + v).sum().backward()
    assert bool(torch.isfinite(slopes.grad).all())


def test_slopes_and_normals_are_inverse():
    slopes = np.random.default_rng(0).normal(size=(5, 7, 2)).astype(np.float32)
    np.testing.assert_allclose(slopes_of(normals_of(slopes)), slopes, rtol=1e-5, atol=1e-6)
    assert (normals_of(slopes)[..., 2] > 0).all()


def test_a_flat_map_changes_neither_renders_nor_the_fits_model(true_asset, cameras, carrier, train_views, transport):
    light = render_transport(true_asset, 1, directions=64, points=1000)
    flat = dataclasses.replace(true_asset, normal=normals_of(np.zeros((64, 64, 2), np.float32)))
    plain, mapped = (
        render_views(a, *(c[:1] for c in cameras), SIZE, SIZE, transport=light) for a in (true_asset, flat)
    )
    np.testing.assert_allclose(mapped.images, plain.images, atol=2e-5)
    np.testing.assert_allclose(mapped.normal, plain.normal, atol=2e-5)
    losses = []
    for settings in (SETTINGS, SETTINGS.replaced(normal_map=False, material_weight=0.0)):
        model = Decomposition(carrier, train_views, transport, settings.replaced(material_weight=0.0), "cpu")
        model.start()
        losses.append(float(weighted_terms(model, model.buffers[1], 100)[0]["image"].detach()))
    assert losses[0] == pytest.approx(losses[1], rel=1e-4)


@pytest.mark.slow
def test_bumps_in_the_normal_map_alone_are_recovered(true_asset, cameras, carrier, transport):
    """Known light, one gray gloss: the angle to the true normals falls, and true normals stay.

    Base colour is free in every texel and takes half the bumps' diffuse shading for colour, so they fall slowly; the
    coat's reflection tells them apart.
    """
    intrinsics, poses = cameras
    uniform = dataclasses.replace(
        true_asset,
        base_color=np.full((64, 64, 3), 0.4, np.float32),
        roughness=np.full((64, 64), 0.25, np.float32),
    )
    true = dataclasses.replace(uniform, normal=normals_of(_slopes(64)))
    shown = render_views(true, intrinsics, poses, SIZE, SIZE, transport=render_transport(true, 2, 256, 4000))
    views = Views(
        names=tuple(f"v{k}" for k in range(8)), images=shown.images[:8], alpha=shown.alpha[:8],
        intrinsics=intrinsics[:8], camera_to_world=poses[:8], split="train", clipped=False,
    )  # fmt: skip
    size = 28  # about one texel per pixel
    settings = SETTINGS.replaced(texture_size=size, keep_light=True)
    slopes, wanted = _slopes(size), normals_of(_slopes(size))

    def error(normal, seen):
        return np.degrees(np.arccos(np.clip((normal * wanted).sum(-1), -1, 1)))[seen].mean()

    asset, _ = fit(carrier, views, transport, settings, seed=2, start=uniform)
    start, end = error(np.array([0, 0, 1.0]), asset.seen), error(asset.normal, asset.seen)
    assert start > 15
    assert end < 0.85 * start
    found = slopes_of(asset.normal)[asset.seen]
    for axis in range(2):
        assert np.corrcoef(found[:, axis], slopes[asset.seen][:, axis])[0, 1] > 0.45
    np.testing.assert_allclose(np.linalg.norm(asset.normal, axis=-1), 1, atol=1e-5)

    gentle = settings.replaced(iterations=20, material_rate=0.02)
    kept, _ = fit(carrier, views, transport, gentle, seed=2, start=true)
    assert error(kept.normal, kept.seen) < 0.2 * start
    with pytest.raises(DataError, match="normal map"):
        fit(carrier, views, transport, settings.replaced(normal_map=False), start=asset)


def test_bounced_light_is_part_of_the_vector(carrier):
    light = with_bounces(trace_transport(carrier.vertices, carrier.faces, 64), 1)
    vectors = VectorTransport(LightTransport(light))
    sent = torch.ones(len(light.points), 3)
    dark = torch.zeros(len(light.directions), 3)
    assert float(vectors.vector(dark, sent).abs().max()) > 0.05
    assert float(vectors.vector(dark).abs().max()) == 0


@pytest.mark.parametrize("secondary_material", [True, False])
def test_the_bounced_vector_along_the_smooth_normal_is_the_bounced_irradiance(carrier, secondary_material):
    light = with_bounces(trace_transport(carrier.vertices, carrier.faces, 64), 1, secondary_material)
    operators = LightTransport(light)
    generator = torch.Generator().manual_seed(0)
    radiance = torch.rand(len(light.directions), 3, generator=generator)
    diffuse = torch.rand(len(light.points), 3, generator=generator)
    direct = operators.irradiance(radiance)
    vectors, strength = VectorTransport(operators), 0.7
    if secondary_material:
        vector = vectors.vector(radiance, strength * diffuse * direct)
    else:
        vector = vectors.vector(radiance, direct, strength * diffuse)
    along = (torch.from_numpy(light.normals)[:, :, None] * vector.reshape(-1, 3, 3)).sum(1)
    torch.testing.assert_close(along, operators.irradiance(radiance, diffuse, strength), rtol=1e-4, atol=1e-4)
