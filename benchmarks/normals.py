"""How far the normals of a run's mesh are off those of the true surface, in the test views of a rendered scene.

    exmesh run graphs/quickstart.yaml --set scene=FOLDER/niche --node settle
    python -m benchmarks.normals runs/latest FOLDER/niche [--node settle] [--picture FILE]

Degrees, the mean over pixels that both surfaces cover: of all, and of those of smooth places, where the true normals of
the 25 pixels around lie within 14 degrees. The picture has the first test view: truth, ours, the angle (white: 30
degrees).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from exmesh_graph import open_run
from exmesh_graph.geometry.adjacency import angle_weighted_normals
from exmesh_graph.io.images import read_image
from exmesh_graph.raster import rasterize
from exmesh_graph.types import Mesh, Views

ALIKE = np.cos(np.radians(14.0))
FULL = 0.9
"""Length of a true normal of a pixel that is covered."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("scene", type=Path, help="its folder, with test/000_normal.exr")
    parser.add_argument("--node", default="settle", help="whose mesh: settle, rounds, retouch, ...")
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    run = open_run(options.run)
    views, frame = run["views"].test, run["views"].frame
    node = run[options.node]
    mesh = node.asset if options.node in ("pbr", "reshape", "retouch") else node.state
    turn = _rotation(frame.dataset_from_scene @ frame.scene_from_normalised)
    every, smooth = [], []
    for view in range(len(views.names)):
        ours, covered = shown_normals(mesh, views, view)
        truth = read_image(options.scene / "test" / f"{view:03d}_normal.exr")[..., :3] @ turn
        length = np.linalg.norm(truth, axis=-1)
        truth = truth / np.maximum(length, 1e-9)[..., None]
        both = covered & (length > FULL)
        angle = np.degrees(np.arccos(np.clip((ours * truth).sum(-1), -1, 1)))
        every.append(angle[both].mean())
        smooth.append(angle[_smooth(truth, both)].mean())
        if view == 0 and options.picture:
            _draw(options.picture, truth, ours, np.where(both, angle, 0.0))
    print(f"normals off by {np.mean(every):.2f} degrees, in smooth places by {np.mean(smooth):.2f}")


def shown_normals(mesh: Mesh, views: Views, view: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals [H, W, 3] of the mesh as shading has them in a view, and what it covers, bool [H, W]."""
    camera = (torch.from_numpy(np.asarray(a[view], np.float32)) for a in (views.intrinsics, views.world_to_camera))
    vertices, faces = (torch.from_numpy(np.array(a)) for a in (mesh.vertices, mesh.faces))
    seen = rasterize(vertices.float(), faces.int(), *camera, views.height, views.width)
    covered = seen.face_id.numpy() >= 0
    corners = angle_weighted_normals(mesh.vertices, mesh.faces)[np.asarray(mesh.faces)[seen.face_id.numpy()[covered]]]
    mixed = (seen.bary.numpy()[covered][..., None] * corners).sum(1)
    normals = np.zeros((*covered.shape, 3))
    normals[covered] = mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-12)
    return normals, covered


def _rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation [3, 3] of a similarity [4, 4]; n @ it takes normals back."""
    left, _, right = np.linalg.svd(np.asarray(matrix, np.float64)[:3, :3])
    return left @ right


def _smooth(truth: np.ndarray, both: np.ndarray) -> np.ndarray:
    chosen = both.copy()
    for down in range(-2, 3):
        for right in range(-2, 3):
            beside = np.roll(truth, (down, right), (0, 1))
            chosen &= np.roll(both, (down, right), (0, 1)) & ((beside * truth).sum(-1) > ALIKE)
    return chosen


def _draw(path: Path, truth: np.ndarray, ours: np.ndarray, angle: np.ndarray) -> None:
    from PIL import Image

    off = np.repeat(np.clip(angle / 30, 0, 1)[..., None], 3, axis=-1)
    row = np.concatenate([(truth + 1) / 2, (ours + 1) / 2, off], axis=1)
    Image.fromarray((255 * row).round().astype(np.uint8)).save(path)


if __name__ == "__main__":
    main()
