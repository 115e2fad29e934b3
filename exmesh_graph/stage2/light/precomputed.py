"""The precomputed light: irradiance by the transport of the frozen mesh, specular by split sum times a measured factor.

    L = f_d(x) I_n(x) + split_sum(x) c(x)          I_n: shading.transport, split_sum: shading.specular

No sampling noise in value or gradient.

`c`, kept per pixel, is what the split sum leaves out. Before a fit that starts from nothing it is the share of the lobe
that sees the sky (from the K rays of the light transport). Now and then, and at the start of a fit that goes on from an
asset, it becomes traced(theta_now) / split_sum(theta_now) (`correction`): then the forward model equals the traced one
at theta_now (stretched lobes, true visibility, the mesh mirrored in itself) while gradients still
come from the cheap term. As the fit settles, so does `c`: a defect correction.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from exmesh_graph.gpu.cores import share
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.rays import RayTracer
from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.lattice import locate
from exmesh_graph.shading.operators import Binning, Deeper, LightTransport, VectorTransport, at_surface
from exmesh_graph.shading.specular import (
    PrefilteredStack,
    directional_albedo,
    mean_visibility,
    reflectance_table,
    resolved_alpha,
    scattered,
)
from exmesh_graph.stage2.fused.view import SpecularTables
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.light.correction import measured_specular_scale
from exmesh_graph.stage2.light.fitted_suns import FittedSuns, find_fitted_suns
from exmesh_graph.stage2.light.fused_lobes import visible_share
from exmesh_graph.stage2.maps import Appearance, Footprint, Material, MaterialMaps
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.surface import (
    CarrierGeometry,
    SurfaceSamples,
    TangentFrames,
    bent_irradiance,
    mapped_surface,
    texel_footprint,
)
from exmesh_graph.types import Transport


@dataclass
class PrecomputedView:
    """What the precomputed light keeps of a view's N pixels.

    point, point_weight   int32 [N, 3], [N, 3]: lattice points of the light transport
    env_u, env_v          [N], image coordinates of the reflected direction
    specular_scale        [N, 3], what to multiply the split sum with
    """

    point: torch.Tensor
    point_weight: torch.Tensor
    env_u: torch.Tensor
    env_v: torch.Tensor
    specular_scale: torch.Tensor

    def at(self, rows: torch.Tensor) -> PrecomputedView:
        """The same of some of the pixels."""
        return PrecomputedView(**{name: values[rows] for name, values in vars(self).items()})


@dataclass
class PreparedTransport:
    """A step's light: prefiltered rows of the environment, irradiance [P, 3] at the lattice but for what small suns
    send directly, their flux [S, 3] (None: no suns), the vector irradiance [P, 9] (None: no normal map)."""

    stack: torch.Tensor
    irradiance: torch.Tensor
    flux: torch.Tensor | None = None
    vector: torch.Tensor | None = None


class PrecomputedLight:
    """A LightModel over a types.Transport of the carrier's own mesh."""

    def __init__(
        self,
        transport: Transport,
        geometry: CarrierGeometry,
        tracer: RayTracer,
        settings: DecompositionSettings,
        frames: TangentFrames | None = None,
        moves: bool = False,
    ) -> None:
        """moves  whether the light moves with the camera: another environment for every view"""
        self.geometry, self.tracer, self.settings, self.frames = geometry, tracer, settings, frames
        self.moves = moves
        device = geometry.device
        self.operators = LightTransport(transport, device)
        height = settings.environment_height
        self.stack = PrefilteredStack(height, 2 * height, device)
        self.vectors = None if frames is None else VectorTransport(self.operators)
        self.binning = Binning(self.operators.bin_matrix(height, 2 * height))
        self.table = reflectance_table(device=device)
        self.lookup = SpecularTables.of(self.stack, self.table)
        self.scale: dict[int, torch.Tensor] = {}  # PrecomputedView.specular_scale by view, which outlives the buffers
        corners = geometry.uvs[geometry.uv_faces[torch.from_numpy(transport.point_face.astype(np.int64)).to(device)]]
        bary = tensor_of(transport.point_bary).to(device)
        self._point_uv = (corners * bary[..., None]).sum(1)
        self.suns: FittedSuns | None = None
        self.deeper = Deeper() if transport.deeper and not moves else None  # it is kept from step to step
        self._footprint: Footprint | None = None

    def texels(self, size: int) -> torch.Tensor:
        return texel_footprint(self._point_uv, size)[0].reshape(-1)

    def view(self, surface: SurfaceSamples, pixel: torch.Tensor, width: int, number: int) -> PrecomputedView:
        light, face, bary = self.operators.light, surface.face.cpu().numpy(), surface.bary.cpu().numpy()
        point, weight = locate(light, face, bary)
        device = self.geometry.device
        env_u, env_v = envmap.uv_of(surface.reflected)
        return PrecomputedView(
            point=torch.from_numpy(point).to(device),
            point_weight=torch.from_numpy(weight).to(device),
            env_u=env_u,
            env_v=env_v,
            specular_scale=self.scale.get(number, torch.ones_like(surface.position)),
        )

    def start(self, maps: MaterialMaps, environment: torch.Tensor, buffers: Iterable[ViewBuffer]) -> None:
        self.find_suns(environment, buffers)
        roughness = float(maps.values()[:, 3].detach().mean())
        share(lambda buffer: self._keep(buffer, initial_specular_scale(self, buffer, roughness)), buffers)

    def prepare(self, appearance: Appearance) -> PreparedTransport:
        diffuse = None
        if self.operators.bounces and appearance.strength > 0:
            diffuse = self.lattice_sends(appearance.maps, appearance.values)
        return self.arriving(appearance.environment, diffuse, appearance.strength)

    def arriving(self, environment: torch.Tensor, diffuse: torch.Tensor | None, strength: float) -> PreparedTransport:
        """The light of a step from the sky and what the points of the transport send on, f [P, 3] (None: no
        interreflection)."""
        rest = environment if self.suns is None else self.suns.suns.without(environment)
        binned = self.binning(rest)
        if self.suns is None:
            irradiance = self.operators.irradiance(binned, diffuse, strength, self.deeper)
            vector = None
            if self.vectors is not None:
                vector = self._vector(binned, irradiance, None if diffuse is None else strength * diffuse)
            return PreparedTransport(self.stack.build(environment), irradiance, vector=vector)
        flux = self.suns.suns.flux(environment)
        both = torch.cat([binned, flux])
        irradiance = self.suns.operators.irradiance(both, diffuse, strength, self.deeper)
        irradiance = irradiance - self.suns.lattice @ flux
        return PreparedTransport(self.stack.build(environment), irradiance, flux)

    def _vector(self, binned: torch.Tensor, irradiance: torch.Tensor, diffuse: torch.Tensor | None) -> torch.Tensor:
        assert self.vectors is not None
        if diffuse is None:
            return self.vectors.vector(binned)
        if self.operators.light.secondary_material:
            return self.vectors.vector(binned, diffuse * irradiance)
        return self.vectors.vector(binned, irradiance, diffuse)

    def radiance(self, buffer: ViewBuffer, material: Material, prepared: PreparedTransport) -> torch.Tensor:
        """Diffuse light by the transport, specular light by the split sum, scaled to what rays measured.

        Equations: 12, 20.
        """
        kept, metallic = buffer.light, material.metallic
        irradiance = gather_rows(prepared.irradiance, kept.point, kept.point_weight)
        if self.suns is not None and prepared.flux is not None:
            irradiance = irradiance + self.suns.views[buffer.number] @ prepared.flux
        mapped = None
        if prepared.vector is not None:
            mapped = self.surface(buffer, material)
            vector = gather_rows(prepared.vector, kept.point, kept.point_weight)
            irradiance = bent_irradiance(irradiance, vector, buffer.samples(self.geometry).normal, mapped.normal)
        split = self.split_sum(buffer, material, prepared, mapped)
        return brdf.diffuse(material.base_color, metallic) * irradiance + split * kept.specular_scale

    def surface(self, buffer: ViewBuffer, material: Material) -> SurfaceSamples:
        """The view's surface samples, under the material's normal map where one is fitted."""
        return mapped_surface(buffer.samples(self.geometry), self.geometry, self.frames, material.slopes)

    def split_sum(
        self, buffer: ViewBuffer, material: Material, prepared: PreparedTransport, mapped: SurfaceSamples | None = None
    ) -> torch.Tensor:
        """Unoccluded specular radiance [N, 3] of a view's pixels; `mapped`: their surface under a normal map."""
        kept, roughness = buffer.light, material.roughness
        env_u, env_v, n_v = kept.env_u, kept.env_v, buffer.n_v
        if mapped is not None:
            (env_u, env_v), n_v = envmap.uv_of(mapped.reflected), mapped.n_v
        index, weight = self.stack.locate(env_u, env_v, roughness)
        prefiltered = gather_rows(prepared.stack, index, weight)
        if material.has_metallic:
            f0 = brdf.base_reflectance(material.base_color, material.metallic)
            return directional_albedo(self.table, n_v, roughness, f0) * prefiltered
        albedo = directional_albedo(self.table, n_v, roughness, brdf.DIELECTRIC_F0)
        return albedo[:, None] * prefiltered

    def lattice_material(self, maps: MaterialMaps, values: torch.Tensor) -> Material:
        """The material at the points of the transport."""
        where = self.footprint(maps)
        return maps.read(values, where.rows, where.weight)

    def lattice_sends(self, maps: MaterialMaps, values: torch.Tensor) -> torch.Tensor:
        """What the points of the transport send on of their irradiance, f [P, 3] (shading.specular.scattered)."""
        there = self.lattice_material(maps, values)
        return scattered(there.base_color, there.roughness, there.metallic)

    def footprint(self, maps: MaterialMaps) -> Footprint:
        """Where the points of the transport read the maps."""
        if self._footprint is None:  # a search of a few milliseconds, for the one table of the fit
            index, weight = texel_footprint(self._point_uv, maps.size)
            self._footprint = Footprint.of(maps.rows(index), weight)
        return self._footprint

    @torch.no_grad()
    def measure(self, appearance: Appearance, buffers: Iterable[ViewBuffer], generator: torch.Generator) -> None:
        if appearance.turns is not None:
            for buffer in buffers:
                self.measure(appearance.seen_by(buffer.number), [buffer], generator)
            return
        maps, values, environment = appearance.maps, appearance.values, appearance.environment
        self.find_suns(environment, buffers)
        prepared = self.prepare(appearance)
        arriving = prepared.irradiance
        if self.suns is not None and prepared.flux is not None:
            arriving = arriving + self.suns.lattice @ prepared.flux
        leaving = self.lattice_sends(maps, values) * arriving

        def sent(face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
            return at_surface(self.operators.light, leaving, face, bary)

        @torch.no_grad()  # a thread's own switch
        def measured(seed: int, buffer: ViewBuffer) -> None:
            if len(buffer.pixel):
                material = maps.read(values, buffer.texel, buffer.texel_weight)
                drawn = torch.Generator().manual_seed(seed)  # a view's own: whoever measures it
                self._keep(buffer, measured_specular_scale(self, buffer, material, prepared, environment, sent, drawn))

        first = int(torch.randint(1 << 40, (), generator=generator))
        share(lambda numbered: measured(*numbered), enumerate(buffers, first))

    @torch.no_grad()
    def find_suns(self, environment: torch.Tensor, buffers: Iterable[ViewBuffer]) -> None:
        """Keep small suns of `environment` [H, W, 3] apart from now on, where they stand still."""
        if self.frames is None and not self.moves:  # their light is kept per pixel, for its smooth normal
            self.suns = find_fitted_suns(environment, self.operators, self.geometry, self.tracer, buffers, self.suns)

    def state(self, buffers: Iterable[ViewBuffer]) -> dict[str, Any]:
        suns = None if self.suns is None else self.suns.state()
        rest = None if self.deeper is None else self.deeper.rest
        return {"specular_scale": dict(self.scale), "suns": suns, "deeper": rest}

    def restore(self, buffers: Iterable[ViewBuffer], kept: Mapping[str, Any]) -> None:
        self.scale = {number: scale.to(self.geometry.device) for number, scale in kept["specular_scale"].items()}
        for buffer in buffers:
            buffer.light.specular_scale = self.scale[buffer.number]
        if self.deeper is not None:
            self.deeper.rest = None if kept["deeper"] is None else kept["deeper"].to(self.geometry.device)
        self.suns = None if kept["suns"] is None else FittedSuns.restored(kept["suns"], self.operators)

    def _keep(self, buffer: ViewBuffer, scale: torch.Tensor) -> None:
        self.scale[buffer.number] = buffer.light.specular_scale = scale


@torch.no_grad()
def initial_specular_scale(
    light: PrecomputedLight, buffer: ViewBuffer, roughness: float, chunk: int = 1 << 14, plain: bool = False
) -> torch.Tensor:
    """A view's factor [N, 3] before any measurement: the visible share of the lobe of `roughness`.

    `plain`: in torch, the reference of the fused form.
    """
    operators, kept = light.operators, buffer.light
    reflected = buffer.samples(light.geometry).reflected
    directions = tensor_of(operators.light.directions).to(reflected)
    if reflected.device.type == "cpu" and reflected.dtype == torch.float32 and not plain:
        alpha = resolved_alpha(roughness, len(directions))
        share = visible_share(operators.visible, directions, kept.point, kept.point_weight, reflected, alpha)
        return share[:, None].repeat(1, 3)
    visible = operators.visible.to(reflected)
    scale = torch.ones_like(kept.specular_scale)
    for start in range(0, len(buffer.pixel), chunk):
        part = slice(start, start + chunk)
        seen = (visible[kept.point[part]] * kept.point_weight[part, :, None]).sum(1)
        share = mean_visibility(seen, directions, reflected[part], roughness)
        scale[part] = share[:, None]
    return scale
