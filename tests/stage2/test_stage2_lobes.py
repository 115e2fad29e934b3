"""Fused lobes against plain ones in float64: rays, what they meet, light under several skies; hard inputs; cores."""

import dataclasses

import pytest
import torch

from exmesh_graph.gpu.cores import cores
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.stage2.light.fused_lobes import FusedLobes, trace_lobes
from exmesh_graph.stage2.light.lobes import PlainLobes, Sky
from exmesh_graph.stage2.surface import CarrierGeometry


@pytest.fixture(scope="module")
def tracer(carrier):
    return make_ray_tracer(carrier.vertices, carrier.faces)


def _random(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def _seen(carrier, count, seed=0):
    """Points all over the mesh, seen from where grazing angles and turned-away faces are frequent."""
    geometry = CarrierGeometry(carrier)
    face = (_random(count, seed=seed) * len(carrier.faces)).long()
    bary = _random(count, 3, seed=seed + 1) + 1e-3
    surface = geometry.samples(face, bary / bary.sum(1, keepdim=True), torch.tensor([0.6, 0.9, 1.2]))
    roughness = 1.2 * _random(count, seed=seed + 2) - 0.1
    return geometry, surface, roughness.clamp(0, 1), _random(count, 2, seed=seed + 3)


def _wide(value):
    return {name: v.double() if v.is_floating_point() else v for name, v in vars(value).items()}


def _both(carrier, tracer, count, samples, seed=0):
    geometry, surface, roughness, shift = _seen(carrier, count, seed)
    found = FusedLobes.traced(surface, geometry.face_normals, roughness, tracer, samples, shift)
    exact = dataclasses.replace(surface, **_wide(surface))
    expected = PlainLobes.traced(
        exact, geometry.face_normals.double(), roughness.double(), tracer, samples, shift.double()
    )
    return found, expected


def _sky(height, width, seed, extra=False):
    levels = [10 * _random(height, width, 3, seed=seed + k) ** 4 for k in range(2)]
    return Sky(Pyramid(levels[0]), Pyramid(levels[1]) if extra else None)


def _double(sky):
    more = None if sky.extra is None else Pyramid(sky.extra.levels[0].double())
    return Sky(Pyramid(sky.pyramid.levels[0].double()), more)


def _sent(lobes, dtype):
    """Any smooth function of where on the mesh rays met it."""
    return torch.stack([lobes.bary[:, 0], lobes.face / 500, lobes.bary[:, 2] ** 2], 1).to(dtype)


@pytest.mark.parametrize(
    ("count", "samples", "shared"), [(1, 1, 1), (7, 12, 3.5), (9, 5, 1), (700, 16, 1), (700, 4, 4)]
)
def test_light_agrees_with_plain_lobes(carrier, tracer, count, samples, shared):
    found, expected = _both(carrier, tracer, count, samples)
    f0, extra = _random(count, 3, seed=8), _random(count, seed=9) < 0.5
    for sky in (_sky(16, 32, 3), _sky(64, 128, 4, extra=True), _sky(2, 4, 5)):
        fused = found.radiance(f0, sky, _sent(found, torch.float32), extra, shared).double()
        plain = expected.radiance(f0.double(), _double(sky), _sent(expected, torch.float64), extra, shared)
        assert torch.isfinite(fused).all()
        error = ((fused - plain).abs() / (plain + 1e-2 * plain.mean() + 1e-9)).amax(dim=1)
        # a ray within rounding of an edge or of a horizon may fall on its other side
        assert float((error < 2e-3).double().mean()) > 0.985
        assert float(fused.mean()) == pytest.approx(float(plain.mean()), rel=2e-3)


def test_rays_agree_with_plain_lobes(carrier, tracer):
    """Ray by ray: weights, Fresnel powers, places in the sky and solid angles; nearly all to seven digits."""
    found, expected = _both(carrier, tracer, 300, 8)
    from exmesh_graph.shading.envmap import uv_of

    groups = found.rays.shape[0]
    rays = found.rays.double().permute(0, 3, 1, 2).reshape(groups * 8, 8, 5)[:300]
    weight = torch.zeros(300, 8, dtype=torch.float64)
    rank = torch.cat([torch.arange(n) for n in torch.bincount(expected.row, minlength=300).tolist()])
    kept = rays[..., 0] > 0
    counts = torch.bincount(expected.row, minlength=300)
    same = kept.sum(1) == counts
    assert float(same.double().mean()) > 0.99
    assert 0.3 < float(kept.double().mean()) < 0.999  # some rays are below the horizon, by the normal or by the face
    weight[expected.row, rank] = expected.weight
    rows = torch.nonzero(same)[:, 0]
    chosen = torch.isin(expected.row, rows)
    ours = rays[rows][kept[rows]]
    torch.testing.assert_close(ours[:, 0], expected.weight[chosen], rtol=2e-4, atol=1e-6)
    torch.testing.assert_close(ours[:, 1], ((1 - expected.v_h[chosen]).clamp(0, 1) ** 5), rtol=2e-3, atol=1e-6)
    u, v = uv_of(expected.direction[chosen])
    turned = (ours[:, 2] - u).abs()
    assert float(torch.minimum(turned, 1 - turned).quantile(0.99)) < 1e-5
    torch.testing.assert_close(ours[:, 3], v, rtol=0, atol=1e-5)
    torch.testing.assert_close(ours[:, 4], 0.5 * expected.solid_angle[chosen].log2(), rtol=0, atol=2e-3)


def test_a_lobe_without_use_is_black(carrier, tracer):
    """Seen from below the face's own plane, every reflected ray would start inside."""
    geometry, surface, roughness, shift = _seen(carrier, 20)
    turned = dataclasses.replace(surface, flat=-surface.view, normal=surface.view)
    lobes = trace_lobes(turned, geometry.face_normals, 0 * roughness, tracer, 4, shift)
    sky = _sky(16, 32, 3)
    assert float(lobes.radiance(torch.ones(20, 3), sky, _sent(lobes, torch.float32)).abs().max()) == 0


def test_no_points_at_all(carrier, tracer):
    geometry, surface, roughness, shift = _seen(carrier, 3)
    lobes = trace_lobes(surface[:0], geometry.face_normals, roughness[:0], tracer, 4, shift[:0])
    assert lobes.radiance(torch.zeros(0, 3), _sky(16, 32, 3), torch.zeros(0, 3)).shape == (0, 3)


def test_the_same_bytes_for_any_number_of_cores(carrier, tracer):
    results = []
    for count in (1, 2, 3):
        with cores(count):
            geometry, surface, roughness, shift = _seen(carrier, 3000)
            lobes = trace_lobes(surface, geometry.face_normals, roughness, tracer, 6, shift)
            assert isinstance(lobes, FusedLobes)
            results.append(lobes.radiance(torch.full((3000, 3), 0.04), _sky(32, 64, 3), _sent(lobes, torch.float32)))
    assert torch.equal(results[0], results[1])
    assert torch.equal(results[0], results[2])
