"""The options of the loaders: parameters of the data nodes, declared once. Imports nothing heavy."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from exmesh_graph.params import Params, param

UpAxis = Literal["y", "-y", "z", "-z", "x", "-x", "auto"]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
Lens = Literal["pinhole", "radial", "opencv"]
Way = Literal["auto", "incremental", "easier", "global"]
Checks = Literal["error", "warn", "off"]

_UP = "The up axis of the files' world; auto: found from level cameras."
_WRONG_MASKS = "Masks that may be wrong at a point, for normalisation."
_BOX = "The object's box in the files' units; default: found from the masks."
_METRES = "Metres in one unit of the files; 0 = unknown."
_DOWNSCALE = "Reduce by this factor, by exact area averaging in linear light."
_MAX_VIEWS = "Keep at most so many training views, evenly spread; 0 = all."
_MAX_TEST_VIEWS = "Keep at most so many test views; 0 = all."
_HOLDOUT = "Every how many views one is held out for testing."
_CHECKS = "Grave faults of cameras and pictures: an error, a warning, or not looked for (off)."
_KEY = "Pictures without alpha or masks that stand on one flat colour: what differs from it is the object."
_FIRST = "Index of the first test view, counted from 0."


class TrainSize(Params):
    """How large the training pictures may be that fits see: what a loader reduces, once it has checked them."""

    train_side: int = param(
        0, ge=0, unit="px", doc="Longer side of the training pictures at most: all are reduced by one whole "
        "factor, test pictures are not. 0: as they are.",
    )  # fmt: skip
    train_megapixels: float = param(
        0.0, ge=0, unit="Mpx", doc="Of all training pictures together at most, by such a factor; 0: no limit."
    )


class BlenderOptions(TrainSize):
    """The layout of Blender and NeRF-Synthetic (`io.blender`)."""

    hdr: Literal["auto", "true", "false"] | bool = param(
        "auto", doc="Linear EXR pictures where they are there (auto), always (true), or 8-bit ones (false)."
    )
    downscale: int = param(1, ge=1, le=16, doc=_DOWNSCALE)
    max_views: int = param(0, ge=0, unit="views", doc=_MAX_VIEWS)
    max_test_views: int = param(0, ge=0, unit="views", doc=_MAX_TEST_VIEWS)
    test: Literal["auto", "file", "holdout"] = param(
        "auto", doc="Test views: the file's own if it has enough (auto), always the file's, or held-out training views."
    )
    holdout: int = param(8, ge=2, unit="views", doc="Every how many training views one is held out, where needed.")
    min_test_views: int = param(2, ge=1, unit="views", doc="Fewer test frames than this count as none (auto).")
    up: UpAxis = param("z", doc=_UP)
    truth: bool = param(True, doc="Read true mesh, maps, light and relit pictures where they are there.")
    true_mesh: str = param(
        "",
        doc="The true mesh, a file below the folder, as of the object without its table; empty: mesh/mesh.obj.",
    )
    wrong_masks: int = param(0, ge=0, unit="views", was="dissent", doc=_WRONG_MASKS)
    box: Box | None = param(None, doc=_BOX)
    metres_per_unit: float = param(0.0, ge=0, unit="m", doc=_METRES)
    key: bool = param(True, doc=_KEY)
    checks: Checks = param("error", doc=_CHECKS)


class RingOptions(TrainSize):
    """What layouts without a test set of their own, and with whole-numbered pixel centres, have in common."""

    holdout: int = param(8, ge=2, unit="views", doc=_HOLDOUT)
    first: int = param(3, ge=0, doc=_FIRST)
    max_views: int = param(0, ge=0, unit="views", doc=_MAX_VIEWS)
    pixel_offset: float | Literal["auto"] = param(
        0.5,
        unit="px",
        doc="Added to the principal point: 0.5 where the file's pixel centres are whole numbers; auto: matches between "
        "the pictures decide between 0 and 0.5.",
    )
    checks: Checks = param("error", doc=_CHECKS)

    @field_validator("pixel_offset")
    @classmethod
    def _at_most_half(cls, value: float | Literal["auto"]) -> float | Literal["auto"]:
        if value != "auto" and not 0 <= value <= 0.5:
            raise ValueError("pixel_offset is 0 to 0.5 pixels, or auto")
        return value


def known_offset(options: RingOptions) -> float:
    """`pixel_offset`, 0 until the pictures have decided."""
    return 0.0 if options.pixel_offset == "auto" else float(options.pixel_offset)


class MiddleburyOptions(RingOptions):
    """The Middlebury multi-view layout (`io.middlebury`)."""

    downscale: int = param(2, ge=1, le=16, doc=_DOWNSCALE)
    up: UpAxis = param("y", doc=_UP)
    masks: bool = param(True, doc="Use mask/ where it is there.")
    wrong_masks: int = param(1, ge=0, unit="views", was="dissent", doc=_WRONG_MASKS)
    box: Box | None = param(None, doc=_BOX)
    metres_per_unit: float = param(1.0, ge=0, unit="m", doc=_METRES)


class IdrOptions(RingOptions):
    """The layout of IDR and NeuS (`io.idr`)."""

    downscale: int = param(1, ge=1, le=16, doc=_DOWNSCALE)
    up: UpAxis = param("auto", doc="The up axis of the files' world; auto: the direction level cameras agree on.")
    masks: str = param("auto", doc="Folder of masks inside the scene; auto = mask/ where it is there; none = ignore.")
    metres_per_unit: float = param(0.001, ge=0, unit="m", doc=_METRES)
    pixel_offset: float | Literal["auto"] = param(
        "auto",
        unit="px",
        doc="Added to the principal point: 0.5 where the file's pixel centres are whole numbers; auto: matches between "
        "the pictures decide between 0 and 0.5.",
    )


class Synthetic4RelightOptions(Params):
    """A scene of Synthetic4Relight (`io.synthetic4relight`)."""

    lights: tuple[str, ...] = param(("envmap6", "envmap12"), doc="Relit test pictures that are scored.")
    downscale: int = param(1, ge=1, le=16, doc=_DOWNSCALE)
    max_views: int = param(0, ge=0, unit="views", doc=_MAX_VIEWS)
    max_test_views: int = param(0, ge=0, unit="views", doc=_MAX_TEST_VIEWS)
    checks: Checks = param("error", doc=_CHECKS)


class OrbOptions(Params):
    """A capture of Stanford-ORB (`io.stanford_orb`)."""

    downscale: int = param(4, ge=1, le=16, doc="Reduce by this factor; the benchmark scores 2048 / 4 pixels.")
    max_views: int = param(0, ge=0, unit="views", doc=_MAX_VIEWS)
    max_test_views: int = param(0, ge=0, unit="views", doc=_MAX_TEST_VIEWS)
    max_novel_views: int = param(0, ge=0, unit="views", doc="Keep at most so many views under other lights; 0 = all.")
    checks: Checks = param("error", doc=_CHECKS)


Matching = Literal["auto", "plain", "wide", "even"]


class MotionSettings(Params):
    """How cameras are found from the photographs alone (`io.motion`)."""

    lens: Lens = param(
        "radial", doc="What is found of the lens: focal length; and one term of distortion; or four and two lengths."
    )
    one_camera: bool = param(
        True, doc="Pictures of one size, camera and focal length (EXIF) share a lens; false: each has its own."
    )
    focal: float = param(
        0.0,
        ge=0,
        unit="px",
        doc="Known focal length to start from, in pixels of the files; 0: from EXIF, else a guess.",
    )
    features: int = param(4096, ge=100, doc="SIFT features of a picture at most; time grows with the square.")
    feature_size: int = param(1600, ge=100, unit="px", doc="Longer side of the pictures in which they are found.")
    registered: float = param(0.5, gt=0, le=1, doc="Share of the pictures that must get a camera.")
    mapping: Way = param(
        "auto", doc="Which of COLMAP's: incremental, with easier thresholds, global; or what most matches agree with."
    )
    matching: Matching = param(
        "auto",
        doc="plain: upright patches, precise; wide: affine patches and matches along epipolar lines, which bear larger "
        "turns of the camera; even: wide, on pictures of even contrast, for dark and smooth ones; auto: wide where "
        "plain leaves pictures with few points or without a camera, and even where wide leaves some without.",
    )
    partners: int = param(
        30,
        ge=0,
        unit="pictures",
        doc="Of more than 80 pictures each is matched with so many that look most alike; 0: all pairs are matched.",
    )
    turntable: bool = param(
        True,
        doc="Where the object turns before a camera on a tripod: leave out the features that stand still.",
    )
    threads: int = param(
        0, ge=0, tuning=True, doc="For features and matching; mapping runs on one. 0: all cores of this process."
    )


class PhotosOptions(TrainSize, MotionSettings):
    """A plain folder of photographs, or a video (`io.photos`)."""

    keep: Literal["all", "object"] = param(
        "all", doc="Find cameras by the whole picture, or (turntable) by what the masks show only."
    )
    cameras: Literal["auto", "file", "find"] = param(
        "auto",
        doc="auto: those of COLMAP, nerfstudio, Metashape or RealityScan where their files lie in the folder, else "
        "found from the pictures; file: these, or an error; find: found from the pictures.",
    )
    adjust: bool = param(
        True,
        doc="Adjust the cameras found, their focal lengths and how much lenses bend until the photographs agree pixel "
        "by pixel; not where alpha cuts objects out.",
    )
    vignetting: bool = param(
        False,
        doc="Take out by how much the lens darkens pictures towards their corners, where they show it beyond doubt; "
        "not on turntables.",
    )
    masks: bool = param(True, doc="Use masks where they are there.")
    frames: int = param(
        60, ge=3, doc="Frames of a video: the sharpest of so many equal parts of the way that its pictures move."
    )
    blurred: float = param(
        0.4,
        ge=0,
        lt=1,
        doc="Pictures with less than this share of the set's median sharpness are left out; 0: none is.",
    )
    alike: float = param(
        0.002,
        ge=0,
        lt=1,
        doc="Of neighbours between which nothing moves by this share of the width the less sharp is left out; 0: none.",
    )
    megapixels: float = param(
        2.0, ge=0, unit="Mpx", doc="Pictures above this size are reduced to it, before anything else; 0: none is."
    )
    downscale: int = param(1, ge=1, le=16, doc="Reduce the views further, by this factor, once cameras are found.")
    holdout: int = param(8, ge=2, unit="views", doc=_HOLDOUT)
    first: int = param(3, ge=0, doc=_FIRST)
    wrong_masks: int = param(1, ge=0, unit="views", was="dissent", doc=_WRONG_MASKS)
    checks: Checks = param("error", doc=_CHECKS)


class DepthOptions(Params):
    """Depth maps from files (`io.depth`)."""

    pattern: str = param(
        "{name}",
        pattern=r"^[^/\\{}]*\{(name|stem)\}[^/\\{}]*$",  # a file of the folder: only their contents are in the key
        doc="File name in `folder` of a view's map, with {name} or {stem}; the ending may be left out.",
    )
    scale: float = param(
        1.0, gt=0, doc="File values times this give the stated units (0.001 for millimetres as integers)."
    )
    units: Literal["normalised", "scene", "relative"] = param(
        "scene",
        doc="After scaling: the normalised world's, the scene's own (then wire `frame`), or relative: right up to a "
        "scale and a shift of each map, as networks give it (for the depth loss, or prior.align).",
    )
