"""Rows of the BRDF, its sampler, the environment and shading normals."""

from __future__ import annotations

import math

import numpy as np
import torch

from benchmarks.brdf_reference import sample_brdf
from benchmarks.stability.table import Reached, row
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.point_sets import fibonacci_sphere, hammersley
from exmesh_graph.shading.specular import PrefilteredStack
from exmesh_graph.stage2.surface import SurfaceSamples, bent

ROUGHNESS = (0.02, 0.05, 0.1, 0.3, 0.6, 1.0)
DEGREES = (0.0, 60.0, 85.0, 89.9, 89.99)
SUN = 1e5


@row("brdf", "GGX from roughness 0.02 to 1, views and lights to 89.99 degrees", "worst relative error", high=1e-3)
def brdf_value() -> Reached:
    exact, single = (np.concatenate([_lobe(r, a, t)[0] for r in ROUGHNESS for a in DEGREES]) for t in _BOTH)
    return Reached(float(np.abs(single / exact - 1).max()), None)


@row("brdf", "the same, gradients in normal, roughness, base colour", "values and gradients not finite", high=0)
def brdf_gradient() -> Reached:
    return Reached(*(float(sum(_lobe(r, a, t)[1] for r in ROUGHNESS for a in DEGREES)) for t in _BOTH[::-1]))


@row("brdf", "light = -view, light or view in the plane or below", "largest |gradient|, if finite", high=0)
def opposite_directions() -> Reached:
    reached = []
    for dtype in (torch.float32, torch.float64):
        normal = torch.tensor([[0.0, 0, 1]], dtype=dtype).expand(4, 3).clone().requires_grad_()
        view = torch.tensor([[0.0, 0, 1], [1, 0, 0], [0.6, 0, 0.8], [0, 0, -1]], dtype=dtype).requires_grad_()
        light = torch.tensor([[0.0, 0, -1], [-1, 0, 0], [-0.6, 0, -0.8], [0, 0, 1]], dtype=dtype).requires_grad_()
        rough = torch.full((4,), 0.05, dtype=dtype, requires_grad=True)
        value = brdf.evaluate(normal, view, light, torch.full((4, 3), 0.5, dtype=dtype), rough)
        grads = torch.autograd.grad(value.sum(), (normal, view, light, rough))
        reached.append(max(float(g.abs().max()) if bool(torch.isfinite(g).all()) else math.inf for g in grads))
    return Reached(*reached)


@row("brdf", "white furnace, roughness 0.02 to 1, views to 89.9 degrees", "energy returned", low=0.3, high=1 + 1e-5)
def furnace() -> Reached:
    reached = []
    for dtype in (torch.float32, torch.float64):
        albedo = [_albedo(r, a, dtype) for r in ROUGHNESS for a in DEGREES[:-1]]
        reached.append(max(albedo) if min(albedo) > 0.3 else min(albedo))
    return Reached(*reached)


@row(
    "brdf",
    "an epsilon beside 4 n.l n.v would darken grazing views: n.v = 0.01",
    "energy over quadrature's",
    low=0.995,
    high=1.005,
)
def grazing_energy() -> Reached:
    angle = math.degrees(math.acos(0.01))
    exact = _furnace_quadrature(0.3, 0.01)
    return Reached(*(_albedo(0.3, angle, t) / exact for t in (torch.float32, torch.float64)))


@row("brdf", "view and light exchanged, to 89.9 degrees", "worst relative difference", high=1e-3)
def reciprocity() -> Reached:
    generator = torch.Generator().manual_seed(0)
    reached = []
    for dtype in (torch.float32, torch.float64):
        view, light = torch.nn.functional.normalize(
            torch.randn(2, 4000, 3, generator=generator.manual_seed(1), dtype=torch.float64), dim=-1
        )
        view[:, 2], light[:, 2] = view[:, 2].abs() ** 3 + 2e-3, light[:, 2].abs() ** 3 + 2e-3
        view, light = (torch.nn.functional.normalize(x, dim=-1).to(dtype) for x in (view, light))
        normal = torch.tensor([0.0, 0, 1], dtype=dtype).expand(4000, 3)
        rough = torch.linspace(0.02, 1, 4000, dtype=dtype)
        color = torch.full((4000, 3), 0.5, dtype=dtype)
        one, two = (brdf.evaluate(normal, a, b, color, rough)[:, 0] for a, b in ((view, light), (light, view)))
        reached.append(float((one / two - 1).abs().max()))
    return Reached(*reached)


@row("brdf", "visible-normal sampler, roughness 0.02 to 1, to 89.99 degrees", "largest estimate over 1", high=1e-3)
def sampler_weight() -> Reached:
    """f n.l / p of a white metal is G / G1 <= 1: any excess is a density that does not belong to the samples."""
    return Reached(
        *(max(float(_estimates(r, a, t).max()) for r in ROUGHNESS for a in DEGREES) - 1 for t in _BOTH[::-1])
    )


@row("environment", "density of a sun of 1e5 in 32 x 64", "|integral - 1|", high=2e-3)
def density_integral() -> Reached:
    fine = torch.from_numpy(envmap.texel_directions(32 * 16, 64 * 16)).reshape(-1, 3)
    angle = torch.from_numpy(np.repeat(envmap.solid_angles(32 * 16, 64 * 16), 64 * 16))
    return Reached(*(abs(float((EnvSampler(_sun(t)).pdf(fine.to(t)).double() * angle).sum()) - 1) for t in _BOTH[::-1]))


@row("environment", "a sun of 1e5 times the mean, 64 samples", "irradiance over quadrature's", low=0.99, high=1.01)
def sun_energy() -> Reached:
    return Reached(*(_irradiance(_sun(t), 64) / _irradiance_exact(_sun(torch.float64)) for t in _BOTH[::-1]))


@row(
    "environment",
    "fireflies beside that sun (bilinear lookup, its own density)",
    "largest sample over the mean",
    high=1.3,
)
def sun_fireflies() -> Reached:
    reached = []
    for dtype in (torch.float32, torch.float64):
        image = _sun(dtype)
        uniform = torch.rand(200_000, 2, generator=torch.Generator().manual_seed(0), dtype=dtype)
        direction, density = EnvSampler(image).sample(uniform)
        ratio = envmap.lookup(image, direction).mean(-1) / density
        reached.append(float(ratio.max() / ratio.mean()))
    return Reached(*reached)


@row("environment", "samples against that density, chi-square over 1024 cells", "excess in standard deviations", high=5)
def environment_chi_square() -> Reached:
    reached = []
    for dtype in (torch.float32, torch.float64):
        sampler, count, fine = EnvSampler(_sun(dtype), uniform=0.5), 100_000, 16
        uniform = torch.rand(count, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        u, v = envmap.uv_of(sampler.sample(uniform.to(dtype))[0].double())
        cell = (v * 16).long().clamp(max=15) * 64 + (u * 64).long().clamp(max=63)
        d = torch.from_numpy(envmap.texel_directions(16 * fine, 64 * fine)).reshape(-1, 3)
        angle = torch.from_numpy(np.repeat(envmap.solid_angles(16 * fine, 64 * fine), 64 * fine))
        share = (sampler.pdf(d.to(dtype)).double() * angle).reshape(16, fine, 64, fine).sum(dim=(1, 3)).reshape(-1)
        seen = torch.bincount(cell, minlength=1024)
        statistic = float(((seen - share * count) ** 2 / (share * count)).sum())
        reached.append((statistic - 1023) / math.sqrt(2 * 1023))
    return Reached(*reached)


@row("environment", "the sun in the polar row", "energy of 256 samples over quadrature's", low=0.98, high=1.02)
def polar_sun() -> Reached:
    exact = _irradiance_exact(_sun(torch.float64, 0), cosine=False)
    return Reached(*(_irradiance(_sun(t, 0), 256, cosine=False) / exact for t in _BOTH[::-1]))


@row("environment", "a constant sky over a white plane", "irradiance over pi E", low=0.999, high=1.001)
def constant_sky() -> Reached:
    return Reached(
        *(_irradiance(torch.full((16, 32, 3), 0.7, dtype=t), 1 << 14) / (0.7 * math.pi) for t in _BOTH[::-1])
    )


@row("environment", "a black environment", "samples or densities not finite or not positive", high=0)
def black() -> Reached:
    return Reached(*(_bad_samples(torch.zeros(16, 32, 3, dtype=t)) for t in _BOTH[::-1]))


@row("environment", "one texel", "irradiance over pi E", low=0.99, high=1.01)
def one_texel() -> Reached:
    return Reached(*(_irradiance(torch.full((1, 1, 3), 2.0, dtype=t), 1 << 16) / (2 * math.pi) for t in _BOTH[::-1]))


@row(
    "environment", "black texels beside a sun keep their gradient", "least texel gradient over its solid angle", low=0.1
)
def black_gradient() -> Reached:
    reached = []
    for dtype in (torch.float32, torch.float64):
        image = torch.zeros(8, 16, 3, dtype=dtype)
        image[2, 3] = SUN
        image.requires_grad_()
        direction, density = EnvSampler(image).sample(hammersley(1 << 15).to(dtype))
        (envmap.lookup(image, direction) / density[:, None]).mean(0).sum().backward()
        angle = torch.from_numpy(envmap.solid_angles(8, 16))[:, None]
        reached.append(float((image.grad[..., 0].double() / angle).min()))
    return Reached(*reached)


@row(
    "environment",
    "softplus from black (floor 1e-4) up to 10 and from 10 down to 0.01, Adam",
    "relative distance left",
    high=0.05,
)
def softplus_alive() -> Reached:
    reached = []
    for dtype in (torch.float32, torch.float64):
        worst = 0.0
        for start, target in ((0.0, 10.0), (10.0, 0.01)):
            parameter = envmap.parameter_of(torch.full((1,), start, dtype=dtype)).requires_grad_()
            optimiser = torch.optim.Adam([parameter], lr=0.1)
            for _ in range(1000):
                optimiser.zero_grad()
                ((envmap.radiance_of(parameter) + 1).log() - math.log(target + 1)).abs().sum().backward()
                optimiser.step()
                optimiser.param_groups[0]["lr"] *= 0.997
            worst = max(worst, abs(float(envmap.radiance_of(parameter.detach())) - target) / (target + 0.1))
        reached.append(worst)
    return Reached(*reached)


@row("environment", "regularisers under a shift of one column and of half a turn", "worst relative change", high=1e-5)
def longitude_shift() -> Reached:
    reached = []
    for dtype in (torch.float32, torch.float64):
        image = torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(0), dtype=dtype)
        change = [
            abs(float(f(image.roll(shift, 1)).sum() / f(image).sum()) - 1)
            for f in (envmap.total_variation, envmap.chroma, envmap.mean_radiance)
            for shift in (1, 16)
        ]
        reached.append(max(change))
    return Reached(*reached)


@row(
    "environment",
    "texel counts would overweight the poles: one bright texel",
    "pole's share over its solid angle's",
    low=0.99,
    high=1.01,
)
def pole_weight() -> Reached:
    reached = []
    for dtype in (torch.float32, torch.float64):
        image = torch.zeros(16, 32, 3, dtype=dtype)
        image[0, 5] = 1
        reached.append(float(envmap.mean_radiance(image)[0]) / (envmap.solid_angles(16, 32)[0] / (4 * math.pi)))
    return Reached(*reached)


@row(
    "shading",
    "a normal map tilted by 60 degrees, views over the whole plane",
    "largest jump of the radiance, relative",
    high=0.05,
)
def tilted_normals() -> Reached:
    """Diffuse plus specular under a fixed light while the view sweeps: black fringes show as jumps to 0."""
    reached = []
    for dtype in (torch.float32, torch.float64):
        angle = torch.linspace(-math.radians(89), math.radians(89), 8001, dtype=dtype)
        view = torch.stack([angle.sin(), torch.zeros_like(angle), angle.cos()], 1)
        tilt = math.radians(60)
        flat = torch.tensor([[0.0, 0, 1]], dtype=dtype).expand_as(view)
        none = torch.zeros_like(view)
        surface = SurfaceSamples(none, flat, flat, view, none, angle, none[:, :2], angle.long(), none)
        slopes = torch.full_like(none[:, :2], math.tan(tilt)) * torch.tensor([1.0, 0.0], dtype=dtype)
        axes = torch.eye(3, dtype=dtype)[:, None].expand(3, len(view), 3)
        normal = bent(surface, tuple(axes), slopes).normal
        light = torch.tensor([[0.2, 0.3, 0.93]], dtype=dtype).expand_as(view)
        light = torch.nn.functional.normalize(light, dim=-1)
        color, rough = torch.full_like(view, 0.5), torch.full_like(angle, 0.5)
        radiance = (brdf.evaluate(normal, view, light, color, rough) * (normal * light).sum(-1, keepdim=True))[:, 0]
        reached.append(float((radiance[1:] - radiance[:-1]).abs().max() / radiance.mean()))
    return Reached(*reached)


@row(
    "environment",
    "prefiltered levels of a sun in any row, the polar ones included",
    "worst relative loss of flux",
    high=1e-3,
)
def filtered_sun() -> Reached:
    stack, worst = PrefilteredStack(32, 64), 0.0
    sizes = list(zip(stack.heights.tolist(), stack.widths.tolist(), strict=True))
    for line in (0, 1, 5, 16, 31):
        sky = _sun(torch.float32, line) - 1
        flux = float(sky[line, 20, 0]) * envmap.solid_angles(32, 64)[line]
        for (height, width), level in zip(sizes, stack.build(sky).split([h * w for h, w in sizes]), strict=True):
            angle = torch.from_numpy(envmap.solid_angles(height, width))[:, None]
            worst = max(worst, abs(float((level[:, 0].double().reshape(height, width) * angle).sum()) / flux - 1))
    return Reached(worst)


_BOTH = (torch.float64, torch.float32)


def _frame(degrees: float, dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    normal = torch.nn.functional.normalize(torch.tensor([0.3, -0.5, 0.8], dtype=torch.float64), dim=0)
    tangent = torch.nn.functional.normalize(
        torch.linalg.cross(normal, torch.tensor([0.0, 1, 0], dtype=torch.float64)), dim=0
    )
    view = normal * math.cos(math.radians(degrees)) + tangent * math.sin(math.radians(degrees))
    # what float32 can hold, in both precisions
    return normal.float().to(dtype), tangent.float().to(dtype), view.float().to(dtype)


def _lobe(roughness: float, degrees: float, dtype: torch.dtype) -> tuple[np.ndarray, int]:
    """Specular values of lights spread over the lobe, and how many values and gradient entries are not finite."""
    normal, tangent, view = _frame(degrees, torch.float64)
    u = hammersley(2000).double()
    s, phi = 0.98 * u[:, 0], 2 * math.pi * u[:, 1]
    slope = max(roughness**2, brdf.ALPHA_MIN) * (s / (1 - s)).sqrt()
    bitangent = torch.linalg.cross(normal, tangent)
    half = normal + slope[:, None] * (phi.cos()[:, None] * tangent + phi.sin()[:, None] * bitangent)
    half = torch.nn.functional.normalize(half, dim=-1)
    light = (2 * (half @ view)[:, None] * half - view).float()
    light = light[(light.double() @ normal) > 1.2 * brdf.COSINE_MIN].to(dtype)
    count = len(light)
    normal, view = (x.to(dtype).expand(count, 3).clone().requires_grad_() for x in (normal, view))
    rough = torch.full((count,), roughness, dtype=dtype, requires_grad=True)
    f0 = torch.full((count, 3), 0.5, dtype=dtype, requires_grad=True)
    value = brdf.specular(normal, view, light.requires_grad_(), rough, f0)
    grads = torch.autograd.grad(value.sum(), (normal, view, light, rough, f0))
    bad = sum(int((~torch.isfinite(x)).sum()) for x in (value, *grads))
    return value.detach().double()[:, 0].numpy(), bad


def _estimates(roughness: float, degrees: float, dtype: torch.dtype) -> torch.Tensor:
    """f n.l / p of a white metal, 2000 samples."""
    normal, _, view = (x[None] for x in _frame(degrees, dtype))
    rough, metal = torch.full((1,), roughness, dtype=dtype), torch.ones(1, dtype=dtype)
    white = torch.ones(1, 3, dtype=dtype)
    light, density = sample_brdf(normal, view, white, rough, metal, hammersley(2000).to(dtype)[None])
    value = brdf.evaluate(normal[:, None], view[:, None], light, white[:, None], rough[:, None], metal[:, None])
    cosine = (light * normal[:, None]).sum(-1).clamp_min(0)
    return torch.where(density > 0, value[..., 0] * cosine / density.clamp_min(1e-30), torch.zeros_like(density))[0]


def _albedo(roughness: float, degrees: float, dtype: torch.dtype) -> float:
    return float(_estimates(roughness, degrees, dtype).mean())


def _furnace_quadrature(roughness: float, n_v: float) -> float:
    """Directional albedo of a white metal in float64, by half vectors on a fine grid."""
    a2 = float(brdf.alpha_of(torch.tensor(roughness, dtype=torch.float64))) ** 2
    s, t = np.meshgrid(*[(np.arange(1500) + 0.5) / 1500] * 2, indexing="ij")
    s = 1 - (1 - s) ** 2
    cos2 = (1 - s) / (1 + (a2 - 1) * s)
    n_h, sine = np.sqrt(cos2), np.sqrt(1 - cos2)
    v_h = math.sqrt(1 - n_v**2) * sine * np.cos(2 * np.pi * t) + n_v * n_h
    n_l = 2 * v_h * n_h - n_v
    lit = (n_l > 0) & (v_h > 0)
    n_l = np.where(lit, n_l, 1)
    visibility = 0.5 / (n_l * np.sqrt(a2 + (1 - a2) * n_v**2) + n_v * np.sqrt(a2 + (1 - a2) * n_l**2))
    measure = 2 * (1 - (np.arange(1500) + 0.5) / 1500)[:, None]
    return float((np.where(lit, 4 * visibility * n_l * v_h / n_h, 0) * measure).mean())


def _sun(dtype: torch.dtype, line: int = 9) -> torch.Tensor:
    image = torch.full((32, 64, 3), 1.0, dtype=dtype)
    image[line, 20] = SUN
    return image


def _irradiance(image: torch.Tensor, count: int, cosine: bool = True) -> float:
    """Of a plane facing +Y; without the cosine the light of the whole sphere."""
    direction, density = EnvSampler(image).sample(hammersley(count).to(image.dtype))
    weight = direction[:, 1].clamp_min(0) if cosine else torch.ones_like(density)
    return float((envmap.lookup(image, direction).mean(-1) * weight / density).double().mean())


def _irradiance_exact(image: torch.Tensor, cosine: bool = True) -> float:
    height, width = (16 * n for n in image.shape[:2])
    fine = torch.from_numpy(envmap.texel_directions(height, width)).reshape(-1, 3)
    angle = torch.from_numpy(np.repeat(envmap.solid_angles(height, width), width))
    weight = fine[:, 1].clamp_min(0) if cosine else torch.ones_like(angle)
    return float((envmap.lookup(image, fine).mean(-1) * weight * angle).sum())


def _bad_samples(image: torch.Tensor) -> float:
    sampler = EnvSampler(image)
    direction, density = sampler.sample(hammersley(4096).to(image.dtype))
    other = sampler.pdf(torch.from_numpy(fibonacci_sphere(4096)).to(image.dtype))
    bad = ~torch.isfinite(direction).all(-1) | ~torch.isfinite(density) | (density <= 0)
    return float(bad.sum() + (~torch.isfinite(other) | (other <= 0)).sum())
