"""What the shape alone tells: how much of itself it sees, and how pixels and texels lie on it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from exmesh_graph.geometry.adjacency import face_areas
from exmesh_graph.shading.lattice import points_of_face
from exmesh_graph.types import Carrier, Transport

#: A point counts as occluded from this share of its cosine-weighted hemisphere on.
OCCLUDED = 0.1


@dataclass(frozen=True)
class ShapeMeasures:
    """Measures of a mesh, area-weighted means over its surface.

    blocked    share of the cosine-weighted hemisphere that is no sky
    concavity  the part of it that meets front faces: the mean form factor of the mesh with itself. Times the albedo,
               the share of a point's light that has met the surface before
    occluded   share of the surface where more than a tenth of the hemisphere is blocked
    """

    blocked: float
    concavity: float
    occluded: float


def measure_shape(light: Transport, vertices: np.ndarray, faces: np.ndarray) -> ShapeMeasures:
    """Occlusion and concavity of a traced mesh (types.Transport, with or without bounces)."""
    count, directions = len(light.points), len(light.directions)
    cosine = np.maximum(light.normals @ light.directions.T, 0)
    seen = np.unpackbits(light.visible, axis=1, count=directions, bitorder="little")
    # the mean over the cosine-weighted directions themselves: a flat open face has exactly 0 blocked
    whole = np.maximum(cosine.sum(axis=1), 1e-12)
    blocked = 1 - (cosine * seen).sum(axis=1) / whole
    hit = np.maximum((light.normals[light.hit_point] * light.directions[light.hit_direction]).sum(axis=1), 0)
    met = np.bincount(light.hit_point, weights=hit, minlength=count) / whole
    area = _point_areas(light, vertices, faces)
    share = area / area.sum()
    return ShapeMeasures(
        blocked=float(share @ blocked), concavity=float(share @ met), occluded=float(share @ (blocked > OCCLUDED))
    )


def _point_areas(light: Transport, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The surface [P] that each lattice point stands for: every face's area, shared evenly among its points."""
    count = points_of_face(light.steps)
    per_point = np.repeat(face_areas(vertices, faces) / count, count)
    return np.bincount(light.face_points, weights=per_point, minlength=len(light.points))


#: Pixels of all views that a texel should get at least, and the quarter of pixels that are finest on the surface.
LEAST_PIXELS, FINEST = 4.0, 0.25


@dataclass(frozen=True)
class TexelBudget:
    """How pixels and texels lie on the surface.

    pixel_side        length on the surface that a pixel of the finest quarter covers, scene units
    texture_size      side of the atlas whose texels are as large, a multiple of 64
    pixels_per_texel  pixels of all training views that one of its texels gets, mean over the surface
    """

    pixel_side: float
    texture_size: int
    pixels_per_texel: float


def texel_budget(carrier: Carrier, footprints: np.ndarray, pixels: float) -> TexelBudget:
    """The atlas that the pictures can feed.

    footprints  areas on the surface that pixels cover [N], scene units squared, in any number of views
    pixels      object pixels of all training views together
    """
    side = math.sqrt(float(np.quantile(footprints, FINEST)))
    surface = float(face_areas(carrier.vertices, carrier.faces).sum())
    used = max(_atlas_share(carrier), 1e-6)
    wanted = math.sqrt(surface / used) / max(side, 1e-12)
    size = int(np.clip(64 * math.ceil(min(wanted, fed_side(carrier, pixels)) / 64), 64, 8192))
    return TexelBudget(side, size, pixels / (size * size * used))


def fed_side(carrier: Carrier, pixels: float) -> float:
    """Side of the atlas whose texels get `LEAST_PIXELS` of `pixels` each."""
    return math.sqrt(pixels / LEAST_PIXELS / max(_atlas_share(carrier), 1e-6))


def _atlas_share(carrier: Carrier) -> float:
    """Share of the unit square that charts cover."""
    a, b, c = (np.asarray(carrier.uvs, np.float64)[carrier.uv_faces[:, k]] for k in range(3))
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    return float(np.abs(ux * vy - uy * vx).sum() / 2)
