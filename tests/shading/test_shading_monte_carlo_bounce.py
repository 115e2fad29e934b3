"""One bounce, half resolution, cached samples: closed forms and plain torch."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from monte_carlo_scenes import bowl, material, on_mesh, studio, tracer_of, wall_and_floor

from benchmarks.meshes import grid
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.rays.warp_bvh import WarpTracer
from exmesh_graph.shading import envmap
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo import (
    Material,
    MeshSurface,
    MonteCarloLight,
    Points,
    SampleCache,
    coarse_points,
)
from exmesh_graph.shading.monte_carlo.bounce import bounce_irradiance
from exmesh_graph.shading.settings import MonteCarloSettings

pytestmark = pytest.mark.usefixtures("one_thread")


def plain(surface, base, metallic=None):
    """A query of one material for the whole mesh, differentiable in base [3]."""

    def query(face, bary):
        m = None if metallic is None else torch.full((len(face),), metallic)
        return surface.face_normals[face], Material(base.expand(len(face), 3), None, m)

    return query


def scene(mesh, count, albedo, settings=MonteCarloSettings(), seed=0):
    surface = MeshSurface(*mesh)
    points, _, _ = on_mesh(*mesh, count, seed)
    light = MonteCarloLight(surface, tracer_of(mesh), settings)
    base = torch.full((3,), albedo)
    return light, points, Material(base.expand(count, 3)), plain(surface, base)


def test_bowl_under_a_constant_sky_has_the_closed_forms_bounce():
    """In a hemisphere every patch sees every other alike: L_dir = a E / 2 and L_ind = a^2 E / 4."""
    light, points, m, query = scene(bowl(), 4000, 0.6)
    sky = torch.full((8, 16, 3), 2.0)
    direct = torch.stack([light.render(points, m, None, sky, seed).mean() for seed in range(4)]).mean()
    both = torch.stack([light.render(points, m, query, sky, seed).mean() for seed in range(4)]).mean()
    assert float(direct) == pytest.approx(0.6, rel=0.01)
    assert float(both - direct) == pytest.approx(0.6**2 * 2 / 4, rel=0.015)


def test_more_samples_at_a_hit_than_the_direct_pool_holds():
    """Two direct samples leave a pool of 1024 directions; hits that ask for more must not read past its end."""
    light, points, m, query = scene(
        bowl(), 40, 0.6, MonteCarloSettings(technique="mis", samples=2, secondary_rays=64, secondary_samples=3000)
    )
    sky = torch.full((8, 16, 3), 2.0)
    drawn = light.draw(points, m, query, EnvSampler(sky), 0)
    assert drawn.hits is not None
    assert len(drawn.hits.light.pool.direction) >= 64 * 3000
    both = light.shade(drawn, points, m, query, sky)
    direct = light.shade(drawn, points, m, None, sky)
    assert float((both - direct).mean()) == pytest.approx(0.6**2 * 2 / 4, rel=0.03)
    light.settings = SimpleNamespace(**{**dict(light.settings), "secondary_samples": 0})  # anything that looks like it
    with pytest.raises(ValueError, match="0 samples"):
        light.draw(points, m, query, EnvSampler(sky), 0)


def test_closed_room_sends_nothing():
    vertices, faces = icosphere(2)
    light, points, m, query = scene((vertices, faces[:, ::-1].copy()), 500, 0.9)
    assert float(light.render(points, m, query, torch.full((4, 8, 3), 5.0), 0).abs().max()) == 0


def test_back_faces_block_and_send_nothing():
    """The bowl wound outwards, seen from inside: its faces look away, so nothing bounces."""
    mesh = bowl(inward=False)
    light, points, m, query = scene(mesh, 2000, 0.6)
    inside = Points(points.position, -points.flat, -points.normal, -points.view)
    sky = torch.full((8, 16, 3), 2.0)
    direct = light.render(inside, m, None, sky, 0)
    assert torch.equal(light.render(inside, m, query, sky, 0), direct)
    assert float(direct.mean()) == pytest.approx(0.6, rel=0.02)


def test_strength_scales_the_bounce_alone():
    light, points, m, query = scene(bowl(8), 300, 0.5)
    sky = studio()
    none, half, full = (light.render(points, m, query, sky, 0, strength=s) for s in (0, 0.5, 1))
    torch.testing.assert_close(half - none, (full - none) / 2)
    assert float((full - none).min()) >= 0
    assert float((full - none).mean()) > 0


@pytest.mark.thorough
def test_bounce_converges_to_brute_force_quadrature():
    """A textured wall over a floor against eq. 19 by nested quadrature with the inner light at full resolution."""
    mesh = wall_and_floor()
    surface, sky = MeshSurface(*mesh), studio(8).clamp(max=3)
    tint = torch.tensor([[0.9, 0.2, 0.4], [0.3, 0.8, 0.5], [0.7, 0.6, 0.1], [0.2, 0.3, 0.9]])

    def query(face, bary):
        colour = tint[face] * (0.5 + 0.5 * bary[:, :1])
        return surface.face_normals[face], Material(colour, None, bary[:, 1] * 0.4)

    points, face, bary = on_mesh(*mesh, 2, seed=4)
    _, m = query(face, bary)
    exact = _nested_quadrature(points, m, surface, query, sky, tracer_of(mesh))
    settings = MonteCarloSettings(technique="environment", samples=2, secondary_rays=2048, secondary_samples=16)
    light = MonteCarloLight(surface, tracer_of(mesh), settings)
    runs = []
    for seed in range(8):
        drawn = light.draw(points, m, query, EnvSampler(sky), seed)
        runs.append(m.diffuse() / math.pi * bounce_irradiance(drawn.hits, points, query, sky))
    mean, spread = torch.stack(runs).mean(0), torch.stack(runs).std(0) / math.sqrt(8)

    # the quadrature of 80 x 160 outer and 32 x 64 inner directions is itself good to about 1 %
    assert float((mean - exact).norm() / exact.norm()) < 0.015
    assert bool(((mean - exact).abs() < 4 * spread + 0.015 * exact).all())


def _nested_quadrature(points, m, surface, query, sky, tracer):
    outer, inner = 80, 32
    d = envmap.texel_directions(outer, 2 * outer).reshape(-1, 3)
    angle = np.repeat(envmap.solid_angles(outer, 2 * outer), 2 * outer)
    e = envmap.texel_directions(inner, 2 * inner).reshape(-1, 3)
    e_angle = np.repeat(envmap.solid_angles(inner, 2 * inner), 2 * inner)
    radiance = envmap.lookup(sky.double(), torch.from_numpy(e)).numpy()
    result = []
    for i in range(len(points)):
        n = points.normal[i].double().numpy()
        up = d[d @ n > 0]
        origin = points.position[i].double().numpy() + 1e-6 * n
        hits = tracer.closest_hit(np.repeat(origin[None], len(up), 0), up)
        facing = (surface.face_normals.numpy()[hits.face.clip(0)] * up).sum(1) < 0
        kept = (hits.face >= 0) & facing
        face = torch.from_numpy(hits.face[kept]).long()
        bary = torch.from_numpy(hits.bary[kept])
        normal, there = query(face, bary)
        total = np.zeros(3)
        weights = ((up @ n) * angle[d @ n > 0])[kept]
        for j in range(len(face)):
            y_n = normal[j].double().numpy()
            above = e @ y_n > 0
            y = surface.at(face[j : j + 1], bary[j : j + 1])[0].double().numpy() + 1e-6 * y_n
            free = ~tracer.any_hit(np.repeat(y[None], above.sum(), 0), e[above])
            arrived = (radiance[above] * ((e[above] @ y_n) * e_angle[above] * free)[:, None]).sum(0)
            total += there.diffuse()[j].double().numpy() / math.pi * arrived * weights[j]
        result.append(m.diffuse()[i].double().numpy() / math.pi * total)
    return torch.from_numpy(np.stack(result)).float()


def test_bounce_gradient_reaches_both_surfaces_the_sky_and_normals():
    mesh = wall_and_floor()
    surface = MeshSurface(*mesh)
    points, face, _ = on_mesh(*mesh, 40)
    tint, sky = torch.rand(4, 3, generator=torch.Generator().manual_seed(2)), studio(4)

    def image(tint, sky, normal, reference):
        def query(face, bary):
            return surface.face_normals[face].to(tint), Material(tint[face])

        here = Points(points.position, points.flat, normal, points.view)
        return tint[face] * bounce_irradiance(drawn.hits, here, query, sky, reference=reference)

    light = MonteCarloLight(surface, tracer_of(mesh), MonteCarloSettings(technique="mis", samples=64))
    query = lambda face, bary: (surface.face_normals[face], Material(tint[face]))  # noqa: E731
    drawn = light.draw(points, Material(tint[face]), query, EnvSampler(sky), 0)
    assert len(drawn.hits.row) > 50
    upstream = torch.randn(40, 3, generator=torch.Generator().manual_seed(3))
    grads = []
    for dtype, reference in ((torch.float32, False), (torch.float64, True)):
        leaves = [t.to(dtype).requires_grad_() for t in (tint, sky, points.normal)]
        grads.append(torch.autograd.grad((image(*leaves, reference) * upstream).sum(), leaves))
    for fast, exact in zip(*grads, strict=True):
        assert float(exact.abs().max()) > 0
        torch.testing.assert_close(fast.double(), exact, rtol=1e-3, atol=1e-4 * float(exact.abs().max()))


def test_without_secondary_material_the_primary_one_stands_in():
    mesh = wall_and_floor()
    surface = MeshSurface(*mesh)
    points, _, _ = on_mesh(*mesh, 200)
    red = Material(torch.tensor([0.8, 0.0, 0.0]).expand(200, 3))
    green = plain(surface, torch.tensor([0.0, 0.7, 0.0]))
    sky = studio()
    bounced = []
    for secondary in (True, False):
        light = MonteCarloLight(
            surface, tracer_of(mesh), MonteCarloSettings(technique="mis", samples=64, secondary_material=secondary)
        )
        bounced.append(light.render(points, red, green, sky, 0) - light.render(points, red, None, sky, 0))
    assert float(bounced[0].abs().max()) < 1e-6  # red sees green: nothing comes back
    assert float(bounced[1][:, 0].mean()) > 0.01
    assert float(bounced[1][:, 1:].abs().max()) < 1e-6


def _image(side=20, step=0.0):
    """A plane seen from above, one point a pixel; its right half lies `step` deeper."""
    y, x = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    depth = torch.where(x >= side // 2, -step, 0.0)
    position = torch.stack([x.float(), depth, y.float()], -1).reshape(-1, 3)
    up = torch.tensor([0.0, 1.0, 0.0]).expand(side * side, 3)
    return Points(position, up, up, up), torch.arange(side * side)


@pytest.mark.parametrize("corner", [0, 1, 2, 3])
def test_upsampling_is_linear_on_a_plane_and_keeps_constants(corner):
    points, pixel = _image()
    coarse = coarse_points(points, pixel, 20, corner)
    assert len(coarse.rows) == 100
    torch.testing.assert_close(coarse.spread(torch.ones(100, 1)), torch.ones(400, 1))
    ramp = (points.position[:, 0] + 2 * points.position[:, 2])[:, None]
    back = coarse.spread(ramp[coarse.rows])
    inner = ((points.position[:, [0, 2]] > 1) & (points.position[:, [0, 2]] < 18)).all(1)
    torch.testing.assert_close(back[inner], ramp[inner], rtol=0, atol=0.02)


def test_upsampling_does_not_cross_a_depth_step_or_a_gap():
    points, pixel = _image(22, step=5.0)  # the step lies inside a block's column, at x = 11
    rows = torch.arange(len(pixel))
    hole = (pixel % 22 == 4) | (pixel % 22 == 5)
    kept = rows[~hole]
    points, pixel = points[kept], pixel[kept]
    coarse = coarse_points(points, pixel, 22)
    deep = (points.position[:, 1] < -1).float()[:, None]
    spread = coarse.spread(deep[coarse.rows])
    own_block_knows = torch.ones(len(pixel), dtype=torch.bool)
    own_block_knows[(pixel % 22 == 11)] = False
    torch.testing.assert_close(spread[own_block_knows], deep[own_block_knows], rtol=0, atol=1e-3)
    # column 11 shares its block with the near side; the next block's coarse point is of its own kind
    torch.testing.assert_close(spread[~own_block_knows], deep[~own_block_knows], rtol=0, atol=1e-3)


@pytest.mark.parametrize("corner", [0, 3])
def test_weights_are_those_of_plain_operations_in_float64(corner):
    """On a rough surface with steps, normals under the horizon, points on top of each other and gaps in the image."""
    generator = torch.Generator().manual_seed(corner)
    points, pixel = _image(23, step=1.5)
    rough = torch.randn(len(pixel), 3, generator=generator)
    normal = torch.nn.functional.normalize(points.normal + 0.8 * rough, dim=1)
    position = points.position + 0.3 * rough
    position[40:44] = position[40]
    kept = torch.rand(len(pixel), generator=generator) < 0.8
    points = Points(position, normal.roll(1, 0), normal, normal)[kept]
    wide = Points(*(t.double() for t in (points.position, points.flat, points.normal, points.view)))
    found, expected = (coarse_points(one, pixel[kept], 23, corner) for one in (points, wide))
    assert torch.equal(found.index, expected.index)
    assert torch.equal(found.rows, expected.rows)
    assert (found.weight.dtype, expected.weight.dtype) == (torch.float32, torch.float64)
    torch.testing.assert_close(found.weight.double(), expected.weight, rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_half_resolution_bounce_is_close_to_full():
    vertices, faces = bowl()
    surface = MeshSurface(vertices, faces)
    side = 40
    y, x = torch.meshgrid(torch.linspace(-0.6, 0.6, side), torch.linspace(-0.6, 0.6, side), indexing="ij")
    down = np.tile([[0.0, -1.0, 0.0]], (side * side, 1))
    tracer = tracer_of((vertices, faces))
    hits = tracer.closest_hit(np.stack([x.numpy().ravel(), np.ones(side * side), y.numpy().ravel()], 1), down)
    face, bary = torch.from_numpy(hits.face).long(), torch.from_numpy(hits.bary)
    normal = -torch.nn.functional.normalize(surface.at(face, bary), dim=-1)
    points = Points(surface.at(face, bary), surface.face_normals[face], normal, normal)
    base = torch.tensor([0.8, 0.5, 0.3])
    m, query, sky = Material(base.expand(side * side, 3)), plain(surface, base), studio()
    light = MonteCarloLight(surface, tracer, MonteCarloSettings(technique="mis", samples=64, secondary_rays=1024))
    coarse = coarse_points(points, torch.arange(side * side), side)
    none, half, full = (
        light.render(points, m, q, sky, 0, coarse=c) for q, c in ((None, None), (query, coarse), (query, None))
    )
    assert float((half - full).norm() / (full - none).norm()) < 0.08
    assert float((half - none).mean()) == pytest.approx(float((full - none).mean()), rel=0.02)


def test_cached_samples_trace_nothing_and_follow_the_changing_light():
    mesh = wall_and_floor()
    light, points, m, query = scene(mesh, 400, 0.7)

    class Counting:
        def __init__(self, tracer):
            self.tracer, self.radius, self.calls = tracer, tracer.radius, 0

        def closest_hit(self, *rays):
            self.calls += 1
            return self.tracer.closest_hit(*rays)

        def any_hit(self, *rays):
            self.calls += 1
            return self.tracer.any_hit(*rays)

    light.tracer = Counting(light.tracer)
    cache, start = SampleCache(8), torch.full((8, 16, 3), 1.0)
    draw = lambda seed: light.draw(points, m, query, EnvSampler(start), seed)  # noqa: E731
    for step in range(8):
        light.shade(cache.get(step, draw), points, m, query, start)
    traced = light.tracer.calls
    later = studio(8)  # the density is still that of the constant sky
    cached = torch.stack([light.shade(cache.get(step, draw), points, m, query, later).mean() for step in range(8, 16)])
    assert light.tracer.calls == traced
    assert torch.equal(cache.get(3, draw).direct.weight, cache.get(11, draw).direct.weight)
    many = MonteCarloLight(
        light.surface,
        light.tracer,
        MonteCarloSettings(technique="mis", samples=256, secondary_rays=64, secondary_samples=16),
    )
    assert float(cached.mean()) == pytest.approx(float(many.render(points, m, query, later, 0).mean()), rel=0.03)


def test_open_sheet_has_no_bounce():
    light, points, m, query = scene(grid(2, 2), 100, 0.9)
    sky = studio()
    assert torch.equal(light.render(points, m, query, sky, 0), light.render(points, m, None, sky, 0))


def test_materials_shape_is_free_of_metallic_and_roughness():
    m = material(3)
    assert m[1:].base_color.shape == (2, 3)
    torch.testing.assert_close(Material(m.base_color).diffuse(), m.base_color)


@pytest.mark.parametrize(
    "device",
    [
        "cpu",
        pytest.param(
            "cuda",
            marks=[
                pytest.mark.gpu,
                pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device that torch can use"),
            ],
        ),
    ],
)
def test_warps_tracer_on_its_own_device_gives_embrees_light(device):
    mesh = bowl(12)
    points, _, _ = on_mesh(*mesh, 1500)
    sky, found = studio(), []
    for tracer, where in ((tracer_of(mesh), "cpu"), (WarpTracer(*mesh, device), device)):
        surface = MeshSurface(*mesh, where)
        here = Points(*(t.to(where) for t in (points.position, points.flat, points.normal, points.view)))
        base = torch.tensor([0.7, 0.5, 0.2], device=where, requires_grad=True)
        light = MonteCarloLight(surface, tracer, MonteCarloSettings())
        coarse = coarse_points(here, torch.arange(1500, device=where), 50)
        image = light.render(
            here, Material(base.expand(1500, 3)), plain(surface, base), sky.to(where), 1, coarse=coarse
        )
        image.sum().backward()
        found.append((image.detach().cpu(), base.grad.cpu()))
    for one, other in zip(*found, strict=True):
        assert float((one - other).norm() / one.norm()) < 0.01
