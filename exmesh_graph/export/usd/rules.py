"""Rules about a stage as a whole (metadata, composition, structure, asset paths), its materials and its dome lights."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from exmesh_graph.errors import DataError
from exmesh_graph.export.usd.problem import Pictures, Problem

_MAPS = {"diffuseColor": ("sRGB", 3), "roughness": ("raw", 1), "metallic": ("raw", 1), "normal": ("raw", 3)}


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
        paths: list[str] = []

        def note(path: str, paths: list[str] = paths) -> str:
            paths.append(path)
            return path

        copy = layer.CreateAnonymous(".usda")
        copy.TransferContent(layer)
        UsdUtils.ModifyAssetPaths(copy, note)
        for path in sorted(set(paths)):
            if not path.startswith("./"):
                what = f"asset path {path!r} does not start with './': it breaks when the folder moves"
                yield Problem("error", "relativePath", Path(layer.identifier).name, what)


def material_rules(prim: Any, pictures: Pictures) -> Iterator[Problem]:
    """All rules on one Material prim."""
    from pxr import UsdShade

    surface, _, _ = UsdShade.Material(prim).ComputeSurfaceSource()
    if not surface or surface.GetIdAttr().Get() != "UsdPreviewSurface":
        yield Problem("error", "surface", str(prim.GetPath()), "no UsdPreviewSurface is connected")
        return
    for name, (color_space, channels) in _MAPS.items():
        shader_input = surface.GetInput(name)
        sources = shader_input.GetConnectedSources()[0] if shader_input else []
        for source in sources:
            yield from _texture(UsdShade.Shader(source.source.GetPrim()), name, color_space, channels, pictures)


def _texture(shader: Any, input_name: str, color_space: str, channels: int, pictures: Pictures) -> Iterator[Problem]:
    where = str(shader.GetPath())

    def value(name: str) -> Any:
        given = shader.GetInput(name)
        return given.Get() if given else None

    if value("sourceColorSpace") != color_space:
        what = f"sourceColorSpace of {input_name} is {value('sourceColorSpace')!r}, expected {color_space!r}"
        yield Problem("error", "colorSpace", where, what)
    for wrap in ("wrapS", "wrapT"):
        if value(wrap) not in ("clamp", "repeat"):
            yield Problem("error", "wrap", where, f"{wrap} must be authored: readers' fallbacks differ")
    if input_name == "normal":
        right = value("scale") == (2, 2, 2, 1) and value("bias") == (-1, -1, -1, 0)
        if not right:
            what = "scale and bias must be (2, 2, 2, 1) and (-1, -1, -1, 0)"
            yield Problem("error", "normalScaleBias", where, what)
    yield from _primvar_reader(shader, where)
    try:
        facts = pictures.facts(value("file"))
    except DataError as error:
        yield Problem("error", "image", where, error.what)
        return
    if facts is None:
        yield Problem("error", "image", where, f"the texture file {value('file')} is not found")
    elif facts.channels < channels:
        what = f"the texture has {facts.channels} channel{'s' * (facts.channels > 1)}, {input_name} needs {channels}"
        yield Problem("error", "channels", where, what)


def _primvar_reader(shader: Any, where: str) -> Iterator[Problem]:
    from pxr import UsdShade

    st = shader.GetInput("st")
    sources = st.GetConnectedSources()[0] if st else []
    reader = UsdShade.Shader(sources[0].source.GetPrim()) if sources else None
    varname = reader.GetInput("varname") if reader else None
    if varname is None or varname.Get() != "st" or str(varname.GetTypeName()) != "string":
        yield Problem("error", "varname", where, "needs a UsdPrimvarReader_float2 with string varname = 'st'")


def dome_rules(prim: Any, stage: Any, pictures: Pictures) -> Iterator[Problem]:
    """All rules on one DomeLight or DomeLight_1 prim."""
    from pxr import Gf, Usd, UsdGeom, UsdLux

    where = str(prim.GetPath())
    if prim.GetTypeName() != "DomeLight":
        yield Problem("error", "domeType", where, "DomeLight_1 is turned wrongly by Blender; use DomeLight")
        return
    dome = UsdLux.DomeLight(prim)
    if dome.GetTextureFormatAttr().Get() != UsdLux.Tokens.latlong:
        yield Problem("error", "domeFormat", where, "texture:format must be latlong")
    if dome.GetExposureAttr().Get():
        yield Problem("error", "domeExposure", where, "Blender ignores exposure; fold it into the pixels")
    turn = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    up = Gf.Vec3d(0, 0, 1) if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else Gf.Vec3d(0, 1, 0)
    if turn.TransformDir(Gf.Vec3d(0, 1, 0)).GetNormalized() * up < 0.5:
        what = "the map's pole is more than 60 degrees off the stage's up axis (a Z-up stage needs RotateX 90)"
        yield Problem("error", "domeUpAxis", where, what)
    if turn.GetDeterminant3() <= 0:
        yield Problem("error", "domeMirrored", where, "the light is mirrored: most renderers cannot do that")
    file = dome.GetTextureFileAttr().Get()
    try:
        facts = pictures.facts(file)
    except DataError as error:
        yield Problem("error", "domeImage", where, error.what)
        return
    if facts is None:
        yield Problem("error", "domeImage", where, f"the environment {file} is not found")
    elif facts.width != 2 * facts.height or not facts.finite or facts.lowest < 0:
        yield Problem("error", "domeImage", where, "the environment must be 2:1, finite and not negative")
