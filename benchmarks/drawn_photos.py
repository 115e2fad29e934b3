"""As many pictures as asked for of the decoy of graphs/samples/photos, with paint of its own, drawn on this machine.

    python -m benchmarks.drawn_photos FOLDER [--count 200]

Paint is noise in space (two octaves), so that object and table need no atlas; one light from above, no shadow, 360 x
270 pixels, each the mean of four. The cameras go around on a spiral, and their poses are written as the sample's are.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import map_coordinates

from benchmarks.photo_sample import SAMPLE
from benchmarks.scenes.cameras import spiral
from exmesh_graph.io.reduce import downscale_area
from exmesh_graph.native import import_open3d
from exmesh_graph.raster import rasterize

WIDTH, HEIGHT, FINE, FOCAL = 360, 270, 2, 480.0
HEIGHTS, TABLE, LIGHT = (0.25, 0.8), 2.0, np.array([0.4, 0.3, 0.87])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=200)
    options = parser.parse_args()
    draw(options.folder, options.count)


def draw(folder: Path, count: int) -> Path:
    """`images/` and `truth/` in `folder`, which is handed back."""
    from PIL import Image

    for place in ("images", "truth"):
        (folder / place).mkdir(parents=True, exist_ok=True)
    mesh = import_open3d().io.read_triangle_mesh(str(SAMPLE / "truth" / "object.ply"))
    vertices, faces, paint = _on_a_table(np.asarray(mesh.vertices), np.asarray(mesh.triangles))
    poses = spiral(count, *HEIGHTS, 0.0, 0)
    cameras = {}
    for k, pose in enumerate(poses):
        name = f"IMG_{1001 + k}.jpg"
        seen = downscale_area(_picture(vertices, faces, paint, pose @ np.diag([1.0, -1, -1, 1])), FINE)
        Image.fromarray(np.round(255 * seen).astype(np.uint8)).save(folder / "images" / name, quality=92)
        cameras[name] = pose.tolist()
    (folder / "truth" / "cameras.json").write_text(json.dumps({"camera_to_world": cameras}) + "\n", encoding="utf-8")
    (folder / "truth" / "object.ply").write_bytes((SAMPLE / "truth" / "object.ply").read_bytes())
    return folder


def _on_a_table(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The object (z up) and a square below it; linear tint [F, 3] of each face."""
    low, middle = vertices[:, 2].min(), vertices[:, :2].mean(axis=0)
    corners = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]) * TABLE + middle
    square = np.column_stack([corners, np.full(4, low)])
    table = len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])
    tints = np.repeat([[0.9, 0.65, 0.35], [0.45, 0.5, 0.6]], [len(faces), 2], axis=0)
    return np.concatenate([vertices, square]), np.concatenate([faces, table]), tints


def _picture(vertices: np.ndarray, faces: np.ndarray, tints: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Display values [FINE HEIGHT, FINE WIDTH, 3]; `pose` looks along +z, y down."""
    width, height, focal = FINE * WIDTH, FINE * HEIGHT, FINE * FOCAL
    k = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    seen = rasterize(
        torch.tensor(vertices, dtype=torch.float32), torch.tensor(faces, dtype=torch.int32), torch.from_numpy(k),
        torch.from_numpy(np.linalg.inv(pose)), height, width,
    )  # fmt: skip
    face, depth = seen.face_id.numpy().reshape(height, width), seen.depth.numpy().reshape(height, width)
    x, y = np.meshgrid((np.arange(width) + 0.5 - width / 2) / focal, (np.arange(height) + 0.5 - height / 2) / focal)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ pose[:3, :3].T
    places = rays * np.where(face >= 0, depth, 8.0)[..., None] + pose[:3, 3]  # behind it a wall that is no wall
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shade = np.where(face >= 0, 0.35 + 0.65 * (normals @ LIGHT).clip(0)[face], 0.3)
    tint = np.where((face >= 0)[..., None], tints[face], 0.5)
    return (tint * shade[..., None] * (0.35 + _noise(places))[..., None]).clip(0, 1) ** (1 / 2.2)


def _noise(places: np.ndarray) -> np.ndarray:
    """[H, W] in 0 to 1.2 at places [H, W, 3]: values at whole numbers, linear between, in two sizes."""
    grid = np.random.default_rng(0).random((48, 48, 48))
    turned = np.moveaxis(places, -1, 0)
    return sum(part * map_coordinates(grid, turned * rate, order=1, mode="grid-wrap")
               for part, rate in ((0.7, 40.0), (0.5, 11.0)))  # fmt: skip


if __name__ == "__main__":
    main()
