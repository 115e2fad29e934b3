"""Exported assets in a DCC tool's hands: packages from elsewhere, scenes of several."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from exmesh_graph.export.settings import ComposeSettings
from exmesh_graph.graph.declare.node import Context, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import EnvMap, UsdAsset


class UsdFileParams(Params):
    path: Path = param(doc="A USD package (.usdz), which holds all that it needs.")


class UsdFileOut(NamedTuple):
    files: UsdAsset


def _package_source(p: UsdFileParams) -> Mapping[str, Path]:
    from exmesh_graph.errors import DataError

    if p.path.suffix != ".usdz" or not p.path.is_file():
        raise DataError("not a USD package", where=str(p.path), expected="a .usdz file", fix="correct `path`")
    return {p.path.name: p.path}


@node("data.usd", version="2", libraries=("usd-core", "OpenImageIO"), sources=_package_source)
def usd_file(ctx: Context, *, p: UsdFileParams) -> UsdFileOut:
    """A USD package from elsewhere, to be composed with others; what the gate finds in it is a warning."""
    import shutil

    from exmesh_graph.export.usd import up_axis, validate_usd

    for problem in validate_usd(p.path):
        ctx.warn(str(problem))
    (ctx.scratch / "usd").mkdir()
    shutil.copyfile(p.path, ctx.scratch / "usd" / p.path.name)
    return UsdFileOut(UsdAsset(root=ctx.scratch / "usd", main=p.path.name, up=up_axis(p.path)))


class ComposeOut(NamedTuple):
    files: UsdAsset


@node("usd.compose", version="2", libraries=("usd-core", "OpenImageIO"))
def compose(
    ctx: Context,
    light: EnvMap,
    first: UsdAsset,
    second: UsdAsset | None = None,
    third: UsdAsset | None = None,
    *,
    p: ComposeSettings,
) -> ComposeOut:
    """Assets side by side on a table top under one light, as a USD scene that references them; with a camera."""
    from exmesh_graph.export.usd.compose import compose_on_table

    given = {"first": first, "second": second, "third": third}
    pieces = {name: files.root / files.main for name, files in given.items() if files is not None}
    compose_on_table(ctx.scratch / "scene", pieces, light.radiance, p)
    return ComposeOut(UsdAsset(root=ctx.scratch / "scene", main="scene.usda"))
