"""Depth that is known before the surface: from the photographs themselves, from a network, and brought together."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from exmesh_graph.gpu.settings import ON_DEVICE, CoreSettings, DeviceSettings
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.priors.settings import NetworkSettings, PatchMatchSettings, SweepSettings
from exmesh_graph.types import DepthMaps, PointCloud, Views

AnyDepth = Annotated[DepthMaps, facets(units=None)]


class SweepParams(DeviceSettings, SweepSettings):
    pass


class DepthOut(NamedTuple):
    depths: DepthMaps


@node("prior.plane_sweep", version="1", libraries=("torch", "warp-lang", "scipy"), resources=ON_DEVICE)
def plane_sweep(ctx: Context, views: Views, *, p: SweepParams) -> DepthOut:
    """Depth from the photographs alone: where windows of neighbouring views correlate best (plane sweep)."""
    from exmesh_graph.gpu.torch_setup import computing
    from exmesh_graph.priors.plane_sweep import plane_sweep as run

    with computing(p) as device:
        depths = run(views, p, device=device, progress=ctx.progress)
    known = (depths.depth > 0).mean(axis=(1, 2))
    ctx.log(f"depth in {known.mean():.0%} of the pixels, from {known.min():.0%} to {known.max():.0%} by view")
    return DepthOut(depths)


class PatchMatchParams(CoreSettings, PatchMatchSettings):
    pass


@node("prior.patch_match", version="1", libraries=("torch", "warp-lang", "scipy"))
def patch_match(ctx: Context, views: Views, points: PointCloud | None = None, *, p: PatchMatchParams) -> DepthOut:
    """Depth from the photographs alone, dense: planes that spread from pixel to pixel (PatchMatch stereo).

    Sparse points, where wired in, say where the search begins.
    """
    import numpy as np

    from exmesh_graph.gpu.torch_setup import sharing
    from exmesh_graph.priors.patch_match.estimate import patch_match as run

    with sharing(p.threads):
        stereo = run(views, p, points=points, seed=ctx.seed, progress=ctx.progress)
    if stereo.lonely:
        ctx.warn(
            f"{len(stereo.lonely)} views have no other that shows the same from 0.5 to 50 degrees away, and so no "
            f"depth: {', '.join(stereo.lonely[:8])}"
        )
    depth = stereo.depths.depth
    shown = [float((one[alpha > 0.5] > 0).mean()) for one, alpha in zip(depth, views.alpha, strict=True)]
    ctx.log(f"depth in {np.mean(shown):.0%} of the pixels, from {min(shown):.0%} to {max(shown):.0%} by view")
    sure = stereo.confidence > 0
    if sure.any():
        middle = np.median(stereo.confidence[sure])
        tilt = np.degrees(np.arccos(np.clip(-stereo.normals[sure][:, 2], -1, 1)))
        ctx.log(f"median confidence {middle:.2f}; surfaces tilted by {np.median(tilt):.0f} degrees (median)")
    return DepthOut(stereo.depths)


class AlignParams(Params):
    reach: float = param(
        0.03,
        ge=0,
        le=1,
        unit="picture widths",
        doc="How far measured depths correct the fit around them, and beyond which there is none; 0: fit alone.",
    )


@node("prior.align", version="1", libraries=("scipy",))
def align(ctx: Context, relative: AnyDepth, measured: DepthMaps, *, p: AlignParams) -> DepthOut:
    """Bring relative depth maps to the world by measured depths: scale and shift of each view, corrected nearby."""
    import numpy as np

    from exmesh_graph.priors.align import align as run

    done = run(relative, measured, p.reach)
    if done.left_out:
        ctx.warn(f"too few measured depths to align {len(done.left_out)} views: {', '.join(done.left_out[:8])}")
    if done.error:
        worst = max(done.error, key=lambda name: done.error[name])
        middle = float(np.median(list(done.error.values())))
        ctx.log(f"median error of scale and shift {middle:.4f}, at most {done.error[worst]:.4f} (view {worst})")
    return DepthOut(done.depths)


class DepthAnythingParams(NetworkSettings):
    device: Literal["auto", "cpu", "cuda"] = param("auto", doc="Where to compute.")


class RelativeOut(NamedTuple):
    depths: AnyDepth


def _weights(p: DepthAnythingParams) -> Mapping[str, Path]:
    from exmesh_graph.priors.depth_anything import weight_files

    return {} if p.weights is None else {file.name: file for file in weight_files(p.weights)}


@node(
    "prior.depth_anything",
    version="1",
    libraries=("torch", "depth-anything-3"),
    sources=_weights,
    resources=ON_DEVICE,
)
def depth_anything(ctx: Context, views: Views, *, p: DepthAnythingParams) -> RelativeOut:
    """Relative depth by Depth Anything 3; needs the optional package and its weights (docs/data.md)."""
    from exmesh_graph.gpu.torch_setup import pick_device
    from exmesh_graph.priors.depth_anything import estimate

    return RelativeOut(estimate(views, p, device=pick_device(p.device), progress=ctx.progress))
