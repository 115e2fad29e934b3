"""Direct light by Monte Carlo: the kernels against plain torch, the estimate against quadrature, every sampler."""

import math

import numpy as np
import pytest
import torch
from monte_carlo_scenes import bowl, material, on_mesh, studio, tracer_of, wall_and_floor

from benchmarks.brdf_reference import pdf_brdf
from benchmarks.brute_rays import BruteTracer
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo import Material, Points, draw_light, make_pool, shade, shade_reference
from exmesh_graph.shading.monte_carlo.samples import draw_directions

pytestmark = pytest.mark.usefixtures("one_thread")

SAMPLERS = ["environment", "brdf", "mis", "cosine"]


def _tensors(m, normal, environment):
    return (normal, m.base_color, m.roughness, m.metallic, environment)


@pytest.mark.parametrize("kind", SAMPLERS)
def test_kernel_equals_plain_torch_in_value_and_gradient(kind):
    mesh = wall_and_floor()
    points, _, _ = on_mesh(*mesh, 300)
    # tilt the shading normals: none of the cosines may be special
    tilt = torch.nn.functional.normalize(
        points.normal + 0.3 * torch.rand(300, 3, generator=torch.Generator().manual_seed(9)), dim=-1
    )
    points = Points(points.position, points.flat, tilt, points.view)
    m = material(300)
    environment = studio()
    drawn = draw_light(points, m, make_pool(EnvSampler(environment), kind, 6, 3), tracer_of(mesh))
    assert 0.2 < (drawn.weight > 0).float().mean() < 1
    upstream = torch.randn(300, 3, generator=torch.Generator().manual_seed(1))
    found = []
    for dtype, function in ((torch.float32, shade), (torch.float64, shade_reference)):
        leaves = [t.detach().to(dtype).requires_grad_() for t in _tensors(m, points.normal, environment)]
        normal, base, rough, metal, sky = leaves
        value = function(drawn, normal, points.view.to(dtype), Material(base, rough, metal), sky)
        found.append((value, *torch.autograd.grad((value * upstream.to(dtype)).sum(), leaves)))
    for fast, exact in zip(*found, strict=True):
        assert float((fast.detach().double() - exact.detach()).abs().max()) < 2e-4 * float(exact.detach().abs().max())


@pytest.mark.parametrize("kind", SAMPLERS)
@pytest.mark.parametrize("specular", [True, False])
def test_samples_that_a_turned_normal_leaves_behind_give_no_light(kind, specular):
    """Samples may be kept while normals are fitted: what then lies under the horizon is 0, not negative."""
    mesh = wall_and_floor()
    points, _, _ = on_mesh(*mesh, 300)
    m, environment = material(300), studio()
    drawn = draw_light(points, m, make_pool(EnvSampler(environment), kind, 6, 3), tracer_of(mesh))
    turned = torch.nn.functional.normalize(points.normal + torch.tensor([0.9, 0.2, 0.4]), dim=-1)
    below = (drawn.directions() * turned[:, None]).sum(-1) < 0
    assert float((below & (drawn.weight > 0)).float().mean()) > 0.02
    found = []
    for dtype, function in ((torch.float32, shade), (torch.float64, shade_reference)):
        leaves = [t.detach().to(dtype).requires_grad_() for t in _tensors(m, turned, environment)]
        normal, base, rough, metal, sky = leaves
        seen = Material(base, rough, metal) if specular else Material(base)
        value = function(drawn, normal, points.view.to(dtype), seen, sky)
        assert float(value.detach().min()) >= 0
        used = (normal, base, sky, rough, metal) if specular else (normal, base, sky)
        found.append((value, *torch.autograd.grad(value.sum(), used)))
    for fast, exact in zip(*found, strict=True):
        assert float((fast.detach().double() - exact.detach()).abs().max()) < 2e-4 * float(exact.detach().abs().max())


@pytest.mark.thorough
def test_reference_gradient_against_finite_differences():
    mesh = wall_and_floor()
    points, _, _ = on_mesh(*mesh, 5)
    m, environment = material(5, dtype=torch.float64), studio(4, dtype=torch.float64)
    drawn = draw_light(points, m, make_pool(EnvSampler(environment), "mis", 4, 0), tracer_of(mesh))
    leaves = [t.double().requires_grad_() for t in _tensors(m, points.normal, environment)]

    def value(normal, base, rough, metal, sky):
        return shade_reference(drawn, normal, points.view.double(), Material(base, rough, metal), sky)

    assert torch.autograd.gradcheck(value, leaves)


def test_diffuse_only_material_has_no_specular_lobe():
    mesh = wall_and_floor()
    points, _, _ = on_mesh(*mesh, 50)
    base = torch.rand(50, 3, generator=torch.Generator().manual_seed(9)).requires_grad_()
    environment = studio()
    drawn = draw_light(points, Material(base), make_pool(EnvSampler(environment), "mis", 8, 0), tracer_of(mesh))
    args = (drawn, points.normal, points.view)
    fast, exact = (f(*args, Material(base), environment) for f in (shade, shade_reference))
    torch.testing.assert_close(fast, exact, rtol=1e-4, atol=1e-5)
    assert shade(*args, Material(base.double()), environment.double()).dtype == torch.float64
    grads = [torch.autograd.grad(v.sum(), base)[0] for v in (fast, exact)]
    torch.testing.assert_close(*grads, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("kind", SAMPLERS)
def test_weights_are_the_balance_heuristic_of_the_true_densities(kind):
    mesh = wall_and_floor()
    points, _, _ = on_mesh(*mesh, 200)
    m, environment = material(200), studio()
    sampler = EnvSampler(environment)
    pool = make_pool(sampler, kind, 6, 5)
    drawn = draw_directions(points.normal, points, m, pool)
    direction = drawn.directions()
    from_sky = sampler.pdf(direction)
    if kind == "cosine":
        from_lobes = (direction * points.normal[:, None]).sum(-1).clamp_min(0) / math.pi
    else:
        from_lobes = pdf_brdf(points.normal, points.view, direction, m.base_color, m.roughness, m.metallic)
    expected = 1 / (pool.pool_samples * from_sky + pool.own_samples * from_lobes)
    lit = drawn.weight > 0
    above = (direction * points.normal[:, None]).sum(-1)
    assert bool((lit == (above > brdf.COSINE_MIN)).all())
    torch.testing.assert_close(drawn.weight[lit], expected[lit], rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("roughness", [0.1, 0.5])
def test_own_directions_follow_their_density(roughness):
    """Chi-square of lobe samples against the integral of pdf_brdf over cells of the sphere."""
    count, rows, columns = 60_000, 12, 24
    view = torch.nn.functional.normalize(torch.tensor([[0.6, 0.8, 0.1]]), dim=-1).repeat(count, 1)
    up = torch.tensor([[0.0, 1.0, 0.0]]).repeat(count, 1)
    points = Points(torch.zeros(count, 3), up, up, view)
    m = Material(torch.full((count, 3), 0.5), torch.full((count,), roughness), torch.full((count,), 0.3))
    pool = make_pool(EnvSampler(torch.ones(4, 8, 3)), "brdf", 1, 11)
    drawn = draw_directions(up, points, m, pool)
    kept = drawn.own_direction[:, 0][drawn.weight[:, 0] > 0]
    u, v = envmap.uv_of(kept)
    cell = (v * rows).long().clamp(max=rows - 1) * columns + (u * columns).long().clamp(max=columns - 1)
    observed = torch.bincount(cell, minlength=rows * columns).double()
    fine = 40
    directions = torch.from_numpy(envmap.texel_directions(rows * fine, columns * fine)).reshape(1, -1, 3)
    density = pdf_brdf(
        up[:1].double(),
        view[:1].double(),
        directions,
        m.base_color[:1].double(),
        m.roughness[:1].double(),
        m.metallic[:1].double(),
    )
    angle = torch.from_numpy(envmap.solid_angles(rows * fine, columns * fine))
    mass = density.view(rows * fine, columns * fine) * angle[:, None]
    expected = mass.view(rows, fine, columns, fine).sum(dim=(1, 3)).reshape(-1) * count
    big = expected > 20
    statistic = float(((observed[big] - expected[big]) ** 2 / expected[big]).sum())
    freedom = int(big.sum())
    assert statistic < freedom + 5 * math.sqrt(2 * freedom)
    assert abs(float(observed.sum() / expected.sum()) - 1) < 0.01


def _quadrature(points, m, environment, tracer, height):
    """Eq. 12 by brute force in float64: every direction of a fine lat-long grid against every triangle."""
    directions = envmap.texel_directions(height, 2 * height).reshape(-1, 3)
    angle = np.repeat(envmap.solid_angles(height, 2 * height), 2 * height)
    radiance = envmap.lookup(environment.double(), torch.from_numpy(directions)).numpy()
    result = []
    for i in range(len(points)):
        n, g, v = (t[i].double() for t in (points.normal, points.flat, points.view))
        above = ((directions @ n.numpy()) > 0) & ((directions @ g.numpy()) > 0)
        origin = points.position[i].double().numpy() + 1e-6 * g.numpy()
        free = np.zeros(len(directions), bool)
        free[above] = ~tracer.any_hit(np.repeat(origin[None], above.sum(), 0), directions[above])
        light = torch.from_numpy(directions[free])
        spread = (len(light), 3)
        f = brdf.evaluate(
            n.expand(spread),
            v.expand(spread),
            light,
            m.base_color[i].double().expand(spread),
            m.roughness[i].double().expand(len(light)),
            m.metallic[i].double().expand(len(light)),
        ).numpy()
        cosine = (directions[free] @ n.numpy()).clip(0)
        result.append((radiance[free] * f * (cosine * angle[free])[:, None]).sum(0))
    return np.stack(result)


def test_every_sampler_converges_to_quadrature_under_occlusion():
    mesh = wall_and_floor()
    points, _, _ = on_mesh(*mesh, 6, seed=2)
    m, environment = material(6, seed=3), studio(8)
    m = Material(m.base_color, m.roughness.clamp_min(0.4), m.metallic)  # lobes that sampling the sky can find
    exact = _quadrature(points, m, environment, BruteTracer(*mesh), 128)
    tracer = tracer_of(mesh)
    for kind in SAMPLERS:
        runs = []
        for seed in range(8):
            drawn = draw_light(points, m, make_pool(EnvSampler(environment), kind, 2048, seed, blocks=8), tracer)
            runs.append(shade(drawn, points.normal, points.view, m, environment).numpy())
        mean, spread = np.mean(runs, 0), np.std(runs, 0, ddof=1) / math.sqrt(len(runs))
        relative = np.sqrt(((mean - exact) ** 2).sum() / (exact**2).sum())
        assert relative < 5e-3, kind
        # per point: no farther than its own noise allows, plus the quadrature's 0.5 %
        assert np.mean(np.abs(mean - exact) < 4 * spread + 5e-3 * exact) > 0.95, kind


@pytest.mark.parametrize("kind", SAMPLERS)
def test_bowl_under_a_constant_sky(kind):
    """Inside a hemisphere every point receives half the sky's cosine: L = a E / 2, at 8 samples without bias."""
    mesh = bowl()
    points, _, _ = on_mesh(*mesh, 4000)
    environment = torch.full((8, 16, 3), 1.5)
    m = Material(torch.full((4000, 3), 0.6))
    tracer = tracer_of(mesh)
    runs = []
    for seed in range(4):
        drawn = draw_light(points, m, make_pool(EnvSampler(environment), kind, 8, seed), tracer)
        runs.append(shade(drawn, points.normal, points.view, m, environment).mean())
    assert float(torch.stack(runs).mean()) == pytest.approx(0.6 * 1.5 / 2, rel=0.01)


def test_same_seed_same_light_whatever_the_memory():
    mesh = bowl(8)
    points, _, _ = on_mesh(*mesh, 500)
    m, environment = material(500), studio()
    pool = make_pool(EnvSampler(environment), "mis", 8, 4)
    whole, pieces = (draw_light(points, m, pool, tracer_of(mesh), memory) for memory in (256, 0.05))
    assert torch.equal(whole.weight, pieces.weight)
    other = draw_light(points, m, make_pool(EnvSampler(environment), "mis", 8, 5), tracer_of(mesh))
    assert not torch.equal(whole.weight, other.weight)


def test_black_sky_is_black_and_its_texels_still_get_gradient():
    mesh = wall_and_floor()
    points, _, _ = on_mesh(*mesh, 400)
    m = material(400)
    environment = torch.zeros(8, 16, 3, requires_grad=True)
    drawn = draw_light(points, m, make_pool(EnvSampler(environment), "environment", 64, 0), tracer_of(mesh))
    value = shade(drawn, points.normal, points.view, m, environment)
    assert float(value.detach().abs().max()) == 0
    value.sum().backward()
    assert float((environment.grad[:4] > 0).float().mean()) > 0.95  # the upper half lights a floor and a wall


def test_more_samples_than_kernels_count_are_refused():
    many = torch.zeros(1, 3).expand(1 << 25, 3)  # takes no memory
    pool = make_pool(EnvSampler(studio(4)), "mis", 64, 0)
    with pytest.raises(ValueError, match="in parts"):
        draw_light(Points(many, many, many, many), Material(many), pool, tracer_of(wall_and_floor()))


def test_no_points_is_no_error():
    points = Points(*[torch.zeros(0, 3)] * 4)
    environment = studio()
    m = material(0)
    drawn = draw_light(points, m, make_pool(EnvSampler(environment), "mis", 8, 0), tracer_of(wall_and_floor()))
    assert shade(drawn, points.normal, points.view, m, environment).shape == (0, 3)


@pytest.mark.parametrize(("kind", "count"), [("sky", 8), ("environment", 0), ("mis", 1)])
def test_wrong_settings_are_refused(kind, count):
    with pytest.raises(ValueError, match="expected"):
        make_pool(EnvSampler(studio()), kind, count, 0)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("kind", SAMPLERS)
def test_cuda_draws_and_shades_as_the_cpu_does(kind):
    mesh = wall_and_floor()
    points, _, _ = on_mesh(*mesh, 3000)
    m, environment = material(3000), studio()
    found = []
    for device in ("cpu", "cuda"):
        there = Points(*(t.to(device) for t in (points.position, points.flat, points.normal, points.view)))
        mat = Material(*(t.to(device) for t in (m.base_color, m.roughness, m.metallic)))
        sky = environment.detach().to(device).requires_grad_()
        drawn = draw_light(there, mat, make_pool(EnvSampler(sky), kind, 8, 3), tracer_of(mesh))
        value = shade(drawn, there.normal, there.view, mat, sky)
        value.sum().backward()
        found.append((value.detach().cpu(), sky.grad.cpu()))
    for one, other in zip(*found, strict=True):
        assert float((one - other).norm() / one.norm()) < 1e-2
