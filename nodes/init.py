"""Nodes that make the coarse mesh Stage I starts from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.stage1.settings import PhotometricSettings
from exmesh_graph.types import DepthMaps, Frame, Mesh, Views

MaskedTrain = Annotated[Views, facets(split="train", masks=True)]
Train = Annotated[Views, facets(split="train")]


class MeshOut(NamedTuple):
    mesh: Mesh


class FileMeshOut(NamedTuple):
    mesh: Annotated[Mesh, facets(units=None)]  # what the file holds is seen when it is used


class ClosedMeshOut(NamedTuple):
    mesh: Annotated[Mesh, facets(manifold=True, closed=True)]


class ManifoldMeshOut(NamedTuple):
    mesh: Annotated[Mesh, facets(manifold=True)]


class HullParams(Params):
    resolution: int = param(128, ge=16, le=512, unit="voxels", doc="Voxels along the object's longest side.")
    wrong_masks: int = param(
        0, ge=0, unit="views", was="dissent", doc="Masks that may be wrong at a point; 1 for hand-made masks."
    )
    smooth: int = param(
        10, ge=0, le=200, unit="steps", doc="Taubin smoothing steps (no shrinking) after marching cubes."
    )
    chunk: int = param(1 << 18, ge=1 << 12, unit="points", doc="Points handled at once; bounds memory.", tuning=True)


@node("init.visual_hull", version="1", libraries=("scipy", "scikit-image"))
def visual_hull(ctx: Context, views: MaskedTrain, *, p: HullParams) -> ClosedMeshOut:
    """The largest closed shape that agrees with the masks."""
    from exmesh_graph.geometry.clean import require_sound, taubin
    from exmesh_graph.geometry.hull import SilhouetteField
    from exmesh_graph.geometry.hull import visual_hull as hull

    field = SilhouetteField.from_masks(
        views.alpha,
        views.intrinsics,
        views.world_to_camera,
        wrong_masks=p.wrong_masks,
        names=views.names,
        chunk=p.chunk,
    )
    vertices, faces = hull(field, resolution=p.resolution)
    vertices = taubin(vertices, faces, p.smooth)
    require_sound(vertices, faces, closed=True, where=ctx.node)
    return ClosedMeshOut(Mesh(vertices, faces))


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


class TsdfParams(Params):
    resolution: int = param(128, ge=16, le=512, unit="voxels", doc="Voxels along the unit sphere's diameter.")
    truncation: float = param(4.0, ge=1.5, le=32, unit="voxels", doc="Distance at which the field is cut off.")
    masked: bool = param(True, doc="Ignore depth where alpha < 1/2.")
    min_weight: float = param(1.0, ge=1, unit="views", doc="Views that must have seen a voxel.")
    radius: float = param(0.0, ge=0, doc="Ignore depth of points farther than this from the origin; 0: none.")
    solid: bool = param(
        False,
        doc="Cut what the depth maps look through out of the visual hull, which fills what they do not see: closed "
        "(needs masks; resolution is along the object's longest side).",
    )
    wrong_masks: int = param(0, ge=0, unit="views", was="dissent", doc="Masks that may be wrong at a point (solid).")
    incidence: float = param(
        0.0, ge=0, le=90, unit="degrees", doc="Ignore surfaces seen at more than this angle; 0: none ignored."
    )
    agreeing: int = param(0, ge=0, unit="views", doc="Neighbours that must show the same point; 0: none asked.")
    tolerance: float = param(0.01, gt=0, le=1, doc="How far those may be off, as a share of the depth.")
    parts: int = param(0, ge=0, doc="Connected parts to keep, largest area first; 0 = all.")


@node("init.tsdf", version="1", libraries=("torch", "open3d", "scipy", "scikit-image"))
def tsdf(ctx: Context, views: Train, depths: DepthMaps, *, p: TsdfParams) -> MeshOut:
    """Fuse depth maps into one surface (truncated signed distance): open (Open3D), or closed by the visual hull."""
    from exmesh_graph.errors import DataError
    from exmesh_graph.geometry.clean import largest_components, require_sound

    if p.incidence > 0 or p.agreeing > 0:
        from exmesh_graph.priors.depth_filter import filtered

        before = int((depths.depth > 0).sum())
        depths = filtered(views, depths, incidence=p.incidence, agreeing=p.agreeing, tolerance=p.tolerance)
        ctx.log(f"{int((depths.depth > 0).sum()) / max(before, 1):.0%} of the depths pass the filters")
    if p.solid:
        from exmesh_graph.geometry.carve import carve
        from exmesh_graph.geometry.hull import SilhouetteField

        if not views.masked.all():
            raise DataError(
                "solid needs a mask for every view", where=ctx.node, fix="set solid: false, then init.clean close_holes"
            )
        field = SilhouetteField.from_masks(
            views.alpha, views.intrinsics, views.world_to_camera, wrong_masks=p.wrong_masks, names=views.names
        )
        vertices, faces = carve(
            field, views, depths, resolution=p.resolution, truncation=p.truncation, min_weight=p.min_weight
        )
    else:
        from exmesh_graph.geometry.tsdf import fuse

        vertices, faces = fuse(
            views, depths, voxel=2.0 / p.resolution, truncation=p.truncation, masked=p.masked, min_weight=p.min_weight,
            radius=p.radius,
        )  # fmt: skip
    vertices, faces = largest_components(vertices, faces, p.parts)
    if p.solid:
        require_sound(vertices, faces, closed=True, where=ctx.node)
    return MeshOut(Mesh(vertices, faces))


class CleanParams(Params):
    faces: int = param(5000, ge=20, unit="faces", doc="Face budget of the result.")
    method: Literal["builtin", "pymeshlab", "open3d"] = param(
        "builtin", doc="builtin, pymeshlab (GPL-3): isotropic remeshing; open3d: quadric decimation."
    )
    components: int = param(1, ge=0, doc="Connected parts to keep, largest area first; 0 = all.")
    min_area: float = param(0.0, ge=0, le=1, doc="Drop parts below this share of the largest part's area.")
    close_holes: int = param(0, ge=0, unit="edges", doc="Fill holes of at most so many edges (not open3d); 0 = none.")


@node("init.clean", version="1", libraries=("scipy", "pymeshlab", "open3d"))
def clean(ctx: Context, mesh: Mesh, *, p: CleanParams) -> ManifoldMeshOut:
    """Largest parts, manifold, evenly triangulated within a face budget; closed stays closed."""
    from exmesh_graph.geometry.clean import clean_mesh

    vertices, faces = clean_mesh(
        mesh.vertices, mesh.faces, faces_budget=p.faces, method=p.method, components=p.components,
        min_area=p.min_area, close_holes=p.close_holes, where=ctx.node,
    )  # fmt: skip
    if len(faces) > 1.1 * p.faces:
        ctx.warn(
            f"{len(faces)} faces, not {p.faces}: the surface has holes or handles that fewer faces cannot hold. "
            "Close the holes (close_holes), or make a smoother surface first"
        )
    return ManifoldMeshOut(Mesh(vertices, faces))


class PhotometricParams(PhotometricSettings):
    device: Literal["auto", "cpu", "cuda"] = param(
        "auto", doc="Where to compute; auto takes a CUDA device if there is one."
    )
    threads: int = param(1, ge=0, tuning=True, doc="torch CPU threads; 0 keeps the process's setting.")


@node("init.photometric", version="1", libraries=("torch", "warp-lang", "scipy"), resources={"cpu": 0, "gpu?": 1})
def photometric(
    ctx: Context, mesh: Annotated[Mesh, facets(manifold=True)], views: Train, *, p: PhotometricParams
) -> ManifoldMeshOut:
    """Open cavities that no outline shows: move a coarse mesh to where patches of the photographs agree."""
    from exmesh_graph.gpu.torch_setup import pick_device, torch_threads
    from exmesh_graph.stage1.photometric import sweep
    from exmesh_graph.targets import prepare_targets

    with torch_threads(p.threads):
        targets = prepare_targets(views, device=pick_device(p.device))
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
