"""Judging a USD file: OpenUSD's own validators, and the rules that they do not know.

OpenUSD's validators pass a file whose base colour is read as raw, whose texture reader names a primvar that is not
there, whose indices run out of range or whose paths are absolute: each of these is a wrong picture, or a crash, in
some DCC tool. The rules here find them (docs/usd.md lists all).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError

_MAP_COLOR_SPACE = {"diffuseColor": "sRGB", "roughness": "raw", "metallic": "raw", "normal": "raw"}


@dataclass(frozen=True)
class Problem:
    """One finding. `level` is "error" or "warning"; `rule` names the check; `where` the prim, layer or file."""

    level: str
    rule: str
    where: str
    what: str

    def __str__(self) -> str:
        return f"{self.level} {self.rule} at {self.where}: {self.what}"


def validate_usd(path: Path) -> list[Problem]:
    """All problems of a `.usda`, `.usdc` or `.usdz` file; an empty list means that none was found."""
    from pxr import Tf, Usd

    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        return [Problem("error", "open", path.name, str(error).strip().splitlines()[-1])]
    problems = list(_openusd_findings(stage))
    for rule in (_stage_metadata, _asset_paths):
        problems += rule(stage)
    for prim in stage.Traverse():
        kind = prim.GetTypeName()
        if kind == "Mesh":
            problems += _mesh(prim)
        elif kind == "Material":
            problems += _material(prim)
        elif kind.startswith("DomeLight"):
            problems += _dome(prim, stage)
    return problems


def _openusd_findings(stage: Any) -> Iterator[Problem]:
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    for error in UsdValidation.ValidationContext(validators).Validate(stage):
        level = "error" if error.GetType() == UsdValidation.ValidationErrorType.Error else "warning"
        sites = [str(site.GetPrim().GetPath()) for site in error.GetSites() if site.IsPrim()]
        yield Problem(level, str(error.GetIdentifier()), ", ".join(sites) or "stage", error.GetMessage())


def _stage_metadata(stage: Any) -> Iterator[Problem]:
    from pxr import UsdGeom

    file = Path(stage.GetRootLayer().identifier).name
    if not stage.GetDefaultPrim():
        yield Problem("error", "defaultPrim", file, "no default prim: a reference to this file brings nothing")
    for key in (UsdGeom.Tokens.upAxis, UsdGeom.Tokens.metersPerUnit):
        if not stage.HasAuthoredMetadata(key):
            yield Problem("error", "stageMetadata", file, f"{key} is not authored")


def _asset_paths(stage: Any) -> Iterator[Problem]:
    from pxr import UsdUtils

    for layer in stage.GetUsedLayers():
        if layer.anonymous:
            continue
        found: list[str] = []

        def note(path: str, found: list[str] = found) -> str:
            found.append(path)
            return path

        copy = layer.CreateAnonymous(".usda")
        copy.TransferContent(layer)
        UsdUtils.ModifyAssetPaths(copy, note)
        for path in sorted(set(found)):
            if not path.startswith("./"):
                what = f"asset path {path!r} does not start with './': it breaks when the folder moves"
                yield Problem("error", "relativePath", Path(layer.identifier).name, what)


def _mesh(prim: Any) -> Iterator[Problem]:
    from pxr import UsdGeom, UsdShade

    where, mesh = str(prim.GetPath()), UsdGeom.Mesh(prim)

    def error(rule: str, what: str) -> Problem:
        return Problem("error", rule, where, what)

    points = np.asarray(mesh.GetPointsAttr().Get() or [], np.float64).reshape(-1, 3)
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get() or [], np.int64)
    corners = np.asarray(mesh.GetFaceVertexIndicesAttr().Get() or [], np.int64)
    if len(points) == 0 or len(counts) == 0:
        yield error("emptyMesh", "no points or no faces")
        return
    if not np.isfinite(points).all():
        yield error("finitePoints", f"point {int(np.argwhere(~np.isfinite(points))[0][0])} is not finite")
    if (counts != 3).any():
        yield error("triangles", f"face {int(np.flatnonzero(counts != 3)[0])} is not a triangle")
    if counts.sum() != len(corners):
        yield error("faceCounts", f"the counts add up to {counts.sum()}, there are {len(corners)} indices")
    if ((corners < 0) | (corners >= len(points))).any():
        yield error("vertexIndex", f"an index points outside the {len(points)} points")
    extent = np.asarray(mesh.GetExtentAttr().Get() or [], np.float64).reshape(-1, 3)
    box = np.stack([points.min(0), points.max(0)])
    if extent.shape != (2, 3) or not np.allclose(extent, box, atol=1e-5 * max(1e-12, float(np.ptp(box)))):
        yield error("extent", "extent is not the bounding box of the points")
    scheme = mesh.GetSubdivisionSchemeAttr()
    if not scheme.HasAuthoredValue() or scheme.Get() != "none":
        yield error("subdivision", "subdivisionScheme must be authored as none (the fallback is catmullClark)")
    if mesh.GetOrientationAttr().Get() != "rightHanded":
        yield error("orientation", "orientation must be rightHanded")
    normals = np.asarray(mesh.GetNormalsAttr().Get() or [], np.float64).reshape(-1, 3)
    wanted = {"vertex": len(points), "faceVarying": len(corners)}.get(mesh.GetNormalsInterpolation(), -1)
    if len(normals) != wanted:
        yield error("normals", f"{len(normals)} {mesh.GetNormalsInterpolation()} normals, {wanted} expected")
    elif (np.abs(np.linalg.norm(normals, axis=1) - 1.0) > 1e-3).any():
        yield error("normals", "normals are not of unit length")
    yield from _texture_coordinates(mesh, len(corners), where)
    if not UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]:
        yield error("unbound", "no material is bound")


def _texture_coordinates(mesh: Any, corners: int, where: str) -> Iterator[Problem]:
    from pxr import UsdGeom

    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    if not st or not st.HasValue():
        yield Problem("error", "st", where, "primvars:st is missing")
        return
    values = np.asarray(st.Get(), np.float64).reshape(-1, 2)
    indices = np.asarray(st.GetIndices() if st.IsIndexed() else np.arange(len(values)), np.int64)
    if str(st.GetTypeName()) != "texCoord2f[]" or st.GetInterpolation() != "faceVarying":
        what = f"{st.GetTypeName()} {st.GetInterpolation()}, expected texCoord2f[] faceVarying"
        yield Problem("error", "stType", where, what)
    if len(indices) != corners:
        yield Problem("error", "stCount", where, f"{len(indices)} values for {corners} face corners")
        return
    if ((indices < 0) | (indices >= len(values))).any():
        yield Problem("error", "stIndex", where, f"an index points outside the {len(values)} values")
        return
    if not np.isfinite(values).all() or (values < 0).any() or (values > 1).any():
        yield Problem("error", "stRange", where, "texture coordinates outside [0, 1]")
    corner = values[indices].reshape(-1, 3, 2)
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    if (area < 0).any():
        what = f"{int((area < 0).sum())} of {len(area)} faces have mirrored texture coordinates"
        yield Problem("warning", "stMirrored", where, what)
    if (area == 0).mean() > 1e-3:
        what = f"{int((area == 0).sum())} of {len(area)} faces have no area in texture space"
        yield Problem("error" if (area == 0).all() else "warning", "stDegenerate", where, what)


def _material(prim: Any) -> Iterator[Problem]:
    from pxr import UsdShade

    surface, _, _ = UsdShade.Material(prim).ComputeSurfaceSource()
    if not surface or surface.GetIdAttr().Get() != "UsdPreviewSurface":
        yield Problem("error", "surface", str(prim.GetPath()), "no UsdPreviewSurface is connected")
        return
    for name, color_space in _MAP_COLOR_SPACE.items():
        shader_input = surface.GetInput(name)
        sources = shader_input.GetConnectedSources()[0] if shader_input else []
        for source in sources:
            yield from _texture(UsdShade.Shader(source.source.GetPrim()), name, color_space)


def _texture(shader: Any, input_name: str, color_space: str) -> Iterator[Problem]:
    from exmesh_graph.io.usd_read import read_asset_pixels

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
    file = value("file")
    try:
        pixels = read_asset_pixels(file.resolvedPath) if file and file.resolvedPath else None
    except DataError as error:
        yield Problem("error", "image", where, error.what)
        return
    if pixels is None:
        yield Problem("error", "image", where, f"the texture file {file} is not found")


def _primvar_reader(shader: Any, where: str) -> Iterator[Problem]:
    from pxr import UsdShade

    st = shader.GetInput("st")
    sources = st.GetConnectedSources()[0] if st else []
    reader = UsdShade.Shader(sources[0].source.GetPrim()) if sources else None
    varname = reader.GetInput("varname") if reader else None
    if varname is None or varname.Get() != "st" or str(varname.GetTypeName()) != "string":
        yield Problem("error", "varname", where, "needs a UsdPrimvarReader_float2 with string varname = 'st'")


def _dome(prim: Any, stage: Any) -> Iterator[Problem]:
    from pxr import UsdGeom, UsdLux

    from exmesh_graph.io.usd_read import read_asset_pixels

    where = str(prim.GetPath())
    if prim.GetTypeName() != "DomeLight":
        yield Problem("error", "domeType", where, "DomeLight_1 is turned wrongly by Blender; use DomeLight")
        return
    dome = UsdLux.DomeLight(prim)
    if dome.GetTextureFormatAttr().Get() != UsdLux.Tokens.latlong:
        yield Problem("error", "domeFormat", where, "texture:format must be latlong")
    if dome.GetExposureAttr().Get():
        yield Problem("error", "domeExposure", where, "Blender ignores exposure; fold it into the pixels")
    if UsdGeom.GetStageUpAxis(stage) != UsdGeom.Tokens.y and not UsdGeom.Xformable(prim).GetOrderedXformOps():
        yield Problem("error", "domeUpAxis", where, "a stage that is not Y-up needs the dome rotated")
    file = dome.GetTextureFileAttr().Get()
    try:
        pixels = read_asset_pixels(file.resolvedPath) if file and file.resolvedPath else None
    except DataError as error:
        yield Problem("error", "domeImage", where, error.what)
        return
    if pixels is None:
        yield Problem("error", "domeImage", where, f"the environment {file} is not found")
    elif pixels.shape[1] != 2 * pixels.shape[0] or not np.isfinite(pixels).all() or pixels.min() < 0:
        yield Problem("error", "domeImage", where, "the environment must be 2:1, finite and not negative")
