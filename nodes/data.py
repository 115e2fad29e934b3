"""Nodes that bring photographs, cameras, depth maps and truth into the graph."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from exmesh_graph.gpu.settings import ALL_CORES
from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.io.settings import (
    BlenderOptions,
    DepthOptions,
    IdrOptions,
    MiddleburyOptions,
    OrbOptions,
    PhotosOptions,
    Synthetic4RelightOptions,
)
from exmesh_graph.params import Params, param
from exmesh_graph.types import DepthMaps, Frame, LitViews, Metrics, PointCloud, SceneTruth, Views
from exmesh_graph.types.pictures import kept_in

if TYPE_CHECKING:
    import numpy as np

    from exmesh_graph.io.scene import Scene
    from exmesh_graph.priors.adjust.cameras import Adjusted
    from exmesh_graph.priors.patch_match.estimate import Stereo

# all but the first: normalisation, which finds the object, and the check of the masks
_PICTURES = ("OpenImageIO", "scipy", "scikit-image", "torch", "warp-lang")

Train = Annotated[Views, facets(split="train")]
Test = Annotated[Views, facets(split="test")]


class _Folder(Params):
    """The path comes first among the parameters; each layout says what lies there."""

    path: Path = param(doc="Folder of the scene.")


class BlenderParams(BlenderOptions, _Folder):
    path: Path = param(doc="Folder with transforms_train.json (or transforms.json).")


class BlenderOut(NamedTuple):
    train: Train
    test: Test
    frame: Frame
    truth: SceneTruth


def _blender_sources(p: BlenderParams) -> Mapping[str, Path]:
    from exmesh_graph.io.blender import blender_files

    return blender_files(p.path, p)


@node("data.blender", version="1", libraries=_PICTURES, sources=_blender_sources)
def blender(ctx: Context, *, p: BlenderParams) -> BlenderOut:
    """Photographs in the Blender / NeRF-Synthetic layout, with the truth of rendered scenes."""
    from exmesh_graph.io.blender import load_blender

    with kept_in(ctx.scratch):
        return _with_truth(ctx, load_blender(p.path, p))


def _with_truth(ctx: Context, scene: Scene) -> BlenderOut:
    return BlenderOut(*_views(ctx, scene), scene.truth or SceneTruth(names=()))


class ViewsOut(NamedTuple):
    train: Train
    test: Test
    frame: Frame


def _views(ctx: Context, scene: Scene) -> ViewsOut:
    for note in scene.notes:
        ctx.warn(note)
    for views in (scene.train, scene.test):
        if views.in_files:
            ctx.log(f"{len(views)} pictures of {views.width} x {views.height} are kept in files and decoded one by one")
    if (scene.train.width, scene.train.height) != (scene.test.width, scene.test.height):
        ctx.log(f"training pictures are reduced to {scene.train.width} x {scene.train.height} for the fits")
    return ViewsOut(scene.train, scene.test, scene.frame)


class MiddleburyParams(MiddleburyOptions, _Folder):
    path: Path = param(doc="Folder with <name>_par.txt, image/ and mask/.")


def _middlebury_sources(p: MiddleburyParams) -> Mapping[str, Path]:
    from exmesh_graph.io.middlebury import middlebury_files

    return middlebury_files(p.path, p)


@node("data.middlebury", version="1", libraries=_PICTURES, sources=_middlebury_sources)
def middlebury(ctx: Context, *, p: MiddleburyParams) -> ViewsOut:
    """Photographs in the Middlebury multi-view layout (templeRing and others)."""
    from exmesh_graph.io.middlebury import load_middlebury

    with kept_in(ctx.scratch):
        return _views(ctx, load_middlebury(p.path, p))


class IdrParams(IdrOptions, _Folder):
    path: Path = param(doc="Folder with cameras_sphere.npz and image/.")


def _idr_sources(p: IdrParams) -> Mapping[str, Path]:
    from exmesh_graph.io.idr import idr_files

    return idr_files(p.path, p)


@node("data.idr", version="1", libraries=_PICTURES, sources=_idr_sources)
def idr(ctx: Context, *, p: IdrParams) -> ViewsOut:
    """Photographs in the IDR / NeuS layout (DTU and others), with masks or without."""
    from exmesh_graph.io.idr import load_idr

    with kept_in(ctx.scratch):
        return _views(ctx, load_idr(p.path, p))


class Synthetic4RelightParams(Synthetic4RelightOptions, _Folder):
    path: Path = param(doc="Folder of a scene, with transforms_train.json and test_rli/; envmaps/ in it or beside it.")


def _s4r_sources(p: Synthetic4RelightParams) -> Mapping[str, Path]:
    from exmesh_graph.io.synthetic4relight import synthetic4relight_files

    return synthetic4relight_files(p.path, p)


@node("data.synthetic4relight", version="1", libraries=_PICTURES, sources=_s4r_sources)
def synthetic4relight(ctx: Context, *, p: Synthetic4RelightParams) -> BlenderOut:
    """A scene of Synthetic4Relight: linear training pictures, test views with materials, relit pictures."""
    from exmesh_graph.io.synthetic4relight import load_synthetic4relight

    with kept_in(ctx.scratch):
        return _with_truth(ctx, load_synthetic4relight(p.path, p))


class OrbParams(OrbOptions, _Folder):
    path: Path = param(doc="Folder of a capture, blender_HDR/<object>_scene00x; ground_truth/ beside blender_HDR/.")


class OrbOut(NamedTuple):
    train: Train
    test: Test
    frame: Frame
    truth: SceneTruth
    novel: LitViews


def _orb_sources(p: OrbParams) -> Mapping[str, Path]:
    from exmesh_graph.io.stanford_orb import orb_files

    return orb_files(p.path, p)


@node("data.stanford_orb", version="1", libraries=_PICTURES, sources=_orb_sources)
def stanford_orb(ctx: Context, *, p: OrbParams) -> OrbOut:
    """A capture of Stanford-ORB: HDR photographs, scanned truth, and views under two other measured lights."""
    from exmesh_graph.io.stanford_orb import load_orb

    with kept_in(ctx.scratch):
        scene, novel = load_orb(p.path, p)
    return OrbOut(*_with_truth(ctx, scene), novel)


class PhotosParams(PhotosOptions, _Folder):
    path: Path = param(doc="Folder of pictures (or its images/) with masks/ beside them, or alpha; or a video.")


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
    version="6",
    libraries=("OpenImageIO", "scipy", "scikit-image", "pycolmap", "networkx", "pillow", "torch", "warp-lang"),
    sources=_photo_files,
    resources=ALL_CORES,
)
def photos(ctx: Context, *, p: PhotosParams) -> PhotosOut:
    """A folder of photographs, or a video: cameras and sparse points by structure from motion (needs pycolmap).

    Or the cameras that COLMAP, nerfstudio, Metashape or RealityScan found, whose files lie in the folder.
    """
    from exmesh_graph.io.photos import place_photos

    work = ctx.scratch / "motion"
    work.mkdir()
    with kept_in(ctx.scratch):
        placed = place_photos(p.path, p, work, ctx.seed, ctx.log)
        scene, motion = placed.scene(), placed.motion
    points, figures = placed.points(scene.frame), motion.figures()
    known = "from what was known" if motion.focal_known else "(found from the pictures alone)"
    ctx.log(
        f"cameras of {figures['registered']} of {figures['pictures']} pictures ({motion.told}), {len(points)} "
        f"points, reprojection error {motion.error:.2f} px, focal length {figures['focal']:.0f} px {known}"
    )
    adjust = p.adjust and motion.found and not placed.alpha  # beyond alpha all is gone
    # what turns before lamps that stand still is as bright in no two pictures
    scene = _compared(ctx, scene, placed.scene, points, figures, p, adjust, p.vignetting and not motion.turned)
    return PhotosOut(*_views(ctx, scene), points, Metrics(figures))


def _compared(
    ctx: Context, scene: Scene, again: Callable[..., Scene], points: PointCloud, figures: dict[str, Any],
    p: PhotosParams, adjust: bool, vignetting: bool,
) -> Scene:  # fmt: skip
    """The scene after what its photographs say when they are compared pixel by pixel, whole ones where it has masks;
    `again` is `Placed.scene`."""
    import numpy as np

    from exmesh_graph.io.placed import Adjustment
    from exmesh_graph.priors.together import together

    stereo = None
    if adjust:
        with kept_in(ctx.scratch):
            whole = again(world=scene.frame, masks=False) if scene.train.has_masks else scene
        adjusted = _adjusted(ctx, together(whole.train, whole.test), points, figures, p)
        names = scene.train.names + scene.test.names
        if adjusted.moved.any():
            cameras = dict(zip(names, adjusted.camera_to_world, strict=True))
            with kept_in(ctx.scratch):
                scene = again(after=Adjustment(scene.frame, cameras, adjusted.lens))
        if adjusted.lens.bend == 0:  # else its pixels are others
            stereo = adjusted.stereo.of(np.flatnonzero(~adjusted.astray))
        if adjusted.astray.any():
            scene = _without(ctx, scene, names, adjusted.astray, figures)
    if not vignetting:
        return scene
    return _even(ctx, scene, together(scene.train, scene.test), stereo, points, figures, p)


def _adjusted(ctx: Context, views: Views, points: PointCloud, figures: dict[str, Any], p: PhotosParams) -> Adjusted:
    """What adjusting the cameras does."""
    import numpy as np

    from exmesh_graph.priors.adjust.cameras import adjust_cameras

    adjusted = adjust_cameras(views, points, seed=ctx.seed, threads=p.threads, tell=ctx.log)
    moved, (before, after) = adjusted.moved, adjusted.correlation
    figures["adjusted_px"], figures["adjusted_most_px"] = float(np.median(moved)), float(moved.max())
    figures["focal"] *= adjusted.lens.zoom
    figures["bend"] = adjusted.lens.bend
    if not moved.any():
        ctx.log("cameras stay as they were found: the photographs agree no better under adjusted ones")
    else:
        ctx.log(
            f"cameras adjusted: pictures move by {np.median(moved):.1f} pixels (median; at most {moved.max():.1f}), "
            f"focal lengths are {adjusted.lens.zoom:.3f} times as long, lenses bend by {adjusted.lens.bend:+.3f} r^2 "
            f"more, and patches agree to {after:.3f} in place of {before:.3f}"
        )
    return adjusted


def _without(ctx: Context, scene: Scene, names: tuple[str, ...], astray: np.ndarray, figures: dict[str, Any]) -> Scene:
    """The scene without the views of these `names` that went `astray` bool [N], training views first."""
    import numpy as np

    wrong = [names[k] for k in np.flatnonzero(astray)]
    figures["registered"] -= len(wrong)
    figures["left_out"] = [*figures["left_out"], *wrong]
    ctx.warn(
        f"no other photograph agrees with what the cameras found for {', '.join(wrong)} show: they are wrong, and "
        "these photographs are left out. To have them in: more pictures between these and their neighbours"
    )
    first, second = (np.flatnonzero(~part) for part in np.split(astray, [len(scene.train)]))
    return replace(scene, train=scene.train.subset(first), test=scene.test.subset(second))


def _even(
    ctx: Context, scene: Scene, views: Views, stereo: Stereo | None, points: PointCloud, figures: dict[str, Any],
    p: PhotosParams,
) -> Scene:  # fmt: skip
    """The scene without vignetting."""
    from exmesh_graph.gpu.torch_setup import sharing
    from exmesh_graph.priors.radiometry.even import even, lenses_of

    with sharing(p.threads):
        lenses = lenses_of(views, stereo, points, seed=ctx.seed)
    corners = [lens.vignetting.corner for lens in lenses if lens.vignetting.found]
    figures["vignetting"] = 1.0 - min(corners, default=1.0)
    for lens in lenses:
        if lens.vignetting.found:
            count = int(lens.took(scene.train).sum() + lens.took(scene.test).sum())
            ctx.log(f"vignetting taken out of {count} pictures: {lens.vignetting.told}")
    return replace(scene, train=even(scene.train, lenses), test=even(scene.test, lenses)) if corners else scene


class _MapFolder(Params):
    folder: Path = param(doc="Folder with one depth map (EXR, NPY or 16-bit PNG) for each view.")


class DepthFilesParams(DepthOptions, _MapFolder):
    pass


class DepthOut(NamedTuple):
    depths: Annotated[DepthMaps, facets(units=None)]


def _depth_sources(p: DepthFilesParams) -> Mapping[str, Path]:
    from exmesh_graph.io.depth import depth_files

    return {file.name: file for file in depth_files(p.folder)}


@node("prior.depth_files", version="1", libraries=("OpenImageIO", "scipy", "scikit-image"), sources=_depth_sources)
def prior_depth_files(ctx: Context, views: Views, frame: Frame | None = None, *, p: DepthFilesParams) -> DepthOut:
    """Depth along the camera's axis, one file for each view."""
    from exmesh_graph.io.depth import load_depths

    return DepthOut(load_depths(views, p.folder, p, frame))
