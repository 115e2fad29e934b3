"""The environment's sampler: its density, its samples, and estimates made with them."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from shading_statistics import chi_square_excess, sphere_cells, sphere_integral

from exmesh_graph.errors import NumericsError
from exmesh_graph.shading import envmap
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.point_sets import hammersley


def _environment(kind, height=16, width=32):
    g = torch.Generator().manual_seed(3)
    image = torch.rand(height, width, 3, generator=g, dtype=torch.float64) + 0.1
    if kind == "sun":
        image[height // 3, width // 5] = 1e5
    elif kind == "polar sun":
        image[0, 3 % width] = 1e5
    elif kind == "black":
        image[:] = 0
    elif kind == "half black":
        image[:, : width // 2] = 0
    return image


CASES = ["plain", "sun", "polar sun", "black", "half black"]


@pytest.mark.thorough
@pytest.mark.parametrize("kind", CASES)
@pytest.mark.parametrize("shape", [(16, 32), (1, 1), (1, 2), (5, 7)])
def test_density_integrates_to_one_and_is_positive(kind, shape):
    sampler = EnvSampler(_environment(kind, *shape))
    # no texel centre coincides with a quadrature point, the kinks do: the tent's integral is then exact in u
    total = sphere_integral(sampler.pdf, shape[0] * 2, shape[1] * 2, 24)
    assert float(total.sum()) == pytest.approx(1, abs=2e-3)
    d = torch.nn.functional.normalize(torch.randn(2000, 3, dtype=torch.float64), dim=1)
    poles = torch.tensor([[0.0, 1, 0], [0, -1, 0]], dtype=torch.float64)
    density = sampler.pdf(torch.cat([d, poles]))
    assert float(density.min()) > 0
    assert bool(torch.isfinite(density).all())


@pytest.mark.thorough
@pytest.mark.parametrize("kind", CASES)
@pytest.mark.parametrize("shape", [(16, 32), (1, 1), (3, 5)])
def test_samples_follow_the_density_chi_square(kind, shape):
    sampler = EnvSampler(_environment(kind, *shape))
    count = 200_000
    direction, density = sampler.sample(torch.rand(count, 2, generator=torch.Generator().manual_seed(0)))
    torch.testing.assert_close(direction.norm(dim=1), torch.ones(count, dtype=torch.float64))
    torch.testing.assert_close(density, sampler.pdf(direction), rtol=1e-6, atol=1e-9)
    expected = sphere_integral(sampler.pdf, 16, 32, 24) * count
    assert chi_square_excess(sphere_cells(direction), expected) < 5
    assert float(sphere_cells(direction).sum()) == count


def test_a_wrong_density_fails_the_chi_square():
    """What the test above is worth: the same samples against the density without its sin(theta)."""
    sampler = EnvSampler(_environment("plain"))
    direction, _ = sampler.sample(torch.rand(200_000, 2, generator=torch.Generator().manual_seed(0)))
    flat = EnvSampler(torch.ones(16, 32, 3, dtype=torch.float64), uniform=1.0)
    assert chi_square_excess(sphere_cells(direction), sphere_integral(flat.pdf, 16, 32, 24) * 200_000) > 20


@pytest.mark.parametrize("kind", ["plain", "sun", "polar sun"])
def test_estimates_of_the_lookups_integral(kind):
    """E(d) / p(d) is nearly constant: 64 samples are within 2 % of the sphere's integral, a sun's included."""
    image = _environment(kind, 32, 64)
    sampler = EnvSampler(image, uniform=0.01)
    direction, density = sampler.sample(hammersley(64).double())
    found = (envmap.lookup(image, direction) / density[:, None]).mean(0).mean()
    fine = torch.from_numpy(envmap.texel_directions(32 * 8, 64 * 8)).reshape(-1, 3)
    angle = torch.from_numpy(envmap.solid_angles(32 * 8, 64 * 8)).repeat_interleave(64 * 8)
    expected = (envmap.lookup(image, fine) * angle[:, None]).sum(0).mean()
    assert float(found) == pytest.approx(float(expected), rel=0.02)


def test_constant_environment_lights_a_white_plane_with_pi():
    sampler = EnvSampler(torch.full((8, 16, 3), 0.7))
    direction, density = sampler.sample(hammersley(20_000))
    irradiance = (0.7 * direction[:, 1].clamp_min(0) / density).mean()
    assert float(irradiance) == pytest.approx(0.7 * math.pi, rel=2e-3)


def test_suns_neighbours_do_not_sparkle():
    """The ratio of looked-up radiance to density is bounded right up to the sun's texel."""
    image = _environment("sun", 32, 64)
    sampler = EnvSampler(image, uniform=0.05)
    direction, density = sampler.sample(torch.rand(100_000, 2, generator=torch.Generator().manual_seed(1)))
    ratio = envmap.lookup(image, direction).mean(-1) / density
    assert float(ratio.max()) < 1.15 * float(ratio.mean())


def test_black_texels_keep_their_gradient():
    image = _environment("half black", 8, 16).requires_grad_()
    sampler = EnvSampler(image)
    assert not sampler.density.requires_grad
    direction, density = sampler.sample(hammersley(4096).double())
    (envmap.lookup(image, direction) / density[:, None]).mean(0).sum().backward()
    angle = torch.from_numpy(envmap.solid_angles(8, 16))
    black = image.grad[:, :8, 0]
    assert float(black.min()) > 0
    assert float(black.sum()) == pytest.approx(float(angle.sum()) * 8, rel=0.1)


def test_density_stays_frozen_and_estimates_stay_right_when_the_map_moves_on():
    image = _environment("plain", 8, 16)
    sampler = EnvSampler(image)
    direction, density = sampler.sample(hammersley(50_000).double())
    later = image.flip(1) * 2
    found = (envmap.lookup(later, direction) / density[:, None]).mean()
    image[:] = 0
    torch.testing.assert_close(sampler.pdf(direction[:100]), density[:100])
    fine = torch.from_numpy(envmap.texel_directions(128, 256)).reshape(-1, 3)
    angle = torch.from_numpy(envmap.solid_angles(128, 256)).repeat_interleave(256)
    assert float(found) == pytest.approx(float((envmap.lookup(later, fine).mean(-1) * angle).sum()), rel=5e-3)


def test_float32_sampling_of_a_sun_matches_float64():
    image = _environment("sun", 64, 128)
    uniform = torch.rand(5000, 2, generator=torch.Generator().manual_seed(2))
    first, second = (EnvSampler(image.to(dtype)).sample(uniform) for dtype in (torch.float32, torch.float64))
    assert first[0].dtype == first[1].dtype == torch.float32
    torch.testing.assert_close(first[0].double(), second[0], rtol=0, atol=1e-6)
    assert float(((first[1] / second[1]) - 1).abs().max()) < 2e-3


@pytest.mark.parametrize("bad", [-0.1, math.nan, math.inf])
def test_radiance_that_cannot_be_sampled_is_refused(bad):
    image = torch.ones(4, 8, 3)
    image[2, 5, 1] = bad
    with pytest.raises(NumericsError, match="row 2, column 5"):
        EnvSampler(image)
    with pytest.raises(ValueError, match="uniform"):
        EnvSampler(torch.ones(2, 4, 3), uniform=0)


@settings(max_examples=20, deadline=None)
@given(
    height=st.integers(1, 9),
    width=st.integers(1, 12),
    seed=st.integers(0, 2**31),
    spread=st.sampled_from([0.0, 1.0, 6.0]),
    uniform=st.sampled_from([0.001, 0.3, 1.0]),
)
def test_any_map_has_a_density_that_its_samples_follow(height, width, seed, spread, uniform):
    """Radiance over many decades: density 1 in all, and the samples' mean of a smooth g is its mean under it."""
    generator = torch.Generator().manual_seed(seed)
    image = 10 ** (spread * torch.randn(height, width, 3, generator=generator, dtype=torch.float64))
    sampler = EnvSampler(image, uniform=uniform)
    assert float(sphere_integral(sampler.pdf, 2 * height, 2 * width, 12).sum()) == pytest.approx(1, abs=5e-3)
    direction, density = sampler.sample(hammersley(4096).double())
    torch.testing.assert_close(density, sampler.pdf(direction), rtol=1e-5, atol=1e-12)
    found = 2 + direction[:, 0]
    expected = sphere_integral(lambda d: sampler.pdf(d) * (2 + d[:, 0]), 2 * height, 2 * width, 12).sum()
    assert float(found.mean()) == pytest.approx(float(expected), rel=0.02)
