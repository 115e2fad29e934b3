"""Rules about meshes: topology, extent, normals, texture coordinates, binding."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from exmesh_graph.export.usd.read import array_of
from exmesh_graph.export.usd.rules import Pictures, Problem
from exmesh_graph.geometry.adjacency import area_vectors, signed_areas_2d

_WRONG_WINDING = 0.05  # share of the surface: a few slivers have vertex normals from the other side in any scan
_DEGENERATE = 1e-3  # share of the faces


def mesh_rules(prim: Any, _: Pictures) -> Iterator[Problem]:
    """All rules on one Mesh prim."""
    from pxr import UsdGeom, UsdShade

    where, mesh = str(prim.GetPath()), UsdGeom.Mesh(prim)

    points = array_of(mesh.GetPointsAttr(), np.float64, 3)
    counts = array_of(mesh.GetFaceVertexCountsAttr(), np.int64, 1)[:, 0]
    corners = array_of(mesh.GetFaceVertexIndicesAttr(), np.int64, 1)[:, 0]
    if len(points) == 0 or len(counts) == 0:
        yield Problem("emptyMesh", where, "no points or no faces")
        return
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        yield Problem("finitePoints", where, f"point {int(np.flatnonzero(~finite)[0])} is not finite")
    if (counts != 3).any():
        yield Problem("triangles", where, f"face {int(np.flatnonzero(counts != 3)[0])} is not a triangle")
    whole = counts.sum() == len(corners)
    if not whole:
        yield Problem("faceCounts", where, f"the counts add up to {counts.sum()}, there are {len(corners)} indices")
    outside = (corners < 0) | (corners >= len(points))
    if outside.any():
        first = int(np.flatnonzero(outside)[0])
        yield Problem(
            "vertexIndex", where, f"index {corners[first]} of corner {first} is outside the {len(points)} points"
        )
    extent = array_of(mesh.GetExtentAttr(), np.float64, 3)
    box = np.stack([points.min(0), points.max(0)])
    if extent.shape != (2, 3) or not np.allclose(extent, box, atol=1e-5 * max(1e-12, float(np.ptp(box)))):
        yield Problem("extent", where, "extent is not the bounding box of the points")
    scheme = mesh.GetSubdivisionSchemeAttr()
    if not scheme.HasAuthoredValue() or scheme.Get() != "none":
        yield Problem("subdivision", where, "subdivisionScheme must be authored as none (the fallback is catmullClark)")
    if mesh.GetOrientationAttr().Get() != "rightHanded":
        yield Problem("orientation", where, "orientation must be rightHanded")
    normals, interpolation = _normals(mesh)
    wanted = {"vertex": len(points), "faceVarying": len(corners)}.get(interpolation, -1)
    if len(normals) != wanted:
        yield Problem("normals", where, f"{len(normals)} {interpolation} normals, {wanted} expected")
    elif not (np.abs(np.linalg.norm(normals, axis=1) - 1.0) <= 1e-3).all():
        yield Problem("normals", where, "normals are not of unit length")
    elif whole and finite.all() and not outside.any() and (counts == 3).all():
        yield from _winding(points, corners, normals[corners] if interpolation == "vertex" else normals, where)
    yield from _texture_coordinates(mesh, len(corners), where)
    if not prim.HasAPI(UsdShade.MaterialBindingAPI) and prim.HasRelationship("material:binding"):
        yield Problem("bindingApi", where, "the material is bound without MaterialBindingAPI: some readers ignore it")
    if not UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]:
        yield Problem("unbound", where, "no material is bound")


def _normals(mesh: Any) -> tuple[np.ndarray, str]:
    """(normals, interpolation); primvars:normals beats normals where both are authored."""
    from pxr import UsdGeom

    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    if primvar and primvar.HasValue():
        return np.asarray(primvar.ComputeFlattened(), np.float64).reshape(-1, 3), str(primvar.GetInterpolation())
    return array_of(mesh.GetNormalsAttr(), np.float64, 3), str(mesh.GetNormalsInterpolation())


def _winding(points: np.ndarray, corners: np.ndarray, normals: np.ndarray, where: str) -> Iterator[Problem]:
    """`normals` [3 F, 3] are those of the corners."""
    area = area_vectors(points, corners.reshape(-1, 3))
    mean = normals.reshape(-1, 3, 3).sum(axis=1)
    size = np.linalg.norm(area, axis=1)
    against = size[(area * mean).sum(axis=1) < 0].sum() / max(size.sum(), 1e-300)
    if against > _WRONG_WINDING:
        what = f"on {100 * against:.0f} % of the surface the normals point against the winding"
        yield Problem("winding", where, what)


def _texture_coordinates(mesh: Any, corners: int, where: str) -> Iterator[Problem]:
    from pxr import UsdGeom

    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    if not st or not st.HasValue():
        yield Problem("st", where, "primvars:st is missing")
        return
    values = np.asarray(st.Get(), np.float64).reshape(-1, 2)
    indices = np.asarray(st.GetIndices() if st.IsIndexed() else np.arange(len(values)), np.int64)
    if str(st.GetTypeName()) != "texCoord2f[]" or st.GetInterpolation() != "faceVarying":
        what = f"{st.GetTypeName()} {st.GetInterpolation()}, expected texCoord2f[] faceVarying"
        yield Problem("stType", where, what)
    if len(indices) != corners:
        yield Problem("stCount", where, f"{len(indices)} values for {corners} face corners")
        return
    if ((indices < 0) | (indices >= len(values))).any():
        yield Problem("stIndex", where, f"an index points outside the {len(values)} values")
        return
    if not np.isfinite(values).all() or (values < 0).any() or (values > 1).any():
        yield Problem("stRange", where, "texture coordinates outside [0, 1]")
    if corners % 3:
        return  # not triangles: said by another rule
    area = signed_areas_2d(values, indices.reshape(-1, 3))
    if (area < 0).any():
        what = f"{int((area < 0).sum())} of {len(area)} faces have mirrored texture coordinates"
        yield Problem("stMirrored", where, what, "warning")
    if (area == 0).mean() > _DEGENERATE:
        what = f"{int((area == 0).sum())} of {len(area)} faces have no area in texture space"
        yield Problem("stDegenerate", where, what)
