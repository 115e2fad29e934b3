"""The layers of an exported asset: root, payload, geometry, materials, scene; and the asset in one flat layer.

    asset.usda    root: /asset (component, payload, the variant sets lod and shading), inherits /__class__/asset
    payload.usda  /asset: references mtl.usda, and geo.usdc by the variant of lod; binds the material
    geo.usdc      /high, /mid, /low: Scope geo with the mesh
    mtl.usda      /asset: Scope mtl with the material, connected by the variant of shading
    scene.usda    /scene: references asset.usda, adds the light that was recovered with it and the photographs' cameras

Variant sets are declared in the root layer, so that they show while the payload is not loaded. Local opinions beat
variants: whatever a variant changes is authored in no place but inside the variants.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

from exmesh_graph.errors import DataError
from exmesh_graph.export.content import AssetContent, CameraContent, MeshContent
from exmesh_graph.export.usd.material import connect_maps, define_material, shading_variants, texture_asset

PAYLOAD_FILE, GEOMETRY_FILE, MATERIAL_FILE = "./payload.usda", "./geo.usdc", "./mtl.usda"
ENVIRONMENT_FILE = "./env.exr"
APERTURE = 36.0
"""Width of the cameras' picture plane, tenths of a scene unit as UsdGeomCamera counts: only ratios matter."""
Author = Callable[[Sdf.Layer, AssetContent], None]


def save_layer(path: Path, author: Author, content: AssetContent) -> None:
    """Write a new layer file; DataError when USD cannot.

    By Save, never by UsdStage.Export: that one turns relative asset paths into absolute ones.
    """
    layer = Sdf.Layer.CreateNew(str(path))
    author(layer, content)
    if not layer.Save():
        raise DataError("USD could not write the layer", where=str(path), fix="check space and permissions")


def author_root(layer: Sdf.Layer, content: AssetContent) -> None:
    """The component that other scenes reference: metadata, payload and variant sets, no arrays, no light."""
    stage = open_stage(layer, content)
    prim = _define_component(stage, Sdf.Path(f"/{content.name}"), content)
    everyone = Sdf.Path(f"/__class__/{content.name}")  # an override there reaches every instance downstream
    stage.CreateClassPrim(everyone.GetParentPath())
    stage.CreateClassPrim(everyone)
    prim.GetInherits().AddInherit(everyone)
    prim.GetPayloads().AddPayload(PAYLOAD_FILE, prim.GetPath())
    for name, choices in (("lod", tuple(content.meshes)), ("shading", shading_variants(content))):
        for _ in _each_variant(prim, name, choices):
            pass  # declared here, filled by the payload
    stage.SetDefaultPrim(prim)


def author_payload(layer: Sdf.Layer, content: AssetContent) -> None:
    """What the payload brings: the material, and the mesh of the chosen level of detail, bound to it."""
    stage = open_stage(layer, content)
    prim = UsdGeom.Xform.Define(stage, f"/{content.name}").GetPrim()
    prim.GetReferences().AddReference(MATERIAL_FILE, prim.GetPath())
    for lod in _each_variant(prim, "lod", tuple(content.files)):
        prim.GetReferences().AddReference(GEOMETRY_FILE, f"/{lod}")
        for name, file in content.files[lod].items():
            if len({levels[name] for levels in content.files.values()}) > 1:
                for node in (name, f"mtlx_{name}"):
                    shader = stage.OverridePrim(prim.GetPath().AppendPath(f"mtl/surface/{node}"))
                    shader.CreateAttribute("inputs:file", Sdf.ValueTypeNames.Asset).Set(texture_asset(file))
    mesh = stage.OverridePrim(prim.GetPath().AppendPath("geo/mesh"))
    binding = UsdShade.MaterialBindingAPI.Apply(mesh)
    binding.Bind(UsdShade.Material(stage.GetPrimAtPath(prim.GetPath().AppendPath("mtl/surface"))))
    stage.SetDefaultPrim(prim)


def author_geometry(layer: Sdf.Layer, content: AssetContent) -> None:
    """All levels of detail, each below a prim of its own."""
    stage = open_stage(layer, content)
    for lod, mesh in content.meshes.items():
        root = UsdGeom.Xform.Define(stage, f"/{lod}")
        UsdGeom.Scope.Define(stage, root.GetPath().AppendChild("geo"))
        define_mesh(stage, root.GetPath().AppendPath("geo/mesh"), mesh)
    stage.SetDefaultPrim(stage.GetPrimAtPath("/high"))


def author_materials(layer: Sdf.Layer, content: AssetContent) -> None:
    """The material with UsdPreviewSurface and OpenPBR; which maps they read is the variant of shading."""
    stage = open_stage(layer, content)
    prim = UsdGeom.Xform.Define(stage, f"/{content.name}").GetPrim()
    UsdGeom.Scope.Define(stage, prim.GetPath().AppendChild("mtl"))
    material = define_material(stage, prim.GetPath().AppendPath("mtl/surface"), content.files["high"], mtlx=True)
    for choice in _each_variant(prim, "shading", shading_variants(content)):
        connect_maps(stage, material, content.maps, choice, mtlx=True)
    stage.SetDefaultPrim(prim)


def author_flat(layer: Sdf.Layer, content: AssetContent) -> None:
    """The component in one layer without composition, variants, MaterialX or light: for augmented reality."""
    stage = open_stage(layer, content)
    prim = _define_component(stage, Sdf.Path(f"/{content.name}"), content)
    UsdGeom.Scope.Define(stage, prim.GetPath().AppendChild("geo"))
    UsdGeom.Scope.Define(stage, prim.GetPath().AppendChild("mtl"))
    material = define_material(stage, prim.GetPath().AppendPath("mtl/surface"), content.files["high"], mtlx=False)
    connect_maps(stage, material, content.maps, "full", mtlx=False)
    mesh = define_mesh(stage, prim.GetPath().AppendPath("geo/mesh"), content.meshes["high"])
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.SetDefaultPrim(prim)


def author_scene(layer: Sdf.Layer, content: AssetContent) -> None:
    """An assembly `/scene` that references the component and adds dome light and cameras."""
    stage = open_stage(layer, content)
    scene = UsdGeom.Xform.Define(stage, "/scene")
    Usd.ModelAPI(scene.GetPrim()).SetKind(Kind.Tokens.assembly)
    stage.SetDefaultPrim(scene.GetPrim())
    define_dome(stage, scene.GetPath().AppendChild("environment"), content.placement.rotation)
    if content.cameras:
        UsdGeom.Scope.Define(stage, "/scene/cameras")
    for camera in content.cameras:
        define_camera(stage, Sdf.Path(f"/scene/cameras/{camera.name}"), camera)
    model = UsdGeom.Xform.Define(stage, scene.GetPath().AppendChild(content.name))
    model.GetPrim().GetReferences().AddReference(f"./{content.name}.usda")


def define_dome(stage: Usd.Stage, path: Sdf.Path, rotation: np.ndarray) -> None:
    """A plain DomeLight: L(d) = E(rotation^T d), E the OpenEXR lat-long map. (DomeLight_1 comes out turned in Blender.)

    Absolute radiance lies in the pixels: intensity is 1, exposure, which Blender ignores, is not authored.
    """
    dome = UsdLux.DomeLight.Define(stage, path)
    dome.CreateTextureFileAttr(Sdf.AssetPath(ENVIRONMENT_FILE))
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    dome.CreateIntensityAttr(1.0)
    if not np.allclose(rotation, np.eye(3), atol=1e-9):
        turn = np.eye(4)
        turn[:3, :3] = rotation
        dome.AddTransformOp().Set(_row_matrix(turn))


def define_camera(stage: Usd.Stage, path: Sdf.Path, content: CameraContent) -> None:
    """Aperture and focal length from K; the principal point by the aperture's offsets (y up there, down in pixels).

    The window's left edge is at -cx / fx = (-aperture / 2 + offset) / focal, hence offset = -(cx - W / 2) aperture / W.
    """
    (fx, _, cx), (_, fy, cy) = content.intrinsics[0], content.intrinsics[1]
    focal = fx * APERTURE / content.width
    height = content.height * focal / fy
    camera = UsdGeom.Camera.Define(stage, path)
    camera.CreateProjectionAttr(UsdGeom.Tokens.perspective)
    camera.CreateHorizontalApertureAttr(APERTURE)
    camera.CreateVerticalApertureAttr(height)
    camera.CreateFocalLengthAttr(focal)
    camera.CreateHorizontalApertureOffsetAttr(-(cx - content.width / 2) * APERTURE / content.width)
    camera.CreateVerticalApertureOffsetAttr((cy - content.height / 2) * height / content.height)
    camera.CreateClippingRangeAttr(Gf.Vec2f(content.near, content.far))
    camera.AddTransformOp().Set(_row_matrix(content.matrix))
    facts = {"view": content.view, "width": content.width, "height": content.height}
    camera.GetPrim().SetCustomDataByKey("recon", facts)


def open_stage(layer: Sdf.Layer, content: AssetContent) -> Usd.Stage:
    """A stage on the new layer with up axis and unit authored."""
    stage = Usd.Stage.Open(layer, Sdf.Layer.CreateAnonymous(".usda"), Usd.Stage.LoadNone)
    UsdGeom.SetStageUpAxis(stage, content.placement.up_axis)
    UsdGeom.SetStageMetersPerUnit(stage, content.placement.metres_per_unit)
    return stage


def _each_variant(prim: Usd.Prim, name: str, choices: Sequence[str]) -> Iterator[str]:
    """A new variant set: what the caller authors at each step goes into that choice; the first one stays selected."""
    variants = prim.GetVariantSets().AddVariantSet(name)
    for choice in choices:
        variants.AddVariant(choice)
        variants.SetVariantSelection(choice)
        with variants.GetVariantEditContext():
            yield choice
    variants.SetVariantSelection(choices[0])


def _define_component(stage: Usd.Stage, path: Sdf.Path, content: AssetContent) -> Usd.Prim:
    prim = UsdGeom.Xform.Define(stage, path).GetPrim()
    model = Usd.ModelAPI(prim)
    model.SetKind(Kind.Tokens.component)
    model.SetAssetName(content.name)
    model.SetAssetIdentifier(Sdf.AssetPath(f"./{content.name}.usda"))
    model.SetAssetVersion("1")
    extent = Vt.Vec3fArray.FromNumpy(content.meshes["high"].extent)
    UsdGeom.ModelAPI.Apply(prim).SetExtentsHint(extent)
    prim.SetCustomDataByKey("recon", dict(content.provenance))
    return prim


def define_mesh(stage: Usd.Stage, path: Sdf.Path, content: MeshContent) -> UsdGeom.Mesh:
    """A mesh of triangles with one normal per point and texture coordinates on the corners."""
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
    return mesh


def _row_matrix(matrix: np.ndarray) -> Gf.Matrix4d:
    """Gf matrices act on row vectors: the transpose of ours."""
    return Gf.Matrix4d(*matrix.T.ravel().tolist())
