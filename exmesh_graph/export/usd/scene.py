"""scene.usda: the asset in the light that was recovered with it, and the cameras that photographed it."""

from __future__ import annotations

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux

from exmesh_graph.export.content import AssetContent, CameraContent
from exmesh_graph.export.usd.layers import open_stage

ENVIRONMENT_FILE = "./env.exr"
APERTURE = 36.0
"""Width of the cameras' picture plane, tenths of a scene unit as UsdGeomCamera counts: only ratios matter."""


def author_scene(layer: Sdf.Layer, content: AssetContent) -> None:
    """An assembly `/scene` that references the component and adds dome light and cameras."""
    stage = open_stage(layer, content)
    scene = UsdGeom.Xform.Define(stage, "/scene")
    Usd.ModelAPI(scene.GetPrim()).SetKind(Kind.Tokens.assembly)
    stage.SetDefaultPrim(scene.GetPrim())
    define_dome(stage, scene.GetPath().AppendChild("environment"), content.rotation)
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


def _row_matrix(matrix: np.ndarray) -> Gf.Matrix4d:
    """Gf matrices act on row vectors: the transpose of ours."""
    return Gf.Matrix4d(*matrix.T.ravel().tolist())
