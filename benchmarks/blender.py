"""Does Blender show an exported asset as it is? True mesh, maps and light of the sample, by this exporter.

    python3.11 -m venv bpy && bpy/bin/pip install bpy==5.0.1
    python benchmarks/blender.py --bpy bpy/bin/python [--quick] [--samples 64] [--picture FILE.png] [--json FILE]

Each row exports a variation, opens it in Blender (a child process), renders test view 000 with Cycles from the file's
own camera, and compares with this project's render of the same file, over pixels that both cover; the first row also
with the photograph. Controls are wrong on purpose. Then the light: a map whose texels hold their own direction, seen by
cameras that look away from each other, gives the rotation that Blender applies.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from exmesh_graph.edit.cameras import orbit
from exmesh_graph.evaluate.metrics.image import psnr
from exmesh_graph.export.blender import BlenderSettings, compare_with_blender, render_in_blender
from exmesh_graph.export.lod import reduced
from exmesh_graph.export.usd import ExportSettings, read_usd, write_usd
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.io.envmaps import canonical_directions
from exmesh_graph.io.images import display, read_image, write_image
from exmesh_graph.types import Asset, Frame, SceneTruth, Views

SCENE = Path(__file__).resolve().parents[1] / "graphs" / "samples" / "spot"


def main() -> None:
    """Export, render, compare, row by row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bpy", required=True, type=Path, help="a Python in which bpy 5 is installed")
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--quick", action="store_true", help="16 samples; the file as it is and one control")
    parser.add_argument("--row", default="", help="only rows whose label holds this")
    parser.add_argument("--picture", type=Path, help="write Blender | ours | photograph | 4 x difference here")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    scene = load_blender(SCENE)
    assert scene.truth is not None
    settings = BlenderSettings(options.bpy, samples=16 if options.quick else options.samples, threads=2)
    asset = true_asset(scene.truth)
    rows = {}
    for number, (label, row) in enumerate(variations(asset, scene.frame).items()):
        if options.quick and label not in ("scene.usda", "control: light turned 20 degrees"):
            continue
        if options.row not in label:
            continue
        with tempfile.TemporaryDirectory(prefix="exmesh-blender-") as folder:
            figures = judge(Path(folder), scene.test, settings, **row)
        if number == 0:
            against_photograph(figures, scene.test, options.picture)
        rows[label] = {name: value for name, value in figures.items() if name not in ("blender", "ours")}
        print(
            f"{label:<34}{figures['psnr']:6.1f} dB  linear {figures['psnr_linear']:5.1f} dB  IoU {figures['iou']:.4f}"
            f"  gain {' '.join(f'{g:.3f}' for g in figures['gain'])}",
            flush=True,
        )
    for label, degrees in ({} if options.row else light_errors(asset, settings)).items():
        print(f"direction of the light, {label:<11}{degrees:8.4f} degrees", flush=True)
        rows[f"light {label}"] = degrees
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def variations(asset: Asset, frame: Frame) -> dict[str, dict]:
    """Rows of the table: what is exported and which file is opened."""
    turn = np.eye(4)
    angle = np.radians(50)
    turn[:3, :3] = 2 * np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    size = asset.base_color.shape[0]
    wave = 0.25 * np.sin(np.arange(size) / size * 60 * np.pi)
    bumps = np.stack(np.broadcast_arrays(wave[None], wave[:, None], np.float32(1)), axis=-1)
    bumps = (bumps / np.linalg.norm(bumps, axis=-1, keepdims=True)).astype(np.float32)
    metal = np.zeros((size, size), np.float32)
    metal[:, : size // 2] = 1
    light = np.roll(asset.environment, asset.environment.shape[1] // 18, axis=1)
    centimetres = Frame(np.diag([100.0, 100, 100, 1]) @ frame.scene_from_normalised, np.eye(4), 0.01)
    return {
        "scene.usda": {"asset": asset, "frame": frame},
        "asset.usdz": {"asset": asset, "frame": frame, "file": "asset.usdz"},
        "Z-up": {"asset": asset, "frame": frame, "up_axis": "Z"},
        "centimetres": {"asset": asset, "frame": centimetres},
        "turned 50 degrees, twice the size": {"asset": asset, "frame": Frame(turn, np.eye(4))},
        "principal point off by 20 %": {"asset": asset, "frame": frame, "shift": 0.2},
        "shading=base_only": {"asset": asset, "frame": frame, "variants": {"shading": "base_only"}},
        "lod=low (a quarter of the faces)": {
            "asset": asset,
            "frame": frame,
            "lods": {"low": reduced(asset, len(asset.faces) // 4)},
            "variants": {"lod": "low"},
        },
        "normal map": {"asset": replace(asset, normal=bumps), "frame": frame},
        "normal map, shading=no_normal": {
            "asset": replace(asset, normal=bumps),
            "frame": frame,
            "variants": {"shading": "no_normal"},
        },
        "half of it metal": {"asset": replace(asset, metallic=metal), "frame": frame},
        "control: light turned 20 degrees": {"asset": asset, "frame": frame, "swap": light},
    }


def judge(
    folder: Path,
    views: Views,
    settings: BlenderSettings,
    *,
    asset: Asset,
    frame: Frame,
    file: str = "scene.usda",
    up_axis: str = "Y",
    lods: dict | None = None,
    variants: dict | None = None,
    shift: float = 0.0,
    swap: np.ndarray | None = None,
) -> dict:
    """Export, compare; with `swap` Blender gets another environment than our renderer."""
    if shift:
        intrinsics = views.intrinsics.copy()
        intrinsics[:, 0, 2] += shift * views.width
        intrinsics[:, 1, 2] -= shift * views.height / 2
        views = replace(views, intrinsics=intrinsics)
    options = ExportSettings(up_axis="Z" if up_axis == "Z" else "Y")
    write_usd(folder / "usd", asset, frame, views, lods=lods, settings=options)
    figures = compare_with_blender(folder / "usd" / file, settings, views.names[0], variants)
    if swap is not None:
        write_usd(folder / "swapped", replace(asset, environment=swap), frame, views, settings=options)
        theirs = render_in_blender(folder / "swapped" / file, settings, cameras=[views.names[0]])[views.names[0]]
        inside = (theirs[..., 3] > 0.999) & (figures["ours"][..., 3] > 0.999)
        figures["psnr"] = psnr(shown(theirs), shown(figures["ours"]), inside)
        figures["psnr_linear"] = psnr(*(np.clip(p[..., :3], 0, 1) for p in (theirs, figures["ours"])), inside)
        figures["gain"] = (theirs[inside][:, :3].mean(0) / figures["ours"][inside][:, :3].mean(0)).tolist()
    return figures


def against_photograph(figures: dict, views: Views, picture: Path | None) -> None:
    """Add the figures against the true picture; write the pictures side by side."""
    true = display(views.images[0], views.alpha[0])
    blender, ours = shown(figures["blender"]), shown(figures["ours"])
    inside = (figures["blender"][..., 3] > 0.999) & (views.alpha[0] > 0.999)
    figures["photograph_psnr"] = psnr(blender, true, inside)
    figures["photograph_whole_psnr"] = psnr(blender, true)
    print(
        f"{'scene.usda against the photograph':<34}{figures['photograph_psnr']:6.1f} dB  "
        f"whole image {figures['photograph_whole_psnr']:.1f} dB; ours {psnr(ours, true, inside):.1f} dB"
    )
    if picture:
        write_image(picture, np.clip(np.concatenate([blender, ours, true, 4 * np.abs(blender - ours)], axis=1), 0, 1))


def light_errors(asset: Asset, settings: BlenderSettings) -> dict[str, float]:
    """Angle [degrees] between the light that the file means and the one that Blender shows."""
    height = 128
    coded = replace(asset, environment=(0.5 * canonical_directions(height, 2 * height) + 0.5).astype(np.float32))
    turn = np.eye(4)
    turn[:3, :3] = [[0.5, 0, 0.75**0.5], [0, 1, 0], [-(0.75**0.5), 0, 0.5]]
    intrinsics, pose = orbit(3, 32, 32)
    images, alpha = np.zeros((3, 32, 32, 3), np.float32), np.zeros((3, 32, 32), np.float32)
    views = Views(("a", "b", "c"), images, alpha, intrinsics, pose, "test")
    light = replace(settings, samples=16, transparent=False, hide_meshes=True)
    errors = {}
    for label, up_axis, frame in (("Y-up", "Y", None), ("Z-up", "Z", None), ("turned", "Y", Frame(turn, np.eye(4)))):
        with tempfile.TemporaryDirectory(prefix="exmesh-blender-") as folder:
            write_usd(Path(folder) / "usd", coded, frame, views, settings=ExportSettings(up_axis=up_axis))
            file = Path(folder) / "usd" / "scene.usda"
            pictures, contents = render_in_blender(file, light), read_usd(file)
        errors[label] = turn_between(pictures, contents)
    return errors


def turn_between(pictures: dict[str, np.ndarray], contents) -> float:
    """Angle of the rotation that takes the meant light to the seen one (Procrustes over all pixels), degrees."""
    meant, seen = [], []
    for camera in contents.cameras:
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.intrinsics).T
        rays = rays @ camera.camera_to_world[:3, :3].T @ contents.rotation  # in the map's own axes
        meant.append((rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3))
        seen.append((2 * pictures[camera.view][..., :3] - 1).reshape(-1, 3))
    left, _, right = np.linalg.svd(np.concatenate(meant).T @ np.concatenate(seen))
    found = left @ right
    assert np.linalg.det(found) > 0, "the light is mirrored"
    return float(np.degrees(np.arccos(np.clip((np.trace(found) - 1) / 2, -1, 1))))


def shown(picture: np.ndarray) -> np.ndarray:
    """Display colour of a linear premultiplied RGBA picture."""
    return display(picture[..., :3], picture[..., 3])


def true_asset(truth: SceneTruth, folder: Path = SCENE) -> Asset:
    """A rendered scene's true mesh with its true maps and light."""
    positions, coordinates, corners = [], [], []
    for line in (folder / "mesh" / "mesh.obj").read_text().splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "vt":
            coordinates.append([float(x) for x in rest.split()[:2]])
        elif kind == "v":
            positions.append(rest)
        elif kind == "f":
            corners.append([[int(i) - 1 for i in corner.split("/")[:2]] for corner in rest.split()])
    assert truth.mesh_vertices is not None
    assert truth.environment is not None
    assert len(positions) == len(truth.mesh_vertices)
    index = np.array(corners, np.int32)
    color = srgb_to_linear(read_image(folder / "mesh" / "albedo.png")[..., :3])
    roughness = read_image(folder / "mesh" / "roughness.png")[..., 0]
    metallic = folder / "mesh" / "metallic.png"
    return Asset(
        vertices=truth.mesh_vertices,
        faces=index[..., 0],
        uvs=np.clip(np.array(coordinates, np.float32), 0, 1),
        uv_faces=index[..., 1],
        texture=np.zeros((2, 2, 3), np.float32),
        base_color=color,
        roughness=roughness,
        seen=np.ones(roughness.shape, bool),
        environment=truth.environment,
        metallic=read_image(metallic)[..., 0] if metallic.is_file() else None,
    )


if __name__ == "__main__":
    main()
