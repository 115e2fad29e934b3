"""The sampled light: the paper's Monte Carlo estimators (eq. 17 to 20), drawn anew in every step or kept for a while.

    L = L_dir(x) + lambda_ind f_d(x) I_ind(x)          shading.monte_carlo

Noise in value and gradient; no bias from directions, lattices or split sums. Samples of step t follow the environment
and the materials of step t and depend on nothing else but the fit's seed, so a resumed fit draws the same ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from exmesh_graph.rays import RayTracer
from exmesh_graph.shading import monte_carlo
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo import (
    Coarse,
    Drawn,
    MonteCarloLight,
    Points,
    SampleCache,
    SecondaryHits,
    coarse_points,
)
from exmesh_graph.shading.monte_carlo.points import mixed
from exmesh_graph.shading.moving import turned
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.maps import Appearance, Material, MaterialMaps
from exmesh_graph.stage2.surface import CarrierGeometry, SurfaceSamples, TangentFrames, bent, texel_footprint
from exmesh_graph.uv.raster import rasterize_atlas

if TYPE_CHECKING:
    from exmesh_graph.shading.settings import MonteCarloSettings

#: Texels around the charts that a bilinear lookup inside them may read.
_MARGIN = 1.5
#: Between the seed of a step's picture and that of its gradient: beyond all seeds of a fit.
_GRADIENT_SEED = 1 << 27


@dataclass
class PreparedSamples:
    """A step's light: how to draw from the environment, and what secondary hits read."""

    appearance: Appearance
    sampler: EnvSampler
    query: monte_carlo.Query | None


@dataclass(frozen=True)
class Seen:
    """A view's surface, and its tangent frames where there is a normal map."""

    surface: SurfaceSamples
    frame: tuple[torch.Tensor, ...] | None

    def points(self, material: Material) -> Points:
        """The pixels as points, under the normal map of their `material`; equation: 11."""
        surface, slopes = self.surface, material.slopes
        if self.frame is not None and slopes is not None:
            surface = bent(surface, self.frame, slopes)
        return Points(surface.position, surface.flat, surface.normal, surface.view)


@dataclass(frozen=True)
class SampledView:
    """What the sampled light keeps of a view: its flat pixels in an image `width` wide."""

    pixel: torch.Tensor
    width: int


class SampledLight:
    """A LightModel over shading.monte_carlo.

    Kept rays follow the maps and the environment of the last measurement, which are part of `state`; they are drawn
    when first asked for, so that a resumed fit draws them again.
    """

    def __init__(
        self,
        settings: MonteCarloSettings,
        geometry: CarrierGeometry,
        tracer: RayTracer,
        seed: int,
        frames: TangentFrames | None = None,
        turns: np.ndarray | None = None,
    ) -> None:
        """turns  of every view, where the light moves with the camera (shading.moving.light_turns)"""
        self.settings, self.geometry, self.seed, self.frames = settings, geometry, seed, frames
        self.light = MonteCarloLight(geometry, tracer, settings)
        self.frozen: tuple[torch.Tensor, torch.Tensor] | None = None
        self.turns = turns
        self.caches: dict[int, SampleCache] = {}

    def texels(self, size: int) -> torch.Tensor:
        if not (self.settings.bounces and self.settings.secondary_material):
            return torch.zeros(0, dtype=torch.int64, device=self.geometry.device)
        geometry = self.geometry
        face, _ = rasterize_atlas(geometry.uvs.cpu().numpy(), geometry.uv_faces.cpu().numpy(), size, _MARGIN)
        return torch.from_numpy(np.flatnonzero(face >= 0)).to(geometry.device)

    def view(self, surface: SurfaceSamples, pixel: torch.Tensor, width: int, number: int) -> SampledView:
        return SampledView(pixel, width)

    def start(self, maps: MaterialMaps, environment: torch.Tensor, buffers: Iterable[ViewBuffer]) -> None:
        """Nothing to measure; rays are kept from the first measurement on."""

    def prepare(self, appearance: Appearance) -> PreparedSamples:
        bounced = self.settings.bounces and appearance.strength > 0
        query = self._query(appearance.maps, appearance.values) if bounced else None
        return PreparedSamples(appearance, EnvSampler(appearance.environment), query)

    def radiance(self, buffer: ViewBuffer, material: Material, prepared: PreparedSamples) -> torch.Tensor:
        now, query = prepared.appearance, prepared.query
        points, here = self.seen(buffer).points(material), surface_material(material)
        drawn = self.draw(buffer, points, material, query is not None, now, prepared.sampler)
        return blended(drawn, lambda one: self.light.shade(one, points, here, query, now.environment, now.strength))

    def draw(
        self,
        buffer: ViewBuffer,
        points: Points,
        material: Material,
        bounced: bool,
        now: Appearance,
        sampler: EnvSampler,
    ) -> list[Drawn]:
        """The samples of a view's estimate at step `now`, and those of its gradient where they are others (`blended`).

        No gradients. `now.values` are not read.
        """
        others = self.settings.kept != 1 or self.frozen is None
        turns = 2 if self.settings.independent_gradient and others and torch.is_grad_enabled() else 1
        facing = self._facing if bounced else None

        def of(turn: int) -> Drawn:
            if self.frozen is None:
                number = self.seed * 1_000_003 + now.step + turn * _GRADIENT_SEED
                coarse = self._coarse(buffer.light, points, now.step + turn)
                return self.light.draw(points, surface_material(material), facing, sampler, number, coarse)
            cache = self.caches.setdefault(buffer.number, SampleCache(self.settings.kept))
            return cache.get(now.step + turn, self._keeping(buffer, now.maps, facing))

        return [of(turn) for turn in range(turns)]

    def measure(self, appearance: Appearance, buffers: Iterable[ViewBuffer], generator: torch.Generator) -> None:
        """Draw kept rays anew from here on, for these maps and this environment."""
        if self.settings.kept:
            self.frozen, self.caches = (appearance.values.clone(), appearance.environment.clone()), {}

    def state(self, buffers: Iterable[ViewBuffer]) -> dict[str, Any]:
        return {"frozen": None if self.frozen is None else list(self.frozen)}

    def restore(self, buffers: Iterable[ViewBuffer], kept: Mapping[str, Any]) -> None:
        frozen, device = kept["frozen"], self.geometry.device
        self.frozen = None if frozen is None else (frozen[0].to(device), frozen[1].to(device))
        self.caches = {}

    def _keeping(
        self, buffer: ViewBuffer, maps: MaterialMaps, facing: monte_carlo.Query | None
    ) -> Callable[[int], Drawn]:
        """How a slot of the view's kept rays is drawn: from the frozen maps and environment, by a seed of its own."""
        assert self.frozen is not None
        values, environment = self.frozen
        if self.turns is not None:
            environment = turned(environment, self.turns[buffer.number])

        def draw(slot: int) -> Drawn:
            read = maps.read(values, buffer.texel, buffer.texel_weight)
            points, material = self.seen(buffer).points(read), surface_material(read)
            number = self.seed * 1_000_003 + buffer.number * self.settings.kept + slot
            coarse = self._coarse(buffer.light, points, slot)
            return self.light.draw(points, material, facing, EnvSampler(environment), number, coarse, turning=True)

        return draw

    def seen(self, buffer: ViewBuffer) -> Seen:
        """What the view's pixels see of the surface, whatever the maps are."""
        surface = buffer.samples(self.geometry)
        frame = None if self.frames is None else self.frames.at(self.geometry, surface.face, surface.bary)
        return Seen(surface, frame)

    def hit_texels(self, hits: SecondaryHits, maps: MaterialMaps) -> tuple[torch.Tensor, torch.Tensor]:
        """Rows of the table [M, 4] that the hits read, and their weights [M, 4]."""
        index, weight = texel_footprint(self._uv(hits.face, hits.bary), maps.size)
        return maps.rows(index), weight

    def hit_query(self, material: Material | None) -> monte_carlo.Query:
        """Smooth normals at hits, and the `material` that they have there (None: black)."""

        def at(face: torch.Tensor, bary: torch.Tensor) -> tuple[torch.Tensor, monte_carlo.Material]:
            normal, black = self._facing(face, bary)
            return normal, black if material is None else surface_material(material)

        return at

    def _coarse(self, view: SampledView, points: Points, step: int) -> Coarse | None:
        if not (self.settings.bounces and self.settings.half_resolution):
            return None
        return coarse_points(points, view.pixel, view.width, step % 4)

    def _query(self, maps: MaterialMaps, values: torch.Tensor) -> monte_carlo.Query:
        """Smooth normal and material at secondary hits."""

        def at(face: torch.Tensor, bary: torch.Tensor) -> tuple[torch.Tensor, monte_carlo.Material]:
            normal, black = self._facing(face, bary)
            if not self.settings.secondary_material:
                return normal, black
            index, weight = texel_footprint(self._uv(face, bary), maps.size)
            return normal, surface_material(maps.read(values, maps.rows(index), weight))

        return at

    def _facing(self, face: torch.Tensor, bary: torch.Tensor) -> tuple[torch.Tensor, monte_carlo.Material]:
        """Smooth normals [M, 3], and no material: all that samples are drawn by."""
        geometry = self.geometry
        normal = mixed(geometry.vertex_normals, geometry.faces, face, bary)
        normal = torch.nn.functional.normalize(normal, dim=-1)
        return normal, monte_carlo.Material(torch.zeros_like(normal))

    def _uv(self, face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
        return mixed(self.geometry.uvs, self.geometry.uv_faces, face, bary)


def blended(drawn: list[Drawn], shade: Callable[[Drawn], torch.Tensor]) -> torch.Tensor:
    """The picture that `shade` makes of the first samples, with the gradient of the last ones.

    A loss's slope at a noisy picture, times the gradient of the same samples, has the covariance of both in it.
    """
    if len(drawn) == 1:
        return shade(drawn[0])
    with torch.no_grad():
        value = shade(drawn[0])
    elsewhere = shade(drawn[1])
    return value + (elsewhere - elsewhere.detach())


def surface_material(material: Material) -> monte_carlo.Material:
    """What points read from the maps, as the estimators take it."""
    return monte_carlo.Material(material.base_color, material.roughness, material.metallic)
