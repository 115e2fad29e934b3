"""Light of a frozen mesh: transport traced once and shared by fits, relighting and ablations, or Monte Carlo light."""

from typing import NamedTuple

from exmesh_graph.gpu.settings import ALL_CORES
from exmesh_graph.graph import Component, component
from exmesh_graph.graph.declare.node import Context, node
from exmesh_graph.shading.settings import BounceSettings, MonteCarloSettings, TransportSettings
from exmesh_graph.types import Carrier, SceneNeeds, Transport, decided


class TransportOut(NamedTuple):
    transport: Transport


@node("transport.direct", version="1", libraries=("embreex", "torch", "scipy", "warp-lang"), resources=ALL_CORES)
def direct(ctx: Context, mesh: Carrier, *, p: TransportSettings) -> TransportOut:
    """Trace the visibility and the secondary hits of the mesh along fixed directions."""
    from exmesh_graph.shading.transport import direct_transport

    light = direct_transport(mesh.vertices, mesh.faces, p, ctx.progress)
    ctx.log(f"{len(light.points)} points x {p.directions} directions, {len(light.hit_point)} secondary hits")
    return TransportOut(light)


@node("transport.bounce", version="2", libraries=("torch", "scipy"), resources=ALL_CORES)
def bounce(ctx: Context, light: Transport, needs: SceneNeeds | None = None, *, p: BounceSettings) -> TransportOut:
    """Build the interreflection operator from the secondary hits and switch it on."""
    from exmesh_graph.shading.transport import with_bounces

    bounces = decided(p.bounces, needs, "bounces")
    if bounces == 0:
        ctx.log("direct light only")
        return TransportOut(light)
    bounced = with_bounces(light, bounces, p.secondary_material, p.deeper)
    assert bounced.gather_point is not None
    ctx.log(f"{len(bounced.gather_point)} entries between {len(bounced.points)} points")
    return TransportOut(bounced)


@component("transport.monte_carlo", version="1")
class MonteCarlo(Component, MonteCarloSettings):
    """The paper's Monte Carlo light, drawn in every step; the defaults are its sample counts."""
