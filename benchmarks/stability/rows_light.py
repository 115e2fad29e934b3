"""Rows of the Monte Carlo light: direct, one bounce, and the noise its loss sees."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import torch

from benchmarks.gradient_seed import independent_gradient
from benchmarks.meshes import grid
from benchmarks.stability.table import Reached, row
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo import (
    Material,
    MeshSurface,
    MonteCarloLight,
    Points,
    Sampler,
    draw_light,
    make_pool,
    shade,
    shade_reference,
)
from exmesh_graph.shading.settings import MonteCarloSettings

TRUTH = torch.tensor([0.6, 0.4, 0.25])

Loss = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


def log_l1(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    return (torch.log1p(image) - torch.log1p(target)).abs().mean()


def fitted_bias(loss: Loss, own_seed: bool, uniform: bool = False, steps: int = 100, count: int = 500) -> float:
    """Worst relative error of a sphere's albedo, fitted under known light from 8 samples a point by Adam.

    own_seed    the gradient's samples are drawn apart from the image's
    uniform     samples spread over the sphere, whatever the sky looks like, for a lot of noise
    The target is analytic (a convex body is never in its own shade); the albedo is averaged over the last third.
    """
    vertices, faces = icosphere(2)
    surface, tracer = MeshSurface(vertices, faces), make_ray_tracer(vertices, faces)
    points = _on_faces(surface, count)
    axis = torch.tensor([0.36, 0.48, 0.8])
    towards = torch.from_numpy(envmap.texel_directions(16, 32)).float() @ axis
    sky = (0.3 + 12 * torch.exp(8 * (towards - 1)))[..., None].expand(-1, -1, 3).contiguous()
    target = TRUTH / math.pi * _irradiance(points.normal, sky).float()
    density = EnvSampler(torch.ones_like(sky) if uniform else sky)
    log_albedo = torch.full((3,), math.log(0.5), requires_grad=True)
    optimiser = torch.optim.Adam([log_albedo], lr=0.05)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimiser, 0.1 ** (1 / steps))

    def estimate(seed: int, base: torch.Tensor) -> torch.Tensor:
        material = Material(base.expand(count, 3))
        drawn = draw_light(points, material, make_pool(density, "environment", 8, seed, blocks=512), tracer)
        return shade(drawn, points.normal, points.view, material, sky)

    found = []
    for step in range(steps):
        base = log_albedo.exp()
        image = independent_gradient(estimate, 2 * step, 2 * step + 1, base) if own_seed else estimate(2 * step, base)
        optimiser.zero_grad()
        loss(image, target).backward()
        optimiser.step()
        schedule.step()
        found.append(log_albedo.detach().exp())
    return float((torch.stack(found[-steps // 3 :]).mean(0) / TRUTH - 1).abs().max())


@row(
    "light",
    "log-L1 of a noisy estimate (8 samples), gradient by a seed of its own",
    "bias of the albedo",
    high=0.01,
    slow=True,
)
def noisy_loss() -> Reached:
    return Reached(fitted_bias(log_l1, own_seed=True))


@row(
    "light", "a sun of one texel, plates of roughness 0.1 to 1, 8 samples", "MIS noise over the better one's", high=0.8
)
def fireflies() -> Reached:
    """Noise of the worst plate. Environment samples miss the narrow lobe's peak, lobe samples miss the sun."""
    noise = {kind: float(_plates(kind, 8, 6)[1].max()) for kind in ("environment", "brdf", "mis")}
    return Reached(noise["mis"] / min(noise["environment"], noise["brdf"]))


@row(
    "light", "the same plates: means of environment and MIS samples", "worst |energy over quadrature's - 1|", high=0.01
)
def mean_of_techniques() -> Reached:
    exact = _plates_exact()
    return Reached(max(float((_plates(kind, 64, 8)[0] / exact - 1).abs().max()) for kind in ("environment", "mis")))


@row("light", "a sun of 1e5 times the mean, half of it behind a wall", "energy over quadrature's", low=0.99, high=1.01)
def sun_behind_wall() -> Reached:
    floor, floor_faces = grid(1, 1)
    wall = floor[:, [0, 2, 1]] * 4 - np.array([2, 0, 0], np.float32)
    vertices = np.concatenate([floor, wall]).astype(np.float32)
    faces = np.concatenate([floor_faces, floor_faces[:, ::-1] + 4])
    surface, tracer = MeshSurface(vertices, faces), make_ray_tracer(vertices, faces)
    points = _on_faces(surface, 12, torch.arange(len(floor_faces)))
    sky = torch.full((32, 64, 3), 1.0)
    sky[6, 32], sky[6, 0] = 1e5, 1e5  # one in front of the wall, one behind it
    directions = torch.from_numpy(envmap.texel_directions(256, 512)[:128]).reshape(-1, 3)
    measure = torch.from_numpy(envmap.solid_angles(256, 512)[:128]).repeat_interleave(512)
    radiance = envmap.lookup(sky.double(), directions)[:, 0] * directions[:, 1] * measure
    exact, sampled = 0.0, 0.0
    white = Material(torch.ones(400, 3))
    for i in range(len(points)):
        origin = points.position[i].double().numpy() + np.array([0, 1e-5, 0])
        free = ~tracer.any_hit(np.repeat(origin[None], len(directions), 0), directions.numpy())
        exact += float(radiance[torch.from_numpy(free)].sum()) / math.pi
        many = points[torch.full((400,), i)]
        drawn = draw_light(many, white, make_pool(EnvSampler(sky), "environment", 256, i), tracer)
        sampled += float(shade(drawn, many.normal, many.view, white, sky)[:, 0].mean())
    return Reached(sampled / exact)


@row("light", "open hemisphere seen from inside, faces looking out", "bounce, and direct over a E / 2 - 1", high=0.01)
def two_sided() -> Reached:
    light, points, material, query = _bowl(inward=False)
    inside = Points(points.position, -points.flat, -points.normal, -points.view)
    sky = torch.full((8, 16, 3), 2.0)
    direct = torch.stack([light.render(inside, material, None, sky, s).mean() for s in range(4)]).mean()
    bounce = (light.render(inside, material, query, sky, 0) - light.render(inside, material, None, sky, 0)).abs().max()
    return Reached(max(float(bounce), abs(float(direct) / 0.6 - 1)))


@row("light", "white bowl under a constant sky", "direct and one bounce over E / 2 + E / 4", low=0.985, high=1.015)
def bowl_energy() -> Reached:
    light, points, _, _ = _bowl(inward=True)
    white = Material(torch.ones(len(points), 3))

    def query(face: torch.Tensor, bary: torch.Tensor) -> tuple[torch.Tensor, Material]:
        return light.surface.face_normals[face], Material(torch.ones(len(face), 3))

    sky = torch.full((8, 16, 3), 2.0)
    return Reached(
        float(torch.stack([light.render(points, white, query, sky, s).mean() for s in range(4)]).mean()) / 1.5
    )


@row("light", "closed room under a bright sky", "largest radiance inside", high=0)
def closed_room() -> Reached:
    vertices, faces = icosphere(2)
    surface = MeshSurface(vertices, faces[:, ::-1].copy())
    points = _on_faces(surface, 2000)
    light = MonteCarloLight(surface, make_ray_tracer(vertices, faces), MonteCarloSettings(technique="mis", samples=64))
    material = Material(torch.full((2000, 3), 0.9))

    def query(face: torch.Tensor, bary: torch.Tensor) -> tuple[torch.Tensor, Material]:
        return surface.face_normals[face], Material(torch.full((len(face), 3), 0.9))

    return Reached(float(light.render(points, material, query, torch.full((8, 16, 3), 1e5), 0).abs().max()))


@row("light", "a black environment", "radiance, and values or gradients not finite", high=0)
def black() -> Reached:
    light, points, _, query = _bowl(inward=True)
    base = torch.full((3,), 0.5, requires_grad=True)
    sky = torch.zeros(8, 16, 3, requires_grad=True)
    glossy = Material(base.expand(len(points), 3), torch.full((len(points),), 0.3))
    image = light.render(points, glossy, query, sky, 0)
    image.sum().backward()
    assert base.grad is not None
    assert sky.grad is not None
    bad = sum(int((~torch.isfinite(t)).sum()) for t in (image, base.grad, sky.grad))
    return Reached(float(image.detach().abs().max()) + bad)


@row("light", "fused kernels: roughness 0.02, grazing views, a sun of 1e5", "relative error to float64", high=2e-3)
def kernels() -> Reached:
    drawn, points, leaves = _hard_plates()
    found = []
    for dtype, function in ((torch.float32, shade), (torch.float64, shade_reference)):
        here = [t.detach().to(dtype).requires_grad_() for t in leaves]
        normal, base, rough, metal, sky = here
        value = function(drawn, normal, points.view.to(dtype), Material(base, rough, metal), sky)
        # each point's own scale: the sun's reflections must not hide the others
        found.append((value, *torch.autograd.grad(torch.log1p(value).sum(), here)))
    errors = [
        float(((fast.double() - exact).norm() / exact.norm()).detach()) for fast, exact in zip(*found, strict=True)
    ]
    return Reached(max(errors))


@row("light", "samples kept while normals turn by 40 degrees, those plates", "relative error to float64", high=2e-3)
def turned_normals() -> Reached:
    """What falls under the new horizon must be dark: a negative cosine there is negative light."""
    drawn, points, leaves = _hard_plates()
    turned = torch.nn.functional.normalize(leaves[0] + torch.tensor([0.7, 0.0, 0.45]), dim=-1)
    found = []
    for dtype, function in ((torch.float32, shade), (torch.float64, shade_reference)):
        here = [t.detach().to(dtype).requires_grad_() for t in (turned, *leaves[1:])]
        normal, base, rough, metal, sky = here
        value = function(drawn, normal, points.view.to(dtype), Material(base, rough, metal), sky)
        found.append((value, *torch.autograd.grad(torch.log1p(value.clamp_min(0)).sum(), here)))
    errors = [
        float(((fast.double() - exact).norm() / exact.norm()).detach()) for fast, exact in zip(*found, strict=True)
    ]
    return Reached(max(errors))


def _on_faces(surface: MeshSurface, count: int, among: torch.Tensor | None = None) -> Points:
    rng = torch.Generator().manual_seed(0)
    choose = torch.arange(len(surface.faces)) if among is None else among
    face = choose[torch.randint(0, len(choose), (count,), generator=rng)]
    bary = torch.rand(count, 3, generator=rng) + 0.05
    bary = bary / bary.sum(1, keepdim=True)
    flat = surface.face_normals[face]
    view = torch.nn.functional.normalize(flat + 0.3 * torch.rand(count, 3, generator=rng), dim=-1)
    return Points(surface.at(face, bary), flat, flat, view)


def _irradiance(normal: torch.Tensor, sky: torch.Tensor, height: int = 64) -> torch.Tensor:
    directions = torch.from_numpy(envmap.texel_directions(height, 2 * height)).reshape(-1, 3)
    measure = torch.from_numpy(envmap.solid_angles(height, 2 * height)).repeat_interleave(2 * height)
    radiance = envmap.lookup(sky.double(), directions) * measure[:, None]
    return (normal.double() @ directions.T).clamp_min(0) @ radiance


def _plate_scene() -> tuple[Points, Material, torch.Tensor, torch.Tensor]:
    """Five plates of roughness 0.1 to 1 whose lobes reach the sun; the last is which plate a point is."""
    per = 800
    which = torch.arange(5).repeat_interleave(per)
    up = torch.tensor([0.0, 1.0, 0.0]).expand(len(which), 3)
    view = torch.nn.functional.normalize(torch.tensor([0.1, 1.0, -0.9]), dim=0).expand(len(which), 3)
    roughness = torch.tensor([0.1, 0.25, 0.4, 0.7, 1.0])[which]
    material = Material(torch.full((len(which), 3), 0.5), roughness)
    sky = torch.full((32, 64, 3), 0.5)
    sky[8, 32] = 2000
    return Points(torch.zeros(len(which), 3), up, up, view), material, sky, which


def _plates(kind: Sampler, samples: int, seeds: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and relative deviation of one estimate, of each plate: [5], [5]."""
    points, material, sky, _ = _plate_scene()
    vertices, faces = grid(1, 1)
    tracer = make_ray_tracer(vertices - np.array([0.5, 1, 0.5], np.float32), faces)  # below: blocks nothing
    runs = []
    for seed in range(seeds):
        drawn = draw_light(points, material, make_pool(EnvSampler(sky), kind, samples, seed), tracer)
        runs.append(shade(drawn, points.normal, points.view, material, sky)[:, 0].view(5, -1))
    values = torch.cat(runs, dim=1).double()
    return values.mean(1), values.std(1) / _plates_exact()


@cache
def _plates_exact() -> torch.Tensor:
    points, material, sky, which = _plate_scene()
    first = torch.searchsorted(which, torch.arange(5))
    directions = torch.from_numpy(envmap.texel_directions(512, 1024)[:256]).reshape(-1, 3)
    measure = torch.from_numpy(envmap.solid_angles(512, 1024)[:256]).repeat_interleave(1024)
    radiance = envmap.lookup(sky.double(), directions)[:, 0] * directions[:, 1] * measure
    found = []
    for i in first.tolist():
        spread = (len(directions), 3)
        assert material.roughness is not None
        f = brdf.evaluate(
            points.normal[i].double().expand(spread),
            points.view[i].double().expand(spread),
            directions,
            material.base_color[i].double().expand(spread),
            material.roughness[i].double().expand(len(directions)),
        )
        found.append((f[:, 0] * radiance).sum())
    return torch.stack(found)


def _hard_plates():  # type: ignore[no-untyped-def]
    rng = torch.Generator().manual_seed(1)
    count = 2000
    vertices, faces = grid(1, 1)
    tracer = make_ray_tracer(vertices - np.array([0.5, 1, 0.5], np.float32), faces)
    up = torch.tensor([0.0, 1.0, 0.0]).expand(count, 3).contiguous()
    slant = torch.rand(count, generator=rng) * (math.pi / 2 - 2e-4)
    around = torch.rand(count, generator=rng) * 2 * math.pi
    view = torch.stack([slant.sin() * around.cos(), slant.cos(), slant.sin() * around.sin()], dim=1)
    sky = 0.1 + torch.rand(16, 32, 3, generator=rng)
    sky[3, 8] = 1e5
    base, metal = torch.rand(count, 3, generator=rng), torch.rand(count, generator=rng)
    rough = 0.02 + 0.98 * torch.rand(count, generator=rng) ** 2
    points = Points(torch.zeros(count, 3), up, up, view)
    drawn = draw_light(points, Material(base, rough, metal), make_pool(EnvSampler(sky), "mis", 8, 0), tracer)
    return drawn, points, (up, base, rough, metal, sky)


def _bowl(inward: bool):  # type: ignore[no-untyped-def]
    """A fine lower half sphere of albedo 0.6: light, points on it, material, query."""
    rings, columns = 24, 48
    polar, turn = np.meshgrid(
        np.linspace(np.pi / 2, np.pi - 1e-3, rings + 1),
        np.linspace(0, 2 * np.pi, columns, endpoint=False),
        indexing="ij",
    )
    vertices = np.stack([np.sin(polar) * np.sin(turn), np.cos(polar), np.sin(polar) * np.cos(turn)], -1).reshape(-1, 3)
    i, j = (axis.reshape(-1) for axis in np.meshgrid(np.arange(rings), np.arange(columns), indexing="ij"))
    a, b = i * columns + j, i * columns + (j + 1) % columns
    faces = np.concatenate([np.stack([a, a + columns, b], 1), np.stack([b, a + columns, b + columns], 1)])
    faces = (faces[:, ::-1] if inward else faces).astype(np.int32)
    surface = MeshSurface(vertices, faces)
    points = _on_faces(surface, 4000)
    light = MonteCarloLight(surface, make_ray_tracer(vertices, faces), MonteCarloSettings())

    def query(face: torch.Tensor, bary: torch.Tensor) -> tuple[torch.Tensor, Material]:
        return surface.face_normals[face], Material(torch.full((len(face), 3), 0.6))

    return light, points, Material(torch.full((len(points), 3), 0.6)), query
