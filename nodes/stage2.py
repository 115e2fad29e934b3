"""Stage II: UV-PBR decomposition on the frozen carrier."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, NamedTuple

from exmesh_nodes.transport import MonteCarlo

from exmesh_graph.errors import DataError
from exmesh_graph.gpu.settings import ON_DEVICE, DeviceSettings, loop_of
from exmesh_graph.graph import Component, component
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.shading.settings import BounceSettings, TransportSettings
from exmesh_graph.stage2.alike import Alike
from exmesh_graph.stage2.settings import DecompositionSettings, RetouchSettings, StartSettings
from exmesh_graph.types import Asset, Carrier, Metrics, SceneNeeds, Transport, Views, decided, with_decisions

if TYPE_CHECKING:
    from exmesh_graph.stage2.decomposition import Decomposition


class MaterialPrior(Component):
    """Base of what stage2.fit takes as `prior`: it settles materials that the pictures leave open."""

    def settle(self, model: Decomposition) -> str:
        """Move the maps of a fit that has ended; says what was done."""
        raise NotImplementedError


@component("material.alike", version="1", libraries=("torch", "scipy"))
class AlikeMaterials(Alike, MaterialPrior):
    """Where no highlight tells the roughness, that of texels of like colour."""


class InitOut(NamedTuple):
    asset: Asset


@node("stage2.init", version="2", libraries=("torch", "embreex"))
def init(
    ctx: Context,
    carrier: Carrier,
    needs: SceneNeeds | None = None,
    transport: Transport | None = None,
    views: Annotated[Views | None, facets(split="train")] = None,
    *,
    p: StartSettings,
) -> InitOut:
    """Where stage2.fit starts: base colour of the Stage I texture or one colour, else neutral, under white light.

    With `key_light` under a sun or lamp as well, where Stage I's texture tells of one; that takes the carrier's
    `transport`. With `light_moves` the light that is fitted moves with the cameras of the training `views`. `needs` of
    scene.probe decides what is `auto`.
    """
    from exmesh_graph.stage2.init import neutral_asset
    from exmesh_graph.stage2.key_light import counts, described, find_key_light
    from exmesh_graph.stage2.moving import axis_for

    settings, key = with_decisions(p, needs), None
    if settings.key_light:
        if transport is None:
            raise DataError(
                "a key light is known by its shadows, and no transport is given", expected="that of the carrier's mesh",
                fix="wire transport.direct's output into `transport`, or set key_light: false",
            )  # fmt: skip
        found = find_key_light(carrier, transport)
        ctx.log(described(found))
        key = found if counts(found) else None
    return InitOut(neutral_asset(carrier, settings, key=key, axis=axis_for(settings.light_moves, views)))


class FitParams(DecompositionSettings, DeviceSettings):
    """The fit, and where it computes."""


class FitOut(NamedTuple):
    asset: Asset
    history: Metrics


@node(
    "stage2.fit",
    version="1",
    libraries=("torch", "embreex", "warp-lang", "scipy"),
    resumable=True,
    resources=ON_DEVICE,
)
def fit(
    ctx: Context,
    carrier: Carrier,
    views: Annotated[Views, facets(split="train")],
    transport: Transport | MonteCarlo,
    start: Asset | None = None,
    needs: SceneNeeds | None = None,
    prior: MaterialPrior | None = None,
    *,
    p: FitParams,
) -> FitOut:
    """Recover base colour, roughness and environment from the training views (paper, section 5).

    `start` is stage2.init's asset, which unwired stands for its defaults, or that of an earlier fit to go on from;
    `prior` settles what the pictures leave open, when the fit has ended.
    """
    settings = with_decisions(p, needs)
    light = transport if isinstance(transport, Transport) else with_decisions(transport, needs)
    return _fitted(ctx, carrier, views, light, settings, start, prior, p)


class RetouchParams(RetouchSettings, TransportSettings, BounceSettings, DeviceSettings):
    """The fit, the light transport that is traced for it, and where it computes."""


@node(
    "stage2.retouch",
    version="1",
    libraries=("torch", "embreex", "warp-lang", "scipy"),
    resumable=True,
    resources=ON_DEVICE,
)
def retouch(
    ctx: Context,
    asset: Asset,
    views: Annotated[Views, facets(split="train")],
    needs: SceneNeeds | None = None,
    prior: MaterialPrior | None = None,
    *,
    p: RetouchParams,
) -> FitOut:
    """Fit the materials and the light of a finished asset again, on the shape that stage3.refine gave it.

    Highlights that the old shape had put elsewhere now tell roughness and metal. Light transport is traced anew, with
    the `bounces` that `needs` of scene.probe decides where they are `auto`. The asset keeps its maps and their sizes:
    what it has no map of is not modelled. With `iterations: 0` it stays as it is.
    """
    from exmesh_graph.shading.transport import direct_transport, with_bounces

    if p.iterations == 0:
        return FitOut(asset, Metrics({}))
    light = direct_transport(asset.vertices, asset.faces, p)
    if bounces := decided(p.bounces, needs, "bounces"):
        light = with_bounces(light, bounces, p.secondary_material, p.deeper)
    return _fitted(ctx, asset, views, light, p.of(asset), asset, prior, p)


def _fitted(
    ctx: Context, carrier: Carrier, views: Views, light: Transport | MonteCarlo, settings: DecompositionSettings,
    start: Asset | None, prior: MaterialPrior | None, on: DeviceSettings,
) -> FitOut:  # fmt: skip
    """The fit on the device and cores of `on`, its memory announced."""
    from exmesh_graph.gpu.torch_setup import computing
    from exmesh_graph.resources import memory_in_use
    from exmesh_graph.stage2.fit import fit as run
    from exmesh_graph.stage2.memory import plan_memory

    traced = light if isinstance(light, Transport) else None
    ctx.log(str(plan_memory(carrier, views, traced, settings, memory_in_use())))
    with computing(on) as device:
        asset, curves = run(
            carrier, views, light, settings, start=start, prior=prior, device=str(device), warn=ctx.warn, log=ctx.log,
            **loop_of(ctx),
        )  # fmt: skip
    # the plan depends on the process and on a tuning knob: it must not be in what the store keeps
    return FitOut(asset, Metrics({"curves": curves}))
