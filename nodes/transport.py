"""Light transport of a frozen mesh, traced once and shared by fits, relighting and ablations."""

from typing import Annotated, NamedTuple

from pydantic import Field

from exmesh_graph.graph.node import Auto, Context, Params, node, param
from exmesh_graph.types import Carrier, SceneNeeds, Transport, decided


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


@node("transport.bounce", version="1", libraries=("torch", "scipy"), resources={"cpu": 0, "gpu?": 1})
def bounce(ctx: Context, light: Transport, needs: SceneNeeds | None = None, *, p: BounceParams) -> TransportOut:
    """Build the interreflection operator from the secondary hits and switch it on."""
    from exmesh_graph.shading.transport import with_bounces

    bounces = decided(p.bounces, needs, "bounces")
    if bounces == 0:
        ctx.log("direct light only")
        return TransportOut(light)
    lit = with_bounces(light, bounces)
    assert lit.gather_point is not None
    ctx.log(f"{len(lit.gather_point)} entries between {len(lit.points)} points")
    return TransportOut(lit)
