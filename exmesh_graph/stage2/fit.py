"""Stage II: base colour, roughness (metallic) and environment on the frozen carrier, eq. 14 to 24.

Every step renders one training view from precomputed light transport (no sampling noise), compares it in linear light
and moves the texels and the environment by Adam. Maps are sigmoids, the environment a softplus, of free parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from exmesh_graph.errors import DataError, NumericsError
from exmesh_graph.losses import d_ssim, linear_to_srgb, ssim_target
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.specular import PrefilteredStack, directional_albedo, reflectance_table
from exmesh_graph.shading.transport import LightTransport, check_fits
from exmesh_graph.stage2.adam import Adam
from exmesh_graph.stage2.correction import initial_specular_scale, measure_specular_scale
from exmesh_graph.stage2.fill import complete_maps
from exmesh_graph.stage2.gbuffer import ViewBuffer, build_gbuffer, lattice_texels
from exmesh_graph.stage2.init import initial_base_color, initial_environment, logit
from exmesh_graph.stage2.losses import log_l1, pair_variation
from exmesh_graph.stage2.settings import FitSettings
from exmesh_graph.stage2.surface import CarrierGeometry
from exmesh_graph.types import Asset, Carrier, Transport, Views

Progress = Callable[[int, int, dict[str, float]], None]
Checkpoint = Callable[[int, dict[str, Any]], None]
Resumed = tuple[int, Mapping[str, Any]]

#: Bilinear weight over all pixels of all views from which a texel counts as seen: one pixel's worth, or this share of
#: the median texel's where maps are finer than pixels. Adam moves a texel that the corner of one footprint touches as
#: fast as any other: such texels, most of them on the borders of charts, end up anywhere.
SEEN_WEIGHT, SEEN_SHARE = 1.0, 0.1

#: Photographs of a dark room: the light's softplus parameter must still have a gradient.
MIN_LEVEL = 0.01


@dataclass
class Light:
    """The environment as a step sees it: texels [H, W, 3], prefiltered rows, irradiance [P, 3] at the lattice."""

    environment: torch.Tensor
    stack: torch.Tensor
    irradiance: torch.Tensor


class Model:
    """The optimised parameters and the differentiable forward render of a view's pixels."""

    def __init__(
        self, carrier: Carrier, views: Views, transport: Transport, settings: FitSettings, device: str
    ) -> None:
        self.settings = settings
        self.size = settings.texture_size or carrier.texture.shape[0]
        self.geometry = CarrierGeometry(carrier, device)
        self.operators = LightTransport(transport, device)
        self.buffers, self.texels = build_gbuffer(self.geometry, transport, views, self.size, settings.min_coverage)
        if not any(len(buffer.pixel) for buffer in self.buffers):
            raise DataError("no training pixel sees the mesh", expected="cameras and mesh in one frame")
        self.point_texel, self.point_weight = lattice_texels(self.geometry, transport, self.texels, self.size)
        start = initial_base_color(carrier.texture, self.size, settings.base_color_init).to(device)
        columns = [start.reshape(-1, 3)[self.texels], torch.full((len(self.texels), 1), 0.5, device=device)]
        span = 1 - settings.roughness_min
        columns[1][:] = (settings.roughness_start - settings.roughness_min) / span
        if settings.metallic:
            columns.append(torch.zeros(len(self.texels), 1, device=device))
        self.material = logit(torch.cat(columns, dim=1)).requires_grad_()
        height = settings.environment_height
        self.environment = initial_environment(height, device=device).requires_grad_()
        self.stack = PrefilteredStack(height, 2 * height, device)
        self.binning = self.operators.bin_matrix(height, 2 * height)
        self.table = reflectance_table(device=device)

    def level_light(self) -> None:
        """Set the white starting light so that the starting maps are as bright as the photographs, on average.

        Materials and light share a factor that only highlights tell, and a short fit moves little along it: where it
        starts, with mid-gray base colour a guess that is rarely far off, decides where it ends. Raises NumericsError
        for a photograph that is not finite.
        """
        with torch.no_grad():
            maps = self.maps()
            light = self.light(maps, 0.0)
            seen = shown = 0.0
            for buffer in self.buffers:
                predicted, _ = self.shade(buffer, maps, light)
                brightness = float((buffer.target * buffer.coverage[:, None]).sum())
                if not np.isfinite(brightness):
                    raise NumericsError(
                        f"the image's brightness is {brightness}",
                        where=f"stage2 step 0, view {buffer.name}",
                        expected="finite pixel values",
                        fix="check the view's image for NaN or Inf",
                    )
                seen += brightness
                shown += float((predicted * buffer.coverage[:, None]).sum())
            level = max(seen / max(shown, 1e-12), MIN_LEVEL)
            self.environment.copy_(
                initial_environment(self.settings.environment_height, level, self.environment.device)
            )

    def maps(self) -> torch.Tensor:
        """Base colour, roughness (and metallic) of the compact texels, [T, 4 or 5]."""
        values = torch.sigmoid(self.material)
        low = self.settings.roughness_min
        roughness = low + (1 - low) * values[:, 3:4]
        return torch.cat([values[:, :3], roughness, values[:, 4:]], dim=1)

    def light(self, maps: torch.Tensor, indirect: float) -> Light:
        """The current environment and what it does at the lattice points, with lambda_ind = `indirect`."""
        environment = envmap.radiance_of(self.environment)
        binned = torch.sparse.mm(self.binning, environment.reshape(-1, 3))
        diffuse = None
        if self.operators.bounces and indirect > 0:
            at_points = gather_rows(maps, self.point_texel, self.point_weight)
            diffuse = brdf.diffuse(at_points[:, :3], at_points[:, 4] if self.settings.metallic else None)
        irradiance = self.operators.irradiance(binned, diffuse, indirect)
        return Light(environment, self.stack.build(environment), irradiance)

    def shade(self, buffer: ViewBuffer, maps: torch.Tensor, light: Light) -> tuple[torch.Tensor, torch.Tensor]:
        """Radiance [N, 3] of a view's pixels and their material [N, 4 or 5]."""
        material = gather_rows(maps, buffer.texel, buffer.texel_weight)
        metallic = material[:, 4] if self.settings.metallic else None
        irradiance = gather_rows(light.irradiance, buffer.point, buffer.point_weight)
        split = self.split_sum(buffer, material, light)
        return brdf.diffuse(material[:, :3], metallic) * irradiance + split * buffer.specular_scale, material

    def split_sum(self, buffer: ViewBuffer, material: torch.Tensor, light: Light) -> torch.Tensor:
        """Unoccluded specular radiance [N, 3] of a view's pixels."""
        roughness = material[:, 3]
        index, weight = self.stack.locate(buffer.env_u, buffer.env_v, roughness)
        prefiltered = gather_rows(light.stack, index, weight)
        if self.settings.metallic:
            f0 = brdf.base_reflectance(material[:, :3], material[:, 4])
            return directional_albedo(self.table, buffer.n_v, roughness, f0) * prefiltered
        albedo = directional_albedo(self.table, buffer.n_v, roughness, brdf.DIELECTRIC_F0)
        return albedo[:, None] * prefiltered


def fit(
    carrier: Carrier,
    views: Views,
    transport: Transport,
    settings: FitSettings | None = None,
    *,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    resumed: Resumed | None = None,
) -> tuple[Asset, dict[str, list[float]]]:
    """Decompose the carrier's appearance into materials and light.

    Returns the asset and curves over iterations (`iteration`, `loss`, `image`, `psnr`: sRGB over the view's pixels).
    A call that was cut off goes on with the same arguments and `resumed`, what `checkpoint(step, state)` was last
    given, and ends with the same bytes.
    Raises GeometryError when `transport` belongs to another mesh, DataError when no pixel sees the mesh and
    NumericsError, naming step, view and term, when a loss stops being finite.
    """
    settings = settings or FitSettings()
    check_fits(transport, carrier.vertices, carrier.faces)
    model = Model(carrier, views, transport, settings, device)
    tracer = make_ray_tracer(carrier.vertices, carrier.faces, device)
    generator = torch.Generator().manual_seed(seed)
    optimiser = Adam([model.material, model.environment], [settings.material_rate, settings.environment_rate])
    refresh = {round(settings.iterations * (i + 1) / (settings.corrections + 1)) for i in range(settings.corrections)}
    curves: dict[str, list[float]] = {"iteration": [], "loss": [], "image": [], "psnr": []}
    order: list[int] = []
    first = 0
    if resumed is None:
        initial_specular_scale(model)
        model.level_light()
    else:
        first, kept = resumed
        curves, order = kept["curves"], kept["order"]
        _restore(model, optimiser, generator, kept)
    for step in range(first, settings.iterations):
        if step in refresh:
            measure_specular_scale(model, tracer, _indirect(settings, step), generator)
        if not order:
            order = torch.randperm(len(model.buffers), generator=generator).tolist()
        buffer = model.buffers[order.pop()]
        if len(buffer.pixel) == 0:
            continue
        terms, predicted = _terms(model, buffer, step)
        loss = torch.stack(list(terms.values())).sum()
        _check(terms, step, buffer.name)
        loss.backward()
        optimiser.step(settings.rate_decay ** (step / settings.iterations))
        if step % 10 == 0 or step == settings.iterations - 1:
            figures = {
                "loss": float(loss.detach()),
                "image": float(terms["image"].detach()),
                "psnr": _psnr(predicted, buffer),
            }
            curves["iteration"].append(step)
            for name, value in figures.items():
                curves[name].append(value)
            if progress:
                progress(step + 1, settings.iterations, figures)
        if checkpoint is not None:
            checkpoint(step + 1, {**_changing(model, optimiser, generator), "curves": curves, "order": order})
    return _asset(carrier, model), curves


def _changing(model: Model, optimiser: Adam, generator: torch.Generator) -> dict[str, Any]:
    """All that steps change: with the arguments of `fit` it determines what follows."""
    return {
        "parameters": optimiser.parameters,
        "first": optimiser.first,
        "second": optimiser.second,
        "steps": optimiser.steps,
        "generator": generator.get_state(),
        "specular_scale": [buffer.specular_scale for buffer in model.buffers],
    }


@torch.no_grad()
def _restore(model: Model, optimiser: Adam, generator: torch.Generator, kept: Mapping[str, Any]) -> None:
    for name in ("parameters", "first", "second"):
        for tensor, value in zip(getattr(optimiser, name), kept[name], strict=True):
            tensor.copy_(value)
    optimiser.steps = kept["steps"]
    generator.set_state(kept["generator"])
    for buffer, scale in zip(model.buffers, kept["specular_scale"], strict=True):
        buffer.specular_scale = scale.to(buffer.specular_scale)


def _indirect(settings: FitSettings, step: int) -> float:
    return settings.indirect_weight * min(1.0, (step + 1) / max(settings.indirect_ramp, 1))


def _terms(model: Model, buffer: ViewBuffer, step: int) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """The weighted terms of eq. 22 for one view, and its predicted radiance."""
    settings = model.settings
    maps = model.maps()
    light = model.light(maps, _indirect(settings, step))
    predicted, material = model.shade(buffer, maps, light)
    terms = {"image": settings.log_weight * log_l1(predicted, buffer.target, buffer.clipped, buffer.coverage)}
    if settings.ssim_weight > 0:
        terms["ssim"] = settings.ssim_weight * _d_ssim(predicted, buffer)
    if settings.material_weight > 0:
        terms["material"] = settings.material_weight * pair_variation(material, buffer.pairs)
    if settings.environment_weight > 0:
        terms["environment"] = settings.environment_weight * envmap.total_variation(light.environment)
    if settings.chroma_weight > 0:
        weight = settings.chroma_weight * (1 - step / settings.iterations)
        terms["chroma"] = weight * envmap.chroma(light.environment)
    return terms, predicted.detach()


def _check(terms: dict[str, torch.Tensor], step: int, view: str) -> None:
    for name, value in terms.items():
        if not bool(torch.isfinite(value)):
            raise NumericsError(
                f"the {name} term is {float(value.detach())}",
                where=f"stage2 step {step}, view {view}",
                expected="a finite loss",
                fix="lower material_rate and environment_rate; check the view's image for NaN",
            )


def _d_ssim(predicted: torch.Tensor, buffer: ViewBuffer) -> torch.Tensor:
    """D-SSIM in sRGB over the box of the view's pixels, black around them."""
    height, width = buffer.box
    if buffer.ssim is None:
        buffer.ssim = ssim_target(_image(_encode(buffer.target), buffer.box_pixel, height, width))
    return d_ssim(_image(_encode(predicted), buffer.box_pixel, height, width), buffer.ssim)


def _encode(linear: torch.Tensor) -> torch.Tensor:
    return linear_to_srgb(linear.clamp(0, 1))


def _image(values: torch.Tensor, pixel: torch.Tensor, height: int, width: int) -> torch.Tensor:
    blank = torch.zeros(height * width, 3, dtype=values.dtype, device=values.device)
    return blank.index_copy(0, pixel, values).reshape(height, width, 3)


def _psnr(predicted: torch.Tensor, buffer: ViewBuffer) -> float:
    error = ((_encode(predicted) - _encode(buffer.target)) ** 2).mean()
    return float(-10 * torch.log10(error.clamp_min(1e-10)))


@torch.no_grad()
def _asset(carrier: Carrier, model: Model) -> Asset:
    evidence = torch.zeros(len(model.texels), device=model.texels.device)
    for buffer in model.buffers:
        evidence.index_add_(0, buffer.texel.reshape(-1), buffer.texel_weight.reshape(-1))
    seen_rows = evidence >= min(SEEN_WEIGHT, SEEN_SHARE * float(evidence[evidence > 0].median()))
    count = model.size * model.size
    maps = model.maps()
    values = torch.zeros(count, maps.shape[1], device=maps.device)
    values[model.texels] = maps
    seen = torch.zeros(count, dtype=torch.bool, device=maps.device)
    seen[model.texels[seen_rows]] = True
    image = values.reshape(model.size, model.size, -1).cpu().numpy()
    seen_image = seen.reshape(model.size, model.size).cpu().numpy()
    image = complete_maps(image, seen_image, carrier)
    return Asset(
        vertices=carrier.vertices,
        faces=carrier.faces,
        uvs=carrier.uvs,
        uv_faces=carrier.uv_faces,
        texture=carrier.texture,
        base_color=np.ascontiguousarray(image[..., :3]),
        roughness=np.ascontiguousarray(image[..., 3]),
        metallic=np.ascontiguousarray(image[..., 4]) if image.shape[-1] > 4 else None,
        seen=seen_image,
        environment=envmap.radiance_of(model.environment).cpu().numpy(),
    )
