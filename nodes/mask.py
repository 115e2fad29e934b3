"""Masks of the object: from files, from a surface, or found in photographs that have none."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from exmesh_graph.gpu.settings import CoreSettings
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.masks.settings import AgreementSettings, CutSettings, ObjectSettings
from exmesh_graph.params import Params, param
from exmesh_graph.types import DepthMaps, Mesh, Metrics, PointCloud, Views
from exmesh_graph.types.pictures import kept_in
from exmesh_graph.types.rows import told

if TYPE_CHECKING:
    import numpy as np

Train = Annotated[Views, facets(split="train")]


class MaskedOut(NamedTuple):
    views: Annotated[Views, facets(split=None, masks=True)]


class FilesParams(Params):
    path: Path = param(doc="Folder of masks, PNG, called as the views: NAME_mask.png, NAME.png or NAME.jpg.png.")


def _mask_files(p: FilesParams) -> Mapping[str, Path]:
    from exmesh_graph.masks.files import mask_files

    return mask_files(p.path)


@node("mask.files", version="1", libraries=("OpenImageIO",), sources=_mask_files)
def files(ctx: Context, views: Views, *, p: FilesParams) -> MaskedOut:
    """Masks from files, laid on views that have none: white on the object, as the views have the pictures."""
    from exmesh_graph.masks.apply import with_masks
    from exmesh_graph.masks.files import masks_for

    with kept_in(ctx.scratch):
        return MaskedOut(with_masks(views, masks_for(views, p.path), ctx.node))


class SurfaceParams(CoreSettings, CutSettings):
    pass


@node("mask.from_surface", version="1", libraries=("torch", "warp-lang", "scipy", "scikit-image"))
def from_surface(ctx: Context, views: Views, surface: Mesh, *, p: SurfaceParams) -> MaskedOut:
    """Masks of what shows a surface: drawn into each view, and cut to the picture's edges around its outline."""
    from exmesh_graph.gpu.torch_setup import sharing
    from exmesh_graph.masks.outlines import masks_of_surface

    with sharing(p.threads):
        masks = masks_of_surface(views, surface.vertices, surface.faces, p, progress=ctx.progress)
    return MaskedOut(_masked(ctx, views, masks))


def _masked(ctx: Context, views: Views, masks: np.ndarray) -> Views:
    """The views that show the surface, with its masks; the others are named and left out."""
    from exmesh_graph.masks.apply import with_found_masks

    with kept_in(ctx.scratch):
        masked, bare = with_found_masks(views, masks, ctx.node)
    if bare:
        ctx.warn(f"{len(bare)} of {len(views)} views do not show the surface and are left out: {', '.join(bare[:8])}")
    return masked


class ObjectParams(CoreSettings, ObjectSettings):
    side: int = param(
        400, ge=32, unit="px", doc="Longer side of the pictures for stereo, and in which the object is sought."
    )


class ObjectOut(NamedTuple):
    mesh: Annotated[Mesh, facets(manifold=True, closed=True)]


_STEREO = ("torch", "warp-lang", "scipy", "scikit-image", "open3d")


@node("init.object", version="1", libraries=_STEREO)
def object_(
    ctx: Context, views: Views, points: PointCloud | None = None, depths: DepthMaps | None = None, *, p: ObjectParams
) -> ObjectOut:
    """The object alone, closed and rough, from views without masks: what stereo shows of it, without its table.

    Depth maps that are wired in take the place of stereo.
    """
    from exmesh_graph.geometry.soundness import require_sound
    from exmesh_graph.gpu.torch_setup import sharing
    from exmesh_graph.masks.decide import table_row
    from exmesh_graph.masks.object import object_of_depths

    maps = depths if depths is not None else _stereo(ctx, views, points, p.reach, p.side, p.threads)
    with sharing(p.threads):
        found = object_of_depths(views, maps, p, side=p.side, seed=ctx.seed)
    row = table_row(found)
    ctx.log(told(row))
    require_sound(found.vertices, found.faces, closed=True, where=ctx.node)
    return ObjectOut(Mesh(found.vertices, found.faces))


def _stereo(ctx: Context, views: Views, points: PointCloud | None, reach: float, side: int, threads: int) -> DepthMaps:
    """Depth by prior.patch_match inside the sphere of radius `reach`."""
    from exmesh_nodes import prior

    from exmesh_graph.masks.wide import brought_back, widened, widened_points

    seen = prior.PatchMatchParams(side=side, threads=threads)
    depths = prior.patch_match(ctx, widened(views, reach), widened_points(points, reach), p=seen).depths
    return brought_back(depths, reach)


class AutoParams(CoreSettings, CutSettings, ObjectSettings, AgreementSettings):
    find: bool = param(True, doc="Look for masks where there are none; false passes the views on as they are.")


class AutoOut(NamedTuple):
    train: Train
    decisions: Metrics
    depths: DepthMaps | None  # of stereo, of the views in `train`; absent where no masks were found
    ground: Mesh | None  # a square of what the object stands on, facing up; absent where masks took none away


@node("mask.auto", version="5", libraries=_STEREO)
def auto(ctx: Context, views: Train, points: PointCloud | None = None, *, p: AutoParams) -> AutoOut:
    """Masks for photographs that have none, where an object stands apart, and a check of them.

    By init.object and mask.from_surface, then by the colours of all views, for what stereo lost and for narrow gaps
    that it filled. The masks must have one common shape. Where a check fails the views go on as they came, and
    `decisions` says by which figures; so do views that have masks.
    """
    from exmesh_graph.masks.decide import given_row, off_row

    depths = ground = None
    if views.has_masks:
        train, rows = views, [given_row(int(views.masked.sum()), len(views))]
    elif not p.find:
        train, rows = views, [off_row()]
    else:
        seen = _stereo(ctx, views, points, p.reach, p.side, p.threads)
        train, rows, ground = _found(ctx, views, seen, p)
        if train.has_masks:  # without, a start is better looked for inside the sphere alone
            depths = DepthMaps(train.names, seen.depth[[views.names.index(name) for name in train.names]])
    for row in rows:
        lacking = row["value"] == "none" and row["name"] == "masks" and p.find
        (ctx.warn if lacking else ctx.log)(told(row))
    return AutoOut(train, Metrics({"decisions": rows}), depths, ground)


def _found(ctx: Context, views: Views, depths: DepthMaps, p: AutoParams) -> tuple[Views, list[dict], Mesh | None]:
    """(views with masks, or as they came; what was decided; the table that these masks took away)."""
    from exmesh_graph.errors import DataError, GeometryError
    from exmesh_graph.gpu.torch_setup import sharing
    from exmesh_graph.masks.agreement import agreed_masks
    from exmesh_graph.masks.decide import found_row, none_row, table_row
    from exmesh_graph.masks.object import object_of_depths
    from exmesh_graph.masks.table import Table

    with sharing(p.threads):
        try:
            found = object_of_depths(views, depths, p, side=p.side, seed=ctx.seed)
        except (DataError, GeometryError) as error:  # told below, with what to do; a fault of ours is neither
            return views, [none_row(str(error).splitlines()[0], {})], None
        rows = [table_row(found)]
        if found.apart < p.least_apart:
            fault = (
                f"most views show {found.apart:.0%} of the surface that stands amidst them, the rest goes on beyond "
                f"their pictures (least_apart {p.least_apart:g})"
            )
            return views, [none_row(fault, {"apart": found.apart}), *rows], None
        table = Table(found.table, depths) if found.removed and found.table is not None else None
        agreement = agreed_masks(views, found.vertices, found.faces, p, p, table=table, progress=ctx.progress)
    if agreement.fault:
        return views, [none_row(agreement.fault, agreement.figures), *rows], None
    train = _masked(ctx, views, agreement.masks)
    square = None if table is None else Mesh(*table.plane.square(found.vertices))
    return train, [found_row(agreement, len(views) - len(train)), *rows], square
