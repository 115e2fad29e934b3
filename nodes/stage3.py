"""The third stage: the shape under the light and the materials that Stage II found."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from exmesh_nodes.regulariser import Smoothness

from exmesh_graph.gpu.settings import ON_DEVICE, DeviceSettings, loop_of
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.stage3.settings import ReshapeSettings
from exmesh_graph.types import Asset, Mesh, Metrics, Transport, Views


class RefineParams(DeviceSettings, ReshapeSettings):
    pass


class RefineOut(NamedTuple):
    asset: Asset
    history: Metrics


@node(
    "stage3.refine",
    version="1",
    libraries=("torch", "embreex", "warp-lang", "scipy"),
    resumable=True,
    resources=ON_DEVICE,
)
def refine(
    ctx: Context,
    asset: Asset,
    views: Annotated[Views, facets(split="train")],
    transport: Transport,
    smoothness: Smoothness | None = None,
    region: Mesh | None = None,
    *,
    p: RefineParams,
) -> RefineOut:
    """Move the vertices of a finished asset: highlights and shading of its own light now say where its normals point.

    `transport` is that of the asset's mesh. Faces, atlas, maps and environment stay as they are.
    """
    from exmesh_graph.gpu.torch_setup import computing
    from exmesh_graph.stage3.reshape import reshape

    if region is not None and views.has_masks:
        ctx.log("the views have masks, which say what counts: the region that is wired in is not used")
        region = None
    wired: dict[str, Any] = {"smoothness": smoothness, "region": region}
    with computing(p) as device:
        new, history = reshape(asset, views, transport, p, **wired, where=ctx.node, device=device, **loop_of(ctx))
    if "explained" in history:
        explained = f"{history['explained']:.2f} dB of the error of one texture"
        ctx.log(f"what the light does beside the texture, view by view, explains {explained}")
        if "moved" not in history:
            ctx.warn(f"the light that was found fits the photographs no better ({explained}): the vertices stay")
    if "moved" in history:
        moved = history["moved"]
        ctx.log(f"vertices moved by {moved['mean']:.2g} on average and {moved['largest']:.2g} at most, in scene units")
    return RefineOut(new, Metrics(history))
