"""Several assets on a table top under one light: a USD scene that references what others made.

The pieces stay what they are: copied beside the scene and referenced, stood on the table by their bounding boxes, their
own lights and cameras switched off.
"""

from __future__ import annotations

import math
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdShade

from exmesh_graph.errors import DataError
from exmesh_graph.export.content import CameraContent, MeshContent
from exmesh_graph.export.folder import new_folder
from exmesh_graph.export.inputs import check_name
from exmesh_graph.export.maps import write_environment
from exmesh_graph.export.settings import ComposeSettings
from exmesh_graph.export.usd.gate import validate_usd
from exmesh_graph.export.usd.layers import define_camera, define_dome, define_mesh
from exmesh_graph.export.usd.read import open_usd

_THICKNESS = 0.06  # of the table, in heights of the pieces
_ELEVATION = 0.3  # of the camera above the horizon, radians


def compose_on_table(
    folder: Path, pieces: Mapping[str, Path], environment: np.ndarray, settings: ComposeSettings | None = None
) -> dict[str, Any]:
    """Write scene.usda into the new `folder`; return where the pieces stand.

    pieces       name -> USD file; for one of this project's packages the light-free component beside it is taken
    environment  float32 [H, W, 3], canonical lat-long
    Raises DataError for files without a default prim or a surface, and when the gate finds an error.
    """
    settings = settings or ComposeSettings()
    with new_folder(folder) as partial:
        write_environment(partial / "env.exr", environment)
        stage = Usd.Stage.CreateNew(str(partial / "scene.usda"))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        scene = UsdGeom.Xform.Define(stage, "/scene").GetPrim()
        Usd.ModelAPI(scene).SetKind(Kind.Tokens.assembly)
        stage.SetDefaultPrim(scene)
        report: dict[str, Any] = {}
        place, depth = 0.0, 0.0
        for number, (name, source) in enumerate(pieces.items()):
            check_name(name)
            turn = settings.turn[number] if number < len(settings.turn) else 0.0
            low, high, upright = _box(source, turn)
            scale = settings.height / (high[1] - low[1])
            place -= scale * low[0]
            report[name] = {"x": place, "scale": scale}
            offset = Gf.Vec3d(place, -scale * low[1], -scale * (low[2] + high[2]) / 2)
            _reference(stage, partial, name, source, offset, turn, scale, upright)
            place += scale * high[0] + settings.gap * settings.height
            depth = max(depth, scale * (high[2] - low[2]))
        length = place - settings.gap * settings.height
        margin = 0.6 * settings.height
        box = np.array(
            [[-margin, -_THICKNESS * settings.height, -depth / 2 - margin], [length + margin, 0, depth / 2 + margin]]
        )
        _define_table(stage, box, settings)
        define_dome(stage, Sdf.Path("/scene/environment"), np.eye(3))
        UsdGeom.Scope.Define(stage, "/scene/cameras")
        define_camera(stage, Sdf.Path("/scene/cameras/front"), _camera(length, depth, settings))
        stage.GetRootLayer().Save()
        problems = [str(p) for p in validate_usd(partial / "scene.usda") if p.level == "error"]
        if problems:
            raise DataError(
                "the composed scene does not pass the gate:\n    " + "\n    ".join(problems), where="usd.compose",
                fix="exmesh check-usd on each piece",
            )  # fmt: skip
    return report


def _component(source: Path) -> Path:
    """The light-free component beside one of this project's packages or scenes; else the file itself."""
    for candidate in (source.with_suffix(".usda"), source.with_name("asset.usda")):
        if candidate.is_file() and candidate.name != "scene.usda" and (source.parent / "payload.usda").is_file():
            return candidate
    if source.suffix == ".usda":
        raise DataError(
            "a layer that may refer to other files cannot be taken along alone", where=str(source),
            expected="a .usdz package, or an export of this project",
        )  # fmt: skip
    return source


def _box(source: Path, turn: float) -> tuple[np.ndarray, np.ndarray, bool]:
    """(low, high) corners of the piece after its turn, Y-up, and whether it was Y-up before."""
    stage = open_usd(_component(source))
    if not stage.GetDefaultPrim():
        raise DataError("the file has no default prim", where=str(source), fix="exmesh check-usd says what is wrong")
    matrix = Gf.Matrix4d(1)
    upright = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    if not upright:
        matrix.SetRotate(Gf.Rotation(Gf.Vec3d(1, 0, 0), -90))
    turned = Gf.Matrix4d(1).SetRotate(Gf.Rotation(Gf.Vec3d(0, 1, 0), math.degrees(turn)))
    cache = UsdGeom.XformCache()
    corners = []
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            points = np.asarray(UsdGeom.Mesh(prim).GetPointsAttr().Get() or np.zeros((0, 3)), np.float64)
            world = np.array(cache.GetLocalToWorldTransform(prim) * matrix * turned)
            corners.append(points @ world[:3, :3] + world[3, :3])
    points = np.concatenate(corners) if corners else np.zeros((0, 3))
    if len(points) == 0 or np.ptp(points[:, 1]) <= 0:
        raise DataError("the file shows no surface", where=str(source), expected="at least one Mesh")
    return points.min(0), points.max(0), upright


def _reference(
    stage: Usd.Stage, folder: Path, name: str, source: Path, offset: Gf.Vec3d, turn: float, scale: float, upright: bool
) -> None:
    file = _component(source)
    target = folder / name
    target.mkdir()
    if file.suffix == ".usda":
        for part in (file.name, "payload.usda", "geo.usdc", "mtl.usda"):
            shutil.copyfile(file.with_name(part), target / part)
        shutil.copytree(file.parent / "textures", target / "textures")
        layer = file.name
    elif file.suffix == ".usdz":
        layer = _unpack(file, target)
    else:
        shutil.copyfile(file, target / file.name)
        layer = file.name
    holder = UsdGeom.Xform.Define(stage, f"/scene/{name}")
    holder.AddTranslateOp().Set(offset)
    holder.AddRotateYOp().Set(math.degrees(turn))
    holder.AddScaleOp().Set(Gf.Vec3f(scale))
    model = UsdGeom.Xform.Define(stage, f"/scene/{name}/model")
    if not upright:
        model.AddRotateXOp(opSuffix="upright").Set(-90)
    model.GetPrim().GetReferences().AddReference(f"./{name}/{layer}")
    for prim in Usd.PrimRange(model.GetPrim()):
        if prim.HasAPI(UsdLux.LightAPI) or prim.IsA(UsdGeom.Camera):
            prim.SetActive(False)


def _unpack(package: Path, target: Path) -> str:
    """Unpack a package and name its root layer.

    Blender's importer unpacks pictures by their base names: two packages with a base_color.png in one scene would both
    show the first one's.
    """
    with zipfile.ZipFile(package) as archive:
        archive.extractall(target)  # keeps within the folder, whatever the members are called
        return archive.namelist()[0]


def _define_table(stage: Usd.Stage, box: np.ndarray, settings: ComposeSettings) -> None:
    """A slab with flat faces, one chart a face."""
    sides = [(axis, end) for axis in range(3) for end in (0, 1)]
    points, st = [], []
    for number, (axis, end) in enumerate(sides):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)) if end else ((0, 0), (0, 1), (1, 1), (1, 0)):
            corner = np.zeros(3)
            corner[[axis, u, v]] = box[end, axis], box[a, u], box[b, v]
            points.append(corner)
        cell = np.array([number % 3, number // 3]) / [3, 2]
        st += [cell + np.array(c) / [3, 2] for c in ((0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9))]
    quads = 4 * np.arange(6)[:, None]
    faces = np.concatenate([quads + np.array(corners) for corners in ([0, 1, 2], [0, 2, 3])]).astype(np.int32)
    positions = np.array(points, np.float32)
    first, second, third = (positions[faces[:6, k]] for k in range(3))
    normals = np.cross(second - first, third - first)
    normals = np.repeat(normals / np.linalg.norm(normals, axis=1, keepdims=True), 4, axis=0).astype(np.float32)
    content = MeshContent(positions, normals, faces, np.array(st, np.float32), faces)
    mesh = define_mesh(stage, Sdf.Path("/scene/table"), content)
    material = UsdShade.Material.Define(stage, "/scene/table_material")
    surface = UsdShade.Shader.Define(stage, "/scene/table_material/preview")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*settings.table_color))
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(settings.table_roughness)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)


def _camera(length: float, depth: float, settings: ComposeSettings) -> CameraContent:
    """Sees the whole row from the front, somewhat from above."""
    width, height = settings.width, round(settings.width * 0.6)
    focal = 1.6 * width
    middle = np.array([length / 2, 0.42 * settings.height, 0.0])
    reach = max(length + 0.5 * settings.height, 1.4 * settings.height / 0.6)
    distance = reach * focal / width + depth / 2
    back = np.array([0.0, math.sin(_ELEVATION), math.cos(_ELEVATION)])
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([[1.0, 0, 0], np.cross(back, [1.0, 0, 0]), back], axis=1)
    matrix[:3, 3] = middle + distance * back
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return CameraContent("front", "front", matrix, intrinsics, width, height, 0.01 * distance, 4 * distance)
