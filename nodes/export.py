"""Writing finished assets for DCC tools."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from exmesh_graph.errors import DataError
from exmesh_graph.export.settings import ExportSettings, FileSettings
from exmesh_graph.graph.declare.node import Context, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Asset, Frame, GltfAsset, Metrics, ObjAsset, UsdAsset, Views


class UsdOut(NamedTuple):
    files: UsdAsset


@node("export.usd", version="3", libraries=("usd-core", "OpenImageIO", "scipy"))
def usd(
    ctx: Context,
    asset: Asset,
    frame: Frame | None = None,
    views: Views | None = None,
    mid: Asset | None = None,
    low: Asset | None = None,
    metrics: Metrics | None = None,
    *,
    p: ExportSettings,
) -> UsdOut:
    """Write mesh, maps, light and cameras as USD; judged by the gate before anything is published.

    `views` become the cameras of scene.usda, `mid` and `low` the coarser levels of detail; `metrics` and the node's
    key are kept in the asset as its provenance.
    """
    from exmesh_graph.export.folder import provenance_of
    from exmesh_graph.export.usd import write_usd

    lods = {name: level for name, level in (("mid", mid), ("low", low)) if level is not None}
    origin = provenance_of(ctx.key, metrics.values if metrics else {})
    report = write_usd(ctx.scratch / "usd", asset, frame, views, lods=lods, settings=p, provenance=origin)
    if report["scale"] == "unknown":
        ctx.warn("the data set gives no metric scale: one scene unit is exported as one metre")
    elif report["scale"] == "normalised":
        ctx.warn("no frame is wired in: the asset keeps normalised units (the object in the unit sphere)")
    _warn_of_rounding(ctx, report)
    if report["roughness_texels_raised"]:
        ctx.warn(f"{report['roughness_texels_raised']} texels were raised to the roughness floor {p.roughness_floor:g}")
    for problem in report.get("problems", ()):
        ctx.warn(problem)
    ctx.log(f"{report['bytes'][f'{p.name}.usdz'] / 1e6:.1f} MB in {p.name}.usdz")
    return UsdOut(UsdAsset(root=ctx.scratch / "usd", main=f"{p.name}.usdz", up="z" if p.up_axis == "Z" else "y"))


def _warn_of_rounding(ctx: Context, report: Mapping[str, Any]) -> None:
    from exmesh_graph.export.content import COARSE_ROUNDING

    if report["point_rounding"] > COARSE_ROUNDING:
        ctx.warn(
            f"the scene's origin is so far away that the file's float32 moves points by {report['point_rounding']:.1g} "
            "of the object's radius: set `recentre`"
        )


class GltfOut(NamedTuple):
    files: GltfAsset


@node("export.gltf", version="2", libraries=("OpenImageIO", "scipy"))
def gltf(
    ctx: Context, asset: Asset, frame: Frame | None = None, metrics: Metrics | None = None, *, p: FileSettings
) -> GltfOut:
    """Write mesh, tangents and maps as one binary glTF file, in metres; glTF holds no environment."""
    from exmesh_graph.export.folder import provenance_of
    from exmesh_graph.export.gltf import write_gltf

    origin = provenance_of(ctx.key, metrics.values if metrics else {})
    report = write_gltf(ctx.scratch / "gltf", asset, frame, p, provenance=origin)
    _warn_of_rounding(ctx, report)
    if report["scale"] != "measured":
        ctx.warn("the metric scale is not known: one unit is exported as one metre")
    ctx.log(f"{report['bytes'] / 1e6:.1f} MB, {report['vertices_split']} vertices")
    return GltfOut(GltfAsset(root=ctx.scratch / "gltf", main=f"{p.name}.glb"))


class ObjOut(NamedTuple):
    files: ObjAsset


@node("export.obj", version="2", libraries=("OpenImageIO", "scipy"))
def obj(ctx: Context, asset: Asset, frame: Frame | None = None, *, p: FileSettings) -> ObjOut:
    """Write mesh and maps as Wavefront OBJ with an MTL file; OBJ holds neither light nor units."""
    from exmesh_graph.export.obj import write_textured_obj

    report = write_textured_obj(ctx.scratch / "obj", asset, frame, p)
    _warn_of_rounding(ctx, report)
    return ObjOut(ObjAsset(root=ctx.scratch / "obj", main=f"{p.name}.obj"))


class LodParams(Params):
    share: float = param(0.25, gt=0, le=1, doc="Faces of the result, as a share of the asset's.")
    texture_size: int = param(
        0, ge=0, le=8192, unit="texels", doc="Side of the maps, a divisor of theirs; 0: as they are."
    )
    fit_pixels: bool = param(
        False,
        doc="Side of the maps at which a texel is no larger than a pixel in the wired views, for 95 % of the surface.",
    )


class LodOut(NamedTuple):
    asset: Asset


@node("export.lod", version="1", libraries=("scipy",))
def lod(ctx: Context, asset: Asset, views: Views | None = None, *, p: LodParams) -> LodOut:
    """A coarser level of detail: fewer faces on the same atlas, normals baked from the fine mesh, smaller maps.

    Wire it into `mid` or `low` of export.usd; evaluate.asset tells what it costs in dB.
    """
    from exmesh_graph.export.lod import footprint_size, reduced

    size = p.texture_size
    if p.fit_pixels:
        if views is None or size:
            raise DataError(
                "fit_pixels needs views, and texture_size left at 0", where=f"node {ctx.node}",
                fix="wire views in, or give texture_size",
            )  # fmt: skip
        size = footprint_size(asset, views)
    wanted = max(round(p.share * len(asset.faces)), 4)
    result = reduced(asset, wanted, min(size, asset.base_color.shape[0]))
    ctx.log(f"{len(asset.faces)} -> {len(result.faces)} faces, maps {result.base_color.shape[0]}")
    if len(result.faces) > 1.1 * wanted:
        ctx.warn(f"{len(result.faces)} faces are left of {wanted} wanted: seams of the atlas hold the others")
    return LodOut(result)
