"""Structure from motion through COLMAP's Python package: cameras and sparse points of a folder of photographs.

pycolmap (BSD) is optional: `pip install 'exmesh-graph[photos]'`. SIFT features, all pairs (of many pictures the likely
ones: `pairs`), and what the matches support best of three mappings (`mapping`). Pixel centres lie at +0.5 in COLMAP as
they do here.

Pictures far apart leave few points. Then it is done again with patches of affine shape and with matches that are looked
for along epipolar lines (`guided`), which find more points, a little less precisely. Where some pictures are still
without a camera, so in pictures whose contrast was made even (`contrast`): SIFT leaves out what differs by less than a
hundredth of white, which on dark or smooth things is nearly all there is.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.contrast import even_pictures
from exmesh_graph.io.guided import match_guided
from exmesh_graph.io.images import picture_size, write_image
from exmesh_graph.io.mapping import SEEN_BY, Mapped, map_cameras
from exmesh_graph.io.normalise import some
from exmesh_graph.io.pairs import likely_pairs, matched_pairs
from exmesh_graph.io.settings import MotionSettings
from exmesh_graph.io.still import turning_masks
from exmesh_graph.native import import_pycolmap
from exmesh_graph.resources import usable_cores

#: Sightings of points a picture, below which pictures are matched again, and the growth that makes the new ones count.
FEW, GROWTH = 150, 1.3
#: Of the verified matches between placed pictures, the share below which cameras are likely wrong: 0.29 where eleven of
#: twenty were (on a chequered cloth), 0.39 where they were off by a few pixels, 0.55 to 0.87 with right ones.
DOUBTFUL = 0.33
#: Pictures up to which all pairs are matched.
MANY = 80
_TURN_LESS = (
    "turn the object by 15 degrees at most from picture to picture, with paint or print on what turns with it (the "
    "room, which stands still, tells nothing); or lower `registered`"
)
_MODELS = {"pinhole": "SIMPLE_PINHOLE", "radial": "SIMPLE_RADIAL", "opencv": "OPENCV"}


class Through(NamedTuple):
    """What a picture was taken through: equal `lens` is one camera, `focal` its focal length in pixels; 0: unknown."""

    lens: Hashable
    focal: float = 0.0


@dataclass(frozen=True)
class Motion:
    """Cameras of the registered pictures and sparse points, in a world of unknown scale and axes.

    camera_to_world  float64 [4, 4] by picture name, OpenCV axes
    camera           index into `lenses` by picture name
    lenses           pycolmap's cameras or others (`io.lens`), with distortion
    points, colours  float64 [P, 3] seen by three pictures or more; display colour in [0, 1]
    tracks           int [P], by how many
    left_out         pictures without a camera, or tied to the others by pairs alone (`mapping.tied`)
    error            mean reprojection error in pixels
    focal_known      whether a focal length was given or stood in the EXIF data
    how              which mapping they are from, or whose cameras they are
    matching         plain, wide or even; "" for cameras of another program
    dropped          names of pictures that were left out before cameras were looked for, by reason
    turned           whether something turned before what stood still, which was left out
    agreeing         of the verified matches between the registered pictures, the share that agrees with the cameras
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
    matching: str = "plain"
    dropped: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    turned: bool = False
    agreeing: float = 1.0

    @property
    def doubtful(self) -> bool:
        """Whether cameras are likely wrong: something looks alike in many places."""
        return self.agreeing < DOUBTFUL

    @property
    def found(self) -> bool:
        """Whether the cameras are from the pictures, not from another program."""
        return bool(self.matching)

    @property
    def sightings(self) -> float:
        """How many points a picture shows, on the mean."""
        return float(self.tracks.sum()) / max(len(self.camera_to_world), 1)

    @property
    def told(self) -> str:
        """Where the cameras are from."""
        return f"{self.how} mapping" if self.found else f"{self.how} own"

    def figures(self) -> dict[str, Any]:
        """For the report: counts, names of what was left out, error, and the (mean) lens."""
        focal = [lens.calibration_matrix()[0, 0] for lens in self.lenses]
        return {
            "pictures": len(self.camera_to_world) + len(self.left_out),
            "registered": len(self.camera_to_world),
            "left_out": list(self.left_out),
            **{reason: list(names) for reason, names in self.dropped.items()},
            "mapping": self.how,
            "matching": self.matching,
            "agreeing": self.agreeing,
            "points": len(self.points),
            "reprojection_error_px": self.error,
            "lenses": len(self.lenses),
            "focal": float(np.mean(focal)),
            "focal_known": self.focal_known,
            "lens": [float(x) for x in np.mean([lens.params for lens in self.lenses], axis=0)],
        }


def renamed(motion: Motion, names: Mapping[str, str]) -> Motion:
    """The same with pictures called as `names` say."""
    return replace(
        motion,
        camera_to_world={names[name]: pose for name, pose in motion.camera_to_world.items()},
        camera={names[name]: lens for name, lens in motion.camera.items()},
        left_out=tuple(names[name] for name in motion.left_out),
    )


def find_motion(
    images: Sequence[Path],
    masks: Mapping[str, np.ndarray],
    settings: MotionSettings,
    work: Path,
    seed: int = 0,
    through: Mapping[str, Through] | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Motion:
    """Cameras of `images`, files of one folder; `work` is an empty folder for the database.

    masks    alpha [H, W] by file name: features where it is below 1/2 are ignored
    through  by file name; pictures of equal `lens` are of one size and share a camera unless `one_camera` is off.
             None: all are of one size, and one lens
    tell     is told what is being done
    `settings.matching`: auto matches again in the wide way where points are few or pictures have no camera, and takes
    what gives more pictures cameras or, of as many pictures, clearly more points. Where some are still without, it does
    so in even pictures, and takes these only for more cameras: their points are less precise.
    `settings.turntable`: where something turns before what stands still (`still`), features are taken again from what
    turns alone.
    The same pictures, seed and version give the same bytes: mapping runs on one thread, whatever `threads` says of
    features and matching. Pictures that hang on the others by pairs alone are left out (`mapping.tied`).
    Raises DataError, naming pictures, where fewer than the share `registered` (or than three) get a camera,
    MissingLibraryError without pycolmap.
    """
    colmap = import_pycolmap()
    names, folder = [image.name for image in images], images[0].parent
    lenses = {name: Through(None) for name in names} if through is None else through
    level, colmap.logging.minloglevel = colmap.logging.minloglevel, 3
    try:

        def matched(matching: str, place: str, shown: Path | None, before: Path | None = None) -> Path:
            (work / place).mkdir()
            database = work / place / "database.db"
            colmap.set_random_seed(seed)
            tell(f"features of {len(names)} pictures ({matching} matching)")
            drawn = folder
            if matching == "even":
                drawn = work / place / "pictures"
                even_pictures(images, drawn, settings.threads or usable_cores())
            _features(colmap, database, folder, names, shown, settings, lenses, drawn, affine=matching != "plain")
            _match(
                colmap, database, _pairs(colmap, database, names, settings, before), len(names), settings, seed, tell
            )
            if matching != "plain":
                match_guided(colmap, database, settings.threads or usable_cores())
            return database

        def found(matching: str, database: Path) -> Motion:
            mapped = map_cameras(colmap, database, folder, database.parent, seed, settings.mapping, tell)
            left_out = tuple(name for name in names if mapped is None or name not in mapped.names)
            return motion_of(mapped, left_out, matching)

        first = "plain" if settings.matching == "auto" else settings.matching
        shown = _mask_files(masks, work / "masks")
        database = matched(first, first, shown)
        moving = turning_masks(colmap, database, seed) if settings.turntable else {}
        if moving:
            share = 1 - np.mean([mask.mean() for mask in moving.values()])
            tell(
                f"something turns before {share:.0%} of the pictures that stand still: these are left out (`turntable`)"
            )
            shown = _mask_files({name: mask * masks.get(name, 1.0) for name, mask in moving.items()}, work / "moving")
            database = matched(first, f"{first}_moving", shown)
        motion = found(first, database)
        if settings.matching == "auto" and len(names) > 2 and (motion.left_out or motion.sightings < FEW):
            wide = found("wide", matched("wide", "wide", shown, database))
            more = wide.sightings >= GROWTH * motion.sightings
            if len(wide.left_out) < len(motion.left_out) or (more and len(wide.left_out) == len(motion.left_out)):
                motion = wide
            if motion.left_out:
                even = found("even", matched("even", "even", shown, database))
                motion = even if len(even.left_out) < len(motion.left_out) else motion
    finally:
        colmap.logging.minloglevel = level
    _check_enough(names, motion.left_out, settings, folder, turned=bool(moving))
    return replace(motion, turned=bool(moving))


def _pairs(
    colmap: Any, database: Path, names: list[str], settings: MotionSettings, before: Path | None
) -> list[tuple[str, str]] | None:
    """Names of the pictures that are matched: of many the likely ones, of few all (None); of those that were matched
    `before`, in another database, the ones that looked alike there."""
    if settings.partners and len(names) > MANY:
        known = [] if before is None else matched_pairs(colmap, before, enough=0)
        return sorted({*known, *likely_pairs(colmap, database, settings.partners)})
    return None if before is None else matched_pairs(colmap, before)


def _match(
    colmap: Any,
    database: Path,
    pairs: list[tuple[str, str]] | None,
    pictures: int,
    settings: MotionSettings,
    seed: int,
    tell: Callable[[str], None],
) -> None:
    """Matches of all pairs of pictures or of the named ones, verified pair by pair."""
    options = colmap.FeatureMatchingOptions()
    options.num_threads = settings.threads or usable_cores()
    verify = colmap.TwoViewGeometryOptions()
    verify.ransac.random_seed, verify.ransac.num_threads = seed, 1
    common = {"matching_options": options, "verification_options": verify, "device": colmap.Device.cpu}
    every = pictures * (pictures - 1) // 2
    if pairs is None or len(pairs) == every:
        tell(f"matching {every} pairs")
        colmap.match_exhaustive(database, **common)
        return
    tell(f"matching {len(pairs)} of {every} pairs: those that look alike (of many pictures `partners` for each)")
    listed = database.parent / "pairs.txt"
    listed.write_text("".join(f"{one} {other}\n" for one, other in pairs), encoding="utf-8")
    pairing = colmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    colmap.match_image_pairs(database, pairing_options=pairing, **common)


def _mask_files(masks: Mapping[str, np.ndarray], folder: Path) -> Path | None:
    if not masks:
        return None
    folder.mkdir()
    for name, alpha in masks.items():
        write_image(folder / f"{name}.png", (alpha >= 0.5).astype(np.float32))
    return folder


def _features(
    colmap: Any,
    database: Path,
    folder: Path,
    names: list[str],
    masks: Path | None,
    settings: MotionSettings,
    through: Mapping[str, Through],
    drawn: Path,
    *,
    affine: bool,
) -> None:
    """Pictures, lens after lens, their cameras and features into a new database; the features from `drawn`."""
    mode = colmap.CameraMode.SINGLE if settings.one_camera else colmap.CameraMode.PER_IMAGE
    options = colmap.FeatureExtractionOptions()
    options.num_threads, options.max_image_size = settings.threads or usable_cores(), settings.feature_size
    options.sift.max_num_features, options.sift.estimate_affine_shape = settings.features, affine
    colmap.Database.open(database).close()
    for group in _groups(names, through):
        reader = colmap.ImageReaderOptions()
        reader.camera_model = _MODELS[settings.lens]
        if masks is not None:
            reader.mask_path = masks
        if focal := settings.focal or through[group[0]].focal:
            reader.camera_params = _parameters(focal, picture_size(folder / group[0]), settings)
        common = {"camera_mode": mode, "image_names": group}
        colmap.import_images(database, folder, options=reader, **common)  # so that numbers do not depend on threads
        colmap.extract_features(
            database, drawn, reader_options=reader, extraction_options=options, device=colmap.Device.cpu, **common
        )


def _groups(names: list[str], through: Mapping[str, Through]) -> list[list[str]]:
    """Names by lens and what is known of its focal length, in the order of the first of each."""
    groups: dict[Through, list[str]] = {}
    for name in names:
        groups.setdefault(through[name], []).append(name)
    return list(groups.values())


def _parameters(focal: float, size: tuple[int, int], settings: MotionSettings) -> str:
    lengths = [focal, focal] if settings.lens == "opencv" else [focal]
    zeros = {"pinhole": 0, "radial": 1, "opencv": 4}[settings.lens]
    return ",".join(map(repr, [*lengths, size[0] / 2, size[1] / 2, *[0.0] * zeros]))


def _check_enough(
    names: list[str], left_out: tuple[str, ...], settings: MotionSettings, folder: Path, *, turned: bool = False
) -> None:
    placed = len(names) - len(left_out)
    if placed >= max(3, settings.registered * len(names)):
        return
    raise DataError(
        f"cameras were found for {placed} of {len(names)} pictures; without one: {some(left_out)}", where=str(folder),
        expected=f"at least {max(3, int(np.ceil(settings.registered * len(names))))} that overlap and show texture",
        fix=_TURN_LESS if turned else
        "take pictures at most 20 degrees apart, sharp, of a still scene, with a textured background; remove those "
        "that do not belong, or lower `registered`",
    )  # fmt: skip


def motion_of(mapped: Mapped | None, left_out: tuple[str, ...], matching: str) -> Motion:
    """Cameras and points of one of COLMAP's models."""
    if mapped is None:
        nothing = np.zeros((0, 3))
        return Motion({}, {}, (), nothing, nothing, np.zeros(0, np.int64), left_out, 0.0, False, "", matching)
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
        matching=matching,
        agreeing=mapped.agreeing / max(mapped.matches, 1),
    )
