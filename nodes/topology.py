"""Topology operations of Stage I: splitting and merging (paper sections 4.1 and 4.2), edge flips, smoothing apart."""

from typing import Annotated, NamedTuple

from exmesh_graph.geometry.settings import FlipSettings, MergeSettings, SplitSettings, UntangleSettings
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Stage1State, Views


class _Budget(Params):
    """How many faces a split aims at: first among its parameters."""

    max_faces: int = param(200_000, ge=4, unit="faces", doc="Never exceeded (Table 1).")
    target_faces: int = param(0, ge=0, unit="faces", doc="Split up to this many faces; 0: use growth.")
    growth: float = param(1.5, ge=1.0, le=16.0, doc="Faces after over faces before, when target_faces is 0.")
    min_edge: float = param(
        0.0, ge=0, le=64, unit="px", doc="Mean edge below which no split goes, in the photographs of `views`; 0: any."
    )


class SplitParams(SplitSettings, _Budget):
    pass


class MergeParams(MergeSettings):
    supersample: int = param(
        2, ge=1, le=8, doc="Views are searched for each face at this multiple of their resolution."
    )


class FlipParams(FlipSettings):
    relax: int = param(2, ge=0, le=20, unit="steps", doc="Then glide vertices, with their UVs, towards even spacing.")


class StateOut(NamedTuple):
    state: Stage1State


@node("mesh.split", version="1", libraries=("scipy",))
def split(
    ctx: Context, state: Stage1State, views: Annotated[Views | None, facets(split="train")] = None, *, p: SplitParams
) -> StateOut:
    """Split faces that are large, curved or far from their images; UVs, moments and gradients follow.

    With `min_edge` the photographs of `views` bound the faces: smaller ones than they show hold noise.
    """
    from exmesh_graph.geometry.order import in_space_order
    from exmesh_graph.geometry.split import split as split_mesh

    before = len(state.faces)
    uniform, limit = p.method == "uniform", p.max_faces
    if p.min_edge:
        limit = min(limit, _shown_faces(ctx, state, views, p.min_edge))
    target = limit if uniform else min(p.target_faces or int(before * p.growth), limit)
    if target <= before and limit < p.max_faces:
        ctx.log(f"{before} faces are left as they are: edges of {p.min_edge:g} pixels are reached")
        return StateOut(state)
    done = split_mesh(
        state.vertices, state.faces, state.uvs, state.uv_faces, state.gradient_ema, target, p, seed=ctx.seed
    )
    if uniform and not done.count:
        bound = f"max_faces = {p.max_faces}" if limit == p.max_faces else f"the {limit} of min_edge = {p.min_edge:g}"
        ctx.warn(f"{before} faces are left as they are: four times as many exceed {bound}")
        return StateOut(state)
    if not uniform and len(done.faces) < 0.9 * target:
        ctx.warn(f"only {len(done.faces)} of {target} faces were reached: no further face can be split")
    ctx.log(f"{before} -> {len(done.faces)} faces, {len(done.vertices)} vertices, {len(done.uvs)} UVs")
    return StateOut(state.carried(in_space_order(done)))


def _shown_faces(ctx: Context, state: Stage1State, views: Views | None, edge: float) -> int:
    """Faces of the state's surface whose mean edge spans `edge` pixels of the views."""
    from exmesh_graph.errors import DataError
    from exmesh_graph.geometry.pixels import faces_at, pixel_width

    if views is None:
        raise DataError(
            "min_edge is measured in pixels of the photographs, and none are wired in", where=ctx.node,
            fix='wire `views: "@<loader>.train"`, or set min_edge: 0',
        )  # fmt: skip
    width = pixel_width(views.intrinsics, views.world_to_camera, state.vertices.mean(axis=0))
    return faces_at(state.vertices, state.faces, edge * width)


@node("mesh.merge", version="1", libraries=("torch", "warp-lang", "scipy"))
def merge(
    ctx: Context,
    state: Stage1State,
    views: Annotated[Views | None, facets(split="train")] = None,
    *,
    p: MergeParams,
) -> StateOut:
    """Collapse small faces that are degenerate or, with views given, that no view shows."""
    from exmesh_graph.geometry.merge import merge as merge_mesh
    from exmesh_graph.raster.rasterize import contribution_counts

    rendered = None
    if views is not None:
        cameras = (views.intrinsics, views.camera_to_world, views.height, views.width)
        rendered = contribution_counts(state.vertices, state.faces, *cameras, p.supersample)
    done = merge_mesh(state.vertices, state.faces, state.uvs, state.uv_faces, rendered, p, seed=ctx.seed)
    unseen = "" if rendered is None else f", {int((rendered == 0).sum())} faces never rendered"
    ctx.log(f"{len(state.faces)} -> {len(done.faces)} faces ({done.count} collapses{unseen})")
    return StateOut(state.carried(done))


@node("mesh.flip", version="1", libraries=("scipy",))
def flip(ctx: Context, state: Stage1State, *, p: FlipParams) -> StateOut:
    """Flip edges inside charts to even out the triangles that splits and merges leave, then space vertices evenly."""
    from dataclasses import replace

    from exmesh_graph.geometry.flip import flip as flip_mesh
    from exmesh_graph.geometry.relax import relax

    done = flip_mesh(state.vertices, state.faces, state.uvs, state.uv_faces, p)
    ctx.log(f"{done.count} edges flipped of {3 * len(state.faces) // 2}")
    state = state.carried(done)
    if p.relax:
        colours = state.model if state.appearance == "per_vertex" else {}
        vertices, uvs, moved = relax(
            done.vertices, done.faces, done.uvs, done.uv_faces,
            steps=p.relax, max_bend=p.max_bend, colours=tuple(colours.values()),
        )  # fmt: skip
        model = {**state.model, **dict(zip(colours, moved, strict=True))}
        state = replace(state, vertices=vertices, uvs=uvs, model=model)
    return StateOut(state)


@node("mesh.untangle", version="1", libraries=("scipy",))
def untangle(ctx: Context, state: Stage1State, *, p: UntangleSettings) -> StateOut:
    """Smooth faces apart that cut one another; nothing else moves. For starts and photographs that leave such faces."""
    from dataclasses import replace

    from exmesh_graph.geometry.untangle import untangle as untangle_mesh

    done = untangle_mesh(state.vertices, state.faces, p)
    ctx.log(f"{done.before} -> {done.after} faces cut others, {done.moved} of {len(state.vertices)} vertices moved")
    if done.after:
        ctx.warn(f"{done.after} faces still cut others after {p.steps} steps of smoothing around them")
    return StateOut(replace(state, vertices=done.vertices))
