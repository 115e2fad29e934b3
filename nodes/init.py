"""Nodes that make the coarse mesh Stage I starts from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from exmesh_graph.geometry.settings import CleanSettings, HullSettings, TsdfSettings
from exmesh_graph.gpu.settings import ON_DEVICE, DeviceSettings
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.stage1.settings import PhotometricSettings
from exmesh_graph.types import DepthMaps, Frame, Mesh, Views

MaskedTrain = Annotated[Views, facets(split="train", masks=True)]
Train = Annotated[Views, facets(split="train")]


_MUCH = 0.02  # of a surface: dropping more is worth a warning


class MeshOut(NamedTuple):
    mesh: Mesh


class FileMeshOut(NamedTuple):
    mesh: Annotated[Mesh, facets(units=None)]  # what the file holds is seen when it is used


class ClosedMeshOut(NamedTuple):
    mesh: Annotated[Mesh, facets(manifold=True, closed=True)]


class ManifoldMeshOut(NamedTuple):
    mesh: Annotated[Mesh, facets(manifold=True)]


@node("init.visual_hull", version="1", libraries=("scipy", "scikit-image", "torch", "warp-lang"))
def visual_hull(ctx: Context, views: MaskedTrain, *, p: HullSettings) -> ClosedMeshOut:
    """The largest closed shape that agrees with the masks."""
    from exmesh_graph.geometry.closed import hull_surface
    from exmesh_graph.geometry.hull import SilhouetteField

    return ClosedMeshOut(Mesh(*hull_surface(SilhouetteField.of_views(views, p.wrong_masks), p, ctx.node)))


class SphereParams(Params):
    faces: int = param(1280, ge=20, unit="faces", doc="Upper limit; a sphere has 20, 80, 320, 1280, 5120, ... faces.")
    radius: float = param(
        0.8, gt=0, le=1, doc="Around the origin of the normalised world, which the unit sphere bounds."
    )


@node("init.sphere", version="1")
def sphere(ctx: Context, *, p: SphereParams) -> ClosedMeshOut:
    """A sphere that knows nothing of the photographs: what Stage I makes of the worst start."""
    from exmesh_graph.geometry.shapes import icosphere

    levels = 0
    while 20 * 4 ** (levels + 1) <= p.faces:
        levels += 1
    return ClosedMeshOut(Mesh(*icosphere(levels, p.radius)))


class TsdfParams(TsdfSettings):
    incidence: float = param(
        0.0, ge=0, le=90, unit="degrees", doc="Ignore surfaces seen at more than this angle; 0: none ignored."
    )
    agreeing: int = param(0, ge=0, unit="views", doc="Neighbours that must show the same point; 0: none asked.")
    tolerance: float = param(0.01, gt=0, le=1, doc="How far those may be off, as a share of the depth.")
    parts: int = param(0, ge=0, doc="Connected parts to keep, largest area first; 0 = all.")


@node("init.tsdf", version="2", libraries=("torch", "warp-lang", "open3d", "scipy", "scikit-image"))
def tsdf(ctx: Context, views: Train, depths: DepthMaps, *, p: TsdfParams) -> MeshOut:
    """Fuse depth maps into one surface (truncated signed distance): open (Open3D), or closed by the visual hull."""
    return MeshOut(fused(ctx, views, depths, p))


def fused(ctx: Context, views: Views, depths: DepthMaps, p: TsdfParams) -> Mesh:
    """As `init.tsdf`."""
    from exmesh_graph.errors import DataError
    from exmesh_graph.geometry.clean import largest_components

    if p.incidence > 0 or p.agreeing > 0:
        from exmesh_graph.priors.depth_filter import filtered

        before = int((depths.depth > 0).sum())
        depths = filtered(views, depths, incidence=p.incidence, agreeing=p.agreeing, tolerance=p.tolerance)
        ctx.log(f"{int((depths.depth > 0).sum()) / max(before, 1):.0%} of the depths pass the filters")
    if p.solid:
        from exmesh_graph.geometry.carve import carving
        from exmesh_graph.geometry.closed import solid_surface
        from exmesh_graph.geometry.hull import SilhouetteField
        from exmesh_graph.masks.regained import regained

        if not views.masked.all():
            raise DataError(
                "solid needs a mask for every view", where=ctx.node, fix="set solid: false, then init.clean close_holes"
            )
        found = carving(SilhouetteField.of_views(views, p.wrong_masks), views, depths, p)
        return Mesh(*solid_surface(regained(found.field(), found, views), found.grid, p.parts, ctx.node))
    from exmesh_graph.geometry.tsdf import fuse

    return Mesh(*largest_components(*fuse(views, depths, p), p.parts))


@node("init.clean", version="1", libraries=("scipy", "pymeshlab", "open3d"))
def clean(ctx: Context, mesh: Mesh, *, p: CleanSettings) -> ManifoldMeshOut:
    """Largest parts, manifold, evenly triangulated within a face budget; closed stays closed."""
    from exmesh_graph.geometry.adjacency import face_areas
    from exmesh_graph.geometry.clean import clean_mesh, largest_components

    kept = face_areas(*largest_components(mesh.vertices, mesh.faces, p.components, p.min_area)).sum()
    share = 1 - kept / max(face_areas(mesh.vertices, mesh.faces).sum(), 1e-30)
    if share > _MUCH:
        ctx.warn(
            f"parts that make up {share:.0%} of the surface are dropped: `components` keeps {p.components or 'all'}, "
            f"`min_area` those above {p.min_area:g} of the largest. If they belong to the object, set components: 0"
        )
    vertices, faces = clean_mesh(mesh.vertices, mesh.faces, p, where=ctx.node)
    if p.tolerance and len(faces) > 1.1 * p.faces:
        ctx.log(f"{len(faces)} faces, where {p.faces} would lose thin parts")
    if len(faces) > 1.1 * (max(p.faces, p.max_faces) if p.tolerance else p.faces):
        ctx.warn(
            f"{len(faces)} faces, not {p.faces}: the surface has holes or handles that fewer faces cannot hold. "
            "Close the holes (close_holes), or make a smoother surface first"
        )
    return ManifoldMeshOut(Mesh(vertices, faces))


class PhotometricParams(DeviceSettings, PhotometricSettings):
    pass


@node("init.photometric", version="1", libraries=("torch", "warp-lang", "scipy"), resources=ON_DEVICE)
def photometric(
    ctx: Context, mesh: Annotated[Mesh, facets(manifold=True)], views: Train, *, p: PhotometricParams
) -> ManifoldMeshOut:
    """Open cavities that no outline shows: move a coarse mesh to where patches of the photographs agree."""
    from exmesh_graph.gpu.torch_setup import computing
    from exmesh_graph.stage1.photometric import sweep
    from exmesh_graph.targets import prepare_targets, reduction_to_hold

    with computing(p) as device:
        factor = reduction_to_hold(views)
        if factor > 1:
            ctx.log(
                f"{len(views)} pictures of {views.width} x {views.height} are compared at 1 / {factor} of their size"
            )
        targets = prepare_targets(views, downscale=factor, device=device)
        vertices, figures = sweep(mesh.vertices, mesh.faces, targets, p, ctx.progress)
    ctx.log(", ".join(f"{name} {value:.2f}" for name, value in figures.items()))
    return ManifoldMeshOut(Mesh(vertices, mesh.faces))


class MeshFileParams(Params):
    path: Path = param(doc="OBJ or PLY file.")
    units: Literal["normalised", "scene", "dataset"] = param(
        "dataset", doc="The file's space: the normalised world, the Y-up scene, or the data set's own axes and units."
    )


def _mesh_file_sources(p: MeshFileParams) -> Mapping[str, Path]:
    from exmesh_graph.io.shots import need_file

    return need_file(p.path)


@node("init.mesh_file", version="1", libraries=("scipy", "scikit-image"), sources=_mesh_file_sources)
def mesh_file(ctx: Context, frame: Frame | None = None, *, p: MeshFileParams) -> FileMeshOut:
    """A mesh from an OBJ or PLY file."""
    import numpy as np

    from exmesh_graph.errors import DataError
    from exmesh_graph.io.meshes import read_mesh
    from exmesh_graph.io.normalise import points_to_normalised

    vertices, faces = read_mesh(p.path)
    if p.units != "normalised":
        if frame is None:
            raise DataError(
                f"a mesh in {p.units} units needs the scene's frame", where=ctx.node,
                fix='wire `frame: "@<loader>.frame"`, or set units: normalised',
            )  # fmt: skip
        if p.units == "scene":
            vertices = vertices @ frame.dataset_from_scene[:3, :3].T
        vertices = points_to_normalised(vertices, frame)
    return FileMeshOut(Mesh(vertices.astype(np.float32), faces))
