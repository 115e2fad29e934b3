"""What an export holds, in scene units: where the normalised world lies on the stage, meshes and cameras there."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from exmesh_graph.export.inputs import check_asset, check_frame, check_name, without_vanished
from exmesh_graph.export.maps import prepare_maps
from exmesh_graph.export.settings import FileSettings
from exmesh_graph.types import Asset, Frame, Views

UpAxis = Literal["Y", "Z"]
COARSE_ROUNDING = 5e-6
"""Point rounding, in radii of the object: above it, pictures of the file may be less than 60 dB from the asset's."""
_Z_FROM_Y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # +90 degrees about x: +Y becomes +Z
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])
LODS = ("high", "mid", "low")


@dataclass(frozen=True, eq=False)
class MeshContent:
    """points, normals float32 [V, 3]; faces int32 [F, 3]; st float32 [T, 2] (v up, distinct); st_faces int32 [F, 3]"""

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    st: np.ndarray
    st_faces: np.ndarray

    @property
    def extent(self) -> np.ndarray:
        """float32 [2, 3], the corners of the bounding box."""
        return np.stack([self.points.min(0), self.points.max(0)])


@dataclass(frozen=True, eq=False)
class CameraContent:
    """One capture camera. `name` is a prim name, `view` what the data set calls it.

    matrix      float64 [4, 4], camera to world, scene units, rigid; OpenGL axes (x right, y up, looks along -z)
    intrinsics  float64 [3, 3], pixels of a `width` x `height` picture
    near, far   what the clipping range spans, scene units
    """

    name: str
    view: str
    matrix: np.ndarray
    intrinsics: np.ndarray
    width: int
    height: int
    near: float
    far: float


@dataclass(frozen=True, eq=False)
class Placement:
    """The similarity x -> scale rotation x + offset from the normalised Y-up world to the stage."""

    rotation: np.ndarray
    scale: float
    offset: np.ndarray
    metres_per_unit: float
    up_axis: UpAxis
    report: dict[str, Any]

    def points(self, points: np.ndarray) -> np.ndarray:
        """float64 [N, 3] on the stage."""
        return np.asarray(points, np.float64) @ (self.scale * self.rotation).T + self.offset


@dataclass(frozen=True, eq=False)
class AssetContent:
    """Everything that the layers need.

    meshes    by level of detail, finest first; the first is "high"
    files     level of detail -> map name (base_color, roughness, normal, metallic) -> file below textures/
    placement where it lies on the stage; light from d is E(rotation^T d)
    """

    name: str
    meshes: Mapping[str, MeshContent]
    files: Mapping[str, Mapping[str, str]]
    placement: Placement
    cameras: tuple[CameraContent, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def maps(self) -> tuple[str, ...]:
        """Names of the maps; all levels of detail have the same ones."""
        return tuple(sorted(self.files["high"]))


def place(frame: Frame | None, up_axis: UpAxis = "Y", *, recentre: bool = False) -> Placement:
    """Without a frame the points stay in normalised units; an unknown scale counts as one metre per unit.

    recentre  the normalised origin (the object's middle) becomes the stage's; what it was moved by is reported
    """
    upright = _Z_FROM_Y if up_axis == "Z" else np.eye(3)
    if frame is None:
        report: dict[str, Any] = {"metres_per_unit": 1.0, "scale": "normalised", "scene_units_per_normalised": 1.0}
        return Placement(upright, 1.0, np.zeros(3), 1.0, up_axis, report)
    rotation, size = check_frame(frame)
    matrix = np.asarray(frame.scene_from_normalised, np.float64)
    known = frame.metres_per_unit > 0
    metres = float(frame.metres_per_unit) if known else 1.0
    report = {
        "metres_per_unit": metres,
        "scale": "measured" if known else "unknown",
        "scene_units_per_normalised": size,
        "scene_from_normalised": matrix.tolist(),
    }
    offset = upright @ matrix[:3, 3]
    if recentre:  # what to add to a point of the stage to be where the scene has it
        report |= {f"recentred_by_{axis}": float(value) for axis, value in zip("xyz", offset, strict=True)}
        offset = np.zeros(3)
    report |= {f"origin_{axis}": float(value) for axis, value in zip("xyz", offset, strict=True)}  # on the stage
    return Placement(upright @ rotation, size, offset, metres, up_axis, report)


def mesh_content(asset: Asset, placement: Placement) -> MeshContent:
    """The asset's mesh on the stage, with the smooth normals that Stage II shaded with."""
    from exmesh_graph.geometry.adjacency import angle_weighted_normals

    normals = angle_weighted_normals(asset.vertices, asset.faces)
    normals[~normals.any(axis=1)] = [0.0, 1.0, 0.0]  # vertices without any area around them still need a unit normal
    used, places = _distinct(np.clip(asset.uvs, 0.0, 1.0).astype(np.float32), asset.uv_faces)
    return MeshContent(
        points=placement.points(asset.vertices).astype(np.float32),
        normals=(normals @ placement.rotation.T).astype(np.float32),
        faces=asset.faces.astype(np.int32),
        st=used,
        st_faces=places,
    )


def file_content(
    asset: Asset, frame: Frame | None, settings: FileSettings
) -> tuple[Asset, dict[str, np.ndarray], Placement, MeshContent, dict[str, Any]]:
    """(the asset without vanished parts, maps as `export.maps.prepare_maps`, placement, its mesh, what was measured) of
    an asset that goes into one file."""
    check_name(settings.name)
    check_asset(asset)
    asset = without_vanished(asset)
    maps, report = prepare_maps(asset, settings)
    placement = place(frame, recentre=settings.recentre)
    report |= mesh_report(asset, placement) | placement.report
    return asset, maps, placement, mesh_content(asset, placement), report


def camera_contents(views: Views, placement: Placement, reach: float) -> tuple[CameraContent, ...]:
    """The views' cameras on the stage; `reach` [scene units] from the stage's `offset` holds the object."""
    cameras: list[CameraContent] = []
    for view, intrinsics, pose in zip(views.names, views.intrinsics, views.camera_to_world, strict=True):
        matrix = np.eye(4)
        matrix[:3, :3] = placement.rotation @ pose[:3, :3] @ _OPENGL_FROM_OPENCV
        matrix[:3, 3] = placement.points(pose[None, :3, 3])[0]
        distance = float(np.linalg.norm(matrix[:3, 3] - placement.offset))
        name = "view_" + re.sub(r"[^A-Za-z0-9_]", "_", view)
        if any(camera.name == name for camera in cameras):
            name += f"_{len(cameras)}"  # "a.b" and "a_b": prim names are narrower than file names
        near = max(distance - 2 * reach, 1e-3 * distance)
        cameras.append(
            CameraContent(name, view, matrix, np.asarray(intrinsics), views.width, views.height, near,
                          distance + 2 * reach)
        )  # fmt: skip
    return tuple(cameras)


def mesh_report(asset: Asset, placement: Placement) -> dict[str, Any]:
    """What matters to a user of the mesh: counts, and how far the file's float32 moves points, in radii of the object.

    Signed texture area < 0 marks a mirrored face.
    """
    from exmesh_graph.geometry.adjacency import signed_areas_2d

    exact = placement.points(asset.vertices)
    radius = float(np.linalg.norm(exact - placement.offset, axis=1).max())
    moved = float(np.abs(exact.astype(np.float32) - exact).max())
    area = signed_areas_2d(asset.uvs, asset.uv_faces)
    facets = asset.facets()
    return {
        "faces": len(asset.faces),
        "vertices": len(asset.vertices),
        "point_rounding": float(f"{moved / max(radius, 1e-300):.2g}"),
        "closed": bool(facets["closed"]),
        "manifold": bool(facets["manifold"]),
        "mirrored_uv_faces": int((area < 0).sum()),
        "degenerate_uv_faces": int((area == 0).sum()),
    }


def _distinct(uvs: np.ndarray, uv_faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distinct coordinates that faces use, and the indices into them: float32 [T, 2], int32 [F, 3]."""
    pairs = np.ascontiguousarray(uvs[uv_faces.reshape(-1)] + np.float32(0)).view(np.uint64)[:, 0]  # + 0: no -0
    _, first, place = np.unique(pairs, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))  # in the order of first use: neighbours stay near each other
    used = uvs[uv_faces.reshape(-1)[np.sort(first)]]
    return used, order[place.reshape(-1)].reshape(-1, 3).astype(np.int32)
