"""Scenes of published benchmarks, scored by their protocols; a run ends with the paper's table."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Asset, Frame, LitViews, Mesh, Metrics, SceneTruth, ScoredViews, Views

TestViews = Annotated[Views, facets(split="test")]
TrainViews = Annotated[Views, facets(split="train")]
_RENDER = ("torch", "warp-lang", "embreex", "scipy", "OpenImageIO")


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


@node("benchmark.dtu", version="1", libraries=("scipy",), sources=_dtu_sources)
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


@node("benchmark.nerf_synthetic", version="1", libraries=("scipy", "embreex"))
def nerf_synthetic(
    ctx: Context, mesh: Mesh, truth: SceneTruth, views: TestViews, frame: Frame, *, p: NerfSyntheticParams
) -> MetricsOut:
    """Chamfer distance on what the test cameras see and on the whole surface, in thousandths of a Blender unit."""
    from exmesh_graph.evaluate.protocols.nerf_synthetic import score_surface

    values = score_surface(mesh, truth, views, frame, p.scene, samples=p.samples, seed=ctx.seed)
    return MetricsOut(Metrics(values))


class _RenderParams(Params):
    scene: str = param("", doc="The scene's name in the table.")
    lpips: Path | None = param(None, doc="LPIPS's weights, a safetensors file (docs/metrics.md); none: left out.")
    max_views: int = param(0, ge=0, doc="Score this many views, evenly spread; 0: all.")
    directions: int = param(256, ge=32, doc="Directions per surface point of the light transport.")
    bounces: int = param(2, ge=0, le=8, doc="Interreflections in the scored renders.")
    supersampling: int = param(2, ge=1, le=8, unit="samples per pixel side", doc="Antialiasing.")
    specular_samples: int = param(12, ge=1, doc="GGX rays per sample of a pixel.")


def _weights(p: _RenderParams) -> Mapping[str, Path]:
    from exmesh_graph.evaluate.metrics.weights import lpips_source

    return lpips_source(p.lpips)


class Synthetic4RelightParams(_RenderParams):
    rule: Literal["median", "median_red", "mean", "none", "least_squares", "sampled_median", "sampled_red"] = param(
        "median", doc="How the albedo's scale is found, which relit pictures get too (docs/metrics.md)."
    )
    pictures: int = param(3, ge=0, doc="Held-out views handed on for pictures (gallery.asset).")


@node(
    "benchmark.synthetic4relight",
    version="1",
    libraries=_RENDER,
    sources=_weights,
    resources={"cpu": 0, "gpu?": 1},
)
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
    from exmesh_graph.evaluate.metrics.lpips import Lpips
    from exmesh_graph.evaluate.protocols.synthetic4relight import score_synthetic4relight
    from exmesh_graph.evaluate.renders import Quality

    scores = score_synthetic4relight(
        asset, views, truth, train, p.scene, rule=p.rule, lpips=Lpips.from_file(p.lpips) if p.lpips else None,
        max_views=p.max_views, progress=ctx.progress,
        quality=Quality(p.supersampling, p.specular_samples, p.directions, p.bounces, ctx.seed),
    )  # fmt: skip
    return ScoredOut(Metrics(scores.values), asset_pairs(scores, views, p.pictures))


class OrbParams(_RenderParams):
    pass


@node("benchmark.stanford_orb", version="1", libraries=_RENDER, sources=_weights, resources={"cpu": 0, "gpu?": 1})
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
    from exmesh_graph.evaluate.metrics.lpips import Lpips
    from exmesh_graph.evaluate.protocols.stanford_orb import score_orb
    from exmesh_graph.evaluate.renders import Quality

    quality = Quality(p.supersampling, p.specular_samples, p.directions, p.bounces, ctx.seed)
    lpips = Lpips.from_file(p.lpips) if p.lpips else None
    values = score_orb(asset, views, novel, truth, frame, p.scene, lpips=lpips, max_views=p.max_views,
                       quality=quality, seed=ctx.seed, progress=ctx.progress)  # fmt: skip
    return MetricsOut(Metrics(values))


class SpeedParams(Params):
    size: int = param(1600, ge=16, le=4096, unit="px", doc="Side of the rendered pictures; the paper's is 1600.")
    frames: int = param(4, ge=2, doc="Frames; the first is a warm-up and not counted.")
    bounces: int = param(2, ge=0, le=8, doc="Interreflections.")
    directions: int = param(256, ge=32, doc="Directions per surface point of the light transport.")
    supersampling: int = param(1, ge=1, le=8, unit="samples per pixel side", doc="Antialiasing.")
    specular_samples: int = param(8, ge=1, doc="GGX rays per sample of a pixel.")


@node("benchmark.speed", version="1", libraries=_RENDER, resources={"cpu": 0, "gpu?": 1})
def speed(ctx: Context, asset: Asset, views: Views, *, p: SpeedParams) -> MetricsOut:
    """Relighting frames per second by the paper's rule, vertices, and the mesh's size as PLY."""
    from exmesh_graph.evaluate.protocols.speed import measure_speed
    from exmesh_graph.evaluate.renders import Quality

    quality = Quality(p.supersampling, p.specular_samples, p.directions, p.bounces, ctx.seed)
    return MetricsOut(Metrics(measure_speed(asset, views, p.size, p.frames, quality)))
