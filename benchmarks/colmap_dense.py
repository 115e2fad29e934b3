"""COLMAP's dense steps that run without CUDA beside ours, on the same pictures: error, completeness, seconds.

    python -m benchmarks.colmap_dense SCENE ... [--downscale N] [--table] [--json FILE]

Scenes lose their masks first (--table: and stand on a noisy table, as in benchmarks.object_masks). COLMAP has no depth
without CUDA: `patch_match_stereo` is asked, and what it says is printed. So its fusion (`stereo_fusion`) and Poisson
surface (`poisson_meshing`, Kazhdan and Hoppe 2013, at 512 voxels) get the depth and normals of `prior.patch_match`, and
sparse points made of these, which tell it what views overlap. Ours fuses the same depth (`init.auto`, cleaned up to 20
000 faces), and carves the hull of masks that `mask.auto` finds. Thousandths of the true mesh's radius: `to truth` from
samples of what stands where the object is (its box and 5 % around, a fiftieth above its lowest point), `from truth` and
the share within 20 from samples of the truth (which no distance over 100 counts in). Seconds are processor seconds of
all threads, without the depth, which is on a line of its own.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from exmesh_nodes import auto, mask

from benchmarks.coarse_work import Surface
from benchmarks.object_masks import bare, on_a_table
from benchmarks.register import choosing
from exmesh_graph.evaluate.metrics.distance import distance_to_mesh
from exmesh_graph.evaluate.metrics.mesh import bounding_radius
from exmesh_graph.geometry.surface import sample_surface
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.meshes import read_mesh
from exmesh_graph.io.normalise import points_to_normalised
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.priors.patch_match.estimate import patch_match
from exmesh_graph.priors.settings import PatchMatchSettings
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Views

SAMPLES, FAR, NEAR, TRIED = 20_000, 100.0, 20.0, 40
DEPTH, TRIM, FACES = 9, 5.0, 20_000
HEAD = f"{'':34s} {'s':>6s} {'to truth':>9s} {'from truth':>11s} {'within 20':>10s} {'faces':>8s}"


def main() -> None:
    options = arguments()
    rows: list[dict[str, Any]] = []
    for scene in options.scenes:
        choosing(scene)
        rows += of_scene(scene, (on_a_table if options.table else bare)(scene, options.downscale)[0])
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


def of_scene(scene: Path, views: Views) -> list[dict[str, Any]]:
    """A row for each way from the depth to a surface; prints them."""
    truth, rows = true_object(scene), []
    begun = time.process_time()
    stereo = patch_match(views, PatchMatchSettings())
    seconds = time.process_time() - begun
    print(f"{scene.name}, {len(views)} views of {views.width} x {views.height}; depth {seconds:.0f} s\n{HEAD}")
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        write_workspace(work, views, stereo.depths.depth, stereo.normals)
        print(f"COLMAP, depth of its own: {asked_for_depth(work)}")
        ways: dict[str, Callable[[], Surface]] = {
            "COLMAP: fusion, Poisson": lambda: by_colmap(work, 5),
            "COLMAP: fusion of 3, Poisson": lambda: by_colmap(work, 3),
            "ours: init.auto, no masks": lambda: fused(views, stereo.depths),
            "ours: mask.auto, init.auto": lambda: carved(views),
        }
        for name, make in ways.items():
            begun = time.process_time()
            surface = make()
            row = {"scene": scene.name, "way": name, "s": time.process_time() - begun, **scored(*surface, *truth)}
            rows.append(row)
            print(f"{name:34s} {row['s']:6.1f} {row['to']:9.1f} {row['from']:11.1f} {row['within']:10.1%} "
                  f"{row['faces']:8d}", flush=True)  # fmt: skip
    return rows


def true_object(scene: Path) -> Surface:
    """The object without its table, in the normalised world."""
    files = [scene / f"mesh/{name}.obj" for name in ("object", "mesh")]
    vertices, faces = read_mesh(next(file for file in files if file.is_file()))
    return points_to_normalised(vertices, load_blender(scene, BlenderOptions(max_views=0)).frame), faces


def write_workspace(work: Path, views: Views, depth: np.ndarray, normals: np.ndarray) -> None:
    """COLMAP's dense workspace: pictures, cameras, points that tell what overlaps, maps of depth and normals."""
    import pycolmap
    from PIL import Image

    for place in ("images", "sparse", "stereo/depth_maps", "stereo/normal_maps"):
        (work / place).mkdir(parents=True)
    model = pycolmap.Reconstruction()
    tracks = shared_points(views, depth)
    for i, (k, pose) in enumerate(zip(views.intrinsics, views.world_to_camera, strict=True)):
        size = {"width": views.width, "height": views.height}
        params = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        model.add_camera_with_trivial_rig(pycolmap.Camera(model="PINHOLE", camera_id=i + 1, params=params, **size))
        places = [track[i] for _, track in tracks if i in track]
        picture = pycolmap.Image(f"{i:03d}.png", np.array(places).reshape(-1, 2), camera_id=i + 1, image_id=i + 1)
        turn = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3])
        model.add_image_with_trivial_frame(picture, turn)
        shown = linear_to_srgb(np.clip(np.asarray(views.images[i]), 0, 1))
        Image.fromarray(np.round(255 * shown).astype(np.uint8)).save(work / "images" / f"{i:03d}.png")
        _write_map(work / f"stereo/depth_maps/{i:03d}.png.geometric.bin", depth[i][..., None])
        _write_map(work / f"stereo/normal_maps/{i:03d}.png.geometric.bin", normals[i])
    counted = dict.fromkeys(range(len(views)), 0)
    for place, track in tracks:
        elements = []
        for i in track:
            elements.append(pycolmap.TrackElement(i + 1, counted[i]))
            counted[i] += 1
        model.add_point3D(place, pycolmap.Track(elements), np.array([128, 128, 128], np.uint8))
    model.write(work / "sparse")
    names = [f"{i:03d}.png" for i in range(len(views))]
    (work / "stereo" / "fusion.cfg").write_text("\n".join(names) + "\n")
    (work / "stereo" / "patch-match.cfg").write_text("".join(f"{name}\n__auto__, 20\n" for name in names))


def shared_points(views: Views, depth: np.ndarray) -> list[tuple[np.ndarray, dict[int, np.ndarray]]]:
    """(point [3], {view: its pixel [2]}): of `TRIED` pixels of each view, where two views have the same depth."""
    rng, found = np.random.default_rng(0), []
    for i, (k, pose) in enumerate(zip(views.intrinsics, views.camera_to_world, strict=True)):
        rows, columns = np.nonzero(depth[i])
        for at in rng.choice(len(rows), size=min(TRIED, len(rows)), replace=False) if len(rows) else ():
            pixel = np.array([columns[at] + 0.5, rows[at] + 0.5, 1.0])
            point = pose[:3, :3] @ (np.linalg.inv(k) @ pixel * depth[i, rows[at], columns[at]]) + pose[:3, 3]
            track = {}
            for j, (other, turn) in enumerate(zip(views.intrinsics, views.world_to_camera, strict=True)):
                x, y, z = other @ (turn[:3, :3] @ point + turn[:3, 3])
                if z <= 0 or not (0 <= x / z < views.width and 0 <= y / z < views.height):
                    continue
                if abs(depth[j, int(y / z), int(x / z)] - z) < 0.01 * z:
                    track[j] = np.array([x / z, y / z])
            if len(track) >= 2:
                found.append((point, track))
    return found


def _write_map(file: Path, values: np.ndarray) -> None:
    """[H, W, C] as COLMAP's Mat: a header in ASCII, then float32, one channel after the other."""
    height, width, channels = values.shape
    with file.open("wb") as out:
        out.write(f"{width}&{height}&{channels}&".encode())
        out.write(np.ascontiguousarray(values.transpose(2, 0, 1), np.float32).tobytes())


def asked_for_depth(work: Path) -> str:
    """What COLMAP says when it is asked for depth."""
    import pycolmap

    try:
        pycolmap.patch_match_stereo(str(work))
    except Exception as error:
        return str(error).strip().splitlines()[-1]
    return "made"


def by_colmap(work: Path, least: int) -> Surface:
    """The surface through points of at least `least` pixels that agree (its default: 5).

    Its default trims what lies on nodes above level 10, which is all that pictures of this size give.
    """
    import pycolmap

    fusion = pycolmap.StereoFusionOptions()
    fusion.min_num_pixels = least
    pycolmap.stereo_fusion(work / "fused.ply", work, input_type="geometric", options=fusion, output_type="PLY")
    poisson = pycolmap.PoissonMeshingOptions()
    poisson.depth, poisson.trim = DEPTH, TRIM
    pycolmap.poisson_meshing(work / "fused.ply", work / "surface.ply", options=poisson)
    return read_mesh(work / "surface.ply")


def fused(views: Views, depths: Any) -> Surface:
    made = auto.auto(FakeContext(), views, None, depths, p=auto.AutoParams(faces=FACES)).mesh
    return made.vertices, made.faces


def carved(views: Views) -> Surface:
    masked = mask.auto(FakeContext(), views, p=mask.AutoParams()).train
    made = auto.auto(FakeContext(), masked, p=auto.AutoParams(faces=FACES)).mesh
    return made.vertices, made.faces


def scored(vertices: np.ndarray, faces: np.ndarray, true: np.ndarray, true_faces: np.ndarray) -> dict[str, Any]:
    radius = bounding_radius(true)
    low, high = true.min(axis=0), true.max(axis=0)
    room = 0.05 * (high - low).max()
    low, high = low - room, high + room
    low[1] = true[:, 1].min() + 0.02 * radius
    ours, _, _ = sample_surface(np.asarray(vertices, np.float64), np.asarray(faces), 4 * SAMPLES, 0)
    ours = ours[((ours > low) & (ours < high)).all(axis=1)][:SAMPLES]
    theirs, _, _ = sample_surface(np.asarray(true, np.float64), true_faces, SAMPLES, 1)
    theirs = theirs[theirs[:, 1] > low[1]]
    to = 1000 / radius * distance_to_mesh(ours, true, true_faces)
    back = 1000 / radius * distance_to_mesh(theirs, np.asarray(vertices, np.float64), faces)
    return {"to": float(to.mean()), "from": float(back.clip(max=FAR).mean()), "within": float((back < NEAR).mean()),
            "faces": len(faces)}  # fmt: skip


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+", help="rendered scenes with a true mesh, for choosing")
    parser.add_argument("--downscale", type=int, default=1, help="reduce the pictures by this factor")
    parser.add_argument("--table", action="store_true", help="put the object on a noisy table")
    parser.add_argument("--json", type=Path, help="write the table here too")
    return parser.parse_args()


if __name__ == "__main__":
    main()
