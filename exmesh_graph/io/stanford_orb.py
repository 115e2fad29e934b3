"""Stanford-ORB's Blender layout: blender_HDR/<scene>/ beside ground_truth/<scene>/.

    blender_HDR/<scene>/transforms_{train,test,novel}.json, train/0000.exr, train_mask/0000.png, test/..., test_mask/...
    ground_truth/<scene>/env_map/0000.exr (per test view), z_depth/0000.npy, surface_normal/0000.npy,
        pseudo_gt_albedo/0000.png, mesh_blender/mesh.obj

`transforms_novel.json` lists the test views of the object's two other captures, with cameras in this capture's world;
`scene_name` says whose pictures they are, and each frame has its own `camera_angle_x`. Pictures are linear, 2048 x
2048.

Environment maps are panoramas as the view's camera sees them: the middle looks forward, right is the camera's right,
up its up. With a novel view's camera they are turned into this capture's world. Normals are in OpenGL camera axes (x
right, y up, z towards the viewer). Both conventions were read off the benchmark's users, not off data: check a first
relit picture by eye.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.blender import read_frame, read_frames, read_json
from exmesh_graph.io.settings import OrbOptions
from exmesh_graph.io.shots import Shot, all_or_none, need_folder, relative_names, shot_files, spread

if TYPE_CHECKING:
    from exmesh_graph.io.scene import Scene
    from exmesh_graph.types import Frame, LitViews, SceneTruth

_MAP_ROWS = 256


@dataclass(frozen=True)
class OrbShots:
    """The three lists of a capture; lights[i] is the environment map of novel[i]."""

    train: list[Shot]
    test: list[Shot]
    novel: list[Shot]
    lights: list[Path]
    truth: Path


def list_orb(path: Path, options: OrbOptions) -> OrbShots:
    """What the capture holds, without reading a picture."""
    folder = need_folder(path).resolve()
    train = [_masked(shot) for shot in read_frames(folder, folder / "transforms_train.json", "true")]
    test = [_masked(shot) for shot in read_frames(folder, folder / "transforms_test.json", "true")]
    truth = folder.parent.parent / "ground_truth"
    novel, lights = _novel(folder, truth)
    chosen = spread(len(novel), options.max_novel_views)
    return OrbShots(
        [train[i] for i in spread(len(train), options.max_views)],
        [test[i] for i in spread(len(test), options.max_test_views)],
        [novel[i] for i in chosen],
        [lights[i] for i in chosen],
        truth / folder.name,
    )


def load_orb(path: Path, options: OrbOptions | None = None) -> tuple[Scene, LitViews]:
    """(training and test views with the truth of the latter, the novel views with their lights)."""
    from exmesh_graph.io.load import load_shots, to_views
    from exmesh_graph.io.scene import load_scene
    from exmesh_graph.types import LitViews

    options = options or OrbOptions()
    shots = list_orb(path, options)
    scene = load_scene(shots.train, shots.test, up="z", downscale=options.downscale, checks=options.checks)
    loaded = load_shots(shots.novel, split="novel", downscale=options.downscale)
    views = to_views(loaded, scene.frame, "test", has_masks=loaded.has_masks)
    maps = [_turned(file, pose) for file, pose in zip(shots.lights, views.camera_to_world, strict=True)]
    lit = LitViews(**vars(views), environments=np.stack(maps))
    return replace(scene, truth=_truth(shots, scene.frame, options.downscale)), lit


def orb_files(path: Path, options: OrbOptions) -> dict[str, Path]:
    """Every file that `load_orb` reads; pictures of the other captures by <capture>/<folder>/<name>."""
    shots = list_orb(path, options)
    folder = need_folder(path).resolve()
    files = [folder / f"transforms_{split}.json" for split in ("train", "test", "novel")]
    files += shot_files([*shots.train, *shots.test])
    others = shot_files(shots.novel) + shots.lights
    others += [file for _, files in _maps(shots) for file in files] + [shots.truth / "mesh_blender" / "mesh.obj"]
    root = folder.parent.parent
    return relative_names(folder, files) | {file.relative_to(root).as_posix(): file for file in others}


def _masked(shot: Shot) -> Shot:
    mask = shot.image.parent.with_name(f"{shot.image.parent.name}_mask") / f"{shot.image.stem}.png"
    if not mask.is_file():
        raise DataError("the view has no mask", where=str(mask), expected="train_mask/0000.png for train/0000.exr",
                        fix="unpack the data set again")  # fmt: skip
    return replace(shot, mask=mask)


def _novel(folder: Path, truth: Path) -> tuple[list[Shot], list[Path]]:
    """Views of the other captures in this one's world, and the map of each."""
    file = folder / "transforms_novel.json"
    content: dict[str, Any] = read_json(file)
    shots, lights = [], []
    for index, frame in enumerate(content.get("frames", ())):
        capture = frame.get("scene_name")
        if not capture or capture == folder.name:
            raise DataError(
                f"the frame's picture is of {capture!r}, not of another capture", where=f"{file}, frame {index}",
                expected='"scene_name": "<object>_scene00x", under another light than this capture\'s',
            )  # fmt: skip
        shot = read_frame(folder.parent / capture, file, index, {**content, **frame}, "true")
        light = truth / capture / "env_map" / f"{shot.image.stem}.exr"
        if not light.is_file():
            raise DataError("the view's environment map does not exist", where=str(light),
                            fix="unpack ground_truth beside blender_HDR")  # fmt: skip
        shots.append(_masked(replace(shot, name=f"{capture}_{shot.name}")))
        lights.append(light)
    if not shots:
        raise DataError("the file lists no views", where=str(file), expected="frames of the object's other captures")
    return shots, lights


def _maps(shots: OrbShots) -> list[tuple[str, list[Path]]]:
    """(field of SceneTruth, file of each test view) of the maps that are there; DataError where only some are."""
    maps = []
    for name, place, ending in (
        ("depth", "z_depth", ".npy"),
        ("normal", "surface_normal", ".npy"),
        ("albedo", "pseudo_gt_albedo", ".png"),
    ):
        files = [shots.truth / place / f"{shot.image.stem}{ending}" for shot in shots.test]
        if there := all_or_none(files, "the truth map", "unpack ground_truth again"):
            maps.append((name, there))
    return maps


def _truth(shots: OrbShots, frame: Frame, downscale: int) -> SceneTruth:
    from exmesh_graph.io.color import srgb_to_linear
    from exmesh_graph.io.images import read_image
    from exmesh_graph.io.meshes import read_mesh
    from exmesh_graph.io.normalise import frame_scale, points_to_normalised
    from exmesh_graph.io.reduce import downscale_area
    from exmesh_graph.types import SceneTruth

    vertices, faces = read_mesh(shots.truth / "mesh_blender" / "mesh.obj")
    maps: dict[str, np.ndarray] = {}
    for name, files in _maps(shots):
        read = []
        for file in files:
            values = read_image(file)[..., :3] if name == "albedo" else _array(file)
            small = downscale_area(values.astype(np.float32), downscale, file)
            if name == "albedo":  # averaged as stored, then decoded, as the benchmark does
                small = srgb_to_linear(small)
            elif name == "normal":
                small = small * np.array([1, -1, -1], np.float32)
            else:
                small = small.reshape(small.shape[:2]) / np.float32(frame_scale(frame))
            read.append(small.astype(np.float32))
        maps[name] = np.stack(read)
    return SceneTruth(
        names=tuple(shot.name for shot in shots.test),
        mesh_vertices=points_to_normalised(vertices, frame).astype(np.float32),
        mesh_faces=faces,
        **maps,  # type: ignore[arg-type]
    )


def _array(file: Path) -> np.ndarray:
    try:
        values = np.load(file, allow_pickle=False)
    except (ValueError, OSError) as error:
        raise DataError(
            f"the map cannot be read ({error})", where=str(file), fix="unpack ground_truth again"
        ) from error
    if not np.isfinite(values).all():
        raise DataError("the map holds NaN or Inf", where=str(file), fix="unpack ground_truth again")
    return values


def _turned(file: Path, camera_to_world: np.ndarray) -> np.ndarray:
    from exmesh_graph.io.envmaps import read_environment
    from exmesh_graph.io.reduce import downscale_area

    panorama = read_environment(file)
    factor = max(1, panorama.shape[0] // _MAP_ROWS)
    if panorama.shape[0] % factor == 0 and panorama.shape[1] % factor == 0:
        panorama = downscale_area(panorama, factor, file)
    return world_from_panorama(panorama, camera_to_world[:3, :3])


def world_from_panorama(panorama: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The canonical map float32 [h, w, 3] of a panorama seen by an OpenCV camera of that `rotation` (to the world).

    A world direction d is rotation^T d in the camera (x right, y down, z forward); the panorama's column there is
    u = 1/2 + atan2(x, z) / 2 pi, its row v = acos(-y) / pi. Bilinear, round in u.
    """
    from scipy.ndimage import map_coordinates

    from exmesh_graph.io.envmaps import canonical_directions

    height, width = panorama.shape[:2]
    x, y, z = np.moveaxis(canonical_directions(height, width) @ rotation, -1, 0)
    column = (0.5 + np.arctan2(x, z) / (2 * np.pi)) * width - 0.5
    row = np.arccos(np.clip(-y, -1, 1)) / np.pi * height - 0.5
    ringed = np.pad(panorama, ((1, 1), (1, 1), (0, 0)), mode="edge")
    ringed[1:-1, 0], ringed[1:-1, -1] = panorama[:, -1], panorama[:, 0]
    where = [row + 1, column + 1]
    return np.stack([map_coordinates(ringed[..., c], where, order=1) for c in range(3)], -1).astype(np.float32)
