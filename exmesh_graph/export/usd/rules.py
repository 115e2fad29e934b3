"""What the gate says, and its rules about a stage as a whole, its asset paths, its materials and its dome lights."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.export.usd.read import asset_bytes, feeding, read_asset_pixels

_MAPS = {"diffuseColor": ("sRGB", 3), "roughness": ("raw", 1), "metallic": ("raw", 1), "normal": ("raw", 3)}


@dataclass(frozen=True)
class Problem:
    """One finding. `level` is "error", "warning" or "note"; `rule` names the check; `where` the prim, layer or file."""

    rule: str
    where: str
    what: str
    level: str = "error"

    def __str__(self) -> str:
        return f"{self.level} {self.rule} at {self.where}: {self.what}"


@dataclass(frozen=True)
class PictureFacts:
    width: int
    height: int
    channels: int
    finite: bool
    lowest: float


@dataclass
class Pictures:
    """Facts of pictures, decoded once each by content: one asset holds the same ones under several names."""

    known: dict[tuple[int, int], PictureFacts] = field(default_factory=dict)  # by (CRC-32, bytes)

    def facts(self, asset: Any, what: str) -> PictureFacts | str:
        """Facts of an Sdf.AssetPath, or why there are none: `what` is not found, or cannot be decoded."""
        path = asset.resolvedPath if asset else ""
        if not path:
            return f"{what} {asset} is not found"
        try:
            data = asset_bytes(path)
            key = zlib.crc32(data), len(data)
            if key not in self.known:
                pixels = read_asset_pixels(path)
                height, width, channels = pixels.shape
                finite = bool(np.isfinite(pixels).all())
                self.known[key] = PictureFacts(width, height, channels, finite, float(pixels.min()))
        except DataError as error:
            return error.what
        return self.known[key]


def stage_rules(stage: Any) -> Iterator[Problem]:
    """defaultPrim, stageMetadata, composition, outside, lightInAsset."""
    from pxr import Kind, Usd, UsdGeom, UsdLux

    file = Path(stage.GetRootLayer().identifier).name
    default = stage.GetDefaultPrim()
    if not default:
        yield Problem("defaultPrim", file, "no default prim: a reference to this file brings nothing")
    for key in (UsdGeom.Tokens.upAxis, UsdGeom.Tokens.metersPerUnit):
        if not stage.HasAuthoredMetadata(key):
            yield Problem("stageMetadata", file, f"{key} is not authored")
    for error in stage.GetCompositionErrors():
        yield Problem("composition", file, str(error).strip().splitlines()[0])
    for prim in stage.Traverse():
        path = str(prim.GetPath())
        if default and prim.IsA(UsdGeom.Mesh) and not prim.GetPath().HasPrefix(default.GetPath()):
            yield Problem("outside", path, "the mesh is not below the default prim: a reference loses it")
        if prim.HasAPI(UsdLux.LightAPI) or prim.IsA(UsdGeom.Camera):
            above = prim.GetParent()
            while above and Usd.ModelAPI(above).GetKind() != Kind.Tokens.component:
                above = above.GetParent()
            if above:
                what = f"a {prim.GetTypeName()} inside a component lights or films every scene that references it"
                yield Problem("lightInAsset", path, what)


def path_rules(stage: Any) -> Iterator[Problem]:
    """relativePath: every asset path, in every layer and every variant, starts with `./`."""
    from pxr import UsdUtils

    for layer in stage.GetUsedLayers():
        if layer.anonymous:
            continue
        paths: set[str] = set()
        copy = layer.CreateAnonymous(".usda")
        copy.TransferContent(layer)
        UsdUtils.ModifyAssetPaths(copy, lambda path, paths=paths: paths.add(path) or path)
        for path in sorted(paths):
            if not path.startswith("./"):
                what = f"asset path {path!r} does not start with './': it breaks when the folder moves"
                yield Problem("relativePath", Path(layer.identifier).name, what)


def material_rules(prim: Any, pictures: Pictures) -> Iterator[Problem]:
    """All rules on one Material prim."""
    from pxr import UsdShade

    surface, _, _ = UsdShade.Material(prim).ComputeSurfaceSource()
    if not surface or surface.GetIdAttr().Get() != "UsdPreviewSurface":
        yield Problem("surface", str(prim.GetPath()), "no UsdPreviewSurface is connected")
        return
    for name, (color_space, channels) in _MAPS.items():
        for shader in feeding(surface.GetInput(name)):
            yield from _texture(shader, name, color_space, channels, pictures)


def _texture(shader: Any, input_name: str, color_space: str, channels: int, pictures: Pictures) -> Iterator[Problem]:
    where = str(shader.GetPath())

    def value(name: str) -> Any:
        given = shader.GetInput(name)
        return given.Get() if given else None

    if value("sourceColorSpace") != color_space:
        what = f"sourceColorSpace of {input_name} is {value('sourceColorSpace')!r}, expected {color_space!r}"
        yield Problem("colorSpace", where, what)
    for wrap in ("wrapS", "wrapT"):
        if value(wrap) not in ("clamp", "repeat"):
            yield Problem("wrap", where, f"{wrap} must be authored: readers' fallbacks differ")
    if input_name == "normal" and (value("scale") != (2, 2, 2, 1) or value("bias") != (-1, -1, -1, 0)):
        yield Problem("normalScaleBias", where, "scale and bias must be (2, 2, 2, 1) and (-1, -1, -1, 0)")
    yield from _primvar_reader(shader, where)
    facts = pictures.facts(value("file"), "the texture file")
    if isinstance(facts, str):
        yield Problem("image", where, facts)
    elif facts.channels < channels:
        what = f"the texture has {facts.channels} channel{'s' * (facts.channels > 1)}, {input_name} needs {channels}"
        yield Problem("channels", where, what)


def _primvar_reader(shader: Any, where: str) -> Iterator[Problem]:
    varname = next((reader.GetInput("varname") for reader in feeding(shader.GetInput("st"))), None)
    if varname is None or varname.Get() != "st" or str(varname.GetTypeName()) != "string":
        yield Problem("varname", where, "needs a UsdPrimvarReader_float2 with string varname = 'st'")


def dome_rules(prim: Any, pictures: Pictures) -> Iterator[Problem]:
    """All rules on one DomeLight or DomeLight_1 prim."""
    from pxr import Gf, Usd, UsdGeom, UsdLux

    where = str(prim.GetPath())
    if prim.GetTypeName() != "DomeLight":
        yield Problem("domeType", where, "DomeLight_1 is turned wrongly by Blender; use DomeLight")
        return
    dome = UsdLux.DomeLight(prim)
    if dome.GetTextureFormatAttr().Get() != UsdLux.Tokens.latlong:
        yield Problem("domeFormat", where, "texture:format must be latlong")
    if dome.GetExposureAttr().Get():
        yield Problem("domeExposure", where, "Blender ignores exposure; fold it into the pixels")
    turn = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    up = Gf.Vec3d(0, 0, 1) if UsdGeom.GetStageUpAxis(prim.GetStage()) == UsdGeom.Tokens.z else Gf.Vec3d(0, 1, 0)
    if turn.TransformDir(Gf.Vec3d(0, 1, 0)).GetNormalized() * up < 0.5:
        what = "the map's pole is more than 60 degrees off the stage's up axis (a Z-up stage needs RotateX 90)"
        yield Problem("domeUpAxis", where, what)
    if turn.GetDeterminant3() <= 0:
        yield Problem("domeMirrored", where, "the light is mirrored: most renderers cannot do that")
    facts = pictures.facts(dome.GetTextureFileAttr().Get(), "the environment")
    if isinstance(facts, str):
        yield Problem("domeImage", where, facts)
    elif facts.width != 2 * facts.height or not facts.finite or facts.lowest < 0:
        yield Problem("domeImage", where, "the environment must be 2:1, finite and not negative")
