"""Rules about materials: the preview surface, its textures and how they are read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from exmesh_graph.errors import DataError
from exmesh_graph.export.usd.problem import Pictures, Problem

_MAPS = {"diffuseColor": ("sRGB", 3), "roughness": ("raw", 1), "metallic": ("raw", 1), "normal": ("raw", 3)}


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
        found = shader.GetInput(name)
        return found.Get() if found else None

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
