"""Prefiltered levels, the split sum's table and the sampler, each against quadrature."""

import math

import numpy as np
import pytest
import torch

from exmesh_graph.gpu.cores import cores
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.brdf_sampling import sample_specular
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.point_sets import fibonacci_sphere, hammersley
from exmesh_graph.shading.specular import (
    LEVELS,
    PrefilteredStack,
    convolve,
    directional_albedo,
    mean_visibility,
    reflectance_table,
    scattered,
)


def _sky(height, seed=0):
    """A band-limited random sky, positive."""
    rng = np.random.default_rng(seed)
    d = envmap.texel_directions(height, 2 * height)
    image = sum(rng.uniform(0, 1, 3) * (d @ rng.normal(size=3))[..., None] ** k for k in (1, 2, 3)) + 6
    return torch.from_numpy(image.astype(np.float32))


def test_levels_keep_a_uniform_sky_and_the_unfiltered_one():
    stack = PrefilteredStack(32, 64)
    rows = stack.build(torch.full((32, 64, 3), 0.7))
    torch.testing.assert_close(rows, torch.full_like(rows, 0.7), rtol=1e-5, atol=1e-5)
    sky = _sky(32)
    torch.testing.assert_close(stack.build(sky)[: 32 * 64], sky.reshape(-1, 3))


@pytest.mark.parametrize("roughness", [0.3, 0.5, 0.8, 1.0])
def test_levels_equal_quadrature_of_the_lobe(roughness):
    stack, sky = PrefilteredStack(64, 128), _sky(64)
    axes = torch.from_numpy(fibonacci_sphere(40).astype(np.float32))
    index, weight = stack.locate(*envmap.uv_of(axes), torch.full((40,), roughness))
    found = gather_rows(stack.build(sky), index, weight)
    d = torch.from_numpy(fibonacci_sphere(20_000).astype(np.float32))
    cosine = axes @ d.T
    lobe = brdf.ggx(0.5 * (1 - cosine), torch.tensor(roughness**2)) * cosine.clamp_min(0)
    expected = (lobe @ envmap.lookup(sky, d)) / lobe.sum(1, keepdim=True)
    torch.testing.assert_close(found, expected, rtol=0.02, atol=0.02)


def test_stack_is_linear_with_matching_gradients():
    stack = PrefilteredStack(8, 16)
    generator = torch.Generator().manual_seed(0)
    first, second = torch.rand(2, 8, 16, 3, generator=generator, dtype=torch.float64)
    first.requires_grad_()
    rows = stack.build(first)
    torch.testing.assert_close(stack.build(first + 2 * second), rows + 2 * stack.build(second))
    # the adjoint: <build(x), y> = <x, build^T(y)> for every x, here the random direction `second`
    pick = torch.rand(rows.shape, generator=generator, dtype=torch.float64)
    (adjoint,) = torch.autograd.grad((rows * pick).sum(), first)
    torch.testing.assert_close((adjoint * second).sum(), (stack.build(second) * pick).sum())


@pytest.mark.parametrize(("rows", "width", "results"), [(16, 32, 48), (1, 2, 1), (7, 6, 33), (40, 20, 5), (3, 8, 0)])
def test_frequencies_by_explicit_vectors_equal_the_plain_product(rows, width, results):
    generator = torch.Generator().manual_seed(0)
    sky = 1e3 * torch.rand(rows, width, 3, generator=generator) ** 8
    kernel = torch.rand(width // 2 + 1, results, rows, generator=generator) - 0.5
    found = []
    for count in (1, 2, 3):
        with cores(count):
            found.append(convolve(sky, kernel, kernel.transpose(1, 2).contiguous()))
    exact = convolve(sky.double(), kernel.double(), kernel.double().transpose(1, 2))
    torch.testing.assert_close(found[0].double(), exact, rtol=1e-4, atol=1e-5 * float(sky.max()))
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])


@pytest.mark.parametrize("height", [8, 64, 256])
def test_float32_levels_and_their_gradient_equal_those_of_float64(height):
    stack, wide = PrefilteredStack(height, 2 * height), PrefilteredStack(height, 2 * height)
    generator = torch.Generator().manual_seed(0)
    sky = torch.rand(height, 2 * height, 3, generator=generator)
    sky[height // 3, 5] = 1e4  # a sun
    exact = sky.double().requires_grad_()
    sky.requires_grad_()
    levels, expected = stack.build(sky), wide.build(exact)
    pick = torch.rand(levels.shape, generator=generator)
    (gradient,) = torch.autograd.grad((levels * pick).sum(), sky)
    (reference,) = torch.autograd.grad((expected * pick.double()).sum(), exact)
    torch.testing.assert_close(levels.double(), expected, rtol=1e-4, atol=2e-2)  # of 10 000
    torch.testing.assert_close(gradient.double(), reference, rtol=1e-4, atol=1e-5)


def test_lookup_gradient_in_roughness():
    stack = PrefilteredStack(16, 32)
    stack.knots = stack.knots.double()
    rows = torch.rand(len(stack.build(_sky(16))), 3, dtype=torch.float64)
    u, v = torch.rand(2, 9, dtype=torch.float64)
    roughness = (torch.rand(9, dtype=torch.float64) * 0.18 + 0.31).requires_grad_()  # between knots .3 and .5
    roughness = torch.where(roughness.detach() > 0.399, roughness + 0.02, roughness).detach().requires_grad_()
    assert torch.autograd.gradcheck(lambda r: gather_rows(rows, *stack.locate(u, v, r)), (roughness,))
    assert float(LEVELS[2]) == 0.3


def test_table_equals_the_integral_of_the_brdf():
    table = reflectance_table()
    d = torch.from_numpy(fibonacci_sphere(60_000))
    normal = torch.tensor([0.0, 0, 1], dtype=torch.float64)
    for n_v, roughness, f0 in ((0.9, 0.4, 0.04), (0.4, 0.6, 0.5), (0.2, 0.9, 1.0), (0.7, 0.25, 0.04)):
        view = torch.tensor([math.sqrt(1 - n_v**2), 0, n_v], dtype=torch.float64)
        value = brdf.specular(normal, view, d, torch.tensor(roughness).double(), torch.full((1,), f0).double())[..., 0]
        expected = float((value * d[:, 2].clamp_min(0)).sum() * 4 * math.pi / len(d))
        found = float(directional_albedo(table, torch.tensor([n_v]), torch.tensor([roughness]), f0))
        assert found == pytest.approx(expected, rel=0.02)


@pytest.mark.thorough
@pytest.mark.parametrize("roughness", [0.3, 0.5, 0.9])
@pytest.mark.parametrize("metallic", [None, 0.7])
def test_what_a_hit_sends_on_equals_the_double_integral_of_the_brdf(roughness, metallic):
    """1 / pi of the share of even light that leaves again: by quadrature over both hemispheres, in float64."""
    u = torch.rand(2, 400_000, 2, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    light, view = (_cosine_weighted(part) for part in u)
    one = torch.ones(len(light), dtype=torch.float64)
    base = torch.tensor([0.6, 0.3, 0.1], dtype=torch.float64)
    metal = None if metallic is None else metallic * one
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand_as(light)
    f = brdf.evaluate(normal, view, light, base.expand_as(light), roughness * one, metal)
    expected = f.mean(dim=0)  # cosine-weighted on both sides: the mean of f is rho / pi
    found = scattered(base[None], roughness * one[:1], None if metal is None else metal[:1])[0]
    torch.testing.assert_close(found, expected, rtol=0.02, atol=2e-4)


def test_what_a_hit_sends_on_has_the_gradient_of_differences():
    generator = torch.Generator().manual_seed(0)
    base, rough, metal = (torch.rand(6, *shape, generator=generator, dtype=torch.float64) for shape in ((3,), (), ()))
    inputs = [value.mul(0.8).add(0.1).requires_grad_() for value in (base, rough, metal)]
    assert torch.autograd.gradcheck(scattered, inputs, eps=1e-7, atol=1e-5)


def _cosine_weighted(u):
    radius, angle = u[:, 0].sqrt(), 2 * math.pi * u[:, 1]
    return torch.stack([radius * angle.cos(), radius * angle.sin(), (1 - u[:, 0]).sqrt()], dim=1)


@pytest.mark.parametrize(("roughness", "n_v"), [(0.3, 0.95), (0.5, 0.5), (0.8, 0.2)])
def test_sampler_follows_its_density_chi_square(roughness, n_v):
    """Counts over 16 x 32 cells of the sphere against the integral of the returned pdf."""
    normal = torch.nn.functional.normalize(torch.tensor([[0.3, -0.5, 0.8]]), dim=1)
    tangent = torch.nn.functional.normalize(torch.linalg.cross(normal, torch.tensor([[0.0, 1, 0]])), dim=1)
    view = normal * n_v + tangent * math.sqrt(1 - n_v**2)
    count = 200_000
    uniform = torch.rand(1, count, 2, generator=torch.Generator().manual_seed(0))
    light, weight, pdf, _ = sample_specular(normal, view, torch.tensor([roughness**2]), uniform)
    above = weight[0] > 0
    u, v = envmap.uv_of(light[0][above])
    cell = (v * 16).long().clamp(max=15) * 32 + (u * 32).long().clamp(max=31)
    observed = torch.bincount(cell, minlength=512).double()
    # integrate the density over the cells: 24 x 24 midpoints each
    fine = 24
    d = torch.from_numpy(envmap.texel_directions(16 * fine, 32 * fine)).reshape(-1, 3)
    density = _density(normal[0].double(), view[0].double(), d, roughness)
    angle = np.repeat(envmap.solid_angles(16 * fine, 32 * fine), 32 * fine)
    expected = (density * torch.from_numpy(angle)).reshape(16, fine, 32, fine).sum(dim=(1, 3)).reshape(-1) * count
    enough = expected > 10
    statistic = float(((observed - expected)[enough] ** 2 / expected[enough]).sum())
    degrees = int(enough.sum())
    assert statistic < degrees + 6 * math.sqrt(2 * degrees)
    assert float(observed.sum()) == pytest.approx(float(expected.sum()), rel=0.01)
    # the returned pdf is that density
    found = _density(normal[0].double(), view[0].double(), light[0][:500].double(), roughness)
    torch.testing.assert_close(pdf[0, :500].double(), found, rtol=2e-3, atol=1e-5)


def _density(normal, view, light, roughness):
    half = torch.nn.functional.normalize(light + view, dim=-1)
    n_v, alpha = (normal * view).sum(), torch.tensor(roughness**2).double()
    sine2 = 1 - ((half * normal).sum(-1) ** 2).clamp(max=1)
    smith = (1 + alpha**2 * (1 / n_v**2 - 1)).sqrt()
    value = brdf.ggx(sine2, alpha) * (2 / (1 + smith)) / (4 * n_v)
    return torch.where((light * normal).sum(-1) > brdf.COSINE_MIN, value, torch.zeros_like(value))


@pytest.mark.parametrize("roughness", [0.25, 0.6])
def test_sampled_specular_equals_quadrature(roughness):
    sky = _sky(64, 2)
    normal, view = (
        torch.tensor([[0.0, 0.6, 0.8]]),
        torch.nn.functional.normalize(torch.tensor([[0.7, 0.5, 0.6]]), dim=1),
    )
    light, weight, pdf, v_h = sample_specular(normal, view, torch.tensor([roughness**2]), hammersley(256)[None])
    fresnel = brdf.schlick(v_h, torch.full((1, 1, 3), 0.04))
    keep = weight[0] > 0
    radiance = Pyramid(sky).lookup(light[0][keep], 1 / (256 * pdf[0][keep]))
    found = (radiance * fresnel[0][keep] * weight[0][keep][:, None]).sum(0) / 256
    d = torch.from_numpy(fibonacci_sphere(300_000)).float()
    value = brdf.specular(normal[0], view[0], d, torch.tensor(roughness), torch.full((1,), 0.04))
    expected = (value * (d @ normal[0]).clamp_min(0)[:, None] * envmap.lookup(sky, d)).sum(0) * 4 * math.pi / len(d)
    torch.testing.assert_close(found, expected, rtol=0.02, atol=1e-3)


def test_gather_rows_equals_plain_indexing():
    generator = torch.Generator().manual_seed(0)
    table = torch.rand(11, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    weight = torch.rand(7, 4, generator=generator, dtype=torch.float64, requires_grad=True)
    index = torch.randint(0, 11, (7, 4), generator=generator)
    torch.testing.assert_close(gather_rows(table, index, weight), (table[index] * weight[..., None]).sum(1))
    assert torch.autograd.gradcheck(lambda t, w: gather_rows(t, index, w), (table, weight))


def test_stack_lookup_wraps_in_longitude_and_stops_at_the_poles():
    stack, sky = PrefilteredStack(16, 32), _sky(16, 3)
    rows = stack.build(sky)
    u = torch.tensor([0.0, 0.001, 0.999, 1.0, 0.4, 0.4])
    v = torch.tensor([0.3, 0.5, 0.5, 0.7, 0.0, 1.0])
    index, weight = stack.locate(u, v, torch.zeros(6))
    expected = gather_rows(sky.reshape(-1, 3), *envmap.bilinear(16, 32, u, v))
    torch.testing.assert_close(gather_rows(rows, index, weight), expected)


def test_pooled_skies_keep_their_energy():
    """Coarser levels weight rows by solid angle: a bright pole must not gain."""
    sky = torch.zeros(32, 64, 3)
    sky[0], sky[9, 5] = 100.0, 1e4
    row = torch.from_numpy(envmap.solid_angles(32, 64)).float()[:, None, None]
    flux = float((sky * row).sum())
    for level in Pyramid(sky).levels:
        angle = torch.from_numpy(envmap.solid_angles(*level.shape[:2])).float()[:, None, None]
        assert float((level * angle).sum()) == pytest.approx(flux, rel=1e-4)
    stack = PrefilteredStack(32, 64)
    sizes = list(zip(stack.heights.tolist(), stack.widths.tolist(), strict=True))
    assert min(sizes) < (32, 64)
    for (height, width), level in zip(sizes, stack.build(sky).split([h * w for h, w in sizes]), strict=True):
        angle = torch.from_numpy(envmap.solid_angles(height, width)).float()[:, None]
        assert float((level.reshape(height, width, 3) * angle[..., None]).sum()) == pytest.approx(flux, rel=1e-3)


def test_pyramid_averages_over_the_solid_angle_asked_for():
    """A texel's own solid angle reads the map, 4^n times it the map halved n times."""
    sky = torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(0))
    pyramid = Pyramid(sky)
    d = torch.from_numpy(fibonacci_sphere(50)).float()
    for level in range(3):
        found = pyramid.lookup(d, torch.full((50,), 4.0**level * 4 * math.pi / (32 * 64)))
        torch.testing.assert_close(found, envmap.lookup(pyramid.levels[level], d), rtol=1e-4, atol=1e-5)


def test_visible_share_of_a_lobe():
    d = torch.from_numpy(fibonacci_sphere(256)).float()
    visible = (d[:, 1] > 0).float()[None].expand(3, -1)  # an open floor: everything above the horizon
    axes = torch.tensor([[0.0, 1, 0], [0, -1, 0], [1, 0, 0]])
    for roughness in (0.2, 0.5):
        share = mean_visibility(visible, d, axes, roughness)
        np.testing.assert_allclose(share.numpy(), [1, 0, 0.5], atol=0.15)


@pytest.mark.parametrize("height", [16, 32, 64])
def test_no_texels_sun_gains_or_loses_by_the_grid(height):
    """Flux of every level over the sphere, for suns from the polar row to the equator: exact, not to a few percent."""
    stack = PrefilteredStack(height, 2 * height)
    sizes = list(zip(stack.heights.tolist(), stack.widths.tolist(), strict=True))
    for row in (0, 1, 3, height // 2, height - 1):
        sky = torch.zeros(height, 2 * height, 3)
        sky[row, 9] = 1e4
        flux = 1e4 * envmap.solid_angles(height, 2 * height)[row]
        for (rows, columns), level in zip(sizes, stack.build(sky).split([h * w for h, w in sizes]), strict=True):
            angle = torch.from_numpy(envmap.solid_angles(rows, columns))[:, None]
            assert float((level[:, 0].double().reshape(rows, columns) * angle).sum()) == pytest.approx(flux, rel=2e-4)


@pytest.mark.parametrize("height", [64, 128])
def test_blocks_are_means_by_solid_angle_and_spread_is_their_adjoint(height):
    draw = torch.Generator().manual_seed(0)
    sky = torch.rand(height, 2 * height, 3, generator=draw, dtype=torch.float64)
    angle = torch.from_numpy(envmap.solid_angles(height, 2 * height))
    factors = []
    for group in PrefilteredStack(height, 2 * height).groups:
        f = group.factor
        factors.append(f)
        pooled = group.pool(sky)
        for i, j in ((0, 0), (height // f // 2, 3), (height // f - 1, 2 * height // f - 1)):
            rows = angle[f * i : f * (i + 1), None, None]
            block = sky[f * i : f * (i + 1), f * j : f * (j + 1)]
            assert torch.allclose(pooled[i, j], (rows * block).sum((0, 1)) / (f * rows.sum()), rtol=1e-6)
        given = torch.rand(pooled.shape, generator=draw, dtype=torch.float64)
        assert float((given * pooled).sum()) == pytest.approx(float((group.spread(given) * sky).sum()), rel=1e-12)
    assert max(factors) >= 4
