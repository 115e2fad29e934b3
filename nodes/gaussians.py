"""Planar Gaussians: fitted to photographs, turned to depth maps, read from and written to files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import DepthMaps, Files, Frame, Metrics, PlanarGaussians, PointCloud, Views

Train = Annotated[Views, facets(split="train")]
Device = Literal["auto", "cpu", "cuda"]
_LIBRARIES = ("torch", "warp-lang", "scipy", "scikit-image")
KERNELS = tuple(  # loaded by a computed name
    f"exmesh_graph.splat.kernels_{name}" for name in ("adam", "blend", "camera", "harmonics", "project", "tiles")
)


class PgsrParams(Params):
    iterations: int = param(1500, ge=1, doc="Length of the fit, one view each; every schedule is a share of it.")
    start: Literal["auto", "points", "hull", "random"] = param(
        "auto",
        doc="points wired in, in the visual hull of the masks, or at random in the unit sphere; auto: the first of "
        "these that there is.",
    )
    count: int = param(20000, ge=1, doc="Gaussians at the start (hull, random).")
    max_gaussians: int = param(40000, ge=1, doc="Gaussians at most.")
    dissent: int = param(0, ge=0, unit="views", doc="Masks that may be wrong at a point (hull).")
    degree: int = param(3, ge=0, le=3, doc="Degree of the spherical harmonics at the end.")
    ssim_weight: float = param(0.2, ge=0, le=1, doc="Share of 1 - SSIM in the colour loss.")
    mask_weight: float = param(0.2, ge=0, doc="Weight of coverage against the mask, where there is one.")
    flatten_weight: float = param(100.0, ge=0, doc="Weight of the Gaussians' mean thickness, in world units.")
    normal_weight: float = param(0.015, ge=0, doc="Weight of rendered normals agreeing with rendered depth.")
    geometric_weight: float = param(0.03, ge=0, doc="Weight of depth agreeing with a neighbouring view's.")
    photometric_weight: float = param(0.15, ge=0, doc="Weight of patches correlating with a neighbouring view's.")
    geometry_from: float = param(0.25, ge=0, le=1, doc="Share of the iterations after which these three act.")
    samples: int = param(4096, ge=1, unit="pixels", doc="Pixels compared with the neighbour in an iteration.")
    mean_rate: float = param(2e-3, gt=0, doc="Step of the means at the start, in world units; a hundredth at the end.")
    densify: float = param(2e-4, gt=0, doc="Mean screen gradient above which a Gaussian is doubled or split.")
    densify_absolute: float = param(8e-4, gt=0, doc="The same for the sum of its absolute values over the pixels.")
    reset_at: float = param(0.0, ge=0, lt=1, doc="Share of the iterations at which opacities are reset; 0: never.")
    gains: bool = param(False, doc="Fit one factor per view and channel, for photographs of wandering exposure.")
    downscale: int = param(1, ge=1, le=16, doc="Work on pictures reduced by this factor.")
    device: Device = param("auto", doc="Where to compute; auto takes a CUDA device if there is one.")
    threads: int = param(1, ge=0, tuning=True, doc="torch CPU threads; 0 keeps the process's setting.")


class PgsrOut(NamedTuple):
    gaussians: PlanarGaussians
    history: Metrics


@node("init.pgsr", version="1", libraries=_LIBRARIES, code=KERNELS, resumable=True, resources={"cpu": 0, "gpu?": 1})
def pgsr(
    ctx: Context, views: Train, points: PointCloud | None = None, begin: PlanarGaussians | None = None, *, p: PgsrParams
) -> PgsrOut:
    """Fit planar Gaussians to the photographs (PGSR): a coarse surface that opens what no outline shows."""
    from exmesh_graph.gpu.torch_setup import pick_device, torch_threads
    from exmesh_graph.splat.pgsr import pgsr as run
    from exmesh_graph.splat.settings import FitSettings

    other = {"start", "count", "dissent", "downscale", "device", "threads"}
    with torch_threads(p.threads):
        gaussians, history = run(
            views,
            FitSettings(**p.model_dump(exclude=other)),
            points=points,
            begin=begin,
            start=p.start,
            count=p.count,
            dissent=p.dissent,
            downscale=p.downscale,
            seed=ctx.seed,
            device=pick_device(p.device),
            progress=ctx.progress,
            log=ctx.log,
            where=ctx.node,
            checkpoint=ctx.checkpoint,
            resumed=ctx.resume(),
        )
    if alone := history["alone"]:
        ctx.warn(f"{len(alone)} views have no neighbour within 45 degrees: colour alone shapes them ({alone[0]}, ...)")
    for name, wrong in list(history["suspects"].items())[:8]:
        ctx.warn(f"view {name!r}: {wrong}")
    return PgsrOut(gaussians, Metrics(history))


class DepthParams(Params):
    surface: Literal["middle", "blended"] = param(
        "middle", doc="Plane of the Gaussian at which half of the light is gone, or all planes blended."
    )
    incidence: float = param(80.0, gt=0, le=90, unit="degrees", doc="Drop planes seen at more than this angle.")
    agreeing: int = param(1, ge=0, unit="views", doc="Neighbours that must show the same point; 0: none asked.")
    tolerance: float = param(0.01, gt=0, le=1, doc="How far those may be off, as a share of the depth.")
    outward: float = param(
        0.5, ge=0, le=4, unit="px", doc="Added along the surface's normal: a fit shrinks the object by about so much."
    )
    device: Device = param("auto", doc="Where to compute.")
    threads: int = param(1, ge=0, tuning=True, doc="torch CPU threads; 0 keeps the process's setting.")


class DepthOut(NamedTuple):
    depths: DepthMaps


@node(
    "prior.depth_from_gaussians",
    version="1",
    libraries=("torch", "warp-lang", "scipy"),
    code=KERNELS,
    resources={"cpu": 0, "gpu?": 1},
)
def depth_from_gaussians(ctx: Context, gaussians: PlanarGaussians, views: Views, *, p: DepthParams) -> DepthOut:
    """Depth maps of fitted Gaussians, without grazing planes and what neighbouring views contradict."""
    from exmesh_graph.errors import GeometryError
    from exmesh_graph.gpu.torch_setup import pick_device, torch_threads
    from exmesh_graph.splat.depths import DepthFilter, depth_maps
    from exmesh_graph.splat.gaussians import Gaussians
    from exmesh_graph.targets import prepare_targets

    with torch_threads(p.threads):
        device = pick_device(p.device)
        keep = DepthFilter(**p.model_dump(exclude={"device", "threads"}))
        depths, share = depth_maps(Gaussians.of(gaussians, device), prepare_targets(views, device=device), keep)
    if not (depths.depth > 0).any():
        raise GeometryError(
            f"no depth is left of {len(gaussians)} Gaussians in {len(views)} views", where=ctx.node,
            expected="Gaussians that these views show", fix="fit longer, or lower agreeing and raise tolerance",
        )  # fmt: skip
    ctx.log(f"{share:.0%} of the covered pixels are kept")
    return DepthOut(depths)


class GaussianFileParams(Params):
    path: Path = param(doc="PLY file of Gaussians in the common 3DGS layout.")
    units: Literal["normalised", "scene", "dataset"] = param(
        "dataset", doc="The file's space: the normalised world, the Y-up scene, or the data set's own axes and units."
    )


def _gaussian_file(p: GaussianFileParams) -> Mapping[str, Path]:
    from exmesh_graph.io.shots import need_file

    return need_file(p.path)


class GaussiansOut(NamedTuple):
    gaussians: PlanarGaussians


@node("init.gaussian_file", version="1", libraries=("torch", "scipy"), sources=_gaussian_file)
def gaussian_file(ctx: Context, frame: Frame | None = None, *, p: GaussianFileParams) -> GaussiansOut:
    """Gaussians from a PLY file of 3DGS, 2DGS or PGSR."""
    import numpy as np

    from exmesh_graph.splat.ply import read_gaussians, transformed

    made = read_gaussians(p.path)
    if p.units != "normalised":
        made = transformed(made, np.linalg.inv(_to_units(frame, p.units, ctx.node)))
    return GaussiansOut(PlanarGaussians(**{name: t.numpy() for name, t in made.tensors().items()}))


class GaussianExportParams(Params):
    units: Literal["normalised", "scene", "dataset"] = param(
        "dataset", doc="The file's space: the normalised world, the Y-up scene, or the data set's own axes and units."
    )
    name: str = param("gaussians", pattern=r"^[A-Za-z0-9_.-]+$", doc="File name, without .ply.")


class FilesOut(NamedTuple):
    files: Files


@node("export.gaussians", version="1", libraries=("torch", "scipy"))
def export_gaussians(
    ctx: Context, gaussians: PlanarGaussians, frame: Frame | None = None, *, p: GaussianExportParams
) -> FilesOut:
    """Write Gaussians as PLY in the common 3DGS layout."""
    from exmesh_graph.splat.gaussians import Gaussians
    from exmesh_graph.splat.ply import transformed, write_gaussians

    made = Gaussians.of(gaussians)
    if p.units != "normalised":
        made = transformed(made, _to_units(frame, p.units, ctx.node))
    folder = ctx.scratch / "gaussians"
    folder.mkdir()
    write_gaussians(folder / f"{p.name}.ply", made)
    return FilesOut(Files(root=folder, main=f"{p.name}.ply"))


def _to_units(frame: Frame | None, units: str, where: str):
    """float64 [4, 4] from the normalised world to the stated units."""
    from exmesh_graph.errors import DataError

    if frame is None:
        raise DataError(
            f"Gaussians in {units} units need the scene's frame", where=where,
            fix='wire `frame: "@<loader>.frame"`, or set units: normalised',
        )  # fmt: skip
    scene = frame.scene_from_normalised
    return scene if units == "scene" else frame.dataset_from_scene @ scene
