"""The material: UsdPreviewSurface, which every reader knows, and the same in MaterialX (OpenPBR Surface).

MaterialX is authored as native shader nodes, since usd-core cannot open a .mtlx file; node names and inputs are those
of MaterialX 1.39 (`ND_normalmap` of 1.38 is `ND_normalmap_float` there).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pxr import Gf, Sdf, Usd, UsdShade

from exmesh_graph.export.content import AssetContent

TEXTURE_FOLDER = "./textures"
MTLX_VERSION = "1.39"
PLAIN_ROUGHNESS = 0.5
"""Roughness of the variant without a roughness map: UsdPreviewSurface's own default."""

_TYPES = Sdf.ValueTypeNames
# map -> (input of UsdPreviewSurface, its type, texture output, colour space)
_PREVIEW = {
    "base_color": ("diffuseColor", _TYPES.Color3f, "rgb", "sRGB"),
    "roughness": ("roughness", _TYPES.Float, "r", "raw"),
    "metallic": ("metallic", _TYPES.Float, "r", "raw"),
    "normal": ("normal", _TYPES.Normal3f, "rgb", "raw"),
}
# map -> (input of OpenPBR, its type, image node, type of what the image gives)
_OPENPBR = {
    "base_color": ("base_color", _TYPES.Color3f, "ND_image_color3", _TYPES.Color3f),
    "roughness": ("specular_roughness", _TYPES.Float, "ND_image_float", _TYPES.Float),
    "metallic": ("base_metalness", _TYPES.Float, "ND_image_float", _TYPES.Float),
    "normal": ("geometry_normal", _TYPES.Float3, "ND_image_vector3", _TYPES.Float3),
}


def shading_variants(content: AssetContent) -> tuple[str, ...]:
    """full; no_normal where there is a normal map; base_only: base colour on a plain dielectric."""
    return ("full", "no_normal", "base_only") if "normal" in content.maps else ("full", "base_only")


def texture_asset(file: str) -> Sdf.AssetPath:
    """The path of a texture file, relative to the layers."""
    return Sdf.AssetPath(f"{TEXTURE_FOLDER}/{file}")


def define_material(stage: Usd.Stage, path: Sdf.Path, files: Mapping[str, str], *, mtlx: bool) -> UsdShade.Material:
    """The shader nodes with all textures, not yet connected to the surfaces."""
    material = UsdShade.Material.Define(stage, path)
    surface = _shader(stage, path.AppendChild("preview"), "UsdPreviewSurface")
    surface.CreateInput("useSpecularWorkflow", _TYPES.Int).Set(0)
    surface.CreateInput("ior", _TYPES.Float).Set(1.5)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    reader = _shader(stage, path.AppendChild("st"), "UsdPrimvarReader_float2")
    reader.CreateInput("varname", _TYPES.String).Set("st")
    st = reader.CreateOutput("result", _TYPES.Float2)
    for name, file in sorted(files.items()):
        _preview_texture(stage, path.AppendChild(name), name, file, st)
    if mtlx:
        _define_openpbr(stage, material, files)
    return material


def connect_maps(
    stage: Usd.Stage, material: UsdShade.Material, maps: Iterable[str], shading: str, *, mtlx: bool
) -> None:
    """Connect the surfaces' inputs to the textures that the variant `shading` reads; constants for the others."""
    kept = {"full": set(maps), "no_normal": set(maps) - {"normal"}, "base_only": {"base_color"}}[shading]
    constants = {"roughness": PLAIN_ROUGHNESS, "metallic": 0.0}
    inputs = [("preview", name, target, kind, name, output) for name, (target, kind, output, _) in _PREVIEW.items()]
    if mtlx:
        nodes = {name: f"mtlx_{name}" for name in _OPENPBR} | {"normal": "mtlx_normal_frame"}
        inputs += [("openpbr", name, of[0], of[1], nodes[name], "out") for name, of in _OPENPBR.items()]
    path = material.GetPath()
    for surface, name, target, kind, source, output in inputs:
        if name not in kept and name not in constants:
            continue
        shader_input = UsdShade.Shader(stage.GetPrimAtPath(path.AppendChild(surface))).CreateInput(target, kind)
        if name in kept:
            node = UsdShade.Shader(stage.GetPrimAtPath(path.AppendChild(source)))
            shader_input.ConnectToSource(node.ConnectableAPI(), output)
        else:
            shader_input.Set(constants[name])


def _preview_texture(stage: Usd.Stage, path: Sdf.Path, name: str, file: str, st: UsdShade.Output) -> None:
    _, _, output, color_space = _PREVIEW[name]
    shader = _shader(stage, path, "UsdUVTexture")
    shader.CreateInput("file", _TYPES.Asset).Set(texture_asset(file))
    shader.CreateInput("sourceColorSpace", _TYPES.Token).Set(color_space)
    for wrap in ("wrapS", "wrapT"):  # charts are padded, nothing reaches over the border
        shader.CreateInput(wrap, _TYPES.Token).Set("clamp")
    shader.CreateInput("st", _TYPES.Float2).ConnectToSource(st)
    if name == "normal":
        shader.CreateInput("scale", _TYPES.Float4).Set(Gf.Vec4f(2, 2, 2, 1))
        shader.CreateInput("bias", _TYPES.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
        shader.CreateInput("fallback", _TYPES.Float4).Set(Gf.Vec4f(0.5, 0.5, 1, 1))
    shader.CreateOutput(output, _TYPES.Float3 if output == "rgb" else _TYPES.Float)


def _define_openpbr(stage: Usd.Stage, material: UsdShade.Material, files: Mapping[str, str]) -> None:
    path, prim = material.GetPath(), material.GetPrim()
    prim.AddAppliedSchema("MaterialXConfigAPI")  # ApplyAPI does not know it: the wheel has no UsdMtlx
    prim.CreateAttribute("config:mtlx:version", _TYPES.String, False).Set(MTLX_VERSION)
    surface = _shader(stage, path.AppendChild("openpbr"), "ND_open_pbr_surface_surfaceshader")
    surface.CreateInput("specular_ior", _TYPES.Float).Set(1.5)
    material.CreateSurfaceOutput("mtlx").ConnectToSource(surface.ConnectableAPI(), "out")
    for name, file in sorted(files.items()):
        _, _, node, kind = _OPENPBR[name]
        image = _shader(stage, path.AppendChild(f"mtlx_{name}"), node)
        source = image.CreateInput("file", _TYPES.Asset)
        source.Set(texture_asset(file))
        if name == "base_color":
            source.GetAttr().SetColorSpace("srgb_texture")
        for mode in ("uaddressmode", "vaddressmode"):
            image.CreateInput(mode, _TYPES.String).Set("clamp")
        out = image.CreateOutput("out", kind)
        if name == "normal":
            frame = _shader(stage, path.AppendChild("mtlx_normal_frame"), "ND_normalmap_float")
            frame.CreateInput("in", _TYPES.Float3).ConnectToSource(out)
            frame.CreateOutput("out", _TYPES.Float3)


def _shader(stage: Usd.Stage, path: Sdf.Path, identifier: str) -> UsdShade.Shader:
    shader = UsdShade.Shader.Define(stage, path)
    shader.CreateIdAttr(identifier)
    if identifier == "UsdPreviewSurface":
        shader.CreateOutput("surface", _TYPES.Token)
    elif identifier == "ND_open_pbr_surface_surfaceshader":
        shader.CreateOutput("out", _TYPES.Token)
    return shader
