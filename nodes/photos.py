"""Photographs without cameras."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.io.params import PhotosOptions
from exmesh_graph.params import Params, param
from exmesh_graph.types import Frame, Metrics, PointCloud, Views

Train = Annotated[Views, facets(split="train")]
Test = Annotated[Views, facets(split="test")]


class _Folder(Params):
    path: Path = param(doc="Folder of pictures of one size (or its images/), with masks/ beside them or alpha.")


class PhotosParams(PhotosOptions, _Folder):
    pass


class PhotosOut(NamedTuple):
    train: Train
    test: Test
    frame: Frame
    points: PointCloud
    cameras: Metrics


def _photo_files(p: PhotosParams) -> Mapping[str, Path]:
    from exmesh_graph.io.photos import photo_files

    return photo_files(p.path, p)


@node(
    "data.photos",
    version="1",
    libraries=("OpenImageIO", "scipy", "scikit-image", "pycolmap", "networkx"),
    sources=_photo_files,
    resources={"cpu": 1},
)
def photos(ctx: Context, *, p: PhotosParams) -> PhotosOut:
    """A plain folder of photographs: cameras and sparse points by structure from motion (needs pycolmap)."""
    from exmesh_graph.io.photos import load_photos

    work = ctx.scratch / "motion"
    work.mkdir()
    scene, points, motion = load_photos(p.path, p, work, ctx.seed)
    for note in scene.notes:
        ctx.warn(note)
    figures = motion.figures()
    known = "from what was known" if motion.focal_known else "(found from the pictures alone)"
    ctx.log(
        f"cameras of {figures['registered']} of {figures['pictures']} pictures ({motion.how} mapping), {len(points)} "
        f"points, reprojection error {motion.error:.2f} px, focal length {figures['focal']:.0f} px {known}"
    )
    return PhotosOut(scene.train, scene.test, scene.frame, points, Metrics(figures))
