"""A scene's copy elsewhere, in other units, turned, or on wider pictures: a run must come to the same figures.

    python -m benchmarks.moved graphs/samples/spot FOLDER           # FOLDER/large, small, turned, padded
    exmesh run graphs/quickstart.yaml --set scene=FOLDER/large      # and the others

The scene is one in the layout of `graphs/samples/spot`. `turned` has no relit views: their
lights would have to turn too.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation


class Move(NamedTuple):
    """x -> scale * turn x + shift, and black pixels (above, below), (left, right) about every picture."""

    scale: float = 1.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)  # a rotation vector
    margin: tuple[tuple[int, int], tuple[int, int]] = ((0, 0), (0, 0))

    def points(self, points: np.ndarray) -> np.ndarray:
        return self.scale * points @ self.rotation.T + np.array(self.shift)

    @property
    def rotation(self) -> np.ndarray:
        return Rotation.from_rotvec(self.turn).as_matrix()


MOVES = {
    "large": Move(scale=1000.0, shift=(50000.0, -20000.0, 3000.0)),
    "small": Move(scale=0.001, shift=(0.02, 0.01, 5.0)),
    "turned": Move(turn=(1.3, -0.7, 0.9)),
    "padded": Move(margin=((10, 20), (40, 24))),
}


def moved(source: Path, folder: Path, move: Move) -> None:
    """Write the copy; what lies at `folder` is replaced."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source, folder)
    if any(move.turn):
        for lights in ("test_rli", "envmaps"):
            shutil.rmtree(folder / lights, ignore_errors=True)
    for file in folder.glob("transforms_*.json"):
        file.write_text(json.dumps(_cameras(json.loads(file.read_text()), move)))
    if move.margin != Move().margin:
        for file in [f for part in ("train", "test", "test_rli") for f in folder.glob(f"{part}/*.png")]:
            pixels = np.asarray(Image.open(file))
            Image.fromarray(np.pad(pixels, [*move.margin, *[(0, 0)] * (pixels.ndim - 2)])).save(file)
    mesh = folder / "mesh" / "mesh.obj"
    mesh.write_text("\n".join(_line(line, move) for line in mesh.read_text().splitlines()) + "\n")


def _cameras(cameras: dict[str, Any], move: Move) -> dict[str, Any]:
    for frame in cameras["frames"]:
        pose = np.array(frame["transform_matrix"])
        pose[:3, 3], pose[:3, :3] = move.points(pose[:3, 3]), move.rotation @ pose[:3, :3]
        frame["transform_matrix"] = pose.tolist()
    width, height, (above, below), (left, right) = cameras["w"], cameras["h"], *move.margin
    focal = 0.5 * width / math.tan(0.5 * cameras.pop("camera_angle_x"))
    centre = {"cx": 0.5 * width + left, "cy": 0.5 * height + above}
    return cameras | centre | {"fl_x": focal, "fl_y": focal, "w": width + left + right, "h": height + above + below}


def _line(line: str, move: Move) -> str:
    """A line of an OBJ file, its vertex or normal moved."""
    kind, *values = line.split() or [""]
    if kind not in ("v", "vn"):
        return line
    value = np.array(values[:3], float)
    value = move.points(value) if kind == "v" else move.rotation @ value
    return " ".join([kind, *(f"{number:.9g}" for number in value)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    for name, move in MOVES.items():
        moved(options.scene, options.folder / name, move)
        print(options.folder / name)


if __name__ == "__main__":
    main()
