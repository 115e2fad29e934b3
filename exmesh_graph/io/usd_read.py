"""Reading an exported asset back: for round-trip tests and for checks of what a reader would see."""

from __future__ import annotations

import tempfile
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.images import read_raw


@dataclass(frozen=True)
class UsdContents:
    """The one mesh of a USD file with its maps.

    points, normals float32 [V, 3];  faces int32 [F, 3];  st float32 [T, 2], v up;  st_faces int32 [F, 3]
    textures        map name -> pixels as stored, [H, W, C]
    environment     float32 [H, W, 3], or None without a dome light
    """

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    st: np.ndarray
    st_faces: np.ndarray
    textures: dict[str, np.ndarray]
    environment: np.ndarray | None
    up_axis: str
    metres_per_unit: float
    default_prim: str
    custom_data: dict[str, Any] = field(default_factory=dict)


def read_usd(path: Path) -> UsdContents:
    """Read `.usda`, `.usdc` or `.usdz` that holds exactly one Mesh; DataError otherwise."""
    from pxr import Usd, UsdGeom, UsdLux

    stage = Usd.Stage.Open(str(path))
    meshes = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    if len(meshes) != 1:
        raise DataError(f"{len(meshes)} meshes", where=str(path), expected="exactly one Mesh")
    mesh = meshes[0]
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    domes = [UsdLux.DomeLight(prim) for prim in stage.Traverse() if prim.IsA(UsdLux.DomeLight)]
    environment = None
    if domes:
        environment = read_asset_pixels(domes[0].GetTextureFileAttr().Get().resolvedPath)
    recon: dict[str, Any] = {}
    for prim in stage.Traverse():
        recon = recon or dict(prim.GetCustomDataByKey("recon") or {})
    return UsdContents(
        points=_array(mesh.GetPointsAttr(), np.float32, 3),
        normals=_array(mesh.GetNormalsAttr(), np.float32, 3),
        faces=_array(mesh.GetFaceVertexIndicesAttr(), np.int32, 3),
        st=np.asarray(st.Get(), np.float32).reshape(-1, 2),
        st_faces=np.asarray(st.GetIndices(), np.int32).reshape(-1, 3),
        textures=_textures(stage),
        environment=environment,
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        metres_per_unit=float(UsdGeom.GetStageMetersPerUnit(stage)),
        default_prim=str(stage.GetDefaultPrim().GetName()),
        custom_data=recon,
    )


def read_asset_pixels(resolved: str) -> np.ndarray:
    """Pixels [H, W, C] of a resolved asset path; `package.usdz[member]` is looked up in the package."""
    if not resolved.endswith("]"):
        return read_raw(Path(resolved))
    package, member = resolved[:-1].split("[", 1)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / Path(member).name
        with zipfile.ZipFile(package) as archive:
            copy.write_bytes(archive.read(member))
        return read_raw(copy)


def _textures(stage: Any) -> dict[str, np.ndarray]:
    from pxr import UsdShade

    textures = {}
    for prim in stage.Traverse():
        shader = UsdShade.Shader(prim)
        if shader and shader.GetIdAttr().Get() == "UsdUVTexture":
            textures[str(prim.GetName())] = read_asset_pixels(shader.GetInput("file").Get().resolvedPath)
    return textures


def _array(attribute: Any, dtype: type, columns: int) -> np.ndarray:
    return np.asarray(attribute.Get(), dtype).reshape(-1, columns)
