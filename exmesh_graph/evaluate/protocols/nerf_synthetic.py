"""NeRF-Synthetic's Chamfer distance, on what the test cameras see and on the whole surface.

There is no standard: nvdiffrec samples the whole surface, NeRF2Mesh and AniSDF take first hits of rays from the test
cameras (so only visible surface). Both are given here: un-squared, mean of the two directions' means, in thousandths
of the data set's own (Blender) unit, with the numbers of samples. ExMesh++ states no unit for its figure, so figures
are for comparing variants of one program only.

Distances are to the exact triangles of the other surface, not to its samples: a figure does not fall with more samples.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.evaluate.metrics.distance import distance_to_mesh
from exmesh_graph.evaluate.metrics.mesh import chamfer
from exmesh_graph.evaluate.scores import benchmark_row
from exmesh_graph.io.normalise import frame_scale
from exmesh_graph.rays.embree import EmbreeTracer
from exmesh_graph.types import Carrier, Frame, Mesh, SceneTruth, Views


@dataclass(frozen=True)
class SurfaceDistance:
    """Means of distances in thousandths of a unit: both directions, and the numbers of points behind them."""

    chamfer: float
    accuracy: float
    completeness: float
    mesh_points: int
    true_points: int


def score_surface(
    mesh: Mesh, truth: SceneTruth, views: Views, frame: Frame, scene: str, *, samples: int = 100_000, seed: int = 0
) -> dict[str, Any]:
    """NeRF-Synthetic's Chamfer distances, visible and full surface, in thousandths of the data set's unit, and, for a
    carrier, its held-out PSNR.

    Raises DataError without a true mesh.
    """
    from exmesh_graph.evaluate.carrier import score_carrier

    if truth.mesh_vertices is None or truth.mesh_faces is None:
        raise DataError(
            "the scene has no true mesh", where=scene, expected="mesh.obj or mesh.ply in the scene's folder",
            fix="export it from the scene's .blend file, in its world and units",
        )  # fmt: skip
    both = (mesh.vertices, mesh.faces, truth.mesh_vertices, truth.mesh_faces)
    unit = 1 / frame_scale(frame)
    size = (views.width, views.height)
    seen = visible_surface(*both, views.intrinsics, views.camera_to_world, size, unit=unit, samples=samples, seed=seed)
    whole = full_surface(*both, unit=unit, samples=samples, seed=seed)
    psnr = score_carrier(mesh, views).values["held_out"]["psnr"] if isinstance(mesh, Carrier) else None
    row: dict[str, float | None] = {
        "CD visible": seen.chamfer, "CD full": whole.chamfer, "PSNR": psnr,
        "vertices": float(len(mesh.vertices)),
    }  # fmt: skip
    values = {"visible": asdict(seen), "full": asdict(whole)}
    return values | benchmark_row(
        "nerf_synthetic", scene, row, {"CD visible": "lower", "CD full": "lower", "vertices": ""}
    )


def full_surface(
    vertices: np.ndarray,
    faces: np.ndarray,
    true_vertices: np.ndarray,
    true_faces: np.ndarray,
    *,
    unit: float = 1.0,
    samples: int = 100_000,
    seed: int = 0,
) -> SurfaceDistance:
    """Over the whole of both surfaces, inner ones included; `unit` is the length of the data set's unit in V's."""
    d = chamfer(vertices, faces, true_vertices, true_faces, samples=samples, seed=seed)
    to = 1000 / unit
    return SurfaceDistance(d.chamfer * to, d.accuracy * to, d.completeness * to, samples, samples)


def visible_surface(
    vertices: np.ndarray,
    faces: np.ndarray,
    true_vertices: np.ndarray,
    true_faces: np.ndarray,
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    size: tuple[int, int],
    *,
    unit: float = 1.0,
    samples: int = 100_000,
    seed: int = 0,
) -> SurfaceDistance:
    """Over the first hits of random rays through the pictures [N cameras] of `size` (width, height); the same rays for
    both surfaces. `samples` is the number of rays; those that miss give no point.
    """
    cameras = (intrinsics, camera_to_world, size, samples, seed)
    ours, truth = visible_points(vertices, faces, *cameras), visible_points(true_vertices, true_faces, *cameras)
    if len(ours) == 0 or len(truth) == 0:
        raise GeometryError(
            f"of {samples} rays from the test cameras {len(ours)} hit the mesh and {len(truth)} the true surface",
            fix="check that mesh, truth and cameras are in one world",
        )
    accuracy = 1000 / unit * float(distance_to_mesh(ours, true_vertices, true_faces).mean())
    completeness = 1000 / unit * float(distance_to_mesh(truth, vertices, faces).mean())
    return SurfaceDistance((accuracy + completeness) / 2, accuracy, completeness, len(ours), len(truth))


def visible_points(
    vertices: np.ndarray,
    faces: np.ndarray,
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    size: tuple[int, int],
    samples: int,
    seed: int,
) -> np.ndarray:
    """First hits float64 [P, 3] of `samples` seeded rays, uniform over the pictures (K [N, 3, 3], poses [N, 4, 4],
    OpenCV axes, pixel centres at +0.5)."""
    generator = np.random.default_rng(seed)
    camera = generator.integers(len(intrinsics), size=samples)
    pixel = np.c_[generator.random((samples, 2)) * size, np.ones(samples)]
    local = np.einsum("nij,nj->ni", np.linalg.inv(intrinsics)[camera], pixel)
    directions = np.einsum("nij,nj->ni", camera_to_world[camera, :3, :3], local)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = camera_to_world[camera, :3, 3]
    hits = EmbreeTracer(vertices, faces).closest_hit(origins, directions)
    hit = hits.face >= 0
    corners = np.asarray(vertices, np.float64)[np.asarray(faces)[hits.face[hit]]]
    return np.einsum("nk,nki->ni", hits.bary[hit].astype(np.float64), corners)
