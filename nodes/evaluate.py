"""Scores: how good is a mesh, a Stage I carrier, a finished asset. Their pictures are made by gallery.*."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

from exmesh_graph.evaluate.settings import AssetParams, RegionSettings, Stage1Params, lpips_weights
from exmesh_graph.gpu.settings import ALL_CORES
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Asset, Carrier, Mesh, Metrics, Region, SceneTruth, ScoredViews, Views
from exmesh_graph.types.rows import told

_DRAWN = ("torch", "warp-lang", "scipy", "OpenImageIO")
_FOUND = (*_DRAWN, "open3d", "scikit-image", "embreex")  # where no region is wired in, what evaluate.region finds
TestViews = Annotated[Views, facets(split="test")]
TrainViews = Annotated[Views, facets(split="train")]


class MeshParams(Params):
    samples: int = param(40_000, ge=100, doc="Points on each surface for the Chamfer distance.")


class MetricsOut(NamedTuple):
    metrics: Metrics


@node("evaluate.mesh", version="1", libraries=("scipy", "torch", "warp-lang"))
def mesh(ctx: Context, mesh: Mesh, truth: SceneTruth | None = None, *, p: MeshParams) -> MetricsOut:
    """Chamfer distance to the true surface, whether the mesh is closed and manifold, its size."""
    from exmesh_graph.evaluate.mesh import score_mesh

    return MetricsOut(Metrics(score_mesh(mesh, truth, samples=p.samples, seed=ctx.seed)))


@node("evaluate.capture", version="1", libraries=("torch", "warp-lang", "scipy"))
def capture(ctx: Context, views: TrainViews, mesh: Mesh, *, p: Params) -> MetricsOut:
    """What the photographs cover of the surface, and from where more of them would help most.

    `advice` is for the photographer, and heads the report.
    """
    from exmesh_graph.evaluate.capture import capture_figures
    from exmesh_graph.gpu.torch_setup import sharing

    with sharing(0):
        figures = capture_figures(views, mesh)
    for row in figures["advice"]:
        ctx.log(told(row))
    return MetricsOut(Metrics(figures))


class RegionOut(NamedTuple):
    region: Region


def _mask_files(p: RegionSettings) -> Mapping[str, Path]:
    from exmesh_graph.evaluate.region import mask_files

    return mask_files(p.masks)


@node("evaluate.region", version="4", libraries=_FOUND, sources=_mask_files)
def region(
    ctx: Context, views: TestViews, train: TrainViews | None = None, ground: Mesh | None = None, *, p: RegionSettings
) -> RegionOut:
    """What counts in held-out views without masks: what shows the hull of the training masks, or their own depth says.

    The hull is that of `train` above the `ground`, where all of `train` have masks; else a pixel counts whose depth
    lies in the object's box. Masks for scoring only, where they are given, come first. Found in photographs alone: the
    same pixels for all that is scored on a scene. Views that have masks keep to these.
    """
    from exmesh_graph.evaluate.region import find_region
    from exmesh_graph.gpu.torch_setup import sharing

    with sharing(0):
        found = find_region(views, train, p, ground)
    shares = found.inside.mean(axis=(1, 2))
    ctx.log(f"{shares.mean():.0%} of the pictures count, from {shares.min():.0%} to {shares.max():.0%} by view")
    empty = [name for name, share in zip(found.names, shares, strict=True) if share == 0]
    if empty:
        ctx.warn(f"in {len(empty)} held-out views nothing counts: {', '.join(empty[:8])}")
    return RegionOut(found)


def _region_of(ctx: Context, views: Views, train: Views | None, wired: Region | None) -> Region | None:
    """What is wired; else, where there are no masks, what evaluate.region finds."""
    if wired is not None or views.has_masks:
        return wired
    ctx.log("no masks and no region wired in: what counts is found in the held-out views, as by evaluate.region")
    return region(ctx, views, train, p=RegionSettings()).region


class ScoredOut(NamedTuple):
    metrics: Metrics
    scored: ScoredViews


@node("evaluate.stage1", version="1", libraries=_FOUND, sources=lpips_weights, resources=ALL_CORES)
def stage1(
    ctx: Context,
    carrier: Carrier,
    views: TestViews,
    region: Region | None = None,
    train: TrainViews | None = None,
    *,
    p: Stage1Params,
) -> ScoredOut:
    """Held-out PSNR and SSIM of the mesh with its Stage I appearance.

    Views without masks are scored where `region` says (evaluate.region): what is missing there counts as wrong.
    """
    from exmesh_graph.evaluate.carrier import carrier_pairs, score_carrier
    from exmesh_graph.evaluate.scores import add_lpips

    region = _region_of(ctx, views, train, region)
    scores = score_carrier(carrier, views, max_views=p.max_views, region=region, exposure=p.exposure)
    add_lpips(scores.values, p.lpips, scores.held_out, label="Held-out LPIPS, Stage I")
    return ScoredOut(Metrics(scores.values), carrier_pairs(scores, views, p.pictures))


class RoundParams(Params):
    samples: int = param(10_000, ge=100, doc="Points on each surface for the Chamfer distance.")
    max_views: int = param(8, ge=1, doc="Held-out views that the PSNR is taken on, evenly spread.")


@node("evaluate.round", version="1", libraries=_DRAWN, resources=ALL_CORES)
def round_(
    ctx: Context,
    state: Carrier,
    views: TestViews | None = None,
    truth: SceneTruth | None = None,
    region: Region | None = None,
    *,
    p: RoundParams,
) -> MetricsOut:
    """What a round of Stage I has reached: error against seconds and vertices.

    Held-out PSNR where there are masks, or a `region` (evaluate.region).
    """
    from exmesh_graph.evaluate.carrier import score_stage
    from exmesh_graph.gpu.torch_setup import sharing

    with sharing(0):
        values = score_stage(state, views, truth, region, samples=p.samples, max_views=p.max_views, seed=ctx.seed)
    return MetricsOut(Metrics(values))


@node("evaluate.asset", version="1", libraries=_FOUND, sources=lpips_weights, resources=ALL_CORES)
def asset(
    ctx: Context,
    asset: Asset,
    views: TestViews,
    truth: SceneTruth | None = None,
    train: TrainViews | None = None,
    region: Region | None = None,
    before: Metrics | None = None,
    *,
    p: AssetParams,
) -> ScoredOut:
    """Held-out and relit PSNR, albedo and roughness, each beside the score of a gray object.

    Views without masks are scored where `region` says (evaluate.region): what is missing there counts as wrong.
    `before`, the metrics of evaluate.stage1: warns where the asset shows held-out views worse than Stage I's texture.
    """
    from exmesh_graph.evaluate.asset import asset_pairs, score_asset
    from exmesh_graph.evaluate.before import set_beside
    from exmesh_graph.evaluate.scores import add_lpips

    scores = score_asset(
        asset, views, truth, train, max_views=p.max_views, quality=p, seed=ctx.seed, progress=ctx.progress,
        region=_region_of(ctx, views, train, region), exposure=p.exposure,
    )  # fmt: skip
    add_lpips(scores.values, p.lpips, scores.held_out, scores.relit)
    if before is not None:
        scores.values["before"] = beside = set_beside(scores.values, before.values, asset)
        if beside.get("worse"):
            ctx.warn(beside["warning"])
    return ScoredOut(Metrics(scores.values), asset_pairs(scores, views, p.pictures))
