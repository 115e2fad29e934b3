"""Writing finished assets for DCC tools."""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

from exmesh_graph.errors import DataError
from exmesh_graph.graph.declare.node import Context, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Asset, Frame, GltfAsset, Metrics, ObjAsset, UsdAsset, Views


class UsdParams(Params):
    name: str = param("asset", doc="Name of the asset and its files: letters, digits and _.")
    up_axis: Literal["Y", "Z"] = param(
        "Y", doc="Z turns points, cameras and light; many tools turn Y-up by themselves."
    )
    recentre: bool = param(
        False, doc="Put the object's middle at the origin, for scenes far from theirs; the move is kept in the asset."
    )
    roughness_floor: float = param(
        0.04, ge=0.0, le=1.0, doc="Lowest roughness written; how many texels were raised is reported."
    )
    dilation: int = param(8, ge=0, le=64, unit="texels", doc="Padding of the charts, so that mip levels do not bleed.")
    normal_bits: Literal[8, 16] = param(8, unit="bits", doc="Depth of the normal map.")
    clip: bool = param(
        False, doc="Clip base colour to [0, 1] and light to half floats; else values outside are errors."
    )
    require_scale: bool = param(False, doc="Refuse an asset whose metric scale is not known.")
    require_closed: bool = param(False, doc="Refuse an open or non-manifold mesh.")
    gate: bool = param(True, doc="Refuse to publish a file that fails the checks; false is noted in the asset.")


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
    p: UsdParams,
) -> UsdOut:
    """Write mesh, maps, light and cameras as USD; judged by the gate before anything is published.

    `views` become the cameras of scene.usda, `mid` and `low` the coarser levels of detail; `metrics` and the node's
    key are kept in the asset as its provenance.
    """
    from exmesh_graph.export.maps import MapSettings
    from exmesh_graph.export.provenance import provenance_of
    from exmesh_graph.export.usd import ExportSettings, write_usd

    settings = ExportSettings(
        name=p.name,
        maps=MapSettings(p.roughness_floor, p.dilation, p.normal_bits),
        up_axis=p.up_axis,
        recentre=p.recentre,
        gate=p.gate,
        clip=p.clip,
        require_scale=p.require_scale,
        require_closed=p.require_closed,
    )
    lods = {name: level for name, level in (("mid", mid), ("low", low)) if level is not None}
    origin = provenance_of(ctx.key, metrics.values if metrics else {})
    report = write_usd(ctx.scratch / "usd", asset, frame, views, lods=lods, settings=settings, provenance=origin)
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
    from exmesh_graph.export.geometry import COARSE_ROUNDING

    if report["point_rounding"] > COARSE_ROUNDING:
        ctx.warn(
            f"the scene's origin is so far away that the file's float32 moves points by {report['point_rounding']:.1g} "
            "of the object's radius: set `recentre`"
        )


class MapParams(Params):
    name: str = param("asset", doc="Name of the asset and its files: letters, digits and _.")
    recentre: bool = param(False, doc="Put the object's middle at the origin, for scenes far from theirs.")
    roughness_floor: float = param(0.04, ge=0.0, le=1.0, doc="Lowest roughness written.")
    dilation: int = param(8, ge=0, le=64, unit="texels", doc="Padding of the charts, so that mip levels do not bleed.")


class GltfOut(NamedTuple):
    files: GltfAsset


@node("export.gltf", version="2", libraries=("OpenImageIO", "scipy"))
def gltf(
    ctx: Context, asset: Asset, frame: Frame | None = None, metrics: Metrics | None = None, *, p: MapParams
) -> GltfOut:
    """Write mesh, tangents and maps as one binary glTF file, in metres; glTF holds no environment."""
    from exmesh_graph.export.gltf import write_gltf
    from exmesh_graph.export.maps import MapSettings
    from exmesh_graph.export.provenance import provenance_of

    origin = provenance_of(ctx.key, metrics.values if metrics else {})
    maps = MapSettings(p.roughness_floor, p.dilation)
    report = write_gltf(
        ctx.scratch / "gltf", asset, frame, name=p.name, maps=maps, recentre=p.recentre, provenance=origin
    )
    _warn_of_rounding(ctx, report)
    if report["scale"] != "measured":
        ctx.warn("the metric scale is not known: one unit is exported as one metre")
    ctx.log(f"{report['bytes'] / 1e6:.1f} MB, {report['vertices_split']} vertices")
    return GltfOut(GltfAsset(root=ctx.scratch / "gltf", main=f"{p.name}.glb"))


class ObjOut(NamedTuple):
    files: ObjAsset


@node("export.obj", version="2", libraries=("OpenImageIO", "scipy"))
def obj(ctx: Context, asset: Asset, frame: Frame | None = None, *, p: MapParams) -> ObjOut:
    """Write mesh and maps as Wavefront OBJ with an MTL file; OBJ holds neither light nor units."""
    from exmesh_graph.export.maps import MapSettings
    from exmesh_graph.export.obj import write_textured_obj

    maps = MapSettings(p.roughness_floor, p.dilation)
    report = write_textured_obj(ctx.scratch / "obj", asset, frame, name=p.name, maps=maps, recentre=p.recentre)
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
