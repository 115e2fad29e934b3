"""Light of a frozen mesh: transport traced once and shared by fits, relighting and ablations, or Monte Carlo light."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from pydantic import Field

from exmesh_graph.graph import Component, component
from exmesh_graph.graph.declare.node import Context, node
from exmesh_graph.params import Auto, Params, param
from exmesh_graph.types import Carrier, SceneNeeds, Transport, decided

if TYPE_CHECKING:
    from exmesh_graph.stage2.sampled import SampledSettings


class DirectParams(Params):
    directions: int = param(128, ge=16, le=8192, doc="Equal-area directions traced from every surface point.")
    points: int = param(
        12_000, ge=1, le=2_000_000, doc="Least number of surface points; faces are subdivided evenly to reach it."
    )


class TransportOut(NamedTuple):
    transport: Transport


@node(
    "transport.direct",
    version="1",
    libraries=("embreex", "torch", "scipy", "warp-lang"),
    resources={"cpu": 0, "gpu?": 1},
)
def direct(ctx: Context, mesh: Carrier, *, p: DirectParams) -> TransportOut:
    """Trace the visibility and the secondary hits of the mesh along fixed directions."""
    from exmesh_graph.shading.transport import choose_subdivision, trace_transport

    subdivision = choose_subdivision(len(mesh.vertices), len(mesh.faces), p.points)
    light = trace_transport(mesh.vertices, mesh.faces, p.directions, subdivision, progress=ctx.progress)
    ctx.log(f"{len(light.points)} points x {p.directions} directions, {len(light.hit_point)} secondary hits")
    return TransportOut(light)


class BounceParams(Params):
    bounces: Annotated[int, Field(ge=0, le=16), Auto("needs")] = param(
        1, doc="Diffuse interreflections to add; the paper has 1. 0 hands the direct light on."
    )
    secondary_material: bool = param(
        True, doc="Light from the mesh carries the maps of where it comes from; else the receiver's own (an ablation)."
    )


@node("transport.bounce", version="1", libraries=("torch", "scipy"), resources={"cpu": 0, "gpu?": 1})
def bounce(ctx: Context, light: Transport, needs: SceneNeeds | None = None, *, p: BounceParams) -> TransportOut:
    """Build the interreflection operator from the secondary hits and switch it on."""
    from exmesh_graph.shading.transport import with_bounces

    bounces = decided(p.bounces, needs, "bounces")
    if bounces == 0:
        ctx.log("direct light only")
        return TransportOut(light)
    lit = with_bounces(light, bounces, p.secondary_material)
    assert lit.gather_point is not None
    ctx.log(f"{len(lit.gather_point)} entries between {len(lit.points)} points")
    return TransportOut(lit)


class LightModel(Component):
    """How `stage2.fit` evaluates light where no traced transport is wired to it."""

    def made(self, needs: SceneNeeds | None = None) -> SampledSettings:
        """What the fit is told."""
        raise NotImplementedError


@component("transport.monte_carlo", version="1", libraries=("torch", "embreex", "warp-lang"))
class MonteCarlo(LightModel):
    """The paper's Monte Carlo light, drawn in every step; the defaults are its sample counts."""

    technique: Annotated[Literal["environment", "brdf", "mis", "cosine"], Auto("needs")] = param(
        "environment", doc="Where direct samples go; mis = half to the environment, half to the lobes."
    )
    samples: int = param(8, ge=2, le=4096, unit="rays", doc="N_d, direct samples per pixel.")
    bounces: Literal[0, 1] = param(1, doc="0: direct light only; 1: one diffuse bounce.")
    secondary_rays: int = param(16, ge=1, le=4096, unit="rays", doc="N_b, rays per pixel that look for the mesh.")
    secondary_samples: int = param(4, ge=1, le=4096, unit="rays", doc="N_s, light samples at each secondary hit.")
    half_resolution: bool = param(True, doc="Secondary rays for one pixel of each 2 x 2 block, then upsampled.")
    secondary_material: bool = param(
        True, doc="Secondary hits read the maps; else the primary point's material stands in (an ablation)."
    )
    kept: int = param(
        0, ge=0, le=64, unit="estimates", doc="Estimates per view whose rays are kept between corrections; 0: none."
    )

    def made(self, needs: SceneNeeds | None = None) -> SampledSettings:
        from exmesh_graph.stage2.sampled import SampledSettings

        return SampledSettings(**{**self.model_dump(), "technique": decided(self.technique, needs, "technique")})
