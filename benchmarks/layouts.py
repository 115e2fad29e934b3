"""The published benchmarks in small: the sample scene in each one's folder layout, and their graphs run on it.

    python -m benchmarks.layouts FOLDER              # write the folders
    python -m benchmarks.layouts FOLDER --run        # and run all four graphs on short schedules, tables at the end
    python -m benchmarks.layouts FOLDER --run stanford_orb --json FILE

For a rehearsal before the real data is at hand: every node of the four graphs runs, from the pictures to the paper's
table. The pictures are those of graphs/samples/spot, averaged over blocks; the figures say nothing about the method.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy.io import savemat
from scipy.ndimage import map_coordinates

from benchmarks.meshes import write_ply
from exmesh_graph.geometry.surface import sample_surface
from exmesh_graph.io.cameras import intrinsics_from_fov, opencv_from_blender
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.envmaps import read_environment
from exmesh_graph.io.images import display, encode_rgba, read_image, read_mask, read_photo, write_image
from exmesh_graph.io.meshes import read_mesh
from exmesh_graph.io.reduce import downscale_area
from exmesh_graph.rays.embree import EmbreeTracer

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "graphs" / "samples" / "spot"
LIGHTS = ("esplanade_a", "esplanade_b")
MILLIMETRES = 100.0  # of a unit of the sample
WALL = 0.2  # linear radiance behind the object where photographs have a background
SHORT = ("rounds.repeat=4", "rounds.refine.iterations=8", "settle.iterations=12", "faces=2500", "coarse.faces=600",
         "texels=128", "look.max_views=2")  # fmt: skip
PAPER = (*SHORT, "gaussians.iterations=150", "gaussians.count=3000", "gaussians.max_gaussians=5000",
         "fused.resolution=40")  # fmt: skip
OURS = (*SHORT, "coarse.method=hull", "coarse.resolution=40")
SHORT_FIT = ("light.directions=64", "pbr.iterations=8", "pbr.texture_size=128", "score.directions=64",
             "score.supersampling=1", "score.specular_samples=4", "score.max_views=2")  # fmt: skip
RUNS = {
    "dtu": ["data={}/DTU", "truth={}/MVS Data", *PAPER],
    "nerf_synthetic": ["data={}/nerf_synthetic", "chamfer.samples=5000", *PAPER],
    "synthetic4relight": ["data={}/Synthetic4Relight", *OURS, *SHORT_FIT],
    "stanford_orb": [
        "data={}/stanford_orb",
        "views.downscale=1",
        "speed.size=64",
        "speed.frames=2",
        *OURS,
        *SHORT_FIT,
    ],
}


class Shot(NamedTuple):
    """A small view: linear premultiplied colour, coverage, K, pose in Blender's and in OpenCV's axes."""

    stem: str
    rgb: np.ndarray
    alpha: np.ndarray
    intrinsics: np.ndarray
    pose: np.ndarray
    opencv: np.ndarray


def main() -> None:
    """Write, and run if asked."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.layouts", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--run", nargs="*", choices=list(RUNS), help="these graphs, or all; one scene of each")
    parser.add_argument("--factor", type=int, default=4, help="pictures are reduced by this factor, from 256")
    parser.add_argument("--views", type=int, default=12, help="training views, of 40")
    parser.add_argument("--quick", action="store_true", help="8 views of 48 pixels where --factor 4 gives 64")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="passed on to exmesh run")
    parser.add_argument("--json", type=Path, help="write the rows here")
    options = parser.parse_args()
    if options.quick:
        options.factor, options.views = 8, 8
    write_layouts(options.folder, options.factor, options.views)
    if options.run is not None:
        rows = {name: run(name, options.folder.resolve(), options.set) for name in options.run or RUNS}
        if options.json:
            options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def write_layouts(folder: Path, factor: int = 4, views: int = 12, tests: int = 3) -> None:
    """Write DTU/, MVS Data/, nerf_synthetic/, Synthetic4Relight/ and stanford_orb/ into `folder`, one scene each."""
    sample = json.loads((SAMPLE / "transforms_train.json").read_text(encoding="utf-8"))
    angle = sample["camera_angle_x"]
    train = _shots("train", factor, views)
    test = _shots("test", factor, tests)
    vertices, faces = read_mesh(SAMPLE / "mesh" / "mesh.obj")
    write_dtu(folder, [*train, *test], vertices, faces)
    write_nerf_synthetic(folder / "nerf_synthetic" / "chair", train, test, angle)
    write_synthetic4relight(folder / "Synthetic4Relight", train, test, angle, factor)
    write_stanford_orb(folder / "stanford_orb", train, test, angle, factor, vertices, faces)


def write_dtu(folder: Path, shots: list[Shot], vertices: np.ndarray, faces: np.ndarray) -> None:
    """IDR's layout of a scan in millimetres, with masks; the evaluation archive with a cloud of the true surface."""
    scan, truth = _empty(folder / "DTU" / "scan24"), _empty(folder / "MVS Data")
    cameras = {}
    for i, shot in enumerate(shots):
        _write(scan / "image" / f"{i:06d}.png", linear_to_srgb(np.clip(_before_wall(shot), 0, 1)))
        _write(scan / "mask" / f"{i:03d}.png", shot.alpha)
        k, view = shot.intrinsics.copy(), np.linalg.inv(shot.opencv)
        k[:2, 2] -= 0.5  # these files count pixel centres as whole numbers
        view[:3, 3] *= MILLIMETRES
        cameras[f"world_mat_{i}"] = np.vstack([k @ view[:3], [0, 0, 0, 1]])
        cameras[f"scale_mat_{i}"] = np.diag([1.3 * MILLIMETRES] * 3 + [1])
    np.savez(scan / "cameras_sphere.npz", **cameras)
    for place in ("Points/stl", "ObsMask"):
        (truth / place).mkdir(parents=True)
    points = MILLIMETRES * sample_surface(vertices, faces, 40_000, seed=0)[0]
    write_ply(truth / "Points" / "stl" / "stl024_total.ply", points, np.zeros((0, 3), np.int32))
    box = np.array([[-150.0] * 3, [150.0] * 3])
    observed = np.ones((31, 31, 31), np.uint8)
    savemat(truth / "ObsMask" / "ObsMask24_10.mat", {"ObsMask": observed, "BB": box, "Res": [[10.0]]})
    savemat(truth / "ObsMask" / "Plane24.mat", {"P": np.array([[0.0], [0], [1], [200]])})


def write_nerf_synthetic(scene: Path, train: list[Shot], test: list[Shot], angle: float) -> None:
    """train/r_0.png with straight alpha, and the true surface."""
    _empty(scene)
    for split, shots in (("train", train), ("test", test)):
        frames = []
        for i, shot in enumerate(shots):
            _write(scene / split / f"r_{i}.png", encode_rgba(shot.rgb, shot.alpha))
            frames.append(_frame(f"./{split}/r_{i}", shot))
        _transforms(scene, split, angle, frames)
    shutil.copy(SAMPLE / "mesh" / "mesh.obj", scene / "mesh.obj")


def write_synthetic4relight(folder: Path, train: list[Shot], test: list[Shot], angle: float, factor: int) -> None:
    """Linear training pictures with masks; test maps; the two other lights under the benchmark's names."""
    scene = _empty(folder / "hotdog")
    for i, shot in enumerate(train):
        _write(scene / "train" / f"{i:03d}_rgb.exr", shot.rgb, "float")
        _write(scene / "train" / f"{i:03d}_mask.png", shot.alpha)
    _transforms(scene, "train", angle, [_frame(f"train/{i:03d}", shot) for i, shot in enumerate(train)])
    for i, shot in enumerate(test):
        _write(scene / "test" / f"{i:03d}_rgba.png", encode_rgba(shot.rgb, shot.alpha))
        _write(scene / "test" / f"{i:03d}_albedo.png", encode_rgba(*_small(_map(shot, "albedo"), factor)))
        _write(scene / "test" / f"{i:03d}_rough.png", _roughness(shot, factor), "uint16")
        for light, name in zip(LIGHTS, ("envmap6", "envmap12"), strict=True):
            relit = _small(SAMPLE / "test_rli" / f"{light}_{shot.stem}.png", factor)
            _write(scene / "test_rli" / f"{name}_{i:03d}.png", encode_rgba(*relit))
    _transforms(scene, "test", angle, [_frame(f"test/{i:03d}", shot) for i, shot in enumerate(test)])
    (folder / "envmaps").mkdir(exist_ok=True)
    shutil.copy(SAMPLE / "env_train.exr", folder / "envmaps" / "envmap3.exr")
    for light, name in zip(LIGHTS, ("envmap6", "envmap12"), strict=True):
        shutil.copy(SAMPLE / "envmaps" / f"{light}.exr", folder / "envmaps" / f"{name}.exr")


def write_stanford_orb(
    folder: Path,
    train: list[Shot],
    test: list[Shot],
    angle: float,
    factor: int,
    vertices: np.ndarray,
    faces: np.ndarray,
) -> None:
    """A capture with its truth; two others under the two other lights, whose pictures are its novel views."""
    home, truth = (
        _empty(folder / "blender_HDR" / "teapot_scene001"),
        _empty(folder / "ground_truth" / "teapot_scene001"),
    )
    for split, shots in (("train", train), ("test", test)):
        for i, shot in enumerate(shots):
            _photograph(home, split, i, shot)
        _transforms(home, split, angle, [_frame(f"{split}/{i:04d}", shot) for i, shot in enumerate(shots)])
    tracer = EmbreeTracer(vertices.astype(np.float32), faces)
    for i, shot in enumerate(test):
        depth, normal = _geometry(tracer, vertices, faces, shot)
        for place, values in (("z_depth", depth), ("surface_normal", normal)):
            (truth / place).mkdir(exist_ok=True)
            np.save(truth / place / f"{i:04d}.npy", values)
        _write(truth / "pseudo_gt_albedo" / f"{i:04d}.png", display(*_small(_map(shot, "albedo"), factor)))
    (truth / "mesh_blender").mkdir()
    shutil.copy(SAMPLE / "mesh" / "mesh.obj", truth / "mesh_blender" / "mesh.obj")
    frames = []
    for light, capture in zip(LIGHTS, ("teapot_scene002", "teapot_scene006"), strict=True):
        other = _empty(folder / "blender_HDR" / capture)
        maps = folder / "ground_truth" / capture / "env_map"
        sky = read_environment(SAMPLE / "envmaps" / f"{light}.exr")
        for i, shot in enumerate(test):
            rgb, alpha = _small(SAMPLE / "test_rli" / f"{light}_{shot.stem}.png", factor)
            _photograph(other, "test", i, shot._replace(rgb=rgb, alpha=alpha))
            _write(maps / f"{i:04d}.exr", _panorama(sky, shot.opencv[:3, :3]), "float")
            frames.append(_frame(f"test/{i:04d}", shot) | {"scene_name": capture, "camera_angle_x": angle})
    (home / "transforms_novel.json").write_text(json.dumps({"frames": frames}), encoding="utf-8")


def run(name: str, folder: Path, sets: list[str]) -> list[dict[str, object]]:
    """Run a graph on its folder, pass on what it prints, and return the rows of its `benchmark.*` nodes."""
    words = [sys.executable, "-c", "from exmesh_graph.cli import main; main()", "run", f"graphs/{name}.yaml"]
    for text in (*RUNS[name], *sets):
        words += ["--set", text.format(folder)]
    runs = folder / "runs" / name
    done = subprocess.run([*words, "--store", str(folder / "store"), "--runs", str(runs)], cwd=ROOT, check=False,
                          capture_output=True, text=True)  # fmt: skip
    if done.returncode:
        raise SystemExit(f"{name} failed:\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    print(f"\n{name}\n{done.stdout}", flush=True)
    report = json.loads((runs / "latest" / "report.json").read_text(encoding="utf-8"))
    return [values["benchmark"] for values in report["metrics"].values() if "benchmark" in values]


def _shots(split: str, factor: int, count: int) -> list[Shot]:
    content = json.loads((SAMPLE / f"transforms_{split}.json").read_text(encoding="utf-8"))
    frames = content["frames"]
    shots = []
    for k in np.linspace(0, len(frames) - 1, count).round().astype(int):
        rgb, alpha = _small(SAMPLE / f"{frames[k]['file_path']}_rgba.png", factor)
        pose = np.array(frames[k]["transform_matrix"])
        intrinsics = intrinsics_from_fov(content["camera_angle_x"], alpha.shape[1], alpha.shape[0])
        stem = Path(frames[k]["file_path"]).name
        shots.append(Shot(stem, rgb, alpha, intrinsics, pose, opencv_from_blender(pose)))
    return shots


def _small(file: Path, factor: int) -> tuple[np.ndarray, np.ndarray]:
    photo = read_photo(file)
    return downscale_area(photo.rgb, factor, file), downscale_area(photo.alpha[..., None], factor, file)[..., 0]


def _map(shot: Shot, name: str) -> Path:
    return SAMPLE / "test" / f"{shot.stem}_{name}.png"


def _roughness(shot: Shot, factor: int) -> np.ndarray:
    """Averaged over the covered part of a pixel, as the sample's is."""
    file = _map(shot, "rough")
    covered = read_image(_map(shot, "albedo"))[..., 3]
    sums = downscale_area((read_mask(file) * covered)[..., None], factor, file)[..., 0]
    share = downscale_area(covered[..., None], factor, file)[..., 0]
    return sums / np.maximum(share, 1e-6)


def _before_wall(shot: Shot) -> np.ndarray:
    return shot.rgb + (1 - shot.alpha)[..., None] * WALL


def _photograph(capture: Path, split: str, number: int, shot: Shot) -> None:
    _write(capture / split / f"{number:04d}.exr", _before_wall(shot), "float")
    _write(capture / f"{split}_mask" / f"{number:04d}.png", shot.alpha)


def _geometry(
    tracer: EmbreeTracer, vertices: np.ndarray, faces: np.ndarray, shot: Shot
) -> tuple[np.ndarray, np.ndarray]:
    """z-depth float32 [H, W] and face normals float32 [H, W, 3] in OpenGL's camera axes, at the pixels' centres."""
    height, width = shot.alpha.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    local = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ np.linalg.inv(shot.intrinsics).T
    directions = local @ shot.opencv[:3, :3].T  # one long along the camera's axis, so a hit's t is its depth
    origins = np.broadcast_to(shot.opencv[:3, 3], directions.shape)
    hits = tracer.closest_hit(origins.astype(np.float32), directions.astype(np.float32))
    met = hits.face >= 0
    a, b, c = np.moveaxis(vertices[faces[np.where(met, hits.face, 0)]], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    depth = np.where(met, hits.t, 0).reshape(height, width)
    seen = (normal * met[:, None]) @ shot.pose[:3, :3]
    return depth.astype(np.float32), seen.reshape(height, width, 3).astype(np.float32)


def _panorama(sky: np.ndarray, rotation: np.ndarray, height: int = 32) -> np.ndarray:
    """What a camera of that `rotation` (OpenCV, to a z-up world) has around it; `sky` in Blender's convention."""
    u, v = np.meshgrid((np.arange(2 * height) + 0.5) / (2 * height), (np.arange(height) + 0.5) / height)
    turn, tilt = 2 * np.pi * (u - 0.5), np.pi * v
    camera = np.stack([np.sin(tilt) * np.sin(turn), -np.cos(tilt), np.sin(tilt) * np.cos(turn)], -1)
    x, y, z = np.moveaxis(camera @ rotation.T, -1, 0)
    column = (0.5 - np.arctan2(y, x) / (2 * np.pi)) * sky.shape[1] - 0.5
    row = np.arccos(np.clip(z, -1, 1)) / np.pi * sky.shape[0] - 0.5
    return np.stack([map_coordinates(sky[..., k], [row, column], order=1, mode="nearest") for k in range(3)], -1)


def _frame(path: str, shot: Shot) -> dict[str, object]:
    return {"file_path": path, "transform_matrix": shot.pose.tolist()}


def _transforms(scene: Path, split: str, angle: float, frames: list[dict[str, object]]) -> None:
    text = json.dumps({"camera_angle_x": angle, "frames": frames})
    (scene / f"transforms_{split}.json").write_text(text, encoding="utf-8")


def _write(file: Path, image: np.ndarray, depth: Literal["uint8", "uint16", "float"] = "uint8") -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    write_image(file, image, depth)


def _empty(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


if __name__ == "__main__":
    main()
