"""Fused rays towards suns against plain ones in float64: where they go, what is seen, what is reflected."""

import dataclasses

import numpy as np
import pytest
import torch

from exmesh_graph.gpu.cores import cores
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading.suns import find_suns
from exmesh_graph.stage2.light.fused_suns import FusedSunRays, trace_suns
from exmesh_graph.stage2.light.traced import SunRays, narrow_lobes
from exmesh_graph.stage2.surface import CarrierGeometry


@pytest.fixture(scope="module")
def tracer(carrier):
    return make_ray_tracer(carrier.vertices, carrier.faces)


def _random(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def _sky(*places, height=64):
    """Suns of one to four texels at (row, column) of a dim sky, each with its own colour."""
    radiance = torch.full((height, 2 * height, 3), 0.1)
    for number, (row, column) in enumerate(places):
        for texel in range(1 + number):
            radiance[row + texel // 2, (column + texel % 2) % (2 * height)] = 1e4 * (1 + _random(3, seed=texel))
    return radiance


def _seen(carrier, count):
    """Points all over the mesh, seen from where grazing angles and turned-away faces are frequent."""
    geometry = CarrierGeometry(carrier)
    face = (_random(count, seed=1) * len(carrier.faces)).long()
    bary = _random(count, 3, seed=2) + 1e-3
    return geometry.samples(face, bary / bary.sum(1, keepdim=True), torch.tensor([0.6, 0.9, 1.2]))


def _both(carrier, tracer, sky, count, samples):
    surface, suns, shift = _seen(carrier, count), find_suns(sky, 256), _random(count, 3, seed=4)
    wide = {name: v.double() if v.is_floating_point() else v for name, v in vars(surface).items()}
    exact = dataclasses.replace(surface, **wide)
    return (
        FusedSunRays.traced(suns, surface, tracer, samples, shift),
        SunRays.traced(suns, exact, tracer, samples, shift.double()),
    )


SKIES = {
    "one texel": _sky((12, 30)),
    "three, one over the seam": _sky((12, 30), (40, 70), (25, 127)),
    "at the poles": _sky((0, 3), (62, 90)),
}


@pytest.mark.parametrize("sky", SKIES.values(), ids=SKIES)
@pytest.mark.parametrize(("count", "samples"), [(1, 1), (7, 4), (700, 4)])
def test_rays_agree_with_plain_ones(carrier, tracer, sky, count, samples):
    found, expected = _both(carrier, tracer, sky, count, samples)
    number = len(found.suns)
    direction = found.direction.reshape(-1, samples, number, 8, 3).permute(1, 2, 0, 3, 4).flatten(2, 3)[:, :, :count]
    seen = found.seen.reshape(-1, samples, number, 8).permute(1, 2, 0, 3).flatten(2, 3)
    assert float((direction.double() - torch.stack(expected.towards)).abs().max()) < 3e-6
    assert not seen[:, :, count:].any()  # what fills the last group up
    error = (seen[:, :, :count].double() - torch.stack(expected.cosine)).abs()
    # a ray within rounding of an edge or of a horizon may fall on its other side
    assert float((error < 3e-6).double().mean()) > 0.995


@pytest.mark.parametrize("sky", SKIES.values(), ids=SKIES)
def test_light_agrees_with_plain_rays(carrier, tracer, sky):
    count = 700
    found, expected = _both(carrier, tracer, sky, count, 4)
    assert float(found.seen.mean()) > 0.05
    flux, diffuse = 1 + _random(len(found.suns), 3), _random(count, 3, seed=5)
    roughness, f0 = (1.2 * _random(count, seed=6) - 0.1).clamp(0, 1), _random(count, 3, seed=7)
    assert narrow_lobes(found.suns, roughness).any()
    assert not narrow_lobes(found.suns, roughness).all()
    fused = found.radiance(flux, diffuse, roughness, f0).double()
    plain = expected.radiance(flux.double(), diffuse.double(), roughness.double(), f0.double())
    assert torch.isfinite(fused).all()
    error = ((fused - plain).abs() / (plain + 1e-3 * plain.mean())).amax(dim=1)
    assert float((error < 2e-3).double().mean()) > 0.985
    assert float(fused.mean()) == pytest.approx(float(plain.mean()), rel=5e-3)


def test_who_takes_which(carrier, tracer):
    """Explicit vectors for float32 on a CPU; no sun, and other numbers, are the plain form's."""
    surface, shift = _seen(carrier, 20), _random(20, 3)
    suns = find_suns(SKIES["one texel"], 256)
    assert isinstance(trace_suns(suns, surface, tracer, 4, shift), FusedSunRays)
    none = trace_suns(find_suns(torch.ones(16, 32, 3), 256), surface, tracer, 4, shift)
    ones = torch.ones(20, 3)
    assert isinstance(none, SunRays)
    assert not none.radiance(torch.zeros(0, 3), ones, ones[:, 0], ones).any()
    wide = {name: v.double() if v.is_floating_point() else v for name, v in vars(surface).items()}
    assert isinstance(trace_suns(suns, dataclasses.replace(surface, **wide), tracer, 4, shift), SunRays)


def test_same_bytes_on_any_number_of_cores(carrier, tracer):
    def lit(count):
        with cores(count):
            rays, _ = _both(carrier, tracer, SKIES["three, one over the seam"], 3000, 4)
            table = [_random(3000, 3, seed=k) for k in range(3)]
            return rays.radiance(torch.ones(3, 3), table[0], table[1][:, 0], table[2]).numpy()

    assert all(np.array_equal(lit(1), lit(count)) for count in (2, 3))
