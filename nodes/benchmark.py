"""Scenes of published benchmarks, scored by their protocols; a run ends with the paper's table."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

from exmesh_graph.evaluate.settings import OrbParams, SpeedParams, Synthetic4RelightParams, lpips_weights
from exmesh_graph.gpu.settings import ALL_CORES
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Asset, Frame, LitViews, Mesh, Metrics, SceneTruth, ScoredViews, Views

TestViews = Annotated[Views, facets(split="test")]
TrainViews = Annotated[Views, facets(split="train")]
_RENDER = ("torch", "warp-lang", "embreex", "scipy")
_PICTURED = (*_RENDER, "OpenImageIO")


class MetricsOut(NamedTuple):
    metrics: Metrics


class ScoredOut(NamedTuple):
    metrics: Metrics
    scored: ScoredViews


class DtuParams(Params):
    folder: Path = param(doc="DTU's evaluation data: Points/stl/ and ObsMask/.")
    scan: int = param(ge=1, doc="Number of the scan.")


def _dtu_sources(p: DtuParams) -> Mapping[str, Path]:
    from exmesh_graph.evaluate.protocols.dtu import truth_files

    return {file.name: file for file in truth_files(p.folder, p.scan)}


@node("benchmark.dtu", version="1", libraries=("scipy", "warp-lang"), sources=_dtu_sources)
def dtu(
    ctx: Context, mesh: Mesh, frame: Frame, train: Views | None = None, test: Views | None = None, *, p: DtuParams
) -> MetricsOut:
    """DTU's Chamfer distance in mm, unculled and, with views that have masks, culled by 2DGS's rule."""
    from exmesh_graph.evaluate.protocols.dtu import score_dtu

    views = [view for view in (train, test) if view is not None]
    return MetricsOut(Metrics(score_dtu(mesh, frame, p.folder, p.scan, views, seed=ctx.seed)))


class NerfSyntheticParams(Params):
    scene: str = param("", doc="The scene's name in the table.")
    samples: int = param(100_000, ge=100, doc="Points on each surface, and rays from the test cameras.")


@node("benchmark.nerf_synthetic", version="1", libraries=("scipy", "embreex", "torch", "warp-lang"))
def nerf_synthetic(
    ctx: Context, mesh: Mesh, truth: SceneTruth, views: TestViews, frame: Frame, *, p: NerfSyntheticParams
) -> MetricsOut:
    """Chamfer distance on what the test cameras see and on the whole surface, in thousandths of a Blender unit."""
    from exmesh_graph.evaluate.protocols.nerf_synthetic import score_surface

    values = score_surface(mesh, truth, views, frame, p.scene, samples=p.samples, seed=ctx.seed)
    return MetricsOut(Metrics(values))


@node("benchmark.synthetic4relight", version="1", libraries=_PICTURED, sources=lpips_weights, resources=ALL_CORES)
def synthetic4relight(
    ctx: Context,
    asset: Asset,
    views: TestViews,
    truth: SceneTruth,
    train: TrainViews | None = None,
    *,
    p: Synthetic4RelightParams,
) -> ScoredOut:
    """New views, relit views, albedo by every published rule, roughness; what `evaluate.asset` gives as well."""
    from exmesh_graph.evaluate.asset import asset_pairs
    from exmesh_graph.evaluate.protocols.synthetic4relight import score_synthetic4relight

    scores = score_synthetic4relight(asset, views, truth, train, p, seed=ctx.seed, progress=ctx.progress)
    return ScoredOut(Metrics(scores.values), asset_pairs(scores, views, p.pictures))


@node("benchmark.stanford_orb", version="1", libraries=_PICTURED, sources=lpips_weights, resources=ALL_CORES)
def stanford_orb(
    ctx: Context,
    asset: Asset,
    views: TestViews,
    novel: LitViews,
    truth: SceneTruth,
    frame: Frame,
    *,
    p: OrbParams,
) -> MetricsOut:
    """Stanford-ORB's PSNR-H, PSNR-L and SSIM in new views and under new lights; depth, normal, shape, albedo."""
    from exmesh_graph.evaluate.protocols.stanford_orb import score_orb

    values = score_orb(asset, views, novel, truth, frame, p, seed=ctx.seed, progress=ctx.progress)
    return MetricsOut(Metrics(values))


@node("benchmark.speed", version="1", libraries=_RENDER, resources=ALL_CORES)
def speed(ctx: Context, asset: Asset, views: Views, *, p: SpeedParams) -> MetricsOut:
    """Relighting frames per second by the paper's rule, vertices, and the mesh's size as PLY."""
    from exmesh_graph.evaluate.protocols.speed import measure_speed

    return MetricsOut(Metrics(measure_speed(asset, views, p, seed=ctx.seed)))
