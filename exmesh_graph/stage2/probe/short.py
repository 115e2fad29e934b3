"""The few coarse pictures that a probe looks at, and short fits of them, with and without a part of the model."""

from __future__ import annotations

import copy
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.optim import Adam
from exmesh_graph.shading import envmap
from exmesh_graph.shading.settings import TransportSettings
from exmesh_graph.shading.transport import direct_transport, with_bounces
from exmesh_graph.stage2 import metal, palette
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.light.precomputed import PrecomputedLight
from exmesh_graph.stage2.maps import Appearance, MaterialMaps
from exmesh_graph.stage2.objective import weighted_terms
from exmesh_graph.stage2.pictures import encode_srgb
from exmesh_graph.stage2.probe.gain import sums_over_tiles
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings
from exmesh_graph.stage2.start_light import KeyLight
from exmesh_graph.types import Carrier, Transport, Views
from exmesh_graph.types.pictures import Pictures

#: The probe's light transport.
TRANSPORT = TransportSettings(points=2500, directions=64)
LAST_RATE = 0.05
#: Of the Gaussian that colours gather by (`palette_width` of stage2.fit, as the graphs have it).
WIDTH = 0.1
#: The short schedule (docs/stage2_trials.md) on coarse maps. `bounces` switches interreflection, not its weight.
SHORT = DecompositionSettings(
    environment_height=32,
    material_rate=0.3,
    environment_rate=0.6,
    rate_decay=0.1,
    ssim_weight=0.0,
    material_weight=0.01,
    environment_weight=0.002,
    chroma_weight=0.02,
    indirect_ramp=1,
    correction_samples=8,
)


#: Views to fit and to keep out, object pixels of a coarse view, and from how many views on whole ones are kept out.
FITTED, HELD, VIEW_PIXELS, ENOUGH = 12, 4, 2000, 6
#: Where whole views cannot be spared, one pixel in five of each is kept out, none beside another.
APART = 5


@dataclass(frozen=True)
class Sample:
    """Coarse views: the first `fitted` rows are fitted, the rest held out. `factor` pixels became one."""

    views: Views
    fitted: int
    factor: int


def sample_views(
    views: Views, fitted: int = FITTED, held: int = HELD, view_pixels: int = VIEW_PIXELS, other: bool = False
) -> Sample:
    """Some views, evenly over their order, reduced so that the object covers about `view_pixels` of each.

    With fewer than `ENOUGH` views none can be spared: every fifth pixel of each is kept out instead.
    other  keep others out: none that is kept out without it
    """
    count = len(views)
    if count >= ENOUGH:
        held = min(held, max(2, count // 4))
        chosen = np.unique(np.linspace(0, count - 1, min(count, fitted + held)).round().astype(int))
        middle = (np.arange(held) + (0.0 if other else 0.5)) * len(chosen) / held
        out = np.zeros(len(chosen), bool)
        out[middle.astype(int)] = True
        order = np.concatenate([chosen[~out], chosen[out]])
        coarse, factor = _coarse(views, order, view_pixels)
        return Sample(coarse, int((~out).sum()), factor)
    coarse, factor = _coarse(views, np.arange(count), view_pixels)
    row, column = np.indices(coarse.alpha.shape[1:])
    kept_out = (row + 2 * column) % APART == int(other)
    doubled = coarse.subset(np.concatenate([np.arange(count)] * 2))
    alpha = doubled.alpha * np.where(np.arange(2 * count)[:, None, None] < count, ~kept_out, kept_out)
    return Sample(replace(doubled, alpha=alpha.astype(np.float32)), count, factor)


def _coarse(views: Views, order: np.ndarray, view_pixels: int) -> tuple[Views, int]:
    inside = max(sum(float((views.alpha[i] > 0.5).sum()) for i in order) / len(order), 1.0)
    factor = max(1, min(round(np.sqrt(inside / view_pixels)), min(views.height, views.width) // 8))
    height, width = views.height // factor, views.width // factor

    def mean(values: np.ndarray | Pictures) -> np.ndarray:
        def one(picture: np.ndarray) -> np.ndarray:
            cut = picture[: height * factor, : width * factor]
            blocks = cut.reshape(height, factor, width, factor, *picture.shape[2:])
            return blocks.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)

        return np.stack([one(values[i]) for i in order])

    intrinsics = np.array(views.intrinsics[order], np.float64)
    intrinsics[:, :2] /= factor
    chosen = views.subset(order)
    return replace(chosen, images=mean(views.images), alpha=mean(views.alpha), intrinsics=intrinsics), factor


def traced(carrier: Carrier) -> Transport:
    """The probe's light transport of the carrier."""
    return with_bounces(direct_transport(carrier.vertices, carrier.faces, TRANSPORT), 1)


@dataclass(frozen=True)
class Part:
    """One more thing to model: settings of the fit and the number of interreflections; `roughness` to begin with,
    where the fit is restarted."""

    settings: dict[str, Any] = field(default_factory=dict)
    bounces: int | None = None
    roughness: float | None = None


class ShortFit:
    """A fit that can be forked: the copy goes on from the same maps and environment with another model."""

    def __init__(
        self,
        carrier: Carrier,
        sample: Sample,
        texture_size: int,
        seed: int = 0,
        transport: Transport | None = None,
        key: KeyLight | None = None,
        axis: np.ndarray | None = None,
    ) -> None:
        """transport  the carrier's `traced` one;  key  what it starts with beside white light;  axis  what the light
        turns about with the camera (types.Asset.light_axis)"""
        self.transport = transport or traced(carrier)
        self.seed, self.carrier, self.key, self.axis = seed, carrier, key, axis
        self.start = neutral_asset(carrier, StartSettings(base_color="gray"), size=8, key=key, axis=axis)
        settings = SHORT.replaced(texture_size=texture_size)
        self.model = Decomposition(carrier, sample.views, self.transport, settings, "cpu", start=self.start)
        buffers = list(self.model.buffers)
        self.model.start()  # of the held-out pixels it uses their mean brightness, for the first sky
        used = [row for row in range(sample.fitted) if len(buffers[row].pixel)]
        self.fitted = [buffers[row] for row in used]
        self.cameras = sample.views.intrinsics[used], sample.views.camera_to_world[used]
        self.held = buffers[sample.fitted :]
        if not self.fitted:
            raise DataError("no fitted pixel sees the mesh", expected="cameras and mesh in one frame")
        self.size = (sample.views.height, sample.views.width)
        self.seconds_per_step = 0.0
        self.first_sky = self.model.environment.detach().clone()
        self._bounce(0)
        self.known = [self._known(buffer) for buffer in self.held]

    def forked(self, part: Part) -> ShortFit:
        """A copy that also models `part`."""
        twin, model = copy.copy(self), copy.copy(self.model)
        twin.model = model
        settings = model.settings.replaced(**part.settings)
        before, model.settings = model.maps, settings
        with torch.no_grad():
            model.maps = MaterialMaps(self.start, before.texels, before.size, settings)
            shared = min(before.parameter.shape[1], model.maps.parameter.shape[1])
            model.maps.parameter[:, :shared] = before.parameter[:, :shared]
            model.environment = self._environment(settings.environment_height)
        model.environment.requires_grad_()
        light = self.light
        if settings.environment_height != light.settings.environment_height:
            bounces = light.operators.bounces
            model.light = PrecomputedLight(self.transport, model.geometry, light.tracer, settings, moves=light.moves)
            model.light.find_suns(envmap.radiance_of(model.environment), [*self.fitted, *self.held])
            twin._bounce(bounces)
        if part.bounces is not None:
            twin._bounce(part.bounces)
        return twin

    def restarted(self, part: Part) -> ShortFit:
        """A copy that models `part` from the very start."""
        twin = self.forked(part)
        model = twin.model
        if part.roughness is not None:
            settings = StartSettings(base_color="gray", roughness=part.roughness)
            twin.start = neutral_asset(self.carrier, settings, size=8, key=self.key, axis=self.axis)
        model.maps = MaterialMaps(twin.start, model.maps.texels, model.maps.size, model.settings)
        model.environment = self.first_sky.clone().requires_grad_()
        return twin

    def run(
        self, steps: int, rate: float = 1.0, last: float = LAST_RATE, draw: int = 0, light_first: float = 0.0
    ) -> ShortFit:
        """`steps` more of one view each, at `rate` times the schedule's rates, falling to `last` of that; of the first
        ones, the share `light_first`, the light moves alone.

        Ends at the mean of the second half's parameters: what is left of the order of the views (`draw` chooses it)
        is then far below what a part of the model changes.
        """
        model, settings = self.model, self.model.settings
        parameters = [model.maps.parameter, model.environment]
        optimiser = Adam(parameters, [rate * settings.material_rate, rate * settings.environment_rate])
        generator = torch.Generator().manual_seed(self.seed * 1000 + draw)
        means = [torch.zeros_like(parameter) for parameter in parameters]
        order: list[int] = []
        alone = round(light_first * steps)
        began = time.perf_counter()
        for step in range(steps):
            order = order or torch.randperm(len(self.fitted), generator=generator).tolist()
            terms, _ = weighted_terms(model, self.fitted[order.pop()], step)
            torch.stack(list(terms.values())).sum().backward()
            if step < alone:
                model.maps.parameter.grad = None
            elif step == alone > 0:
                optimiser.forget()
            optimiser.step(last ** (step / steps))
            if step >= steps // 2:
                for mean, parameter in zip(means, parameters, strict=True):
                    mean += parameter.detach()
        with torch.no_grad():
            for mean, parameter in zip(means, parameters, strict=True):
                parameter.copy_(mean / (steps - steps // 2))
        self.seconds_per_step = (time.perf_counter() - began) / steps
        return self

    def agreeing(self, steps: int) -> ShortFit:
        """`steps` as of a whole fit with metal: half way rays measure the specular term, and texels of one colour
        agree on metal (stage2.metal), where there is any; after that base colours gather (stage2.palette), and each
        time the light alone goes on for a while."""
        settings, maps = self.model.settings, self.model.maps
        gather = [share for share in palette.WHEN if share >= metal.WHEN]
        for draw, (since, until) in enumerate(pairwise([0.0, metal.WHEN, *gather, 1.0])):
            alone = 0.0
            if since == metal.WHEN:
                self.measure()
                if settings.metallic:
                    metal.agree_on_metal(maps, self._evidence(), settings.metal_share)
            elif since in gather:
                palette.gather_colors(maps, self._evidence(), WIDTH)
                alone = palette.WAIT / (until - since)
            length = round(until * steps) - round(since * steps)
            self.run(length, LAST_RATE**since, LAST_RATE ** (until - since), draw, alone)
        return self

    @torch.no_grad()
    def measure(self) -> ShortFit:
        """Let rays measure the specular term at the current maps, for this fit and all its forks."""
        model = self.model
        sky = envmap.radiance_of(model.environment)
        now = Appearance(model.maps, model.maps.values(), sky, turns=model.turns)
        generator = torch.Generator().manual_seed(self.seed)
        model.light.measure(now, [*self.fitted, *self.held], generator)
        return self

    def measured(self) -> dict[str, Any]:
        """What rays have measured so far, which all forks share."""
        return self.light.state([*self.fitted, *self.held])

    def put_back(self, measured: dict[str, Any]) -> None:
        """Forget what rays have measured since."""
        self.light.restore([*self.fitted, *self.held], measured)

    @torch.no_grad()
    def held_errors(
        self, only: Sequence[torch.Tensor] | None = None, shown: Sequence[torch.Tensor] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Squared error (display values, mean over channels) and pixels, summed over every cluster: float64 [C] each.

        A cluster is a tile of a held-out view. Pixels on texels that no fitted pixel reads are left out, and so are
        channels at the top of a photograph's range. `only`: of every held-out view the pixels that count, bool [N];
        `shown`: `held_pictures`, where they are known.
        """
        errors, pixels, shown = [], [], shown or self.held_pictures()
        for number, (buffer, known, picture) in enumerate(zip(self.held, self.known, shown, strict=True)):
            if only is not None:
                known = known & only[number]
            wrong = (picture - encode_srgb(buffer.target)) ** 2
            wrong = torch.where(buffer.clipped, torch.zeros_like(wrong), wrong).mean(dim=1)[known]
            sums = sums_over_tiles(wrong.double().numpy(), buffer.pixel[known].numpy(), self.size)
            errors.append(sums[0])
            pixels.append(sums[1])
        return np.concatenate(errors), np.concatenate(pixels)

    @torch.no_grad()
    def held_pictures(self) -> list[torch.Tensor]:
        """What the fit shows at the pixels of every held-out view: display values [N, 3]."""
        prepared = self.model.prepare(1.0, 0)
        return [encode_srgb(self.model.shade(buffer, prepared)[0]) for buffer in self.held]

    @torch.no_grad()
    def mean_roughness(self) -> float:
        """The mean over texels, by how much the fitted pixels read them."""
        evidence = self._evidence()
        return float((evidence * self.model.maps.values()[:, 3]).sum() / evidence.sum())

    @torch.no_grad()
    def held_metal(self) -> list[torch.Tensor]:
        """Which pixels of every held-out view are metal rather than not, bool [N]."""
        metallic = self.model.maps.values()[:, 4]
        return [(metallic[buffer.texel] * buffer.texel_weight).sum(1) > 0.5 for buffer in self.held]

    @torch.no_grad()
    def fitted_term(self) -> float:
        """The image term (eq. 21) of the fitted pixels, the mean over views."""
        terms = [weighted_terms(self.model, buffer, 0)[0]["image"] for buffer in self.fitted]
        return float(torch.stack(terms).mean())

    def sky(self) -> np.ndarray:
        """The environment found: radiance [H, W, 3]."""
        return np.asarray(envmap.radiance_of(self.model.environment.detach()).numpy())

    def irradiance(self, binned: torch.Tensor, diffuse: torch.Tensor, bounces: int) -> torch.Tensor:
        """Irradiance [P, 3] of the lattice points under binned light [K, 3] with `bounces` interreflections."""
        operators = copy.copy(self.light.operators)
        operators.bounces = bounces
        return operators.irradiance(binned, diffuse if bounces else None)

    def footprints(self) -> np.ndarray:
        """Surface areas [N] that the fitted pixels cover, scene units squared."""
        areas = []
        for row, buffer in enumerate(self.fitted):
            samples = buffer.samples(self.model.geometry)
            intrinsics, pose = self.cameras[0][row], self.cameras[1][row]
            depth = (samples.position.double().numpy() - pose[:3, 3]) @ pose[:3, 2]
            areas.append(depth**2 / (intrinsics[0, 0] * intrinsics[1, 1]) / samples.n_v.double().numpy())
        return np.concatenate(areas)

    @property
    def light(self) -> PrecomputedLight:
        """The light model."""
        assert isinstance(self.model.light, PrecomputedLight)
        return self.model.light

    def _bounce(self, bounces: int) -> None:
        """Switch `bounces` interreflections on, in this fit alone."""
        self.model.light = light = copy.copy(self.light)
        light.operators = copy.copy(light.operators)
        light.operators.bounces = bounces
        if light.suns is not None:
            light.suns = light.suns.under(light.operators)

    def _environment(self, height: int) -> torch.Tensor:
        parameter = self.model.environment.detach()
        if parameter.shape[0] == height:
            return parameter.clone()
        radiance = envmap.resample(envmap.radiance_of(parameter).numpy(), height, 2 * height)
        return envmap.parameter_of(torch.from_numpy(np.maximum(radiance, 1e-6).astype(np.float32)))

    def _known(self, buffer: Any) -> torch.Tensor:
        return (self._evidence()[buffer.texel] * buffer.texel_weight).sum(1) > 0.5

    def _evidence(self) -> torch.Tensor:
        """How much the fitted pixels read each texel, float [T]."""
        evidence = torch.zeros(len(self.model.maps.texels))
        for fitted in self.fitted:
            evidence.index_add_(0, fitted.texel.reshape(-1), fitted.texel_weight.reshape(-1))
        return evidence
