"""Scores: how good is a mesh, a Stage I carrier, a finished asset. Their pictures are made by gallery.*."""

from typing import Annotated, NamedTuple

from exmesh_graph.evaluate.settings import AssetParams, Stage1Params, lpips_weights
from exmesh_graph.gpu.settings import ON_DEVICE
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Asset, Carrier, Mesh, Metrics, SceneTruth, ScoredViews, Views

_DRAWN = ("torch", "warp-lang", "scipy", "OpenImageIO")
TestViews = Annotated[Views, facets(split="test")]


class MeshParams(Params):
    samples: int = param(40_000, ge=100, doc="Points on each surface for the Chamfer distance.")


class MetricsOut(NamedTuple):
    metrics: Metrics


@node("evaluate.mesh", version="1", libraries=("scipy",))
def mesh(ctx: Context, mesh: Mesh, truth: SceneTruth | None = None, *, p: MeshParams) -> MetricsOut:
    """Chamfer distance to the true surface, whether the mesh is closed and manifold, its size."""
    from exmesh_graph.evaluate.mesh import score_mesh

    return MetricsOut(Metrics(score_mesh(mesh, truth, samples=p.samples, seed=ctx.seed)))


class ScoredOut(NamedTuple):
    metrics: Metrics
    scored: ScoredViews


@node("evaluate.stage1", version="1", libraries=_DRAWN, sources=lpips_weights, resources=ON_DEVICE)
def stage1(
    ctx: Context, carrier: Carrier, views: TestViews, region: Mesh | None = None, *, p: Stage1Params
) -> ScoredOut:
    """Held-out PSNR and SSIM of the mesh with its Stage I appearance.

    Views without masks are scored where the mesh shows, or, to compare meshes, where `region` shows.
    """
    from exmesh_graph.evaluate.carrier import carrier_pairs, score_carrier
    from exmesh_graph.evaluate.scores import add_lpips

    scores = score_carrier(carrier, views, max_views=p.max_views, region=region)
    add_lpips(scores.values, p.lpips, scores.held_out, label="Held-out LPIPS, Stage I")
    return ScoredOut(Metrics(scores.values), carrier_pairs(scores, views, p.pictures))


class RoundParams(Params):
    samples: int = param(10_000, ge=100, doc="Points on each surface for the Chamfer distance.")
    max_views: int = param(8, ge=1, doc="Held-out views that the PSNR is taken on, evenly spread.")


@node("evaluate.round", version="1", libraries=_DRAWN, resources=ON_DEVICE)
def round_(
    ctx: Context, state: Carrier, views: TestViews | None = None, truth: SceneTruth | None = None, *, p: RoundParams
) -> MetricsOut:
    """What a round of Stage I has reached: error against seconds and vertices."""
    from exmesh_graph.evaluate.carrier import score_stage
    from exmesh_graph.gpu.torch_setup import torch_threads

    with torch_threads(1):
        values = score_stage(state, views, truth, samples=p.samples, max_views=p.max_views, seed=ctx.seed)
    return MetricsOut(Metrics(values))


@node("evaluate.asset", version="1", libraries=(*_DRAWN, "embreex"), sources=lpips_weights, resources=ON_DEVICE)
def asset(
    ctx: Context,
    asset: Asset,
    views: TestViews,
    truth: SceneTruth | None = None,
    train: Annotated[Views, facets(split="train")] | None = None,
    *,
    p: AssetParams,
) -> ScoredOut:
    """Held-out and relit PSNR, albedo and roughness, each beside the score of a gray object."""
    from exmesh_graph.evaluate.asset import asset_pairs, score_asset
    from exmesh_graph.evaluate.scores import add_lpips

    scores = score_asset(
        asset, views, truth, train, max_views=p.max_views, quality=p, seed=ctx.seed, progress=ctx.progress
    )  # fmt: skip
    add_lpips(scores.values, p.lpips, scores.held_out, scores.relit)
    return ScoredOut(Metrics(scores.values), asset_pairs(scores, views, p.pictures))
