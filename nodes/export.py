"""Writing finished assets for DCC tools."""

from typing import NamedTuple

from exmesh_graph.errors import DataError
from exmesh_graph.graph.node import Context, Params, node, param
from exmesh_graph.types import Asset, Frame, UsdAsset


class UsdParams(Params):
    name: str = param("asset", doc="Prim name of the asset: letters, digits and _.")
    roughness_floor: float = param(
        0.04, ge=0.0, le=1.0, doc="Lowest roughness written; how many texels were raised is reported."
    )
    dilation: int = param(8, ge=0, le=64, unit="texels", doc="Padding of the charts, so that mip levels do not bleed.")


class UsdOut(NamedTuple):
    files: UsdAsset


@node("export.usd", version="1", libraries=("usd-core", "OpenImageIO", "scipy"))
def usd(ctx: Context, asset: Asset, frame: Frame | None = None, *, p: UsdParams) -> UsdOut:
    """Write mesh, maps and light as USD (asset.usdz, asset.usdc, scene.usda, textures); validated."""
    from exmesh_graph.io.usd import validate_usd, write_usd

    folder = ctx.scratch / "usd"
    report = write_usd(folder, asset, frame, name=p.name, roughness_floor=p.roughness_floor, dilation=p.dilation)
    if report["scale"] == "unknown":
        ctx.warn("the data set gives no metric scale: one scene unit is exported as one metre")
    elif report["scale"] == "normalised":
        ctx.warn("no frame is wired in: the asset keeps normalised units (the object in the unit sphere)")
    if report["roughness_texels_raised"]:
        ctx.warn(f"{report['roughness_texels_raised']} texels were raised to the roughness floor {p.roughness_floor:g}")
    errors = []
    for file in ("asset.usdc", "scene.usda", "asset.usdz"):
        for problem in validate_usd(folder / file):
            if problem.level == "error":
                errors.append(f"{file}: {problem}")
            elif file == "asset.usdz":  # it holds what the other two hold: say it once
                ctx.warn(str(problem))
    if errors:
        raise DataError(
            "the exported USD does not pass validation:\n    " + "\n    ".join(errors),
            where=f"node {ctx.node}",
            expected="no error",
            fix="see docs/usd.md for each rule",
        )
    return UsdOut(UsdAsset(root=folder, main="asset.usdz"))
