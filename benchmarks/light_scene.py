"""The scene of the light benchmarks: an open box with coloured walls, a ball and a ring in it, under a real sky.

Materials are attributes of the vertices, interpolated over the faces, and normals are those of the faces: two
conventions that every renderer shares exactly, so that differences are differences of the light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks.meshes import grid, torus
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.io.envmaps import canonical_from_blender, read_environment
from exmesh_graph.raster import rasterize
from exmesh_graph.rays import RayTracer
from exmesh_graph.shading import envmap
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.monte_carlo import Coarse, Material, MeshSurface, Points, Query, coarse_points

SKY = Path(__file__).parent.parent / "graphs" / "samples" / "spot" / "env_train.exr"
EYE, TARGET = np.array([0.6, 4.6, 1.5]), np.array([0.0, -0.2, 0.0])
FIELD = math.radians(33)


@dataclass
class Scene:
    """Mesh (vertices [V, 3], faces [F, 3]), vertex attributes [V, 5] (base colour, roughness, metallic), sky
    [H, W, 3], and the image's covered pixels: pixel [N] flat, face [N], bary [N, 3] of an image `size` square."""

    vertices: np.ndarray
    faces: np.ndarray
    attributes: torch.Tensor
    sky: torch.Tensor
    size: int
    pixel: torch.Tensor
    face: torch.Tensor
    bary: torch.Tensor
    surface: MeshSurface
    metallic: bool

    def points(self) -> Points:
        position = self.surface.at(self.face, self.bary)
        flat = self.surface.face_normals[self.face]
        view = torch.nn.functional.normalize(torch.from_numpy(EYE).to(position) - position, dim=-1)
        return Points(position, flat, flat, view)

    def coarse(self) -> Coarse:
        return coarse_points(self.points(), self.pixel, self.size)

    def material(self, attributes: torch.Tensor, face: torch.Tensor, bary: torch.Tensor) -> Material:
        """The attributes [V, 5] read at surface positions; differentiable."""
        read = gather_rows(attributes, self.surface.faces[face], bary.to(attributes))
        return Material(read[:, :3], read[:, 3], read[:, 4] if self.metallic else None)

    def query(self, attributes: torch.Tensor) -> Query:
        def at(face: torch.Tensor, bary: torch.Tensor) -> tuple[torch.Tensor, Material]:
            return self.surface.face_normals[face], self.material(attributes, face, bary)

        return at

    def tracer(self, threads: int | None = None) -> RayTracer:
        from exmesh_graph.rays.embree import EmbreeTracer

        return EmbreeTracer(self.vertices, self.faces, threads)


def build(size: int, sky_height: int = 64, metallic: bool = False, device: torch.device | str = "cpu") -> Scene:
    """The scene seen by an image of size x size pixels."""
    vertices, faces, colours, roughness = _assemble()
    metal = (roughness < 0.3) * 0.8 if metallic else np.zeros_like(roughness)
    attributes = np.column_stack([colours, roughness, metal]).astype(np.float32)
    sky = envmap.resample(canonical_from_blender(read_environment(SKY)), sky_height, 2 * sky_height)
    intrinsics, pose = camera(size)
    surface = MeshSurface(vertices, faces, device)
    fragments = rasterize(
        surface.vertices,
        surface.faces.int(),
        torch.from_numpy(intrinsics).to(device),
        torch.from_numpy(pose).to(device),
        size,
        size,
    )
    face = fragments.face_id.reshape(-1).long()
    # faces seen from behind (the box's outer side) are no part of the image: the BRDF is one-sided
    eye = torch.from_numpy(EYE).to(surface.vertices)
    bary = fragments.bary.reshape(-1, 3)
    known = face.clamp_min(0)
    front = ((eye - surface.at(known, bary)) * surface.face_normals[known]).sum(-1) > 0
    pixel = torch.nonzero((face >= 0) & front)[:, 0]
    return Scene(
        vertices,
        faces,
        torch.from_numpy(attributes).to(device),
        torch.from_numpy(np.ascontiguousarray(sky, np.float32)).to(device),
        size,
        pixel,
        face[pixel],
        bary[pixel].contiguous(),
        surface,
        metallic,
    )


def camera(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Intrinsics [3, 3] and world-to-camera [4, 4] (x right, y down, z forward)."""
    forward = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ EYE
    focal = size / 2 / math.tan(FIELD / 2)
    return np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]]), pose


def _assemble() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    parts, offset = [], 0
    tiles = 16
    plane, plane_faces = grid(tiles, tiles)
    plane = plane * 2 - [1.0, 0.0, 1.0]
    tints = [(0.65, 0.62, 0.55), (0.75, 0.12, 0.1), (0.12, 0.55, 0.15), (0.2, 0.25, 0.75), (0.75, 0.65, 0.2)]
    # the floor, then four walls that face inwards
    walls = [plane - np.array([0, 1, 0])]
    for turn in range(4):
        c, s = math.cos(turn * math.pi / 2), math.sin(turn * math.pi / 2)
        upright = np.stack([plane[:, 1] - 1, -plane[:, 0], plane[:, 2]], axis=1)
        walls.append(upright @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]))
    for number, (points, tint) in enumerate(zip(walls, tints, strict=True)):
        checker = (np.floor(plane[:, 0] * 4 + 0.01) + np.floor(plane[:, 2] * 4 + 0.01)) % 2
        colour = np.array(tint) * (0.7 + 0.3 * checker)[:, None]
        parts.append((points, plane_faces, colour, np.full(len(points), 0.5 if number == 0 else 0.7)))
    ball, ball_faces = icosphere(4, 0.45)
    stripe = np.sin(12 * ball[:, 1:2]) > 0
    ball_colour = np.where(stripe, [0.85, 0.85, 0.85], [0.85, 0.4, 0.1])
    parts.append((ball + np.array([-0.35, -0.5, -0.2]), ball_faces, ball_colour, np.full(len(ball), 0.25)))
    ring, ring_faces = torus(64, 32, 0.35, 0.14)
    sector = np.sin(4 * np.arctan2(ring[:, 0], ring[:, 2])) > 0
    parts.append(
        (ring + np.array([0.45, -0.8, 0.35]), ring_faces, np.full((len(ring), 3), 0.6), np.where(sector, 0.2, 0.6))
    )
    vertices, faces, colours, roughness = [], [], [], []
    for points, part, colour, rough in parts:
        vertices.append(points)
        faces.append(part + offset)
        colours.append(colour)
        roughness.append(rough)
        offset += len(points)
    return (
        np.concatenate(vertices).astype(np.float32),
        np.concatenate(faces).astype(np.int32),
        np.concatenate(colours),
        np.concatenate(roughness),
    )
