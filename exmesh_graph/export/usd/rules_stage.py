"""Rules about a stage as a whole: metadata, composition, structure, asset paths, packages."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from exmesh_graph.export.usd.package import ALIGNMENT, data_offset
from exmesh_graph.export.usd.problem import Problem


def stage_rules(stage: Any) -> Iterator[Problem]:
    """defaultPrim, stageMetadata, composition, outside, lightInAsset."""
    from pxr import Kind, Usd, UsdGeom, UsdLux

    file = Path(stage.GetRootLayer().identifier).name
    default = stage.GetDefaultPrim()
    if not default:
        yield Problem("error", "defaultPrim", file, "no default prim: a reference to this file brings nothing")
    for key in (UsdGeom.Tokens.upAxis, UsdGeom.Tokens.metersPerUnit):
        if not stage.HasAuthoredMetadata(key):
            yield Problem("error", "stageMetadata", file, f"{key} is not authored")
    for error in stage.GetCompositionErrors():
        yield Problem("error", "composition", file, str(error).strip().splitlines()[0])
    for prim in stage.Traverse():
        path = str(prim.GetPath())
        if default and prim.IsA(UsdGeom.Mesh) and not prim.GetPath().HasPrefix(default.GetPath()):
            yield Problem("error", "outside", path, "the mesh is not below the default prim: a reference loses it")
        if prim.HasAPI(UsdLux.LightAPI) or prim.IsA(UsdGeom.Camera):
            above = prim.GetParent()
            while above and Usd.ModelAPI(above).GetKind() != Kind.Tokens.component:
                above = above.GetParent()
            if above:
                what = f"a {prim.GetTypeName()} inside a component lights or films every scene that references it"
                yield Problem("error", "lightInAsset", path, what)


def path_rules(stage: Any) -> Iterator[Problem]:
    """relativePath: every asset path, in every layer and every variant, starts with `./`."""
    from pxr import UsdUtils

    for layer in stage.GetUsedLayers():
        if layer.anonymous:
            continue
        found: list[str] = []

        def note(path: str, found: list[str] = found) -> str:
            found.append(path)
            return path

        copy = layer.CreateAnonymous(".usda")
        copy.TransferContent(layer)
        UsdUtils.ModifyAssetPaths(copy, note)
        for path in sorted(set(found)):
            if not path.startswith("./"):
                what = f"asset path {path!r} does not start with './': it breaks when the folder moves"
                yield Problem("error", "relativePath", Path(layer.identifier).name, what)


def package_rules(path: Path) -> Iterator[Problem]:
    """package: a .usdz is a stored zip whose first member is a USD layer, all data at multiples of 64 bytes."""
    if path.suffix.lower() != ".usdz" or not path.is_file():
        return
    try:
        archive = zipfile.ZipFile(path)
    except zipfile.BadZipFile as error:
        yield Problem("error", "package", path.name, f"not a whole zip archive ({error})")
        return
    with archive, path.open("rb") as file:
        members = archive.infolist()
        if not members or Path(members[0].filename).suffix not in (".usda", ".usdc", ".usd"):
            yield Problem("error", "package", path.name, "the first member is not a USD layer")
        for member in members:
            if member.header_offset < 0:
                yield Problem("error", "package", path.name, "the archive's beginning is missing")
            elif member.compress_type != zipfile.ZIP_STORED:
                yield Problem("error", "package", f"{path.name}[{member.filename}]", "the member is compressed")
            elif data_offset(file, member) % ALIGNMENT:
                what = f"the member's data does not start at a multiple of {ALIGNMENT} bytes"
                yield Problem("error", "package", f"{path.name}[{member.filename}]", what)
