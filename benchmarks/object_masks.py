"""Masks found in photographs without masks (`mask.auto`) against the true ones: overlap, what was decided, seconds.

python -m benchmarks.object_masks SCENE ... [--table] [--downscale N] [--set NAME=VALUE ...] [--start]
    [--picture FOLDER]

Scenes with masks lose them first: their pictures keep the background where it was photographed. Rendered ones have a
black background; with --table they stand on a noisy one before a noisy wall instead, and cameras below it are left out.
Scenes without masks are scored by masks/ in their folder where it is there. `IoU` is the median over the training views
of intersection over union, `worst` the least; `apart` and `overlap` are what the checks rest on. Seconds are
processor seconds, all threads together.

--start makes init.auto's coarse start without and with these masks too, where there is a true mesh of the object alone:
mean distances to and from it in thousandths of normalised units, and how much of it lies within 20 of the start.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from exmesh_nodes import auto, mask
from scipy.ndimage import map_coordinates

from benchmarks.coarse_work import load_case
from benchmarks.register import choosing
from exmesh_graph.geometry.remesh import nearest_of
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.color import linear_to_srgb, srgb_to_linear
from exmesh_graph.io.idr import load_idr
from exmesh_graph.io.images import read_mask, write_image
from exmesh_graph.io.meshes import read_mesh
from exmesh_graph.io.middlebury import load_middlebury
from exmesh_graph.io.normalise import points_to_normalised
from exmesh_graph.io.settings import BlenderOptions, IdrOptions, MiddleburyOptions
from exmesh_graph.masks.agreement import overlap
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Views

HEAD = (
    f"{'':22s} {'views':>5s} {'pixels':>9s} {'masks':>6s} {'table':>8s} {'IoU':>6s} {'worst':>6s} {'apart':>6s} "
    f"{'overlap':>7s} {'s':>5s}"
)


def main() -> None:
    options = arguments()
    p = mask.AutoParams.model_validate(dict(one.split("=", 1) for one in options.set))
    print(HEAD)
    for scene in options.scenes:
        choosing(scene)
        views, truth = on_a_table(scene, options.downscale) if options.table else bare(scene, options.downscale)
        context = FakeContext()
        start = time.process_time()
        out = mask.auto(context, views, p=p)
        seconds = time.process_time() - start
        print(line(scene.name + (", table" if options.table else ""), views, truth, out, seconds), flush=True)
        for said in context.warnings:
            print(f"    {said}")
        if options.start:
            for name, given in (("without", views), ("with", out.train)):
                print(f"    start {name:8s} {started(scene, given)}", flush=True)
        if options.picture:
            name = f"{scene.name}{'_table' if options.table else ''}.jpg"
            write_image(options.picture / name, sheet(views, out.train))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+", help="folders of scenes, for choosing")
    parser.add_argument(
        "--table", action="store_true", help="put rendered objects on a noisy table, before a noisy wall"
    )
    parser.add_argument("--downscale", type=int, default=1, help="reduce the pictures by this factor")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="parameters of mask.auto")
    parser.add_argument("--start", action="store_true", help="make the coarse start without and with the masks too")
    parser.add_argument("--picture", type=Path, help="write pictures of the masks into this folder")
    return parser.parse_args()


def bare(scene: Path, downscale: int) -> tuple[Views, np.ndarray | None]:
    """The training views of a scene without their masks; these as bool [N, H, W], None where there are none."""
    if any(scene.glob("*_par.txt")):
        without = load_middlebury(scene, MiddleburyOptions(downscale=downscale, masks=False)).train
        return without, load_middlebury(scene, MiddleburyOptions(downscale=downscale)).train.alpha >= 0.5
    if any(scene.glob("cameras*.npz")):
        without = load_idr(scene, IdrOptions(downscale=downscale, masks="none")).train
        there = (scene / "mask").is_dir()
        return without, load_idr(scene, IdrOptions(downscale=downscale)).train.alpha >= 0.5 if there else None
    views = load_blender(scene, BlenderOptions(downscale=downscale)).train
    if views.has_masks:
        alpha = np.asarray(views.alpha)
        return replace(views, alpha=np.ones_like(alpha), has_masks=False), alpha >= 0.5
    files = [scene / "masks" / f"{name}.png" for name in views.names]
    if not all(file.is_file() for file in files):
        return views, None
    size = views.height, downscale, views.width, downscale
    return views, np.stack([read_mask(file).reshape(size).mean(axis=(1, 3)) for file in files]) >= 0.5


def on_a_table(scene: Path, downscale: int) -> tuple[Views, np.ndarray]:
    """(views without masks of a rendered object on a round table under its lowest point, its masks)."""
    case = load_case(scene, downscale, 0)
    views = case.train
    assert case.truth is not None, f"{scene}: no true mesh to put on a table"
    ground = float(case.truth[0][:, 1].min()) - 0.002
    views = views.subset(np.flatnonzero(views.camera_to_world[:, 1, 3] > ground + 0.3))
    alpha, images = np.asarray(views.alpha), []
    for number, pose in enumerate(views.camera_to_world):
        behind = backdrop(views, number, pose, ground)
        images.append(np.asarray(views.images[number]) + (1 - alpha[number])[..., None] * behind)
    images = np.stack(images).astype(np.float32)
    return replace(views, images=images, alpha=np.ones_like(alpha), has_masks=False), alpha >= 0.5


def backdrop(views: Views, number: int, pose: np.ndarray, ground: float) -> np.ndarray:
    """Linear colour float64 [H, W, 3] of what stands behind: a disc of radius 1.4 at height `ground`, a far wall."""
    rows, columns = np.indices((views.height, views.width)) + 0.5
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
    rays = pixels @ np.linalg.inv(views.intrinsics[number]).T @ pose[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    far = (ground - pose[1, 3]) / np.where(np.abs(rays[..., 1]) < 1e-9, 1e-9, rays[..., 1])
    place = pose[:3, 3] + far[..., None] * rays
    on = (far > 0) & (np.hypot(place[..., 0], place[..., 2]) < 1.4)
    angle = np.arctan2(rays[..., 2], rays[..., 0]) / np.pi
    wall = noise(np.stack([40 * angle, 40 * rays[..., 1]]), 2) * [0.8, 0.9, 1.0]
    table = noise(40 * np.stack([place[..., 0], place[..., 2]]).clip(-9, 9), 1) * [1.0, 0.75, 0.5]
    return srgb_to_linear(np.where(on[..., None], table, wall).clip(0, 1))


def noise(places: np.ndarray, seed: int) -> np.ndarray:
    """[H, W, 1] in about 0.1 to 0.7 at places [2, H, W]: two octaves of values at whole numbers, linear between."""
    grid = np.random.default_rng(seed).random((256, 256))
    fine, rough = (map_coordinates(grid, np.mod(places * k, 255), order=1) for k in (1.0, 0.21))
    return (0.1 + 0.3 * fine + 0.3 * rough)[..., None]


def line(name: str, views: Views, truth: np.ndarray | None, out: mask.AutoOut, seconds: float) -> str:
    rows = {row["name"]: row for row in out.decisions.values["decisions"]}
    found, evidence = rows["masks"]["value"] == "found", rows["masks"].get("evidence", {})
    middle = worst = "-"
    if found and truth is not None:
        kept = [views.names.index(one) for one in out.train.names]
        scores = overlap(np.asarray(out.train.alpha) >= 0.5, truth[kept])
        middle, worst = f"{np.median(scores):.3f}", f"{scores.min():.3f}"
    table = rows.get("table", {"value": "-", "evidence": {}})
    apart, agreed = table["evidence"].get("apart", float("nan")), evidence.get("overlap", float("nan"))
    return (
        f"{name:22s} {len(views):5d} {f'{views.width}x{views.height}':>9s} {rows['masks']['value']:>6s} "
        f"{table['value']:>8s} {middle:>6s} {worst:>6s} {apart:6.2f} {agreed:7.2f} {seconds:5.0f}"
    )


def started(scene: Path, views: Views) -> str:
    """The coarse start from these views against the object's true mesh: closed or open, distances."""
    file = next(
        (scene / f"mesh/{name}.obj" for name in ("object", "mesh") if (scene / f"mesh/{name}.obj").is_file()), None
    )
    if file is None:
        return "no true mesh"
    frame = load_blender(scene, BlenderOptions(max_views=0)).frame
    vertices, faces = read_mesh(file)
    vertices = points_to_normalised(vertices, frame)
    made = auto.auto(FakeContext(), views, p=auto.AutoParams(faces=8000)).mesh
    middles = vertices[faces].mean(axis=1)
    there = np.linalg.norm(nearest_of(made.vertices, made.faces)(middles) - middles, axis=1)
    own = made.vertices.astype(np.float64)
    back = np.linalg.norm(nearest_of(vertices, faces)(own) - own, axis=1)
    return (
        f"{'closed' if made.facets()['closed'] else 'open':6s} {len(made.faces)} faces; truth to start "
        f"{1e3 * there.mean():.1f}, within 20: {(there < 0.02).mean():.0%}; start to truth {1e3 * back.mean():.1f}"
    )


def sheet(views: Views, masked: Views) -> np.ndarray:
    """Six views in two columns: the picture, and what its mask leaves of it on green."""
    rows = []
    for number in np.linspace(0, len(masked) - 1, 6).astype(int):
        source = views.names.index(masked.names[number])
        alpha = np.asarray(masked.alpha[number])[..., None] if masked.has_masks else 1.0
        whole = linear_to_srgb(np.clip(np.asarray(views.images[source]), 0, 1))
        rows.append(np.concatenate([whole, alpha * whole + (1 - alpha) * (0.3 * whole + [0, 0.35, 0])], axis=1))
    return np.concatenate([np.concatenate(rows[k : k + 2], axis=1) for k in (0, 2, 4)])


if __name__ == "__main__":
    main()
