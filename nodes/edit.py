"""Other light and other materials for a finished asset; a film of it."""

from collections.abc import Mapping
from math import pi
from pathlib import Path
from typing import Literal, NamedTuple

from exmesh_graph.edit.settings import EditParams
from exmesh_graph.gpu.settings import ALL_CORES
from exmesh_graph.graph.declare.node import Context, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Asset, EnvMap, Frame, Gallery, Transport, Views

_RENDER = ("torch", "warp-lang", "embreex", "scipy", "OpenImageIO")


class EnvironmentParams(Params):
    path: Path = param(doc="Lat-long picture: EXR or HDR.")
    convention: Literal["openexr", "blender"] = param(
        "openexr", doc="Where the picture's middle looks: +Z of the Y-up world, or Blender's +X of its z-up world."
    )


class EnvironmentOut(NamedTuple):
    light: EnvMap


def _environment_sources(p: EnvironmentParams) -> Mapping[str, Path]:
    from exmesh_graph.errors import DataError

    if not p.path.is_file():
        raise DataError("the environment map does not exist", where=str(p.path), fix="correct `path`")
    return {p.path.name: p.path}


@node("data.environment", version="1", libraries=("OpenImageIO",), sources=_environment_sources)
def environment(ctx: Context, *, p: EnvironmentParams) -> EnvironmentOut:
    """A lat-long environment map."""
    from exmesh_graph.io.envmaps import canonical_from_blender, read_environment

    radiance = read_environment(p.path)
    return EnvironmentOut(EnvMap(canonical_from_blender(radiance) if p.convention == "blender" else radiance))


class RelightParams(Params):
    rotation: float = param(
        0.0, ge=-2 * pi, le=2 * pi, unit="rad", doc="Turn of the light about +Y, counter-clockwise from above."
    )
    exposure: float = param(0.0, ge=-20, le=20, unit="stops", doc="The light is multiplied by 2 to this power.")
    pictures: int = param(3, ge=0, le=64, doc="Pictures in the report: of the wired views, or around the object.")
    size: int = param(384, ge=16, le=4096, unit="px", doc="Side of pictures that no view gives a size.")
    bounces: int = param(8, ge=0, le=16, doc="Interreflections in the pictures, where no transport is wired.")


class RelightOut(NamedTuple):
    asset: Asset
    gallery: Gallery


@node("edit.relight", version="1", was="use.relight", libraries=(*_RENDER, "pillow"), resources=ALL_CORES)
def relight(
    ctx: Context,
    asset: Asset,
    light: EnvMap | None = None,
    views: Views | None = None,
    transport: Transport | None = None,
    *,
    p: RelightParams,
) -> RelightOut:
    """The asset under another environment, turned and exposed (its own where none is wired), with pictures."""
    from exmesh_graph.edit.cameras import orbit
    from exmesh_graph.edit.relight import pictures, relit
    from exmesh_graph.gallery.editing import light_gallery

    result = relit(asset, None if light is None else light.radiance, rotation=p.rotation, exposure=p.exposure)
    if views is None:
        cameras, height, width = orbit(p.pictures, p.size, p.size), p.size, p.size
    else:
        chosen = [len(views) * (2 * k + 1) // (2 * p.pictures) for k in range(min(p.pictures, len(views)))]
        cameras = (views.intrinsics[chosen], views.camera_to_world[chosen])
        height, width = views.height, views.width
    images = []
    if p.pictures:
        images = pictures(
            result, *cameras, height, width, transport=transport, bounces=p.bounces, seed=ctx.seed,
            progress=ctx.progress,
        )  # fmt: skip
    return RelightOut(result, light_gallery(ctx.scratch / "gallery", result, images))


class TurntableParams(Params):
    frames: int = param(36, ge=2, le=720, doc="Pictures in one turn.")
    size: int = param(384, ge=16, le=2160, unit="px", doc="Side of a picture.")
    seconds: float = param(4.0, gt=0, le=120, unit="s", doc="Duration of one turn.")
    elevation: float = param(0.35, gt=-1.5, lt=1.5, unit="rad", doc="Height of the camera above the horizon.")
    turn: Literal["camera", "light"] = param("camera", doc="What goes round.")
    bounces: int = param(8, ge=0, le=16, doc="Interreflections, where no transport is wired.")


class TurntableOut(NamedTuple):
    film: Gallery


@node("edit.turntable", version="1", was="use.turntable", libraries=(*_RENDER, "pillow"), resources=ALL_CORES)
def turntable(ctx: Context, asset: Asset, transport: Transport | None = None, *, p: TurntableParams) -> TurntableOut:
    """A film of the asset turning under its light (animated WebP, shown in the report)."""
    from exmesh_graph.edit.relight import turntable as render
    from exmesh_graph.edit.relight import write_film
    from exmesh_graph.gallery.pictures import GalleryWriter

    images = render(
        asset, frames=p.frames, size=p.size, elevation=p.elevation, turn=p.turn, transport=transport,
        bounces=p.bounces, seed=ctx.seed, progress=ctx.progress,
    )  # fmt: skip
    writer = GalleryWriter(ctx.scratch / "film")
    file = writer.claim("turntable.webp", "Turntable", f"{p.frames} pictures, the {p.turn} goes round once.")
    write_film(file, images, p.seconds)
    return TurntableOut(writer.finish())


class EditOut(NamedTuple):
    asset: Asset
    gallery: Gallery


def _edit_sources(p: EditParams) -> Mapping[str, Path]:
    from exmesh_graph.errors import DataError

    files = {name: getattr(p, name) for name in ("picture", "mask") if getattr(p, name) is not None}
    for name, file in files.items():
        if not file.is_file():
            raise DataError("the picture does not exist", where=str(file), fix=f"correct `{name}`")
    return files


@node("edit.material", version="1", was="use.edit_material", libraries=(*_RENDER, "pillow"), sources=_edit_sources)
def material(
    ctx: Context, asset: Asset, views: Views | None = None, frame: Frame | None = None, *, p: EditParams
) -> EditOut:
    """Set, scale or paint a map in a region; all other texels keep their bytes."""
    from exmesh_graph.edit.apply import apply_edit
    from exmesh_graph.gallery.editing import edit_gallery

    result, weight = apply_edit(asset, p, views, frame, where=f"node {ctx.node}")
    changed = int((weight > 0).sum())
    ctx.log(f"{changed} of {weight.size} texels changed")
    if changed == 0:
        ctx.warn("the region holds no texel: nothing was changed; look at `center`, `radius` or `mask`")
    return EditOut(result, edit_gallery(ctx.scratch / "gallery", asset, result, weight, p.channel))
