"""Stage I of the paper: the texture's start, and the differentiable refinement of one round."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

from exmesh_nodes.appearance import Appearance
from exmesh_nodes.regulariser import Smoothness
from pydantic import model_validator

from exmesh_graph.gpu.settings import ON_DEVICE, CoreSettings, DeviceSettings, loop_of
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import param
from exmesh_graph.stage1.settings import BalanceSettings, RefineSettings
from exmesh_graph.types import Carrier, DepthMaps, Mesh, Metrics, Stage1State, Views
from exmesh_graph.types.pictures import kept_in

Train = Annotated[Views, facets(split="train")]

_LIBRARIES = ("torch", "warp-lang", "scipy")


class BalanceParams(CoreSettings, BalanceSettings):
    pass


class BalanceOut(NamedTuple):
    views: Train
    decisions: Metrics


@node("stage1.balance", version="1", libraries=(*_LIBRARIES, "OpenImageIO"))
def balance(ctx: Context, views: Train, mesh: Mesh, *, p: BalanceParams) -> BalanceOut:
    """The photographs as one exposure and white balance would have taken them, where theirs wander.

    What each shows of the parts of a rough mesh says by how much. `decisions` says why, for the report.
    """
    from exmesh_graph.gpu.torch_setup import sharing
    from exmesh_graph.stage1.exposure import balanced, exposures, wander

    if p.exposure == "off":
        return BalanceOut(views, Metrics({"decisions": []}))
    with sharing(p.threads):
        found = exposures(views, mesh)
    wanders, much = wander(found, p)
    takes = p.exposure == "on" or wanders
    reason = (
        f"A view's brightness differs from its neighbours' by {found.rough:.2f} stops, here {much:.2f} would be much."
    )
    stops = {name: [round(float(g), 3) for g in row] for name, row in zip(views.names, found.stops, strict=True)}
    evidence = {"rough_stops": found.rough, "spread_stops": found.spread, "known_views": int(found.known.sum())}
    row = {"name": "exposure", "value": "balanced" if takes else "as it is", "reason": reason, "evidence": evidence}
    ctx.log(f"exposure: {row['value']}. {reason}")
    if takes and not found.known.all():
        lonely = [name for name, known in zip(views.names, found.known, strict=True) if not known]
        ctx.warn(f"{len(lonely)} views show too little of what others show to know their exposure: {_some(lonely)}")
    if takes:
        with kept_in(ctx.scratch):
            views = balanced(views, found.log_gains)
    return BalanceOut(views, Metrics({"decisions": [row], "stops": stops}))


class InitParams(DeviceSettings):
    texture: Literal["views", "carrier", "grey"] = param(
        "views", doc="First texture: projected from the photographs, the carrier's own, or plain grey."
    )


class InitOut(NamedTuple):
    state: Stage1State


@node("stage1.init", version="1", libraries=(*_LIBRARIES, "OpenImageIO"), resources=ON_DEVICE)
def init(
    ctx: Context, carrier: Carrier, views: Train, appearance: Appearance | None = None, *, p: InitParams
) -> InitOut:
    """Start Stage I: colour the carrier's atlas from the photographs, optimiser moments at zero."""
    from exmesh_graph.gpu.torch_setup import computing
    from exmesh_graph.stage1.init import initial_state

    with computing(p) as device:
        state = initial_state(carrier, views, texture=p.texture, device=device)
        if appearance is not None:
            state = appearance.decided(views, state, ctx.log).begin(state, ctx.seed, str(device))
        return InitOut(state)


class RefineParams(DeviceSettings, RefineSettings):
    share: float = param(
        0.0, ge=0, le=1, doc="This round's part of total_iterations; above 0 it stands in place of iterations."
    )
    seconds: float = param(
        0.0, ge=0, unit="s", doc="Processor time of the whole Stage I, by a fixed estimate from the pictures' size: "
        "above 0 it decides total_iterations, of which this round takes its `share`.",
    )  # fmt: skip
    vertex_units: Literal["edges", "world"] = param(
        "edges", doc="Unit of vertex_lr: mean edges of the round's mesh, or the normalised world's (the paper)."
    )
    deviation_units: Literal["edges", "world"] = param(
        "edges", doc="Unit of the distances in L_b: mean edges of the round's mesh, or the world's (the paper)."
    )

    @model_validator(mode="after")
    def _share_of_something(self) -> RefineParams:
        if self.share > 0 and self.total_iterations == 0 and self.seconds == 0:
            raise ValueError("share is a part of total_iterations, which is 0: give total_iterations, or iterations")
        if self.seconds > 0 and self.share == 0:
            raise ValueError("seconds are those of the whole Stage I: give this round's share of them")
        return self


class RefineOut(NamedTuple):
    state: Stage1State
    history: Metrics


@node("stage1.refine", version="1", libraries=(*_LIBRARIES, "OpenImageIO"), resumable=True, resources=ON_DEVICE)
def refine(
    ctx: Context,
    state: Stage1State,
    views: Train,
    depths: Annotated[DepthMaps, facets(units=None)] | None = None,
    smoothness: Smoothness | None = None,
    region: Mesh | None = None,
    appearance: Appearance | None = None,
    *,
    p: RefineParams,
) -> RefineOut:
    """Move vertices and texels against the photographs on a fixed topology.

    A state of another appearance than the one plugged in begins that one from its texture; with none it keeps its own.
    """
    from exmesh_graph.gpu.torch_setup import computing
    from exmesh_graph.resources import memory_in_use
    from exmesh_graph.stage1.length import iterations_in
    from exmesh_graph.stage1.memory import plan_memory
    from exmesh_graph.stage1.refine import refine as run
    from exmesh_graph.stage1.units import in_edge_lengths

    if not views.has_masks and region is None:
        ctx.warn("the views have no masks and no region is wired in: the outline follows from colour alone")
    elif views.has_masks and not views.masked.all():
        bare = [name for name, masked in zip(views.names, views.masked, strict=True) if not masked]
        ctx.warn(f"{len(bare)} of {len(views)} views have no mask and shape the surface by colour alone: {_some(bare)}")
    if region is not None and views.has_masks:
        ctx.log("the views have masks, which say what counts: the region that is wired in is not used")
        region = None
    if p.seconds > 0:
        p = p.replaced(total_iterations=iterations_in(p.seconds, views.width * views.height // p.downscale**2))
        ctx.log(f"{p.seconds:g} s pay for {p.total_iterations} iterations of the whole Stage I")
    if p.share > 0:
        p = p.replaced(iterations=round(p.share * p.total_iterations))
    p = in_edge_lengths(p, state, step=p.vertex_units == "world", deviation=p.deviation_units == "world")
    ctx.log(str(plan_memory(state, views, p, memory_in_use())))
    with computing(p) as device:
        if appearance is not None:
            appearance = appearance.decided(views, state, ctx.log)
        if appearance is not None and appearance.kind != state.appearance:
            state = appearance.begin(state, ctx.seed, str(device))
        wired: dict[str, Any] = {"smoothness": smoothness, "depths": depths, "region": region}
        new, history = run(state, views, p, **wired, where=ctx.node, device=device, **loop_of(ctx))
    suspects = history.get("suspects", {})
    for view in list(suspects)[:8]:
        ctx.warn(f"view {view!r}: {suspects[view]}")
    if more := list(suspects)[8:]:
        ctx.warn(f"{len(more)} more views do not fit (see the history): {_some(more)}")
    if dark := history.get("dark"):
        ctx.warn(f"the object is almost black in {len(dark)} views, where only masks shape it: {_some(dark)}")
    return RefineOut(new, Metrics(history))


def _some(names: list[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
