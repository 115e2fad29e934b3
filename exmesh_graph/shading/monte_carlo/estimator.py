"""The Monte Carlo light of a frozen mesh: direct (eq. 17) plus one bounce (eq. 19).

I = L_dir + lambda_ind f_d(x) I_ind(x)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from exmesh_graph.rays import RayTracer
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo.bounce import (
    SecondaryHits,
    bounce_irradiance,
    draw_bounce,
    secondary_pool,
)
from exmesh_graph.shading.monte_carlo.points import Coarse, Material, Points, Query, Surface
from exmesh_graph.shading.monte_carlo.samples import LightSamples, draw_light, make_pool
from exmesh_graph.shading.monte_carlo.shade import shade

if TYPE_CHECKING:
    from exmesh_graph.shading.settings import MonteCarloSettings


@dataclass(frozen=True)
class Drawn:
    """Everything random of one estimate; reuse it (`MonteCarloLight.shade`) and no ray is traced."""

    direct: LightSamples
    hits: SecondaryHits | None
    coarse: Coarse | None


class MonteCarloLight:
    """Direct and one-bounce light of points on `surface`, whose rays are answered by `tracer`.

    settings    shading.settings.MonteCarloSettings, or any object that has its attributes
    memory_mib  limit of the working memory of tracing (the samples themselves: 4 to 16 bytes each on top)
    """

    def __init__(
        self, surface: Surface, tracer: RayTracer, settings: MonteCarloSettings, memory_mib: float = 64.0
    ) -> None:
        self.surface, self.tracer, self.settings, self.memory_mib = surface, tracer, settings, memory_mib

    @torch.no_grad()
    def draw(
        self,
        points: Points,
        material: Material,
        query: Query | None,
        sampler: EnvSampler,
        seed: int,
        coarse: Coarse | None = None,
        turning: bool = False,
    ) -> Drawn:
        """Draw and trace all samples. The same seed gives the same samples.

        query    attributes at secondary hits; None leaves the bounce out
        coarse   points that carry the bounce (`points.coarse_points`), None: every point
        turning  primary normals will change before the samples are shaded: trace to the surface's own horizon
        """
        s = self.settings
        # the streams of one estimate: far apart, so that seeds 0, 1, 2... of a caller do not meet each other's
        first = 8 * seed
        pool = make_pool(sampler, s.technique, s.samples, first)
        direct = draw_light(points, material, pool, self.tracer, self.memory_mib, turning)
        hits = None
        if query is not None and s.bounces:
            hits = draw_bounce(
                points if coarse is None else points[coarse.rows],
                self.surface,
                query,
                self.tracer,
                sampler,
                s.secondary_rays,
                secondary_pool(pool, sampler, s.secondary_samples, first + 2),
                first + 4,
                self.memory_mib,
            )
        return Drawn(direct, hits, coarse)

    def shade(
        self,
        drawn: Drawn,
        points: Points,
        material: Material,
        query: Query | None,
        environment: torch.Tensor,
        strength: float = 1.0,
    ) -> torch.Tensor:
        """Radiance [N, 3] towards `points.view`; differentiable in points.normal, material, environment [H, W, 3] and
        in what `query` reads. `strength` is lambda_ind.

        Equation: 20.
        """
        radiance = shade(drawn.direct, points.normal, points.view, material, environment)
        if drawn.hits is None or query is None or strength == 0:
            return radiance
        coarse = drawn.coarse
        here = points if coarse is None else points[coarse.rows]
        stand_in = None
        if not self.settings.secondary_material:
            stand_in = material if coarse is None else material[coarse.rows]
        arrived = bounce_irradiance(drawn.hits, here, query, environment, stand_in, lobes=self.settings.secondary_lobes)
        if coarse is not None:
            arrived = coarse.spread(arrived)
        return radiance + (strength / torch.pi) * material.diffuse() * arrived

    def render(
        self,
        points: Points,
        material: Material,
        query: Query | None,
        environment: torch.Tensor,
        seed: int,
        *,
        sampler: EnvSampler | None = None,
        coarse: Coarse | None = None,
        strength: float = 1.0,
    ) -> torch.Tensor:
        """`draw` and `shade` in one; samples follow `sampler`, None: the environment as it is now."""
        drawn = self.draw(points, material, query, sampler or EnvSampler(environment), seed, coarse)
        return self.shade(drawn, points, material, query, environment, strength)


class SampleCache:
    """The samples of `slots` estimates of one set of points: step t reuses the rays of slot t mod `slots`.

    What is reused is directions, densities and visibility; radiance and material are read afresh, so the estimate
    stays unbiased while both change, with densities of the time when the slot was drawn. Where shading normals will
    turn, draw with `turning`, else the light between the old horizon and the new one is lost; samplers without
    environment samples (brdf, cosine) lose it all the same.
    """

    def __init__(self, slots: int) -> None:
        if slots < 1:
            raise ValueError(f"{slots} slots; expected at least 1")
        self.slots = slots
        self._drawn: dict[int, Drawn] = {}

    def get(self, step: int, draw: Callable[[int], Drawn]) -> Drawn:
        """The samples of `step`; `draw(seed)` makes those of a slot that is still empty, with seed = slot."""
        slot = step % self.slots
        if slot not in self._drawn:
            self._drawn[slot] = draw(slot)
        return self._drawn[slot]
