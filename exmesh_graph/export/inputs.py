"""What must hold of an asset before any file is written (bad input never leaves half an asset behind).

Shapes, dtypes and indices are the type's own promise (`types.ArrayArtifact`).
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from exmesh_graph.errors import DataError, GeometryError, NumericsError
from exmesh_graph.types import Asset, Frame, Views

MAX_TEXTURE = 8192  # texels a side: what DCC tools and GPUs hold without tiling
HALF_MAX = 65504.0  # largest finite half float: what an EXR half environment can hold
_ANY, _UNIT = (-np.inf, np.inf), (0.0, 1.0)
_RANGES = {"vertices": _ANY, "uvs": (-1e-6, 1 + 1e-6), "base_color": _UNIT, "roughness": _UNIT, "confidence": _UNIT,
           "metallic": _UNIT, "normal": _ANY, "environment": (0.0, HALF_MAX)}  # fmt: skip
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def check_name(name: str) -> None:
    """Prim and file names are [A-Za-z_][A-Za-z0-9_]*; anything else is refused, never renamed silently."""
    if not _NAME.fullmatch(name):
        raise DataError(
            f"asset name {name!r} is not a USD identifier",
            where="export.usd, parameter name",
            expected="letters, digits and _, not starting with a digit",
            fix=f"use {re.sub(r'[^A-Za-z0-9_]', '_', name) or 'asset'!r}",
        )


def without_vanished(asset: Asset) -> Asset:
    """The asset without parts that have shrunk to nothing (`geometry.vanished`), whose faces have no texture area.

    Stage I's rounds drop them; here go those that shrank after the last round.
    """
    from exmesh_graph.geometry.adjacency import without_unused
    from exmesh_graph.geometry.vanished import vanished

    keep = ~vanished(asset.vertices, asset.faces)
    if keep.all():
        return asset
    vertices, faces = without_unused(asset.vertices, asset.faces[keep])
    uvs, uv_faces = without_unused(asset.uvs, asset.uv_faces[keep])
    return replace(asset, vertices=vertices, faces=faces, uvs=uvs, uv_faces=uv_faces)


def check_asset(asset: Asset, owner: str = "asset") -> None:
    """Ranges and finiteness of everything that the export writes; shapes are right by the type. `owner` names the asset
    in errors.

    Raises GeometryError, NumericsError or DataError that names the array and the first offending element.
    """
    if len(asset.vertices) == 0 or len(asset.faces) == 0:
        raise GeometryError("the mesh is empty", where=f"{owner}.faces", expected="at least one triangle")
    if len(asset.uvs) == 0 or len(asset.uv_faces) == 0:
        raise GeometryError("the mesh has no texture coordinates", where=f"{owner}.uvs", fix="unwrap it (uv.unwrap)")
    height, width = asset.base_color.shape[:2]
    if max(height, width) > MAX_TEXTURE or min(height, width) < 1:
        raise DataError(
            f"the maps are {width} x {height}",
            where=f"{owner}.base_color",
            expected=f"1 to {MAX_TEXTURE} texels a side",
            fix="fit smaller maps, or reduce them",
        )
    height, width = asset.environment.shape[:2]
    if width != 2 * height:
        raise DataError(f"the environment is {width} x {height}", where=f"{owner}.environment",
                        expected="a lat-long map, twice as wide as high")  # fmt: skip
    for name, (low, high) in _RANGES.items():
        array = getattr(asset, name)
        if array is not None:
            _refuse(owner, name, ~np.isfinite(array), "is not finite", NumericsError)
            _refuse(owner, name, (array < low) | (array > high), f"lies outside [{low:g}, {high:g}]")
    if asset.normal is not None:
        length = np.linalg.norm(asset.normal, axis=-1)
        _refuse(owner, "normal", np.abs(length - 1.0) > 1e-3, "has a vector that is not of unit length")
        _refuse(owner, "normal", asset.normal[..., 2] <= 0.0, "has a vector below the surface (z <= 0)")


def _refuse(
    owner: str, name: str, bad: np.ndarray, what: str, error: type[DataError | NumericsError] = DataError
) -> None:
    """Raise `error` naming the first True element of `bad`."""
    if bad.any():
        index = [int(i) for i in np.argwhere(bad)[0]]
        raise error(
            f"{name}{index} {what} ({int(bad.sum())} of {bad.size} such)",
            where=f"{owner}.{name}",
            fix="mend the node that made the asset; nothing was written",
        )


def clipped(asset: Asset) -> tuple[Asset, dict[str, int]]:
    """Base colour clipped to [0, 1] and light to what a half float holds, with counts; NaN stays for the checks."""
    base = np.clip(asset.base_color, 0.0, 1.0)
    light = np.clip(asset.environment, 0.0, HALF_MAX)
    counts = {
        "base_color_values_clipped": int((base != asset.base_color).sum()),
        "environment_values_clipped": int((light != asset.environment).sum()),
    }
    return replace(asset, base_color=base, environment=light), counts


def check_views(views: Views) -> None:
    """Cameras must be rigid (camera_to_world a proper rotation and a place) and see with positive focal lengths."""
    for name, pose, intrinsics in zip(views.names, views.camera_to_world, views.intrinsics, strict=True):
        turn = pose[:3, :3]
        rigid = np.isfinite(pose).all() and np.allclose(turn @ turn.T, np.eye(3), atol=1e-5)
        if not (rigid and np.linalg.det(turn) > 0 and np.allclose(pose[3], [0, 0, 0, 1])):
            raise DataError(
                "camera_to_world is not rigid", where=f"view {name}",
                expected="a proper rotation without scale or mirroring, and a place", fix="mend the camera file",
            )  # fmt: skip
        if not (np.isfinite(intrinsics).all() and intrinsics[0, 0] > 0 and intrinsics[1, 1] > 0):
            raise DataError("the focal length is not positive", where=f"view {name}", fix="mend the camera file")


def check_frame(frame: Frame) -> tuple[np.ndarray, float]:
    """The rotation [3, 3] and the scale of `frame.scene_from_normalised`; anything but a similarity is refused."""
    matrix = np.asarray(frame.scene_from_normalised, np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise DataError("scene_from_normalised is not a finite 4x4 matrix", where="Frame", expected="float64 [4, 4]")
    linear = matrix[:3, :3]
    scale = float(np.cbrt(np.linalg.det(linear)))
    # A similarity is x -> s R x + t with R orthonormal and det R = +1.
    rotation = linear / scale if scale > 0.0 else linear
    orthonormal = bool(np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-5))
    if not (scale > 0.0 and orthonormal and np.allclose(matrix[3], [0, 0, 0, 1])):
        raise DataError(
            "scene_from_normalised is not a similarity",
            where="Frame",
            expected="one positive scale, a proper rotation and a translation",
            fix="the loader that made the frame must return such a matrix",
        )
    return rotation, scale
