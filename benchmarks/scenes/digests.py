"""Whether a made scene is the one that the register knows: to the byte, or up to another processor's last bits."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.register import Digests, find
from benchmarks.scenes import files
from benchmarks.scenes.catalogue import RECIPES

#: Largest difference of the mean colour of a 64th of the picture [of 255]; relative difference of the area.
COLOUR, AREA = 3, 1e-3
NAMES = ("mesh/mesh.obj", "mesh/albedo.png", "mesh/roughness.png", "mesh/metallic.png")


def measured(folder: Path) -> Digests:
    """The digests of a made scene."""
    picture = first_picture(folder)
    corners = triangles(folder / "mesh" / "mesh.obj")
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    named = {name: files.digest(folder / name) for name in (*NAMES, str(picture.relative_to(folder)))}
    return Digests(files=named, faces=len(corners), area=round(float(area), 5), first=parts(picture).tobytes().hex())


def triangles(path: Path) -> np.ndarray:
    """Corners [F, 3, 3] of a mesh that `files.write_model` wrote."""
    lines = path.read_text(encoding="ascii").splitlines()
    points = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    faces = [[corner.split("/")[0] for corner in line.split()[1:]] for line in lines if line.startswith("f ")]
    return points[np.array(faces, int) - 1]


def first_picture(folder: Path) -> Path:
    """The picture of test view 000."""
    masked = folder / "test" / "000_rgba.png"
    return masked if masked.is_file() else folder / "test" / "000.png"


def parts(picture: Path) -> np.ndarray:
    """Mean colours uint8 [8, 8, 3] of 8 x 8 parts, over black."""
    pixels = np.asarray(Image.open(picture).convert("RGBA"), float)
    pixels = pixels[..., :3] * pixels[..., 3:] / 255
    side = len(pixels) // 8
    return np.round(pixels[: 8 * side, : 8 * side].reshape(8, side, 8, side, 3).mean((1, 3))).astype(np.uint8)


def differences(kept: Digests, now: Digests) -> tuple[list[str], list[str]]:
    """(what is another scene, what differs by no more than another processor may)."""
    wrong, slight = [], []
    if abs(now.area / kept.area - 1) > AREA:
        wrong.append(f"the mesh has area {now.area:.5f}, not {kept.area:.5f}")
    colours = [np.frombuffer(bytes.fromhex(d.first), np.uint8).astype(int) for d in (kept, now)]
    far = np.abs(colours[0] - colours[1]).max()
    if far > COLOUR:
        wrong.append(f"the first test picture differs by up to {far} of 255 in the mean of a 64th")
    slight += [name for name, digest in kept.files.items() if now.files.get(name) != digest]
    return wrong, slight


def check(out: Path, names: list[str]) -> int:
    """Print how the scenes below `out` compare with the register; 1 where one is another scene."""
    failed = 0
    for folder in _folders(out, names):
        entry = find(folder)
        if entry is None or not entry.digests.first:
            print(f"{folder.name}: the register has no digests of it")
            continue
        wrong, slight = differences(entry.digests, measured(folder))
        failed += bool(wrong)
        print(
            f"{entry.name}: "
            + ("; ".join(wrong) or ("same but for last bits: " + ", ".join(slight) if slight else "same"))
        )
    return int(failed > 0)


def _folders(out: Path, names: list[str]) -> list[Path]:
    return [out / name for name in names or RECIPES if names or (out / name / "made.json").is_file()]


def show(out: Path, names: list[str]) -> int:
    """Print the entries for the register."""
    from ruamel.yaml import YAML

    writer = YAML()
    writer.width = 200
    writer.dump({folder.name: measured(folder).model_dump() for folder in _folders(out, names)}, sys.stdout)
    return 0


def figures(out: Path, names: list[str]) -> int:
    """Print what was measured of the scenes, as the table of docs/scenes.md."""
    lights = ("train", "sun", "overcast", "lamps", "coloured")
    print("| scene | " + " | ".join(lights) + " | silhouettes | depth | noise: test; relit | seconds, of a processor |")
    print("| " + " | ".join(["---"] * 10) + " |")
    for folder in _folders(out, names):
        found, noise, made = (json.loads((folder / f"{n}.json").read_text()) for n in ("verify", "noise", "made"))
        ratios = (found["light"][light]["render_over_sum"] for light in lights)
        cells = [f"{middle:.3f} ({low:.2f} to {high:.2f})" for low, middle, high in ratios]
        cells.append(f"{min(found['iou']):.3f}" if "iou" in found else "no masks")
        cells.append(f"{found['depth_to_mesh_max']:.0e}")
        parts = [[db for name, db in noise.items() if name.startswith(kind)] for kind in ("test/", "test_rli/")]
        cells.append("; ".join(f"{np.mean(part) + 6:.1f}" for part in parts if part))
        print(
            f"| `{folder.name}` | "
            + " | ".join([*cells, f"{made['seconds']:.0f}, {made['processor_seconds']:.0f}"])
            + " |"
        )
    return 0
