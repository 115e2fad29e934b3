"""Nodes that bring photographs, cameras, depth maps and truth into the graph."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from exmesh_graph.graph.declare.node import Context, facets, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import DepthMaps, Frame, LitViews, SceneTruth, Views

if TYPE_CHECKING:
    from exmesh_graph.io.scene import Scene

Up = Literal["y", "-y", "z", "-z", "x", "-x", "auto"]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
_PICTURES = ("OpenImageIO", "scipy", "scikit-image")  # the last two: normalisation, which finds the object

Train = Annotated[Views, facets(split="train")]
Test = Annotated[Views, facets(split="test")]


class BlenderParams(Params):
    path: Path = param(doc="Folder with transforms_train.json (or transforms.json).")
    hdr: Literal["auto", "true", "false"] | bool = param(
        "auto", doc="Linear EXR pictures where they are there (auto), always (true), or 8-bit ones (false)."
    )
    downscale: int = param(1, ge=1, le=16, doc="Reduce by this factor, by exact area averaging in linear light.")
    max_views: int = param(0, ge=0, unit="views", doc="Keep at most so many training views, evenly spread; 0 = all.")
    max_test_views: int = param(0, ge=0, unit="views", doc="Keep at most so many test views; 0 = all.")
    test: Literal["auto", "file", "holdout"] = param(
        "auto", doc="Test views: the file's own if it has enough (auto), always the file's, or held-out training views."
    )
    holdout: int = param(8, ge=2, unit="views", doc="Every how many training views one is held out, where needed.")
    min_test_views: int = param(2, ge=1, unit="views", doc="Fewer test frames than this count as none (auto).")
    up: Up = param("z", doc="The up axis of the files' world; auto: found from level cameras.")
    truth: bool = param(True, doc="Read true mesh, maps, light and relit pictures where they are there.")
    dissent: int = param(0, ge=0, unit="views", doc="Masks that may be wrong at a point, for normalisation.")
    box: Box | None = param(None, doc="The object's box in the files' units; default: found from the masks.")
    metres_per_unit: float = param(0.0, ge=0, unit="m", doc="Metres in one unit of the files; 0 = unknown.")


class BlenderOut(NamedTuple):
    train: Train
    test: Test
    frame: Frame
    truth: SceneTruth


def _blender_options(p: BlenderParams):
    from exmesh_graph.io.blender import BlenderOptions

    values = {name: getattr(p, name) for name in BlenderParams.model_fields if name != "path"}
    values["hdr"] = str(p.hdr).lower()
    return BlenderOptions(**values)


def _blender_sources(p: BlenderParams) -> Mapping[str, Path]:
    from exmesh_graph.io.blender import blender_files

    return blender_files(p.path, _blender_options(p))


@node("data.blender", version="1", libraries=_PICTURES, sources=_blender_sources)
def blender(ctx: Context, *, p: BlenderParams) -> BlenderOut:
    """Photographs in the Blender / NeRF-Synthetic layout, with the truth of rendered scenes."""
    from exmesh_graph.io.blender import load_blender

    return _with_truth(ctx, load_blender(p.path, _blender_options(p)))


def _with_truth(ctx: Context, scene: Scene) -> BlenderOut:
    for note in scene.notes:
        ctx.warn(note)
    return BlenderOut(scene.train, scene.test, scene.frame, scene.truth or SceneTruth(names=()))


class _RingParams(Params):
    """What layouts without a test set of their own, and with whole-numbered pixel centres, have in common."""

    holdout: int = param(8, ge=2, unit="views", doc="Every how many views one is held out for testing.")
    first: int = param(3, ge=0, doc="Index of the first test view, counted from 0.")
    max_views: int = param(0, ge=0, unit="views", doc="Keep at most so many training views, evenly spread; 0 = all.")
    pixel_offset: float = param(
        0.5,
        ge=0,
        le=0.5,
        unit="px",
        doc="Added to the principal point: 0.5 where the file's pixel centres are whole numbers.",
    )


class MiddleburyParams(_RingParams):
    path: Path = param(doc="Folder with <name>_par.txt, image/ and mask/.")
    downscale: int = param(2, ge=1, le=16, doc="Reduce by this factor, by exact area averaging in linear light.")
    up: Up = param("y", doc="The up axis of the files' world; auto: found from level cameras.")
    masks: bool = param(True, doc="Use mask/ where it is there.")
    dissent: int = param(1, ge=0, unit="views", doc="Masks that may be wrong at a point, for normalisation.")
    box: Box | None = param(None, doc="The object's box in the files' units; default: found from the masks.")
    metres_per_unit: float = param(1.0, ge=0, unit="m", doc="Metres in one unit of the files; 0 = unknown.")


class ViewsOut(NamedTuple):
    train: Train
    test: Test
    frame: Frame


def _middlebury_options(p: MiddleburyParams):
    from exmesh_graph.io.middlebury import MiddleburyOptions

    return MiddleburyOptions(**{n: getattr(p, n) for n in MiddleburyParams.model_fields if n != "path"})


def _middlebury_sources(p: MiddleburyParams) -> Mapping[str, Path]:
    from exmesh_graph.io.middlebury import find_par, list_middlebury
    from exmesh_graph.io.shots import relative_names

    train, test = list_middlebury(p.path, _middlebury_options(p))
    files = [f for shot in (*train, *test) for f in (shot.image, shot.mask) if f is not None]
    return relative_names(p.path, [find_par(p.path), *files])


@node("data.middlebury", version="1", libraries=_PICTURES, sources=_middlebury_sources)
def middlebury(ctx: Context, *, p: MiddleburyParams) -> ViewsOut:
    """Photographs in the Middlebury multi-view layout (templeRing and others)."""
    from exmesh_graph.io.middlebury import load_middlebury

    scene = load_middlebury(p.path, _middlebury_options(p))
    for note in scene.notes:
        ctx.warn(note)
    return ViewsOut(scene.train, scene.test, scene.frame)


class IdrParams(_RingParams):
    path: Path = param(doc="Folder with cameras_sphere.npz and image/.")
    downscale: int = param(1, ge=1, le=16, doc="Reduce by this factor, by exact area averaging in linear light.")
    up: Up = param("auto", doc="The up axis of the files' world; auto: the direction level cameras agree on.")
    masks: str = param("auto", doc="Folder of masks inside the scene; auto = mask/ where it is there; none = ignore.")
    metres_per_unit: float = param(0.001, ge=0, unit="m", doc="Metres in one unit of the files; 0 = unknown.")


def _idr_options(p: IdrParams):
    from exmesh_graph.io.idr import IdrOptions

    return IdrOptions(**{n: getattr(p, n) for n in IdrParams.model_fields if n != "path"})


def _idr_sources(p: IdrParams) -> Mapping[str, Path]:
    from exmesh_graph.io.idr import camera_file, list_idr
    from exmesh_graph.io.shots import relative_names

    train, test, _ = list_idr(p.path, _idr_options(p))
    files = [f for shot in (*train, *test) for f in (shot.image, shot.mask) if f is not None]
    return relative_names(p.path, [camera_file(p.path), *files])


@node("data.idr", version="1", libraries=_PICTURES, sources=_idr_sources)
def idr(ctx: Context, *, p: IdrParams) -> ViewsOut:
    """Photographs in the IDR / NeuS layout (DTU and others), with masks or without."""
    from exmesh_graph.io.idr import load_idr

    scene = load_idr(p.path, _idr_options(p))
    for note in scene.notes:
        ctx.warn(note)
    return ViewsOut(scene.train, scene.test, scene.frame)


class Synthetic4RelightParams(Params):
    path: Path = param(doc="Folder of a scene, with transforms_train.json and test_rli/; envmaps/ in it or beside it.")
    lights: tuple[str, ...] = param(("envmap6", "envmap12"), doc="Relit test pictures that are scored.")
    downscale: int = param(1, ge=1, le=16, doc="Reduce by this factor, by exact area averaging in linear light.")
    max_views: int = param(0, ge=0, unit="views", doc="Keep at most so many training views, evenly spread; 0 = all.")
    max_test_views: int = param(0, ge=0, unit="views", doc="Keep at most so many test views; 0 = all.")


def _s4r_options(p: Synthetic4RelightParams):
    from exmesh_graph.io.synthetic4relight import Synthetic4RelightOptions

    return Synthetic4RelightOptions(**{n: getattr(p, n) for n in Synthetic4RelightParams.model_fields if n != "path"})


def _s4r_sources(p: Synthetic4RelightParams) -> Mapping[str, Path]:
    from exmesh_graph.io.synthetic4relight import synthetic4relight_files

    return synthetic4relight_files(p.path, _s4r_options(p))


@node("data.synthetic4relight", version="1", libraries=_PICTURES, sources=_s4r_sources)
def synthetic4relight(ctx: Context, *, p: Synthetic4RelightParams) -> BlenderOut:
    """A scene of Synthetic4Relight: linear training pictures, test views with materials, relit pictures."""
    from exmesh_graph.io.synthetic4relight import load_synthetic4relight

    return _with_truth(ctx, load_synthetic4relight(p.path, _s4r_options(p)))


class OrbParams(Params):
    path: Path = param(doc="Folder of a capture, blender_HDR/<object>_scene00x; ground_truth/ beside blender_HDR/.")
    downscale: int = param(4, ge=1, le=16, doc="Reduce by this factor; the benchmark scores 2048 / 4 pixels.")
    max_views: int = param(0, ge=0, unit="views", doc="Keep at most so many training views, evenly spread; 0 = all.")
    max_test_views: int = param(0, ge=0, unit="views", doc="Keep at most so many test views; 0 = all.")
    max_novel_views: int = param(0, ge=0, unit="views", doc="Keep at most so many views under other lights; 0 = all.")


class OrbOut(NamedTuple):
    train: Train
    test: Test
    frame: Frame
    truth: SceneTruth
    novel: LitViews


def _orb_options(p: OrbParams):
    from exmesh_graph.io.stanford_orb import OrbOptions

    return OrbOptions(**{n: getattr(p, n) for n in OrbParams.model_fields if n != "path"})


def _orb_sources(p: OrbParams) -> Mapping[str, Path]:
    from exmesh_graph.io.stanford_orb import orb_files

    return orb_files(p.path, _orb_options(p))


@node("data.stanford_orb", version="1", libraries=_PICTURES, sources=_orb_sources)
def stanford_orb(ctx: Context, *, p: OrbParams) -> OrbOut:
    """A capture of Stanford-ORB: HDR photographs, scanned truth, and views under two other measured lights."""
    from exmesh_graph.io.stanford_orb import load_orb

    scene, novel = load_orb(p.path, _orb_options(p))
    for note in scene.notes:
        ctx.warn(note)
    return OrbOut(scene.train, scene.test, scene.frame, scene.truth or SceneTruth(names=()), novel)


class DepthFilesParams(Params):
    folder: Path = param(doc="Folder with one depth map (EXR, NPY or 16-bit PNG) for each view.")
    pattern: str = param(
        "{name}",
        pattern=r"^[^/\\{}]*\{(name|stem)\}[^/\\{}]*$",  # a file of `folder`: only their contents are in the key
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


class DepthOut(NamedTuple):
    depths: Annotated[DepthMaps, facets(units=None)]


def _depth_sources(p: DepthFilesParams) -> Mapping[str, Path]:
    from exmesh_graph.io.depth import depth_files

    return {file.name: file for file in depth_files(p.folder)}


@node("prior.depth_files", version="1", libraries=_PICTURES, sources=_depth_sources)
def prior_depth_files(ctx: Context, views: Views, frame: Frame | None = None, *, p: DepthFilesParams) -> DepthOut:
    """Depth along the camera's axis, one file for each view."""
    from exmesh_graph.errors import DataError
    from exmesh_graph.io.depth import load_depths

    if p.units == "scene" and frame is None:
        raise DataError(
            "depth maps in scene units need the scene's frame", where=ctx.node,
            fix='wire `frame: "@<loader>.frame"`, or set units: normalised',
        )  # fmt: skip
    used = frame if p.units == "scene" else None
    relative = p.units == "relative"
    return DepthOut(load_depths(views, p.folder, pattern=p.pattern, scale=p.scale, frame=used, relative=relative))
