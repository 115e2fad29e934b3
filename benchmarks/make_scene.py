"""A scene to choose settings on, so that no scored scene is used for it: a closed object with a bowl and an arch that
no outline shows, a thin ring and a fin, and fine relief on a small part of its surface.

    python -m benchmarks.make_scene FOLDER            # 48 + 12 views of 256 x 256 pixels, about a minute

Writes the layout that `data.blender` reads, with the true mesh. The surface is a signed distance by marching cubes, its
colours are smooth noise and stripes at the vertices, lit there without noise: matt and a broad gloss under the sky of
graphs/samples/spot, with shadows but no light between surfaces. The same bytes on every run.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np
import torch
from skimage.measure import marching_cubes

from benchmarks.meshes import write_ply
from exmesh_graph.geometry.adjacency import area_weighted_normals
from exmesh_graph.io.envmaps import canonical_from_blender, read_environment
from exmesh_graph.io.images import encode_rgba, write_image
from exmesh_graph.raster import rasterize
from exmesh_graph.rays.embree import EmbreeTracer
from exmesh_graph.rays.tracer import offset_origins
from exmesh_graph.shading import envmap
from exmesh_graph.shading.point_sets import fibonacci_sphere

SKY = Path(__file__).parent.parent / "graphs" / "samples" / "spot" / "env_train.exr"
RADIUS, DISTANCE, FIELD = 1.2, 4.0, math.radians(35.5)
DIRECTIONS = 192
RELIEF = np.array([0.0, 0.62, 0.0])


def main() -> None:
    options = arguments()
    vertices, faces = surface(options.grid)
    colours = paint(vertices)
    folder: Path = options.folder
    (folder / "mesh").mkdir(parents=True, exist_ok=True)
    write_ply(folder / "mesh" / "mesh.ply", vertices, faces)
    light = Light(vertices, faces, colours, options.gloss)
    for split, count, first in (("train", options.views, 0.0), ("test", options.test_views, 0.37)):
        (folder / split).mkdir(exist_ok=True)
        frames = []
        for number, pose in enumerate(poses(count, first)):
            rgba = photograph(light, faces, pose, options.size)
            write_image(folder / split / f"{number:03d}_rgba.png", rgba)
            frames.append({"file_path": f"{split}/{number:03d}", "transform_matrix": pose.tolist()})
        record = {"camera_angle_x": FIELD, "w": options.size, "h": options.size, "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(f"{len(vertices)} vertices, {len(faces)} faces, {options.views} + {options.test_views} views in {folder}")


def surface(grid: int) -> tuple[np.ndarray, np.ndarray]:
    """(vertices float32 [V, 3], faces int32 [F, 3]) of the object, z up, all within 1.2 of the origin."""
    axis = np.linspace(-1.25, 1.25, grid)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).astype(np.float32)
    values = np.concatenate([distance(slab) for slab in np.array_split(points, 16)])
    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    vertices = -1.25 + vertices * (axis[1] - axis[0])
    middle = (vertices.min(0) + vertices.max(0)) / 2
    vertices = (vertices - middle) * (RADIUS / np.linalg.norm(vertices - middle, axis=1).max())
    return vertices.astype(np.float32), faces.astype(np.int32)


def distance(p: np.ndarray) -> np.ndarray:
    """About the signed distance of points [..., 3], negative inside."""

    def ball(centre: tuple[float, ...], radii: tuple[float, ...]) -> np.ndarray:
        scaled = np.linalg.norm((p - np.float32(centre)) / np.float32(radii), axis=-1)
        return (scaled - 1) * min(radii)

    x, y, z = np.moveaxis(p, -1, 0)
    body = ball((0, 0, 0), (0.85, 0.62, 0.5))
    for centre in ((0.5, 0.36, -0.5), (0.5, -0.36, -0.5), (-0.55, 0.0, -0.5)):  # the feet; an arch between them
        body = blend(body, ball(centre, (0.2, 0.2, 0.36)), 0.12)
    body = blend(body, ball((0.78, 0, 0.45), (0.33, 0.28, 0.28)), 0.15)
    body = -blend(-body, ball((-0.2, 0, 0.5), (0.38, 0.3, 0.36)), 0.05)  # the bowl
    body = -blend(-body, ball((0.1, 0, -0.62), (0.5, 0.3, 0.3)), 0.08)
    around = np.hypot(np.hypot(x + 0.85, z - 0.12) - 0.25, y) - 0.05  # the ring
    fin = np.maximum(np.abs(y) - 0.03, ball((0.85, 0, 0.72), (0.3, 0.6, 0.3)))
    body = blend(blend(body, around, 0.03), fin, 0.04)
    near = np.exp(-(np.square((p - RELIEF) / np.float32((0.3, 0.4, 0.24))).sum(-1) ** 2))
    return body - 0.016 * near * np.sin(30 * x) * np.sin(30 * z)


def blend(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Union of two distances, rounded over `width`."""
    near = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - near**2 * width / 4


def paint(vertices: np.ndarray) -> np.ndarray:
    """Base colour float32 [V, 3], linear."""
    rng = np.random.default_rng(7)
    colour = np.zeros((len(vertices), 3))
    for frequency in (3, 6, 12, 24):
        for _ in range(6):
            wave = rng.normal(size=3)
            phase = vertices @ (frequency * wave / np.linalg.norm(wave)) + rng.uniform(0, 6)
            colour += np.sin(phase)[:, None] * rng.normal(size=3) / math.sqrt(frequency)
    colour = 0.42 + 0.09 * colour
    stripes = (np.sin(9 * vertices[:, 0] + 2 * np.sin(3 * vertices[:, 2])) > 0.75)[:, None]
    return np.clip(np.where(stripes, colour * [0.35, 0.5, 0.9], colour), 0.03, 0.85).astype(np.float32)


def poses(count: int, first: float) -> list[np.ndarray]:
    """Camera-to-world [4, 4] of the Blender convention on a spiral from 25 degrees below the horizon to 75 above."""
    found = []
    for k in range(count):
        height = math.sin(math.radians(-25)) + (k + 0.5) / count * (
            math.sin(math.radians(75)) - math.sin(math.radians(-25))
        )
        turn = (k + first) * math.pi * (3 - math.sqrt(5)) + first
        level = math.sqrt(1 - height**2)
        back = np.array([level * math.cos(turn), level * math.sin(turn), height])
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.column_stack([right, np.cross(back, right), back, DISTANCE * back])
        found.append(pose)
    return found


class Light:
    """Light at the vertices: matt and a broad gloss (Phong, exponent 20) under a blurred sky with exact shadows."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray, gloss: float) -> None:
        self.gloss = gloss
        normals = area_weighted_normals(vertices, faces)
        towards = fibonacci_sphere(DIRECTIONS)
        sky = torch.from_numpy(envmap.resample(canonical_from_blender(read_environment(SKY)), 8, 16))
        # the sky's up is +y, the scene's +z
        radiance = envmap.lookup(sky, torch.from_numpy(towards[:, [0, 2, 1]] * [1.0, 1, -1]).to(sky)).numpy()
        tracer = EmbreeTracer(vertices, faces)
        origins = offset_origins(vertices, normals, 100 * tracer.radius).astype(np.float32)
        open_sky = np.empty((len(vertices), DIRECTIONS), bool)
        for k, direction in enumerate(towards):
            open_sky[:, k] = normals @ direction > 0
            rows = np.flatnonzero(open_sky[:, k])
            rays = np.broadcast_to(direction.astype(np.float32), (len(rows), 3))
            open_sky[rows, k] = ~tracer.any_hit(origins[rows], np.ascontiguousarray(rays))
        self.vertices, self.normals = torch.from_numpy(vertices), torch.from_numpy(normals).float()
        self.towards, self.open_sky = torch.from_numpy(towards).float(), torch.from_numpy(open_sky)
        self.radiance = torch.from_numpy(radiance).float() * (4 * math.pi / DIRECTIONS)
        arriving = (self.normals @ self.towards.T).clamp(min=0) * self.open_sky
        self.matt = torch.from_numpy(colours) / math.pi * (arriving @ self.radiance)

    def seen_from(self, eye: np.ndarray) -> torch.Tensor:
        """Linear colour float32 [V, 3]."""
        view = torch.nn.functional.normalize(torch.from_numpy(eye).float() - self.vertices, dim=1)
        mirror = 2 * (view * self.normals).sum(1, keepdim=True) * self.normals - view
        lobe = (mirror @ self.towards.T).clamp(min=0).pow(20) * self.open_sky
        return self.matt + self.gloss * 21 / (2 * math.pi) * (lobe @ self.radiance)


def photograph(light: Light, faces: np.ndarray, pose: np.ndarray, size: int, fine: int = 3) -> np.ndarray:
    """float32 [size, size, 4], sRGB-encoded colour with straight alpha; fine^2 samples a pixel."""
    world_to_camera = torch.from_numpy(np.linalg.inv(pose @ np.diag([1.0, -1, -1, 1])))
    focal = fine * size / 2 / math.tan(FIELD / 2)
    half = fine * size / 2
    intrinsics = torch.tensor([[focal, 0, half], [0, focal, half], [0, 0, 1.0]], dtype=torch.float64)
    table = torch.from_numpy(faces)
    seen = rasterize(light.vertices, table, intrinsics, world_to_camera, fine * size, fine * size)
    corners = light.seen_from(pose[:3, 3])[table.long()[seen.face_id.clamp(min=0).long()]]
    covered = (seen.face_id >= 0)[..., None]
    colour = (seen.bary[..., None] * corners).sum(-2) * covered
    rgba = torch.cat([colour, covered.to(colour)], dim=-1).view(size, fine, size, fine, 4).mean(dim=(1, 3)).numpy()
    return encode_rgba(rgba[..., :3], rgba[..., 3])


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.make_scene",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--size", type=int, default=256, help="pixels on a side")
    parser.add_argument("--views", type=int, default=48)
    parser.add_argument("--test-views", type=int, default=12)
    parser.add_argument("--grid", type=int, default=192, help="samples along each axis of the distance field")
    parser.add_argument("--gloss", type=float, default=0.08, help="share of light in the broad highlights")
    parser.add_argument("--quick", action="store_true", help="small")
    options = parser.parse_args()
    if options.quick:
        options.size, options.views, options.test_views, options.grid = 64, 8, 2, 96
    return options


if __name__ == "__main__":
    main()
