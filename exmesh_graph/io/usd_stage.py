"""Authoring the prims of an exported asset: mesh, material, dome light, stage metadata."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

from exmesh_graph.errors import DataError

ASSET_FILE = "./asset.usdc"  # also the root layer's name inside the package
TEXTURE_FOLDER = "./textures"
ENVIRONMENT_FILE = "./env.exr"


@dataclass(frozen=True)
class StageContent:
    """Everything a stage needs, already in scene units and checked.

    points, normals  float32 [V, 3];  faces int32 [F, 3];  st float32 [T, 2], v up;  st_faces int32 [F, 3]
    maps             names of the texture files that exist: base_color, roughness, normal, metallic
    rotation         float64 [3, 3], of the scene's world against the environment's
    """

    name: str
    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    st: np.ndarray
    st_faces: np.ndarray
    maps: tuple[str, ...]
    metres_per_unit: float
    rotation: np.ndarray
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def extent(self) -> np.ndarray:
        """float32 [2, 3], the corners of the bounding box."""
        return np.stack([self.points.min(0), self.points.max(0)])


def save_layer(path: Path, author: Callable[[Sdf.Layer, StageContent], None], content: StageContent) -> None:
    """Write a new layer file; DataError when USD cannot.

    By Save, never by UsdStage.Export: that one turns relative asset paths into absolute ones.
    """
    layer = Sdf.Layer.CreateNew(str(path))
    author(layer, content)
    if not layer.Save():
        raise DataError("USD could not write the layer", where=str(path), fix="check space and permissions")


def author_asset_layer(layer: Sdf.Layer, content: StageContent) -> None:
    """The light-free component `/<name>` with Scopes geo and mtl: what other scenes reference."""
    stage = _open(layer, content)
    root = _define_asset(stage, Sdf.Path(f"/{content.name}"), content)
    stage.SetDefaultPrim(root.GetPrim())


def author_scene_layer(layer: Sdf.Layer, content: StageContent) -> None:
    """An assembly `/scene` that references the component's file and adds the recovered light."""
    stage = _open(layer, content)
    scene = _define_scene(stage, content)
    model = UsdGeom.Xform.Define(stage, scene.GetPath().AppendChild(content.name))
    model.GetPrim().GetReferences().AddReference(ASSET_FILE)


def author_flat_layer(layer: Sdf.Layer, content: StageContent) -> None:
    """The composed scene of `author_scene_layer` in one layer without composition arcs, for the package."""
    stage = _open(layer, content)
    scene = _define_scene(stage, content)
    _define_asset(stage, scene.GetPath().AppendChild(content.name), content)


def _open(layer: Sdf.Layer, content: StageContent) -> Usd.Stage:
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, content.metres_per_unit)
    return stage


def _define_scene(stage: Usd.Stage, content: StageContent) -> UsdGeom.Xform:
    scene = UsdGeom.Xform.Define(stage, "/scene")
    Usd.ModelAPI(scene.GetPrim()).SetKind(Kind.Tokens.assembly)
    stage.SetDefaultPrim(scene.GetPrim())
    dome = UsdLux.DomeLight.Define(stage, scene.GetPath().AppendChild("environment"))
    dome.CreateTextureFileAttr(Sdf.AssetPath(ENVIRONMENT_FILE))
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    dome.CreateIntensityAttr(1.0)  # absolute radiance lives in the pixels; exposure stays unauthored
    if not np.allclose(content.rotation, np.eye(3), atol=1e-9):
        # L(d) = E(R^T d). Gf matrices act on row vectors, hence the transpose.
        turn = np.eye(4)
        turn[:3, :3] = content.rotation.T
        dome.AddTransformOp().Set(Gf.Matrix4d(*turn.ravel().tolist()))
    return scene


def _define_asset(stage: Usd.Stage, path: Sdf.Path, content: StageContent) -> UsdGeom.Xform:
    root = UsdGeom.Xform.Define(stage, path)
    prim = root.GetPrim()
    model = Usd.ModelAPI(prim)
    model.SetKind(Kind.Tokens.component)
    model.SetAssetName(content.name)
    model.SetAssetIdentifier(Sdf.AssetPath(ASSET_FILE))
    model.SetAssetVersion("1")
    UsdGeom.ModelAPI.Apply(prim).SetExtentsHint(Vt.Vec3fArray.FromNumpy(content.extent))
    prim.SetCustomDataByKey("recon", content.provenance)
    UsdGeom.Scope.Define(stage, path.AppendChild("geo"))
    UsdGeom.Scope.Define(stage, path.AppendChild("mtl"))
    material = _define_material(stage, path.AppendPath("mtl/surface"), content.maps)
    _define_mesh(stage, path.AppendPath("geo/mesh"), content, material)
    return root


def _define_mesh(stage: Usd.Stage, path: Sdf.Path, content: StageContent, material: UsdShade.Material) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(content.points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(content.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(content.faces.reshape(-1))))
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(content.extent))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)  # the fallback is catmullClark
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    mesh.CreateDoubleSidedAttr(False)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(content.normals))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
    st.Set(Vt.Vec2fArray.FromNumpy(content.st))
    st.SetIndices(Vt.IntArray.FromNumpy(np.ascontiguousarray(content.st_faces.reshape(-1))))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    return mesh


def _define_material(stage: Usd.Stage, path: Sdf.Path, maps: tuple[str, ...]) -> UsdShade.Material:
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, path.AppendChild("preview"))
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("useSpecularWorkflow", Sdf.ValueTypeNames.Int).Set(0)
    surface.CreateInput("ior", Sdf.ValueTypeNames.Float).Set(1.5)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    reader = UsdShade.Shader.Define(stage, path.AppendChild("st"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    st = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)

    def texture(name: str, color_space: str, output: str, type_name: Sdf.ValueTypeName) -> UsdShade.Output:
        shader = UsdShade.Shader.Define(stage, path.AppendChild(name))
        shader.CreateIdAttr("UsdUVTexture")
        file = Sdf.AssetPath(f"{TEXTURE_FOLDER}/{name}.png")
        shader.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(file)
        shader.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set(color_space)
        for wrap in ("wrapS", "wrapT"):  # charts are padded, nothing reaches over the border
            shader.CreateInput(wrap, Sdf.ValueTypeNames.Token).Set("clamp")
        shader.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(st)
        if name == "normal":
            shader.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(2, 2, 2, 1))
            shader.CreateInput("bias", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
            shader.CreateInput("fallback", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(0.5, 0.5, 1, 1))
        return shader.CreateOutput(output, type_name)

    types = Sdf.ValueTypeNames
    color = texture("base_color", "sRGB", "rgb", types.Float3)
    surface.CreateInput("diffuseColor", types.Color3f).ConnectToSource(color)
    roughness = texture("roughness", "raw", "r", types.Float)
    surface.CreateInput("roughness", types.Float).ConnectToSource(roughness)
    metallic = surface.CreateInput("metallic", types.Float)
    if "metallic" in maps:
        metallic.ConnectToSource(texture("metallic", "raw", "r", types.Float))
    else:
        metallic.Set(0.0)
    if "normal" in maps:
        normal = texture("normal", "raw", "rgb", types.Float3)
        surface.CreateInput("normal", types.Normal3f).ConnectToSource(normal)
    return material
