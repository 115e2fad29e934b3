"""The coarse start that suits what there is."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from exmesh_graph.geometry.settings import CleanSettings, HullSettings, Voxels
from exmesh_graph.gpu.settings import ON_DEVICE, DeviceSettings
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import param
from exmesh_graph.types import DepthMaps, Mesh, Metrics, PointCloud, Views
from exmesh_graph.types.pictures import kept_in
from exmesh_graph.types.rows import told

if TYPE_CHECKING:
    from exmesh_graph.evaluate.surfaces import Kept, Solid
    from exmesh_graph.geometry.hull import SilhouetteField
    from exmesh_graph.geometry.openings import Opening

Train = Annotated[Views, facets(split="train")]
_LEAST_PART = 0.002  # of the largest part's area: smaller ones stay where masks need them
_LIDS_AT = 96  # voxels along the object: fine enough to see where an opening may be, and how thick its walls are
_LEAST_BARE_PART = 0.05  # without masks: a part of the object may lie apart from the rest, lumps are small


class AutoParams(DeviceSettings):
    method: Literal["auto", "hull", "tsdf", "stereo", "pgsr", "sphere"] = param(
        "auto",
        doc="auto: by what there is and `seconds`; else init.visual_hull, init.tsdf (of depths, or of "
        "prior.patch_match: stereo), init.pgsr, init.sphere.",
    )
    seconds: float = param(300.0, gt=0, unit="s", doc="Processor time the start may take, by a fixed estimate.")
    iterations: int = param(
        0,
        ge=0,
        doc="Of planar Gaussians (beside stereo with masks, else alone); 0: 500 to 1500 if needed, by `seconds`.",
    )
    side: int = param(
        400, ge=16, unit="px", doc="Longer side of the pictures for stereo, and to which Gaussians are fitted, about."
    )
    count: int = param(20000, ge=1, doc="Gaussians at the start where no points are wired in.")
    resolution: Voxels = param(
        0, ge=0, le=512, unit="voxels", doc="Of the hull or the fusion; 0: as fine as masks show it, without masks 128."
    )
    faces: int = param(5000, ge=20, unit="faces", doc="Face budget of the result.")
    edge: float = param(
        0.0,
        ge=0,
        unit="pixels",
        doc="With masks: more faces, up to 12 000, where edges would span more pixels of the photographs; 0: no.",
    )
    tolerance: float = param(
        0.02, ge=0, le=1, doc="With masks: more faces, where so few would lose thin parts (as init.clean)."
    )
    close_holes: int = param(60, ge=0, unit="edges", doc="Without masks: fill holes of at most so many edges.")
    wrong_masks: int = param(0, ge=0, unit="views", was="dissent", doc="Masks that may be wrong at a point.")
    table: Literal["auto", "remove", "keep"] = param(
        "auto", doc="Without masks: the plane that the object stands on, as in init.object; lumps in the air go anyway."
    )
    openings: bool = param(
        True,
        doc="With masks: open flat parts of the surface where photographs say so: vessels, whose depth no outline "
        "shows.",
    )

    flat_base: bool = param(
        True,
        doc="With masks and without a `ground`: where cameras look down at it, the hull ends at the lowest level that "
        "outlines show; else it goes on below in a cone.",
    )


class AutoOut(NamedTuple):
    mesh: Annotated[Mesh, facets(manifold=True)]
    decisions: Metrics


@node(
    "init.auto",
    version="16",
    libraries=("torch", "warp-lang", "scipy", "scikit-image", "open3d", "pymeshlab"),
    resumable=True,
    resources=ON_DEVICE,
)
def auto(
    ctx: Context,
    views: Train,
    points: PointCloud | None = None,
    depths: DepthMaps | None = None,
    stereo: DepthMaps | None = None,
    ground: Mesh | None = None,
    *,
    p: AutoParams,
) -> AutoOut:
    """A coarse mesh by what there is: the hull of masks, carved by stereo; without masks the depth of stereo, fused.

    Depth maps that are wired in take its place, and Gaussians where `iterations` asks for them; `stereo` is its depth
    where that was found already (mask.auto), and is not looked for again. A hull ends on the `ground`, where one was
    found, or at the lowest level that outlines show (`flat_base`): what cameras from above do not see below the object
    is none of it. Only what is chosen runs. Where a hull was
    carved, the photographs say which of its flat parts are mouths of vessels (`openings`), what of the carving they let
    go, and which surface is kept: the opened hull, or what stereo or the Gaussians leave of it. What masks show is not
    carved away. `decisions` says why, for the report.
    """
    import numpy as np
    from exmesh_nodes import init

    from exmesh_graph.errors import DataError
    from exmesh_graph.evaluate.surfaces import carved_solid
    from exmesh_graph.geometry.carve import carving
    from exmesh_graph.geometry.closed import hull_surface, solid_surface
    from exmesh_graph.geometry.coarse_start import ENOUGH_VIEWS, Known, choose, reduction
    from exmesh_graph.geometry.footing import base_row, footing
    from exmesh_graph.geometry.grounded import Grounded, hull_of
    from exmesh_graph.geometry.openings import opened
    from exmesh_graph.gpu.torch_setup import sharing
    from exmesh_graph.masks.regained import regained
    from exmesh_graph.stage1.parts import without_phantoms

    masks, factor = bool(views.masked.all()), reduction(views.width, views.height, p.side)
    pixels = (views.width // factor) * (views.height // factor)
    known = Known(len(views), masks, points is not None, depths is not None, pixels, stereo is not None)
    start, count = choose(known, p.seconds)
    method, reason = (start.value, start.reason) if p.method == "auto" else (p.method, "Set by `method`.")
    if p.method == "auto" and method == "stereo" and p.iterations:
        method, reason = "pgsr", "`iterations` asks for planar Gaussians."
    iterations, paid = (p.iterations, "Set by `iterations`.") if p.iterations else (int(count.value), count.reason)
    rows = [{"name": "start", "value": method, "reason": reason, "evidence": start.evidence}]
    if method == "pgsr":
        iterations = max(iterations, 1)
        rows.append({"name": "iterations", "value": iterations, "reason": paid})
    for row in rows:
        ctx.log(told(row))

    if method == "tsdf" and depths is None:
        raise DataError(
            "method: tsdf fuses depth maps, and none are wired in", where=ctx.node,
            fix='wire depths: "@<a prior>.depths", or set method: auto',
        )  # fmt: skip
    outline = HullSettings(resolution=p.resolution, wrong_masks=p.wrong_masks)
    silhouettes = masks and method != "sphere"
    field = hull_of(views, ground, p.wrong_masks, found=stereo is not None) if silhouettes else None
    if field is not None and ground is None and p.flat_base and (base := footing(field)):
        field = Grounded.above(field, np.array([0.0, 1.0, 0.0]), base.height)
        rows.append(base_row(base))
        ctx.log(told(rows[-1]))
    solid = _hull_solid(field) if field else None
    shown, vessel = views, None  # the photographs that foretell one another; what was said on openings
    if method == "hull":
        if field is None:
            mesh = init.visual_hull(ctx, views, p=outline).mesh
        else:
            mesh = Mesh(*hull_surface(field, outline, ctx.node))
    elif method == "sphere":
        mesh = init.sphere(ctx, p=init.SphereParams(faces=p.faces)).mesh
    else:
        judged = p.method == "auto" and method in ("pgsr", "stereo") and masks and len(views) >= ENOUGH_VIEWS
        # where Gaussians are asked for and the photographs decide, stereo is little beside them and often better
        tried = ["stereo", "pgsr"] if judged and method == "pgsr" else [str(method)]
        maps = {name: _depths(ctx, views, points, depths, stereo, name, iterations, factor, p) for name in tried}
        if field is None:
            mesh = init.fused(ctx, views, maps[str(method)], _bare(p))
            mesh, row = _standing(ctx, views, maps[str(method)], mesh, p)
            rows.append(row)
        elif judged:
            kept, shown, vessel, said = _judged(ctx, views, field, maps, factor, p, found=stereo is not None)
            mesh, solid, rows = kept.mesh, kept.solid, rows + said
        else:
            found = carving(field, views, maps[str(method)], _carving(str(method), p))
            values = regained(found.field(), found, views, found=stereo is not None)
            mesh = Mesh(*solid_surface(values, found.grid, 0, ctx.node))
            solid = carved_solid(values, found.grid, p.resolution)
    if solid and p.openings and len(views) >= ENOUGH_VIEWS:
        if vessel is None:
            mouths, vessel = _mouths(ctx, shown, solid, p)
            mesh = Mesh(*opened(*solid(p.resolution), mouths)) if mouths else mesh
        rows.append(vessel)
    if masks:  # parts that masks show belong to the object; without, they are what fusion left in the air
        with sharing(p.threads):
            mesh = Mesh(*without_phantoms(mesh.vertices, mesh.faces, views, _LEAST_PART))
        cleaning = CleanSettings(faces=_budget(mesh, views, p), tolerance=p.tolerance, components=0)
    else:
        cleaning = CleanSettings(faces=p.faces, close_holes=p.close_holes, components=0, min_area=_LEAST_BARE_PART)
    mesh = init.clean(ctx, mesh, p=cleaning).mesh
    if method == "stereo" and not masks:
        rows.append(_mirrors(ctx, views, mesh, p))
    return AutoOut(mesh, Metrics({"decisions": rows}))


def _budget(mesh: Mesh, views: Views, p: AutoParams) -> int:
    """Faces of the start: as many as are asked for, or as photographs show details of."""
    from exmesh_graph.geometry.pixels import faces_at, pixel_width

    if p.edge == 0:
        return p.faces
    width = pixel_width(views.intrinsics, views.world_to_camera, mesh.vertices.mean(axis=0))
    shown = faces_at(mesh.vertices, mesh.faces, p.edge * width)
    return max(p.faces, min(shown, CleanSettings().max_faces))


def _mirrors(ctx: Context, views: Views, mesh: Mesh, p: AutoParams) -> dict[str, Any]:
    """Whether stereo found reflections, which is warned of."""
    from exmesh_graph.evaluate.metrics.agreement import reflected
    from exmesh_graph.geometry.coarse_start import mirror_row
    from exmesh_graph.gpu.torch_setup import sharing

    with sharing(p.threads):
        row = mirror_row(*reflected(mesh.vertices, mesh.faces, views))
    (ctx.log if row["value"] == "none" else ctx.warn)(told(row))
    return row


def _depths(
    ctx: Context, views: Views, points: PointCloud | None, depths: DepthMaps | None, stereo: DepthMaps | None,
    method: str, iterations: int, factor: int, p: AutoParams,
) -> DepthMaps:  # fmt: skip
    """Those wired in, of stereo or of Gaussians."""
    import numpy as np
    from exmesh_nodes import prior

    from exmesh_graph.errors import DataError

    if method == "pgsr":
        return _fitted_depths(ctx, views, points, iterations, factor, p)
    if method == "stereo":
        if stereo is None:
            seen = prior.PatchMatchParams(side=p.side, threads=p.threads)
            depths = prior.patch_match(ctx, views, points, p=seen).depths
        else:
            stereo.require_of(views, ctx.node)
            depths = replace(stereo, depth=np.where(np.asarray(views.alpha) >= 0.5, stereo.depth, np.float32(0)))
        if not views.masked.all() and not (depths.depth > 0).any():
            raise DataError(
                f"no two of the {len(views)} views agree on any depth, and there are no masks", where=ctx.node,
                expected="painted surfaces, seen from several views some 15 degrees apart",
                fix="set iterations: 500 (planar Gaussians), add masks or views, or raise side",
            )  # fmt: skip
    assert depths is not None
    return depths


def _steady(ctx: Context, views: Views, mesh: Mesh, p: AutoParams) -> Views:
    """The photographs without what their exposures wander: photographs foretell one another only in one exposure."""
    from exmesh_graph.gpu.torch_setup import sharing
    from exmesh_graph.stage1.exposure import balanced, exposures, wander
    from exmesh_graph.stage1.settings import BalanceSettings

    with sharing(p.threads), kept_in(ctx.scratch):
        found = exposures(views, mesh)
        if not wander(found, BalanceSettings())[0]:
            return views
        ctx.log(f"exposures wander by {found.rough:.2f} stops: evened out where photographs foretell one another")
        return balanced(views, found.log_gains)


def _bare(p: AutoParams) -> Any:
    """How depth maps are fused without masks: parameters of init.tsdf."""
    from exmesh_nodes import init

    return init.TsdfParams(resolution=p.resolution, masked=False, truncation=6, min_weight=2, radius=1)


def _carving(method: str, p: AutoParams) -> Any:
    """How depth maps carve the hull: parameters of init.tsdf."""
    from exmesh_nodes import init

    rough = {"clear": 2.0, "blur": 1.0} if method == "stereo" else {}
    return init.TsdfParams(
        resolution=p.resolution, solid=True, truncation=3, min_weight=2, wrong_masks=p.wrong_masks, **rough
    )


def _hull_solid(field: SilhouetteField) -> Solid:
    from exmesh_graph.geometry.hull import hull_field

    return lambda resolution: hull_field(field, resolution=resolution)


def _judged(
    ctx: Context,
    views: Views,
    field: SilhouetteField,
    maps: dict[str, DepthMaps],
    factor: int,
    p: AutoParams,
    *,
    found: bool,
) -> tuple[Kept, Views, dict[str, Any] | None, list[dict[str, Any]]]:
    """What photographs foretell one another best over: the hull, opened where it is a vessel's, or what depth maps let
    them take away of it.

    Returns that surface, the photographs in one exposure, what was said on openings if that is the last word on them,
    and the rows of the decisions.
    """
    from exmesh_graph.evaluate.surfaces import Kept, kept_surface
    from exmesh_graph.geometry.carve import carving
    from exmesh_graph.geometry.closed import hull_surface, solid_surface
    from exmesh_graph.geometry.openings import opened
    from exmesh_graph.gpu.torch_setup import sharing

    outline = HullSettings(resolution=p.resolution, wrong_masks=p.wrong_masks)
    with sharing(p.threads):
        carvings = {name: carving(field, views, seen, _carving(name, p)) for name, seen in maps.items()}
        last = list(carvings.values())[-1]
        shown = _steady(ctx, views, Mesh(*solid_surface(last.field(), last.grid, 0, ctx.node)), p)
    hull = Kept("hull", Mesh(*hull_surface(field, outline, ctx.node)), _hull_solid(field))
    vessel = None
    if p.openings:  # first: a mouth that an outline hides must not decide for a carved surface, pits and all
        mouths, vessel = _mouths(ctx, shown, hull.solid, p)
        if mouths:
            hull = hull._replace(mesh=Mesh(*opened(*hull.solid(p.resolution), mouths)), mouths=mouths)
    with sharing(p.threads):
        kept, rows = kept_surface(
            hull, carvings, maps, views, shown, factor, resolution=p.resolution, found=found, where=ctx.node
        )  # fmt: skip
    for row in rows:
        ctx.log(told(row))
    if kept.name != "hull" and not kept.mouths:
        vessel = None  # what was carved may be a vessel as well
    return kept, shown, vessel, rows


def _mouths(ctx: Context, views: Views, solid: Solid, p: AutoParams) -> tuple[list[Opening], dict[str, Any]]:
    """(what photographs find open in a solid; a row)."""
    from exmesh_graph.evaluate.metrics.opened import openings
    from exmesh_graph.geometry.coarse_start import openings_row
    from exmesh_graph.gpu.torch_setup import sharing

    with sharing(p.threads):
        found = openings(*solid(_LIDS_AT), views)
    row = openings_row([(one.lid.normal, one.lid.radius, one.wall, one.depth, gain) for one, gain in found])
    ctx.log(told(row))
    return [one for one, _ in found], row


def _standing(ctx: Context, views: Views, depths: DepthMaps, mesh: Mesh, p: AutoParams) -> tuple[Mesh, dict[str, Any]]:
    """(what of an open surface stands amidst the views, what was done with its table)."""
    from exmesh_graph.errors import GeometryError
    from exmesh_graph.gpu.torch_setup import sharing
    from exmesh_graph.masks.decide import nothing_row, table_row
    from exmesh_graph.masks.object import open_object

    try:
        with sharing(p.threads):
            found = open_object(
                views, depths, mesh.vertices, mesh.faces, 2 / (p.resolution or 128), p.table, side=p.side, seed=ctx.seed
            )
    except GeometryError as error:
        if p.table == "remove":
            raise
        row = nothing_row(str(error).splitlines()[0])
    else:
        row, mesh = table_row(found), Mesh(found.vertices, found.faces)
    ctx.log(told(row))
    return mesh, row


def _fitted_depths(
    ctx: Context, views: Views, points: PointCloud | None, iterations: int, factor: int, p: AutoParams
) -> DepthMaps:
    from exmesh_nodes import gaussians

    fit = gaussians.PgsrParams(
        iterations=iterations, count=p.count, max_gaussians=max(40000, 2 * (len(points) if points else p.count)),
        wrong_masks=p.wrong_masks, downscale=factor, device=p.device, threads=p.threads,
    )  # fmt: skip
    fitted = gaussians.pgsr(ctx, views, points, p=fit).gaussians
    drawing = gaussians.DepthParams(device=p.device, threads=p.threads)
    return gaussians.depth_from_gaussians(ctx, fitted, views, p=drawing).depths
