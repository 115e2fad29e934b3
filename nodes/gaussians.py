"""Planar Gaussians: fitted to photographs, turned to depth maps, read from and written to files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from exmesh_graph.gpu.settings import ON_DEVICE, DeviceSettings, loop_of
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.splat.settings import DepthSettings, PgsrSettings
from exmesh_graph.types import DepthMaps, Files, Frame, Metrics, PlanarGaussians, PointCloud, Views

Train = Annotated[Views, facets(split="train")]
_LIBRARIES = ("torch", "warp-lang", "scipy", "scikit-image")


class PgsrParams(DeviceSettings, PgsrSettings):
    pass


class PgsrOut(NamedTuple):
    gaussians: PlanarGaussians
    history: Metrics


@node("init.pgsr", version="1", libraries=_LIBRARIES, resumable=True, resources=ON_DEVICE)
def pgsr(
    ctx: Context, views: Train, points: PointCloud | None = None, begin: PlanarGaussians | None = None, *, p: PgsrParams
) -> PgsrOut:
    """Fit planar Gaussians to the photographs (PGSR): a coarse surface that opens what no outline shows."""
    from exmesh_graph.gpu.torch_setup import computing
    from exmesh_graph.splat.pgsr import pgsr as run

    with computing(p) as device:
        gaussians, history = run(
            views, p, points=points, begin=begin, device=device, log=ctx.log, where=ctx.node, **loop_of(ctx)
        )
    if alone := history["alone"]:
        ctx.warn(f"{len(alone)} views have no neighbour within 45 degrees: colour alone shapes them ({alone[0]}, ...)")
    for name, wrong in list(history["suspects"].items())[:8]:
        ctx.warn(f"view {name!r}: {wrong}")
    return PgsrOut(gaussians, Metrics(history))


class DepthParams(DeviceSettings, DepthSettings):
    pass


class DepthOut(NamedTuple):
    depths: DepthMaps


@node("prior.depth_from_gaussians", version="1", libraries=("torch", "warp-lang", "scipy"), resources=ON_DEVICE)
def depth_from_gaussians(ctx: Context, gaussians: PlanarGaussians, views: Views, *, p: DepthParams) -> DepthOut:
    """Depth maps of fitted Gaussians, without grazing planes and what neighbouring views contradict."""
    from exmesh_graph.errors import GeometryError
    from exmesh_graph.gpu.torch_setup import computing
    from exmesh_graph.splat.depths import depth_maps
    from exmesh_graph.splat.gaussians import Gaussians
    from exmesh_graph.targets import prepare_targets

    with computing(p) as device:
        depths, share = depth_maps(Gaussians.of(gaussians, device), prepare_targets(views, device=device), p)
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
