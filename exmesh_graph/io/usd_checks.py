"""What must hold of an asset before any file is written (bad input never leaves half an asset behind)."""

from __future__ import annotations

import re

import numpy as np

from exmesh_graph.errors import DataError, GeometryError, NumericsError
from exmesh_graph.types import Asset, Frame

HALF_MAX = 65504.0  # largest finite half float: what an EXR half environment can hold
_UV_TOLERANCE = 1e-6
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


def check_asset(asset: Asset) -> None:
    """Shapes, ranges and finiteness of everything that the export writes.

    Raises GeometryError, NumericsError or DataError that names the array and the first offending element.
    """
    _check_mesh(asset)
    _check_uvs(asset)
    _check_maps(asset)
    _check_environment(asset.environment)


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


def _check_mesh(asset: Asset) -> None:
    vertices, faces = asset.vertices, asset.faces
    _shape("vertices", vertices, (None, 3))
    _shape("faces", faces, (None, 3))
    if len(vertices) == 0 or len(faces) == 0:
        raise GeometryError("the mesh is empty", where="asset.faces", expected="at least one triangle")
    _finite("vertices", vertices)
    _index_range("faces", faces, len(vertices), "vertices")


def _check_uvs(asset: Asset) -> None:
    _shape("uvs", asset.uvs, (None, 2))
    _shape("uv_faces", asset.uv_faces, (len(asset.faces), 3))
    if len(asset.uvs) == 0:
        raise GeometryError("the mesh has no texture coordinates", where="asset.uvs", fix="unwrap it (uv.unwrap)")
    _finite("uvs", asset.uvs)
    _index_range("uv_faces", asset.uv_faces, len(asset.uvs), "uvs")
    _in_range("uvs", asset.uvs, -_UV_TOLERANCE, 1.0 + _UV_TOLERANCE)


def _check_maps(asset: Asset) -> None:
    _shape("base_color", asset.base_color, (None, None, 3))
    height, width = asset.base_color.shape[:2]
    _shape("roughness", asset.roughness, (height, width))
    _shape("seen", asset.seen, (height, width))
    _in_range("base_color", asset.base_color, 0.0, 1.0)
    _in_range("roughness", asset.roughness, 0.0, 1.0)
    if asset.confidence is not None:
        _shape("confidence", asset.confidence, (height, width))
        _in_range("confidence", asset.confidence, 0.0, 1.0)
    if asset.metallic is not None:
        _shape("metallic", asset.metallic, (height, width))
        _in_range("metallic", asset.metallic, 0.0, 1.0)
    if asset.normal is not None:
        _shape("normal", asset.normal, (height, width, 3))
        _finite("normal", asset.normal)
        length = np.linalg.norm(asset.normal, axis=-1)
        _first("normal", np.abs(length - 1.0) > 1e-3, "has a vector that is not of unit length")
        _first("normal", asset.normal[..., 2] <= 0.0, "has a vector below the surface (z <= 0)")


def _check_environment(radiance: np.ndarray) -> None:
    _shape("environment", radiance, (None, None, 3))
    height, width = radiance.shape[:2]
    if width != 2 * height:
        raise DataError(
            f"the environment is {width} x {height}",
            where="asset.environment",
            expected="a lat-long map, twice as wide as high",
        )
    _in_range("environment", radiance, 0.0, HALF_MAX)


def _shape(name: str, array: np.ndarray, shape: tuple[int | None, ...]) -> None:
    fits = array.ndim == len(shape) and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("*" if n is None else str(n) for n in shape)
        raise DataError(f"shape {list(array.shape)} does not fit", where=f"asset.{name}", expected=f"[{wanted}]")


def _finite(name: str, array: np.ndarray) -> None:
    _first(name, ~np.isfinite(array), "is not finite", NumericsError)


def _in_range(name: str, array: np.ndarray, low: float, high: float) -> None:
    _finite(name, array)
    _first(name, (array < low) | (array > high), f"lies outside [{low:g}, {high:g}]")


def _index_range(name: str, indices: np.ndarray, count: int, target: str) -> None:
    bad = (indices < 0) | (indices >= count)
    _first(name, bad, f"points outside the {count} {target}", GeometryError)


def _first(
    name: str, bad: np.ndarray, what: str, error: type[DataError | GeometryError | NumericsError] = DataError
) -> None:
    """Raise `error` naming the first True element of `bad`."""
    if bad.any():
        index = [int(i) for i in np.argwhere(bad)[0]]
        raise error(
            f"{name}{index} {what} ({int(bad.sum())} of {bad.size} such)",
            where=f"asset.{name}",
            fix="mend the node that made the asset; nothing was written",
        )
