"""The Blender / NeRF-Synthetic layout, with the truth that rendered scenes carry.

scene/transforms_train.json, transforms_test.json (or transforms.json): frames of {file_path, transform_matrix}, with
`camera_angle_x` or `fl_x, fl_y, cx, cy, w, h` (and nerfstudio's `k1` to `k4`, `p1`, `p2`, which are undone) for all
frames or each. `file_path` may lack its ending; `train/000` stands for train/000_rgba.exr, 000_rgb.exr, 000.exr,
000_rgba.png, 000.png or 000.jpg. A picture without alpha takes its mask from train/000_mask.png where that is there.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import opencv_from_blender
from exmesh_graph.io.lens import Lens
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.io.shots import Shot, hold_out, need_folder, relative_names, shot_files, spread
from exmesh_graph.io.truth_files import truth_files

if TYPE_CHECKING:
    from exmesh_graph.io.scene import Scene

_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
_MODELS = ("OPENCV", "OPENCV_FISHEYE", "SIMPLE_RADIAL", "RADIAL", "PINHOLE", "SIMPLE_PINHOLE")
_ENDINGS = {
    "auto": ("_rgba.exr", "_rgb.exr", ".exr", "_rgba.png", ".png", ".jpg", ".jpeg"),
    "true": ("_rgba.exr", "_rgb.exr", ".exr"),
    "false": ("_rgba.png", ".png", ".jpg", ".jpeg"),
}


def list_blender(path: Path, options: BlenderOptions) -> tuple[list[Shot], list[Shot], bool]:
    """(train, test, whether the test views are the data set's own), without reading a picture."""
    folder = need_folder(path)
    train_file = folder / "transforms_train.json"
    if not train_file.is_file():
        train_file = folder / "transforms.json"
    hdr = str(options.hdr).lower()
    train = read_frames(folder, train_file, hdr)
    test_file = folder / "transforms_test.json"
    test: list[Shot] = []
    if options.test != "holdout" and (test_file.is_file() or options.test == "file"):
        test = read_frames(folder, test_file, hdr)
    own = len(test) >= options.min_test_views or (options.test == "file" and len(test) > 0)
    if not own:
        kept, held = hold_out(len(train), options.holdout, options.holdout // 2)
        if not held:
            raise DataError(
                f"there are no test views, and {len(train)} training views are too few to hold out every "
                f"{options.holdout}-th",
                where=str(train_file), fix="add transforms_test.json, or lower `holdout`",
            )  # fmt: skip
        train, test = [train[i] for i in kept], [train[i] for i in held]
    train = [train[i] for i in spread(len(train), options.max_views)]
    test = [test[i] for i in spread(len(test), options.max_test_views)]
    return train, test, own


def load_blender(path: Path, options: BlenderOptions | None = None) -> Scene:
    """Load the scene; truth where the test views are the data set's own and `options.truth` asks for it."""
    # Listing a scene must stay quick (`exmesh check`); what reads and normalises pictures is imported here.
    from exmesh_graph.io.scene import load_scene
    from exmesh_graph.io.truth import load_truth

    options = options or BlenderOptions()
    train, test, own = list_blender(path, options)
    scene = load_scene(
        train, test, up=options.up, downscale=options.downscale, wrong_masks=options.wrong_masks, box=options.box,
        metres_per_unit=options.metres_per_unit, checks=options.checks, key=options.key, size=options,
    )  # fmt: skip
    if not options.truth:
        return scene
    hdr = test[0].image.suffix == ".exr"
    truth, notes = load_truth(
        Path(path), test if own else [], scene.frame, options.downscale, hdr, options.up, options.true_mesh
    )
    return replace(scene, truth=truth, notes=[*scene.notes, *notes])


def blender_files(path: Path, options: BlenderOptions) -> dict[str, Path]:
    """Every file that `load_blender` reads, by a name that does not depend on where the scene lies."""
    folder = need_folder(path)
    train, test, own = list_blender(folder, options)
    files = [f for f in (folder / f"transforms{s}.json" for s in ("_train", "", "_test")) if f.is_file()]
    files += shot_files([*train, *test])
    if options.truth:
        files += truth_files(folder, test if own else [], test[0].image.suffix == ".exr", options.up, options.true_mesh)
    return relative_names(folder, files)


def read_frames(folder: Path, file: Path, hdr: str) -> list[Shot]:
    """The shots a transforms file lists, pictures below `folder`. DataError names file and frame."""
    content = read_json(file)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not frames:
        raise DataError(
            "the file lists no views", where=str(file), expected='"frames": [{"file_path", "transform_matrix"}, ...]'
        )
    shots = []
    for index, frame in enumerate(frames):
        try:
            shots.append(read_frame(folder, file, index, {**content, **frame}, hdr))
        except (KeyError, ValueError, TypeError) as error:
            raise DataError(
                f"the frame cannot be read ({type(error).__name__}: {error})", where=f"{file}, frame {index}",
                expected="file_path, a 4 x 4 transform_matrix, and numbers for w, h, fl_x, camera_angle_x, ...",
            ) from error  # fmt: skip
    return shots


def read_frame(folder: Path, file: Path, index: int, frame: dict[str, Any], hdr: str) -> Shot:
    """One entry of a transforms file, together with what the file says for all."""
    where = f"{file}, frame {index}"
    stem = str(frame["file_path"]).removeprefix("./")
    pose = np.array(frame["transform_matrix"], dtype=np.float64)
    if pose.shape == (3, 4):
        pose = np.vstack([pose, [0, 0, 0, 1]])
    if pose.shape != (4, 4):
        raise DataError(f"transform_matrix is {pose.shape}", where=where, expected="4 x 4 (or 3 x 4) numbers")
    bent = [name for name in _DISTORTION if frame.get(name)]
    image = _resolve(folder / stem, hdr)
    mask = image.with_name(image.stem.removesuffix("_rgba").removesuffix("_rgb") + "_mask.png")
    size = (int(frame["w"]), int(frame["h"])) if "w" in frame and "h" in frame else None
    shot = Shot(
        name=stem.removesuffix(".png").removesuffix(".jpg").removesuffix(".exr").replace("/", "_"),
        image=image,
        camera_to_world=opencv_from_blender(pose),
        mask=mask if not _has_alpha_name(image) and mask.is_file() else None,
        size=size,
    )
    if "fl_x" in frame:
        if size is None:
            raise DataError("fl_x is given without w and h", where=where, fix="add w and h, the image size in pixels")
        fx = float(frame["fl_x"])
        fy, cx, cy = (float(frame.get(k, d)) for k, d in (("fl_y", fx), ("cx", size[0] / 2), ("cy", size[1] / 2)))
        k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        return replace(shot, intrinsics=k, lens=_lens(frame, size, k, where) if bent else None)
    if bent:
        raise DataError(f"the camera has lens distortion ({', '.join(bent)}), but no fl_x", where=where,
                        fix="give fl_x, fl_y, cx, cy, w and h, or undistort the pictures")  # fmt: skip
    angle = float(frame.get("camera_angle_x", 0))
    if not 0 < angle < np.pi:
        raise DataError(f"camera_angle_x is {angle:g}", where=where, expected="radians between 0 and pi, or fl_x")
    return replace(shot, angle_x=angle)


def _lens(frame: dict[str, Any], size: tuple[int, int], k: np.ndarray, where: str) -> Lens:
    """The lens of nerfstudio's transforms: OPENCV or OPENCV_FISHEYE, in COLMAP's words."""
    model = str(frame.get("camera_model", "OPENCV"))
    if model not in _MODELS:
        raise DataError(f"camera_model is {model}, with distortion", where=where, expected=" or ".join(_MODELS),
                        fix="undistort the pictures (colmap image_undistorter)")  # fmt: skip
    *radial, p1, p2 = (float(frame.get(name) or 0) for name in _DISTORTION)
    fisheye = "FISHEYE" in model
    return Lens(
        *size, (k[0, 0], k[1, 1]), (k[0, 2], k[1, 2]), tuple(radial), (0.0, 0.0) if fisheye else (p1, p2),
        fisheye=fisheye,
    )  # fmt: skip


def _has_alpha_name(image: Path) -> bool:
    return image.name.removesuffix(image.suffix).endswith("_rgba")


def _resolve(stem: Path, hdr: str) -> Path:
    if stem.suffix.lower() in (".png", ".jpg", ".jpeg", ".exr", ".tif", ".tiff"):
        return stem
    for ending in _ENDINGS[hdr]:
        candidate = stem.with_name(stem.name + ending)
        if candidate.is_file():
            return candidate
    names = ", ".join(stem.name + ending for ending in _ENDINGS[hdr])
    raise DataError(
        "the image does not exist", where=str(stem), expected=f"one of {names}",
        fix="check file_path and the ending" + ("; or set hdr: auto" if hdr == "true" else ""),
    )  # fmt: skip


def read_json(file: Path) -> Any:
    """Parsed JSON; DataError for a missing or malformed file, with line and column."""
    if not file.is_file():
        raise DataError("the camera file does not exist", where=str(file),
                        expected="transforms_train.json or transforms.json",
                        fix="correct the loader's `path`, or use the loader of this data set's layout")  # fmt: skip
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"the file is not valid JSON ({error})", where=str(file), fix="export it again") from error
