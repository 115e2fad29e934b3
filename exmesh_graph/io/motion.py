"""Structure from motion through COLMAP's Python package: cameras and sparse points of a folder of photographs.

pycolmap (BSD) is optional: `pip install 'exmesh-graph[photos]'`. SIFT features, all pairs, and what the matches support
best of three mappings (`mapping`). Pixel centres lie at +0.5 in COLMAP as they do here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.images import picture_size, write_image
from exmesh_graph.io.mapping import SEEN_BY, Mapped, map_cameras
from exmesh_graph.io.normalise import some
from exmesh_graph.io.settings import MotionSettings
from exmesh_graph.native import import_pycolmap

_MODELS = {"pinhole": "SIMPLE_PINHOLE", "radial": "SIMPLE_RADIAL", "opencv": "OPENCV"}


@dataclass(frozen=True)
class Motion:
    """Cameras of the registered pictures and sparse points, in a world of unknown scale and axes.

    camera_to_world  float64 [4, 4] by picture name, OpenCV axes
    camera           index into `lenses` by picture name
    lenses           pycolmap's cameras, with distortion
    points, colours  float64 [P, 3] seen by three pictures or more; display colour in [0, 1]
    tracks           int [P], by how many
    left_out         pictures without a camera, or tied to the others by pairs alone (`mapping.tied`)
    error            mean reprojection error in pixels
    focal_known      whether a focal length was given or stood in the EXIF data
    how              which mapping they are from
    """

    camera_to_world: Mapping[str, np.ndarray]
    camera: Mapping[str, int]
    lenses: Sequence[Any]
    points: np.ndarray
    colours: np.ndarray
    tracks: np.ndarray
    left_out: tuple[str, ...]
    error: float
    focal_known: bool
    how: str

    def figures(self) -> dict[str, Any]:
        """For the report: counts, names of what was left out, error, and the (mean) lens."""
        focal = [lens.calibration_matrix()[0, 0] for lens in self.lenses]
        return {
            "pictures": len(self.camera_to_world) + len(self.left_out),
            "registered": len(self.camera_to_world),
            "left_out": list(self.left_out),
            "mapping": self.how,
            "points": len(self.points),
            "reprojection_error_px": self.error,
            "focal": float(np.mean(focal)),
            "focal_known": self.focal_known,
            "lens": [float(x) for x in np.mean([lens.params for lens in self.lenses], axis=0)],
        }


def find_motion(
    images: Sequence[Path], masks: Mapping[str, np.ndarray], settings: MotionSettings, work: Path, seed: int = 0
) -> Motion:
    """Cameras of `images`, files of one folder and one size; `work` is an empty folder for the database.

    masks  alpha [H, W] by file name: features where it is below 1/2 are ignored
    The same pictures, seed and version give the same bytes: mapping runs on one thread, whatever `threads` says of
    features and matching. Pictures that hang on the others by pairs alone are left out (`mapping.tied`).
    Raises DataError, naming pictures, where fewer than the share `registered` (or than three) get a camera,
    MissingLibraryError without pycolmap.
    """
    colmap = import_pycolmap()
    names = [image.name for image in images]
    level, colmap.logging.minloglevel = colmap.logging.minloglevel, 3
    try:
        colmap.set_random_seed(seed)
        database = work / "database.db"
        _features(colmap, database, images[0].parent, names, _mask_files(masks, work), settings)
        matching = colmap.FeatureMatchingOptions()
        matching.num_threads = settings.threads
        verify = colmap.TwoViewGeometryOptions()
        verify.ransac.random_seed, verify.ransac.num_threads = seed, 1
        colmap.match_exhaustive(
            database, matching_options=matching, verification_options=verify, device=colmap.Device.cpu
        )
        mapped = map_cameras(colmap, database, images[0].parent, work, seed, settings.mapping)
    finally:
        colmap.logging.minloglevel = level
    left_out = tuple(name for name in names if mapped is None or name not in mapped.names)
    _check_enough(names, left_out, settings, images[0].parent)
    assert mapped is not None
    return _motion(mapped, left_out)


def _mask_files(masks: Mapping[str, np.ndarray], work: Path) -> Path | None:
    if not masks:
        return None
    folder = work / "masks"
    folder.mkdir()
    for name, alpha in masks.items():
        write_image(folder / f"{name}.png", (alpha >= 0.5).astype(np.float32))
    return folder


def _features(
    colmap: Any, database: Path, folder: Path, names: list[str], masks: Path | None, settings: MotionSettings
) -> None:
    mode = colmap.CameraMode.SINGLE if settings.one_camera else colmap.CameraMode.PER_IMAGE
    reader = colmap.ImageReaderOptions()
    reader.camera_model = _MODELS[settings.lens]
    if masks is not None:
        reader.mask_path = masks
    if settings.focal > 0:
        width, height = picture_size(folder / names[0])
        size = [settings.focal, settings.focal] if settings.lens == "opencv" else [settings.focal]
        zeros = {"pinhole": 0, "radial": 1, "opencv": 4}[settings.lens]
        reader.camera_params = ",".join(map(repr, [*size, width / 2, height / 2, *[0.0] * zeros]))
    options = colmap.FeatureExtractionOptions()
    options.num_threads, options.max_image_size = settings.threads, settings.feature_size
    options.sift.max_num_features = settings.features
    common = {"camera_mode": mode, "image_names": names}
    colmap.Database.open(database).close()
    colmap.import_images(database, folder, options=reader, **common)  # so that numbers do not depend on threads
    colmap.extract_features(
        database, folder, reader_options=reader, extraction_options=options, device=colmap.Device.cpu, **common
    )


def _check_enough(names: list[str], left_out: tuple[str, ...], settings: MotionSettings, folder: Path) -> None:
    placed = len(names) - len(left_out)
    if placed >= max(3, settings.registered * len(names)):
        return
    raise DataError(
        f"cameras were found for {placed} of {len(names)} pictures; without one: {some(left_out)}", where=str(folder),
        expected=f"at least {max(3, int(np.ceil(settings.registered * len(names))))} that overlap and show texture",
        fix="take pictures at most 20 degrees apart, sharp, of a still scene, with a textured background; remove those "
        "that do not belong, or lower `registered`",
    )  # fmt: skip


def _motion(mapped: Mapped, left_out: tuple[str, ...]) -> Motion:
    model = mapped.model
    kept = {number: image for number, image in model.images.items() if image.has_pose and image.name in mapped.names}
    used = sorted({image.camera_id for image in kept.values()})
    poses, camera = {}, {}
    for image in sorted(kept.values(), key=lambda image: image.name):
        pose = np.eye(4)
        pose[:3] = image.cam_from_world().matrix()
        poses[image.name], camera[image.name] = np.linalg.inv(pose), used.index(image.camera_id)
    seen = {
        number: len({element.image_id for element in point.track.elements} & kept.keys())
        for number, point in sorted(model.points3D.items())
    }
    held = [number for number, count in seen.items() if count >= SEEN_BY]
    points = [model.points3D[number] for number in held]
    lenses = [model.cameras[number] for number in used]
    return Motion(
        camera_to_world=poses,
        camera=camera,
        lenses=lenses,
        points=np.array([point.xyz for point in points], np.float64).reshape(-1, 3),
        colours=np.array([point.color for point in points], np.float64).reshape(-1, 3) / 255,
        tracks=np.array([seen[number] for number in held], np.int64),
        left_out=left_out,
        error=float(model.compute_mean_reprojection_error()),
        focal_known=any(lens.has_prior_focal_length for lens in lenses),
        how=mapped.how,
    )
