"""The optimised parameters (maps and environment) and the differentiable forward render of a view's pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import torch

from exmesh_graph.errors import DataError
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading import envmap
from exmesh_graph.shading.moving import light_turns
from exmesh_graph.shading.transport import check_fits
from exmesh_graph.stage2.gains import CommonFactor, Exposure
from exmesh_graph.stage2.gbuffer import ViewBuffer, ViewBuffers
from exmesh_graph.stage2.init import check_start, neutral_asset
from exmesh_graph.stage2.light.model import LightModel
from exmesh_graph.stage2.light.precomputed import PrecomputedLight
from exmesh_graph.stage2.light.sampled import SampledLight
from exmesh_graph.stage2.maps import Appearance, Material, MaterialMaps
from exmesh_graph.stage2.memory import buffer_budget
from exmesh_graph.stage2.metal import Places
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.start_light import is_neutral
from exmesh_graph.stage2.surface import CarrierGeometry, TangentFrames
from exmesh_graph.types import Asset, Carrier, Transport, Views

if TYPE_CHECKING:
    from exmesh_graph.shading.settings import MonteCarloSettings

#: Photographs of a dark room: the light's softplus parameter must still have a gradient.
MIN_LEVEL = 0.01


@dataclass
class Prepared:
    """Maps and environment as a step sees them: values [T, C], radiance [H, W, 3], and what the light model made of
    them, for all views or, under light that moves with the camera, for one view at a time."""

    values: torch.Tensor
    environment: torch.Tensor
    light: Any
    appearance: Appearance


class Decomposition:
    """Maps, environment and light model on a carrier, and the buffers of its training views."""

    def __init__(
        self,
        carrier: Carrier,
        views: Views,
        transport: Transport | MonteCarloSettings,
        settings: DecompositionSettings,
        device: str,
        seed: int = 0,
        start: Asset | None = None,
    ) -> None:
        """`seed`: of light that is sampled; `start`: the maps and the light to start from, None for
        `stage2.init.neutral_asset`."""
        if start is None and settings.keep_light:
            raise DataError(
                "keep_light keeps the start's environment, but no start is given",
                expected="an asset whose light is known, say of edit.relight",
                fix="wire `start`, or set keep_light: false",
            )
        start = start or neutral_asset(carrier)
        check_start(start, carrier, settings.metallic, settings.normal_map)
        self.light_axis, self.turns = start.light_axis, light_turns(start.light_axis, views.camera_to_world)
        self.settings = settings
        self.geometry = CarrierGeometry(carrier, device)
        tracer = make_ray_tracer(carrier.vertices, carrier.faces, device)
        frames = TangentFrames(carrier, device) if settings.normal_map else None
        self.light: LightModel
        if not isinstance(transport, Transport):
            self.light = SampledLight(transport, self.geometry, tracer, seed, frames, self.turns)
        else:
            check_fits(transport, carrier.vertices, carrier.faces)
            moves = self.turns is not None
            self.light = PrecomputedLight(transport, self.geometry, tracer, settings, frames, moves)
        size = settings.texture_size or carrier.texture.shape[0]
        budget = buffer_budget(settings, device)
        self.buffers = ViewBuffers(self.geometry, self.light, views, size, settings.min_coverage, budget)
        if not any(self.buffers.pixels):
            raise DataError("no training pixel sees the mesh", expected="cameras and mesh in one frame")
        self.maps = MaterialMaps(start, self.buffers.texels, size, settings)
        self.carrier = carrier
        height = settings.environment_height
        self.neutral = is_neutral(start.environment) and not settings.keep_light
        radiance = torch.from_numpy(envmap.resample(start.environment, height, 2 * height)).to(device)
        self.environment = envmap.parameter_of(radiance).requires_grad_(not settings.keep_light)
        self.factor = CommonFactor(device)
        self.factor.parameter.requires_grad_(not settings.keep_light)
        self.exposure = Exposure(len(views), device) if settings.exposure else None

    def prepare(self, strength: float, step: int) -> Prepared:
        """The current maps and light of a step, with lambda_ind = `strength`; differentiable.

        The sky's regularisers (`Prepared.environment`) have no say in the common factor, but for its tint.
        """
        radiance = envmap.radiance_of(self.environment)
        values, environment = self.factor.share(self.maps.values(), radiance)
        now = Appearance(self.maps, values, environment, strength, step, self.turns)
        light = None if self.turns is not None else self.light.prepare(now)
        return Prepared(values, radiance * self.factor.parameter.detach().exp(), light, now)

    def settle_factor(self) -> None:
        """Fold the common factor into the maps and the sky, which are whole without it afterwards."""
        self.factor.fold(self.maps.parameter, self.environment)

    def shade(self, buffer: ViewBuffer, prepared: Prepared) -> tuple[torch.Tensor, Material]:
        """Radiance [N, 3] of a view's pixels, in its exposure, and their material."""
        material = self.maps.read(prepared.values, buffer.texel, buffer.texel_weight)
        radiance = self.light.radiance(buffer, material, self.lit(buffer, prepared))
        return radiance if self.exposure is None else radiance * self.exposure.gain(buffer.number), material

    def lit(self, buffer: ViewBuffer, prepared: Prepared) -> Any:
        """What the light model's `radiance` of a view takes."""
        if self.turns is None:
            return prepared.light
        return self.light.prepare(prepared.appearance.seen_by(buffer.number))

    def start(self) -> None:
        """Make ready for the first step: the light model's first measurement; a neutral sky as bright as the views."""
        self.light.start(self.maps, envmap.radiance_of(self.environment.detach()), self.buffers)
        if self.neutral:
            self.level_light()

    @torch.no_grad()
    def measure(self, strength: float, generator: torch.Generator) -> None:
        """Let the light model measure again, at the current maps and environment."""
        sky = envmap.radiance_of(self.environment)
        now = Appearance(self.maps, self.maps.values(), sky, strength, turns=self.turns)
        self.light.measure(now, self.buffers, generator)

    @cached_property
    def places(self) -> Places:
        """Where the maps' texels lie."""
        return Places.of(self.carrier, self.maps)

    def state(self) -> dict[str, Any]:
        """What steps change besides the optimised parameters."""
        exposure = None if self.exposure is None else self.exposure.logs
        return {"light": self.light.state(self.buffers.held), "exposure": exposure, "least": self.factor.least}

    def restore(self, kept: Mapping[str, Any]) -> None:
        """Go on from `state`."""
        self.light.restore(self.buffers.held, kept["light"])
        self.factor.least = kept["least"].to(self.factor.least)
        if self.exposure is not None:
            self.exposure.logs = kept["exposure"].to(self.exposure.logs)

    @torch.no_grad()
    def level_light(self) -> None:
        """Scale the neutral starting light so that the starting maps are as bright as the photographs, on average."""
        prepared = self.prepare(0.0, 0)
        seen = shown = 0.0
        for buffer in self.buffers:
            predicted, _ = self.shade(buffer, prepared)
            seen += float((buffer.target * buffer.coverage[:, None]).sum())
            shown += float((predicted * buffer.coverage[:, None]).sum())
        level = max(seen / max(shown, 1e-12), MIN_LEVEL)
        self.environment.copy_(envmap.parameter_of(level * envmap.radiance_of(self.environment)))
