"""Reading an exported asset back: for round-trip tests, for checks, and to render what a reader would see."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.export.content import MeshContent
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.io.images import read_raw
from exmesh_graph.types import Asset

_MAPS = {"diffuseColor": "base_color", "roughness": "roughness", "metallic": "metallic", "normal": "normal"}


@dataclass(frozen=True, eq=False)
class UsdCamera:
    """A camera as types.Views has them: K in pixels, camera_to_world [4, 4] on the stage with OpenCV axes.

    `view` is what the data set calls it, `prim` the name of its prim.
    """

    view: str
    prim: str
    intrinsics: np.ndarray
    camera_to_world: np.ndarray
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class UsdContents(MeshContent):
    """The one mesh of a USD file with its maps.

    textures        name of each map that the material reads -> pixels as stored, [H, W, C]
    constants       name -> value of inputs that no map feeds
    environment     float32 [H, W, 3], or None without a dome light
    rotation        float64 [3, 3], the dome's: light from d is E(rotation^T d)
    """

    textures: dict[str, np.ndarray]
    environment: np.ndarray | None
    up_axis: str
    metres_per_unit: float
    default_prim: str
    constants: dict[str, Any] = field(default_factory=dict)
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    cameras: tuple[UsdCamera, ...] = ()
    custom_data: dict[str, Any] = field(default_factory=dict)

    def asset(self) -> Asset:
        """What our renderer needs, in the normalised world of the environment's axes; see `normalised`.

        Raises DataError without a dome light or a base colour map.
        """
        if self.environment is None or "base_color" not in self.textures:
            raise DataError("no dome light with a picture, or no base colour map", where=self.default_prim,
                            expected="a scene.usda or its package")  # fmt: skip
        maps = {name: _unit(codes) for name, codes in self.textures.items()}
        base = maps["base_color"][..., :3]
        shape = base.shape[:2]
        for name in ("roughness", "metallic"):
            if name not in maps and (name == "roughness" or self.constants.get(name)):
                maps[name] = np.full((*shape, 1), float(self.constants.get(name, 0.0)), np.float32)
        normal = None
        if "normal" in maps:
            normal = maps["normal"][..., :3] * 2 - 1
            normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return Asset(
            vertices=self.normalised(self.points).astype(np.float32),
            faces=self.faces,
            uvs=self.st,
            uv_faces=self.st_faces,
            texture=base,
            base_color=srgb_to_linear(base),
            roughness=maps["roughness"][..., 0],
            seen=np.ones(shape, bool),
            environment=self.environment,
            normal=normal,
            metallic=maps["metallic"][..., 0] if "metallic" in maps else None,
        )

    def normalised(self, points: np.ndarray) -> np.ndarray:
        """Stage points [N, 3] in the normalised world: as the exporter noted it, else the mesh in the unit sphere."""
        size = self.custom_data.get("scene_units_per_normalised")
        if size is None:
            low, high = self.points.min(0).astype(np.float64), self.points.max(0).astype(np.float64)
            centre = (low + high) / 2
            size = max(float(np.linalg.norm(self.points - centre, axis=1).max()), 1e-300)
        else:
            centre = np.array([float(self.custom_data.get(f"origin_{axis}", 0.0)) for axis in "xyz"])
        return (np.asarray(points, np.float64) - centre) @ self.rotation / size

    def normalised_pose(self, camera: UsdCamera) -> np.ndarray:
        """camera_to_world [4, 4] of a camera in the world of `asset`."""
        out = np.eye(4)
        out[:3, :3] = self.rotation.T @ camera.camera_to_world[:3, :3]
        out[:3, 3] = self.normalised(camera.camera_to_world[None, :3, 3])[0]
        return out


def open_usd(path: Path) -> Any:
    """The composed Usd.Stage of a file; DataError where there is none, or what is there cannot be read as USD."""
    from pxr import Tf, Usd

    if not path.is_file():
        folder = path.is_dir()
        raise DataError(
            "this is a folder" if folder else "the file does not exist", where=str(path),
            expected="a .usda, .usdc or .usdz file", fix="give asset.usdz or scene.usda in it" if folder else "",
        )  # fmt: skip
    try:
        if path.suffix.lower() == ".usdz":  # USD opens a cut one too, as far as it goes
            zipfile.ZipFile(path).close()
        return Usd.Stage.Open(str(path))
    except (Tf.ErrorException, zipfile.BadZipFile) as error:
        reason = str(error).strip().splitlines()[-1].rsplit(" : ", 1)[-1].strip("' ")  # without USD's own file and line
        raise DataError(
            f"USD cannot read it ({reason})", where=str(path), expected="a whole .usda, .usdc or .usdz file",
            fix="export or copy it again",
        ) from error  # fmt: skip


def read_usd(path: Path, variants: Mapping[str, str] | None = None) -> UsdContents:
    """Read `.usda`, `.usdc` or `.usdz` that holds exactly one Mesh, of triangles with `primvars:st` on their corners.

    `variants` (lod, shading) are chosen on the prim that has them. Raises DataError for anything else.
    """
    from pxr import UsdGeom, UsdLux

    stage = open_usd(path)
    for name, choice in (variants or {}).items():
        select_variant(stage, name, choice)
    meshes = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    if len(meshes) != 1:
        raise DataError(f"{len(meshes)} meshes", where=str(path), expected="exactly one Mesh")
    mesh = meshes[0]
    where = f"{path}, {mesh.GetPath()}"
    if (np.asarray(mesh.GetFaceVertexCountsAttr().Get() or [0]) != 3).any():
        raise DataError("the mesh has faces that are not triangles", where=where, fix="triangulate it in the DCC tool")
    faces = array_of(mesh.GetFaceVertexIndicesAttr(), np.int32, 3)
    st, st_faces = _texture_coordinates(mesh, len(faces), where)
    domes = [UsdLux.DomeLight(prim) for prim in stage.Traverse() if prim.IsA(UsdLux.DomeLight)]
    environment, rotation = None, np.eye(3)
    if domes and (file := domes[0].GetTextureFileAttr().Get()):
        environment = read_asset_pixels(file.resolvedPath or file.path).astype(np.float32)[..., :3]
        rotation = _matrix(domes[0])[:3, :3]
    noted = (prim.GetCustomDataByKey("recon") for prim in stage.Traverse() if not prim.IsA(UsdGeom.Camera))
    textures, constants = _maps(mesh)
    return UsdContents(
        points=array_of(mesh.GetPointsAttr(), np.float32, 3),
        normals=array_of(mesh.GetNormalsAttr(), np.float32, 3),
        faces=faces,
        st=st,
        st_faces=st_faces,
        textures=textures,
        constants=constants,
        environment=environment,
        rotation=rotation,
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        metres_per_unit=float(UsdGeom.GetStageMetersPerUnit(stage)),
        default_prim=str(stage.GetDefaultPrim().GetName()),
        cameras=tuple(read_camera(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)),
        custom_data=dict(next(filter(None, noted), {})),
    )


def up_axis(path: Path) -> str:
    """ "y" or "z": what the file's stage says of itself (USD's default is y)."""
    from pxr import UsdGeom

    return str(UsdGeom.GetStageUpAxis(open_usd(path))).lower()


def select_variant(stage: Any, name: str, choice: str, layer: Any = None) -> None:
    """Choose `choice` of the variant set `name` wherever it is, in `layer` (None: for this session alone).

    Raises DataError where there is no such choice.
    """
    prims = [prim for prim in stage.Traverse() if name in prim.GetVariantSets().GetNames()]
    offered = sorted({c for prim in prims for c in prim.GetVariantSets().GetVariantSet(name).GetVariantNames()})
    if choice not in offered:
        raise DataError(
            f"there is no variant {name}={choice}",
            where=str(stage.GetRootLayer().identifier),
            expected=f"one of {', '.join(offered) or 'none'}",
        )
    from pxr import Usd

    with Usd.EditContext(stage, layer or stage.GetSessionLayer()):
        for prim in prims:
            prim.GetVariantSets().GetVariantSet(name).SetVariantSelection(choice)


def read_asset_pixels(resolved: str) -> np.ndarray:
    """Pixels [H, W, C] of a resolved asset path; `package.usdz[member]` is looked up in the package.

    Raises DataError for a picture that is missing or cannot be decoded.
    """
    if not resolved.endswith("]"):
        return read_raw(Path(resolved))
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / Path(resolved[:-1]).name
        copy.write_bytes(asset_bytes(resolved))
        return read_raw(copy)


def asset_bytes(resolved: str) -> bytes:
    """The file of a resolved asset path, as `read_asset_pixels`."""
    if not resolved.endswith("]"):
        return Path(resolved).read_bytes()
    package, member = resolved[:-1].split("[", 1)
    try:
        with zipfile.ZipFile(package) as archive:
            return archive.read(member)
    except (zipfile.BadZipFile, KeyError) as error:
        raise DataError(f"the package does not give the picture ({error})", where=resolved) from error


def _texture_coordinates(mesh: Any, faces: int, where: str) -> tuple[np.ndarray, np.ndarray]:
    """(st float32 [T, 2], st_faces int32 [F, 3]) of a mesh."""
    from pxr import UsdGeom

    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    if not st or not st.HasValue() or st.GetInterpolation() != UsdGeom.Tokens.faceVarying:
        raise DataError("the mesh has no texture coordinates on its corners", where=where, expected="primvars:st")
    values = np.array(st.Get(), np.float32).reshape(-1, 2)
    indices = np.array(st.GetIndices() if st.IsIndexed() else np.arange(len(values)), np.int32)
    if len(indices) != 3 * faces:
        raise DataError(f"{len(indices)} texture coordinates for {faces} triangles", where=where)
    return values, indices.reshape(-1, 3)


def _maps(mesh: Any) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """(textures, constants) that the surface of the mesh's material is fed by."""
    from pxr import UsdShade

    textures: dict[str, np.ndarray] = {}
    constants: dict[str, Any] = {}
    material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    surface = material.ComputeSurfaceSource()[0] if material else None
    for name, key in _MAPS.items():
        shader_input = surface.GetInput(name) if surface else None
        for shader in feeding(shader_input)[:1]:
            file = shader.GetInput("file").Get() if shader.GetInput("file") else None
            if file is None:
                raise DataError(f"{name} is fed by no picture", where=str(shader.GetPath()), expected="a UsdUVTexture")
            textures[key] = read_asset_pixels(file.resolvedPath or file.path)
        if key not in textures and shader_input and shader_input.Get() is not None:
            constants[key] = shader_input.Get()
    return textures, constants


def feeding(shader_input: Any) -> list[Any]:
    """The shaders that feed a shader's input; none for an input that is not there."""
    from pxr import UsdShade

    sources = shader_input.GetConnectedSources()[0] if shader_input else []
    return [UsdShade.Shader(source.source.GetPrim()) for source in sources]


def read_camera(prim: Any) -> UsdCamera:
    """A UsdGeomCamera; its picture's size is what the exporter noted, 512 x 512 without a note."""
    from pxr import UsdGeom

    camera, facts = UsdGeom.Camera(prim), prim.GetCustomDataByKey("recon") or {}
    width, height = int(facts.get("width", 512)), int(facts.get("height", 512))
    wide, high = camera.GetHorizontalApertureAttr().Get(), camera.GetVerticalApertureAttr().Get()
    focal = camera.GetFocalLengthAttr().Get()
    cx = width / 2 - camera.GetHorizontalApertureOffsetAttr().Get() / wide * width
    cy = height / 2 + camera.GetVerticalApertureOffsetAttr().Get() / high * height
    intrinsics = np.array([[focal * width / wide, 0, cx], [0, focal * height / high, cy], [0, 0, 1.0]])
    pose = _matrix(camera) @ np.diag([1.0, -1, -1, 1])
    name = str(prim.GetName())
    return UsdCamera(str(facts.get("view", name)), name, intrinsics, pose, width, height)


def _matrix(schema: Any) -> np.ndarray:
    """float64 [4, 4], local to world, for column vectors."""
    from pxr import Usd

    return np.array(schema.ComputeLocalToWorldTransform(Usd.TimeCode.Default())).T


def _unit(codes: np.ndarray) -> np.ndarray:
    if codes.dtype.kind != "u":
        return codes.astype(np.float32)
    return codes.astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)


def array_of(attribute: Any, dtype: type, columns: int) -> np.ndarray:
    """[N, columns] of an attribute; empty where it has no value."""
    value = attribute.Get()
    return np.zeros((0, columns), dtype) if value is None else np.array(value, dtype).reshape(-1, columns)
