"""Topology operations of Stage I: splitting and merging (paper sections 4.1 and 4.2), edge flips, smoothing apart."""

from typing import Annotated, Literal, NamedTuple

from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Stage1State, Views


class SplitParams(Params):
    max_faces: int = param(200_000, ge=4, unit="faces", doc="Never exceeded (Table 1).")
    target_faces: int = param(0, ge=0, unit="faces", doc="Split up to this many faces; 0: use growth.")
    growth: float = param(1.5, ge=1.0, le=16.0, doc="Faces after over faces before, when target_faces is 0.")
    method: Literal["score", "area", "random", "uniform"] = param(
        "score", doc="Which faces split: eq. 3, the largest, at random, or all into four (stops at max_faces)."
    )
    position: Literal["projection", "midpoint", "random"] = param("projection", doc="Where on its edge a vertex goes.")
    edge_degrees: Literal["opposite", "endpoints"] = param(
        "opposite", doc="Whose degrees divide the length in the edge score: those that rise, or the edge's own (paper)."
    )
    gradient_weight: float = param(0.6, ge=0.0, doc="w_g of eq. 3.")
    curvature_weight: float = param(0.4, ge=0.0, doc="w_k of eq. 3.")
    area_quantile: float = param(0.5, ge=0.0, lt=1.0, doc="Faces from this quantile of area on may be selected.")
    max_degree: int = param(10, ge=6, doc="Vertices that start a round with this degree get no further edge in it.")


class MergeParams(Params):
    degenerate: float = param(0.05, ge=0.0, le=0.433, doc="tau_degen: faces below this area / longest edge squared go.")
    area_quantile: float = param(0.3, ge=0.0, le=1.0, doc="Only faces up to this quantile of area may go.")
    method: Literal["degenerate", "random"] = param(
        "degenerate", doc="Which faces go: degenerate or never rendered ones, or a tenth at random."
    )
    min_faces: int = param(100, ge=4, unit="faces", doc="The mesh keeps at least this many.")
    supersample: int = param(
        2, ge=1, le=8, doc="Views are searched for each face at this multiple of their resolution."
    )


class FlipParams(Params):
    method: Literal["delaunay", "valence"] = param(
        "delaunay", doc="Which edges turn: those under wide angles, or those between vertices of many edges."
    )
    max_bend: float = param(0.5, ge=0.0, le=1.5, unit="radians", doc="Only pairs of faces that are flatter than this.")
    max_shift: float = param(
        0.1, ge=0.0, unit="diagonals", doc="How far the texture may move under the new edge; 0 allows rounding only."
    )
    max_rounds: int = param(8, ge=1, le=64, doc="Passes over the mesh; it ends early when no edge is left to flip.")
    relax: int = param(2, ge=0, le=20, unit="steps", doc="Then glide vertices, with their UVs, towards even spacing.")


class UntangleParams(Params):
    steps: int = param(12, ge=1, le=200, doc="Steps of smoothing at most; it ends when no face cuts another.")


class StateOut(NamedTuple):
    state: Stage1State


@node("mesh.split", version="1", libraries=("scipy",))
def split(ctx: Context, state: Stage1State, *, p: SplitParams) -> StateOut:
    """Split faces that are large, curved or far from their images; UVs, moments and gradients follow."""
    from exmesh_graph.geometry.split import SplitSettings
    from exmesh_graph.geometry.split import split as split_mesh
    from exmesh_graph.geometry.subdivide import subdivide

    before = len(state.faces)
    arrays = (state.vertices, state.faces, state.uvs, state.uv_faces)
    if p.method == "uniform":
        if 4 * before > p.max_faces:
            ctx.warn(f"{before} faces are left as they are: four times as many exceed max_faces = {p.max_faces}")
            return StateOut(state)
        done = subdivide(*arrays)
    else:
        target = min(p.target_faces or int(before * p.growth), p.max_faces)
        settings = SplitSettings(
            gradient_weight=p.gradient_weight,
            curvature_weight=p.curvature_weight,
            area_quantile=p.area_quantile,
            criterion=p.method,
            edge_degrees=p.edge_degrees,
            position=p.position,
            max_degree=p.max_degree,
        )
        done = split_mesh(*arrays, state.gradient_ema, target, settings, seed=ctx.seed)
        if len(done.faces) < 0.9 * target:
            ctx.warn(f"only {len(done.faces)} of {target} faces were reached: no further face can be split")
    ctx.log(f"{before} -> {len(done.faces)} faces, {len(done.vertices)} vertices, {len(done.uvs)} UVs")
    return StateOut(state.carried(done))


@node("mesh.merge", version="1", libraries=("torch", "warp-lang", "scipy"))
def merge(
    ctx: Context,
    state: Stage1State,
    views: Annotated[Views | None, facets(split="train")] = None,
    *,
    p: MergeParams,
) -> StateOut:
    """Collapse small faces that are degenerate or, with views given, that no view shows."""
    from exmesh_graph.geometry.merge import MergeSettings
    from exmesh_graph.geometry.merge import merge as merge_mesh
    from exmesh_graph.raster.rasterize import contribution_counts

    rendered = None
    if views is not None:
        rendered = contribution_counts(
            state.vertices,
            state.faces,
            views.intrinsics,
            views.camera_to_world,
            views.height,
            views.width,
            p.supersample,
        )
    settings = MergeSettings(degenerate=p.degenerate, area_quantile=p.area_quantile, criterion=p.method)
    done = merge_mesh(
        state.vertices,
        state.faces,
        state.uvs,
        state.uv_faces,
        rendered,
        settings,
        min_faces=p.min_faces,
        seed=ctx.seed,
    )
    unseen = "" if rendered is None else f", {int((rendered == 0).sum())} faces never rendered"
    ctx.log(f"{len(state.faces)} -> {len(done.faces)} faces ({done.count} collapses{unseen})")
    return StateOut(state.carried(done))


@node("mesh.flip", version="1", libraries=("scipy",))
def flip(ctx: Context, state: Stage1State, *, p: FlipParams) -> StateOut:
    """Flip edges inside charts to even out the triangles that splits and merges leave, then space vertices evenly."""
    from dataclasses import replace

    from exmesh_graph.geometry.flip import FlipSettings
    from exmesh_graph.geometry.flip import flip as flip_mesh
    from exmesh_graph.geometry.relax import relax

    settings = FlipSettings(criterion=p.method, max_bend=p.max_bend, max_shift=p.max_shift)
    done = flip_mesh(state.vertices, state.faces, state.uvs, state.uv_faces, settings, max_rounds=p.max_rounds)
    ctx.log(f"{done.count} edges flipped of {3 * len(state.faces) // 2}")
    state = state.carried(done)
    if p.relax:
        colours = state.model if state.appearance == "per_vertex" else {}
        vertices, uvs, moved = relax(
            done.vertices,
            done.faces,
            done.uvs,
            done.uv_faces,
            steps=p.relax,
            max_bend=p.max_bend,
            colours=tuple(colours.values()),
        )
        model = {**state.model, **dict(zip(colours, moved, strict=True))}
        state = replace(state, vertices=vertices, uvs=uvs, model=model)
    return StateOut(state)


@node("mesh.untangle", version="1", libraries=("scipy",))
def untangle(ctx: Context, state: Stage1State, *, p: UntangleParams) -> StateOut:
    """Smooth faces apart that cut one another; nothing else moves. For starts and photographs that leave such faces."""
    from dataclasses import replace

    from exmesh_graph.geometry.untangle import untangle as untangle_mesh

    done = untangle_mesh(state.vertices, state.faces, steps=p.steps)
    ctx.log(f"{done.before} -> {done.after} faces cut others, {done.moved} of {len(state.vertices)} vertices moved")
    if done.after:
        ctx.warn(f"{done.after} faces still cut others after {p.steps} steps of smoothing around them")
    return StateOut(replace(state, vertices=done.vertices))
