"""Pictures of results for the report: what scores compared, shapes, light, maps, a model to turn; files in Blender."""

from typing import NamedTuple

from exmesh_graph.gpu.settings import ALL_CORES
from exmesh_graph.graph.declare.node import Context, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Asset, Carrier, Gallery, SceneTruth, ScoredViews, UsdAsset

_LIBRARIES = ("torch", "warp-lang", "scipy", "OpenImageIO")


class GalleryOut(NamedTuple):
    gallery: Gallery


@node("gallery.round", version="1", libraries=_LIBRARIES)
def round_(ctx: Context, state: Carrier) -> GalleryOut:
    """A round of Stage I: the shape from six sides, its edges, its atlas in colours of stretch."""
    from exmesh_graph.gallery.rounds import round_gallery
    from exmesh_graph.gpu.torch_setup import sharing

    with sharing(0):
        return GalleryOut(round_gallery(ctx.scratch / "gallery", state))


@node("gallery.stage1", version="1", libraries=(*_LIBRARIES, "pillow"))
def stage1(ctx: Context, carrier: Carrier, scored: ScoredViews) -> GalleryOut:
    """The views that evaluate.stage1 scored, geometry, texture, a model to turn."""
    from exmesh_graph.gallery.evaluation import carrier_gallery

    return GalleryOut(carrier_gallery(ctx.scratch / "gallery", carrier, scored))


@node("gallery.asset", version="1", libraries=(*_LIBRARIES, "pillow"))
def asset(ctx: Context, asset: Asset, scored: ScoredViews, truth: SceneTruth | None = None) -> GalleryOut:
    """What evaluate.asset or benchmark.synthetic4relight compared, light, atlas, geometry, a model to turn."""
    from exmesh_graph.gallery.evaluation import asset_gallery

    return GalleryOut(asset_gallery(ctx.scratch / "gallery", asset, scored, truth))


class BlenderParams(Params):
    python: str = param(doc="Path of a Python with bpy (docs/usd.md); not looked for anywhere else.")
    cameras: tuple[str, ...] = param((), doc="Names of the file's cameras; none: the first `pictures` of them.")
    pictures: int = param(3, ge=1, le=64, doc="How many cameras are rendered where `cameras` names none.")
    samples: int = param(64, ge=1, unit="paths per pixel", doc="Cycles' samples.")
    scale: float = param(1.0, gt=0, le=8, doc="Factor on the pictures' sides.")
    background: bool = param(False, doc="Show the light behind the objects.")


@node(
    "gallery.blender", version="1", was="use.blender", libraries=("usd-core", "OpenImageIO"),
    code=("exmesh_graph.export.blender_child",), resources=ALL_CORES,
)  # fmt: skip
def blender(ctx: Context, files: UsdAsset, *, p: BlenderParams) -> GalleryOut:
    """Pictures of an exported file by Blender's Cycles, from the file's own cameras."""
    from exmesh_graph.gallery.blender import blender_gallery

    return GalleryOut(
        blender_gallery(
            ctx.scratch / "gallery", files.root / files.main, p.python, p.cameras, p.pictures,
            samples=p.samples, scale=p.scale, background=p.background, threads=ctx.threads,
        )
    )  # fmt: skip
