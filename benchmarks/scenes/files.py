"""The files of a scene, in the layout of the Blender / NeRF-Synthetic loader with the truth beside the pictures."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scenes.cameras import FIELD
from benchmarks.scenes.model import Model, encode
from exmesh_graph.io.images import write_image


def write_model(folder: Path, model: Model) -> None:
    """mesh.obj, mesh.mtl, albedo, roughness and metallic pictures; object.obj where a ground is left out of it."""
    folder.mkdir(parents=True, exist_ok=True)
    write_image(folder / "albedo.png", model.base / 255.0)
    write_image(folder / "roughness.png", model.roughness / 255.0)
    write_image(folder / "metallic.png", model.metallic / 255.0)
    text = "newmtl surface\nmap_Kd albedo.png\nmap_Pr roughness.png\nmap_Pm metallic.png\n"
    (folder / "mesh.mtl").write_text(text, encoding="ascii")
    _write_obj(folder / "mesh.obj", model, model.faces)
    mine = model.of_object()
    if len(mine) < len(model.faces):
        _write_obj(folder / "object.obj", model, model.faces[mine])
    kept = {name: getattr(model, name) for name in Model.__dataclass_fields__}
    temporary = folder / "model.part.npz"
    np.savez_compressed(temporary, **kept)  # what a resumed run renders, to the last bit
    temporary.rename(folder / "model.npz")


def read_model(folder: Path) -> Model | None:
    file = folder / "model.npz"
    if not file.is_file():
        return None
    with np.load(file) as kept:
        return Model(**{name: kept[name] for name in Model.__dataclass_fields__})


def _write_obj(path: Path, model: Model, faces: np.ndarray) -> None:
    lines = ["mtllib mesh.mtl", "usemtl surface"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in model.vertices]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in model.uv]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in model.normals]
    lines += [f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def write_cameras(path: Path, split: str, poses: list[np.ndarray], size: int) -> None:
    frames = [{"file_path": f"{split}/{k:03d}", "transform_matrix": pose.tolist()} for k, pose in enumerate(poses)]
    write_json(path, {"camera_angle_x": FIELD, "w": size, "h": size, "frames": frames})


def write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def write_photograph(stem: Path, rgba: np.ndarray, *, masked: bool, hdr: bool, suffix: str = "_rgba") -> None:
    """stem + "_rgba.png" (straight alpha, sRGB, clipped) or ".png" without alpha; the EXR beside it where `hdr`.

    rgba float32 [H, W, 4], linear, premultiplied. The PNG is written last: where it lies the picture is whole."""
    name = f"{stem.name}{suffix if masked else ''}"
    if hdr:
        write_image(stem.with_name(name + ".exr"), rgba if masked else rgba[..., :3], "half")
    alpha = rgba[..., 3]
    straight = np.where(alpha[..., None] > 0, rgba[..., :3] / alpha[..., None].clip(1e-6), 0)
    shown = encode(straight)
    whole(stem.with_name(name + ".png"), np.concatenate([shown, alpha[..., None]], -1) if masked else shown)


def whole(path: Path, picture: np.ndarray, depth: str = "uint8") -> None:
    """Write the picture so that it is there whole or not at all."""
    part = path.with_name(f"part_{path.name}")
    write_image(part, picture, depth)
    part.rename(path)


def digest(path: Path) -> str:
    """sha256 of the file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
