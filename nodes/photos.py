"""Photographs without cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Frame, Metrics, PointCloud, Views

Train = Annotated[Views, facets(split="train")]
Test = Annotated[Views, facets(split="test")]


class PhotosParams(Params):
    path: Path = param(doc="Folder of pictures of one size (or its images/), with masks/ beside them or alpha.")
    lens: Literal["pinhole", "radial", "opencv"] = param(
        "radial", doc="What is found of the lens: focal length; and one term of distortion; or four and two lengths."
    )
    one_camera: bool = param(True, doc="All pictures were taken at one zoom and focus; false: each has its own lens.")
    focal: float = param(0.0, ge=0, unit="px", doc="Known focal length to start from; 0: from EXIF, else a guess.")
    keep: Literal["all", "object"] = param(
        "all", doc="Find cameras by the whole picture, or (turntable) by what the masks show only."
    )
    features: int = param(4096, ge=100, doc="SIFT features of a picture at most; time grows with the square.")
    feature_size: int = param(1600, ge=100, unit="px", doc="Longer side of the pictures in which they are found.")
    registered: float = param(0.5, gt=0, le=1, doc="Share of the pictures that must get a camera.")
    mapping: Literal["auto", "incremental", "easier", "global"] = param(
        "auto", doc="Which of COLMAP's: incremental, with easier thresholds, global; or what most matches agree with."
    )
    masks: bool = param(True, doc="Use masks where they are there.")
    downscale: int = param(1, ge=1, le=16, doc="Reduce by this factor, by exact area averaging in linear light.")
    holdout: int = param(8, ge=2, unit="views", doc="Every how many views one is held out for testing.")
    first: int = param(3, ge=0, doc="Index of the first test view, counted from 0.")
    dissent: int = param(1, ge=0, unit="views", doc="Masks that may be wrong at a point, for normalisation.")
    threads: int = param(1, ge=1, tuning=True, doc="For features and matching; mapping runs on one.")


class PhotosOut(NamedTuple):
    train: Train
    test: Test
    frame: Frame
    points: PointCloud
    cameras: Metrics


def _photo_files(p: PhotosParams) -> Mapping[str, Path]:
    from exmesh_graph.io.photos import list_photos
    from exmesh_graph.io.shots import relative_names

    listed = list_photos(p.path, p.masks)
    return relative_names(p.path, [file for pair in listed for file in pair if file is not None])


@node(
    "data.photos",
    version="1",
    libraries=("OpenImageIO", "scipy", "scikit-image", "pycolmap", "networkx"),
    sources=_photo_files,
    resources={"cpu": 1},
)
def photos(ctx: Context, *, p: PhotosParams) -> PhotosOut:
    """A plain folder of photographs: cameras and sparse points by structure from motion (needs pycolmap)."""
    from exmesh_graph.io.motion import MotionSettings
    from exmesh_graph.io.photos import PhotosOptions, load_photos

    of_motion = {field.name for field in fields(MotionSettings)}
    motion = MotionSettings(**p.model_dump(include=of_motion))
    options = PhotosOptions(motion, **p.model_dump(exclude={*of_motion, "path"}))
    work = ctx.scratch / "motion"
    work.mkdir()
    scene, points, found = load_photos(p.path, options, work, ctx.seed)
    for note in scene.notes:
        ctx.warn(note)
    figures = found.figures()
    known = "from what was known" if found.focal_known else "(found from the pictures alone)"
    ctx.log(
        f"cameras of {figures['registered']} of {figures['pictures']} pictures ({found.how} mapping), {len(points)} "
        f"points, reprojection error {found.error:.2f} px, focal length {figures['focal']:.0f} px {known}"
    )
    return PhotosOut(scene.train, scene.test, scene.frame, points, Metrics(figures))
