"""Does Blender show an exported asset as the truth looks? True mesh, maps and light of the sample, by our exporter.

    python3.11 -m venv /tmp/bpy && /tmp/bpy/bin/pip install bpy==5.0.1
    python benchmarks/blender.py --bpy /tmp/bpy/bin/python [--file asset.usdz] [--spp 64] [--picture FILE.png]

Exports the true spot, opens the file in Blender (a child process: a bad file may crash it), renders test view 000
with Cycles from the data set's camera and compares it with the photograph. A wrong axis, a flipped texture, a wrong
colour space or a turned environment cost many decibels; the control turns the environment by 20 degrees.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from exmesh_graph.export.usd import validate_usd, write_usd
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.io.images import display, read_image, write_image
from exmesh_graph.metrics.image import psnr
from exmesh_graph.types import Asset, SceneTruth, Views

SCENE = Path(__file__).resolve().parents[1] / "graphs" / "samples" / "spot"

# The stage is Y-up and Blender turns it to its own Z-up, which is the data set's world: its cameras fit as they are.
RENDER = """
import json, sys
import bpy, mathutils
usd, cameras, picture, spp = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=False)
for thing in list(bpy.data.objects):
    bpy.data.objects.remove(thing)
bpy.ops.wm.usd_import(filepath=usd)
data = json.load(open(cameras))
camera = bpy.data.cameras.new("camera")
camera.sensor_fit, camera.angle_x = "HORIZONTAL", data["camera_angle_x"]
thing = bpy.data.objects.new("camera", camera)
thing.matrix_world = mathutils.Matrix(data["frames"][0]["transform_matrix"])
scene = bpy.context.scene
scene.collection.objects.link(thing)
scene.camera = thing
scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", int(spp)
scene.cycles.use_denoising, scene.cycles.pixel_filter_type = False, "BOX"
scene.render.resolution_x = scene.render.resolution_y = 256
scene.render.resolution_percentage = 100
scene.render.film_transparent, scene.view_settings.view_transform = True, "Raw"
settings = scene.render.image_settings
settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
scene.render.filepath = picture
bpy.ops.render.render(write_still=True)
"""


def main() -> None:
    """Export, render, compare; then once more with the environment turned."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bpy", required=True, help="a Python in which bpy 5 is installed")
    parser.add_argument("--file", default="asset.usdz", choices=["asset.usdz", "scene.usda"])
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--picture", type=Path, help="write Blender | truth | 4 x error here")
    options = parser.parse_args()
    scene = load_blender(SCENE)
    assert scene.truth is not None
    asset = true_asset(scene.truth)
    turned = np.roll(asset.environment, asset.environment.shape[1] // 18, axis=1)
    for label, chosen in (
        ("as exported", asset),
        ("environment turned 20 degrees", replace(asset, environment=turned)),
    ):
        with tempfile.TemporaryDirectory(prefix="exmesh-blender-") as folder:
            out = Path(folder) / "usd"
            write_usd(out, chosen, scene.frame)
            errors = [str(p) for p in validate_usd(out / options.file) if p.level == "error"]
            image = render(options.bpy, out / options.file, Path(folder) / "render.exr", options.spp)
        compare(label, image, scene.test, errors, options.picture if chosen is asset else None)


def true_asset(truth: SceneTruth) -> Asset:
    """The sample's true mesh with its true maps and light."""
    positions, coordinates, corners = [], [], []
    for line in (SCENE / "mesh" / "mesh.obj").read_text().splitlines():
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
    color = srgb_to_linear(read_image(SCENE / "mesh" / "albedo.png")[..., :3])
    roughness = read_image(SCENE / "mesh" / "roughness.png")[..., 0]
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
    )


def render(python: str, usd: Path, picture: Path, spp: int) -> np.ndarray:
    """Blender's picture [H, W, 4], linear premultiplied."""
    arguments = [str(usd), str(SCENE / "transforms_test.json"), str(picture), str(spp)]
    done = subprocess.run([python, "-c", RENDER, *arguments], capture_output=True, text=True, check=False)
    if not picture.is_file():
        raise SystemExit(f"Blender rendered nothing (exit code {done.returncode}):\n{done.stdout}\n{done.stderr}")
    return read_image(picture)


def compare(label: str, image: np.ndarray, views: Views, errors: list[str], picture: Path | None) -> None:
    """Print the figures; write the picture."""
    ours, alpha = display(image[..., :3], image[..., 3]), image[..., 3]
    true = display(views.images[0], views.alpha[0])
    inside = (alpha > 0.999) & (views.alpha[0] > 0.999)
    overlap = np.minimum(alpha, views.alpha[0]).sum() / np.maximum(alpha, views.alpha[0]).sum()
    gain = ours[inside].mean(0) / true[inside].mean(0)
    print(
        f"{label}: whole image {psnr(ours, true):.1f} dB, object {psnr(ours, true, inside):.1f} dB, IoU {overlap:.4f}, "
        f"gain {' '.join(f'{g:.3f}' for g in gain)}, validation errors {errors or 'none'}"
    )
    if picture:
        write_image(picture, np.clip(np.concatenate([ours, true, 4 * np.abs(ours - true)], axis=1), 0, 1))


if __name__ == "__main__":
    main()
