"""The UV atlas: made, kept valid, made anew (paper section 4.3)."""

from typing import NamedTuple

from exmesh_graph.graph.declare.node import Context, node
from exmesh_graph.params import Params, param
from exmesh_graph.types import Carrier, Mesh, Stage1State, Views
from exmesh_graph.uv.settings import DiscSettings, XatlasSettings


class NewTexture(Params):
    texture_size: int = param(
        1024,
        ge=0,
        le=8192,
        unit="texels",
        doc="Side of the square texture; 0: as fine as `views` show it, 1.25 pixels, in multiples of 64.",
    )
    fill: float = param(0.5, ge=0.0, le=1.0, doc="Grey that the sRGB texture starts with.")


class MovedTexture(Params):
    texture_size: int = param(
        0,
        ge=0,
        le=8192,
        unit="texels",
        doc="Side of the new texture; 0: as fine as `views` show it, without views the old one's.",
    )


class UnwrapParams(DiscSettings, NewTexture):
    pass


class RegenerateParams(DiscSettings, MovedTexture):
    pass


class XatlasUnwrapParams(XatlasSettings, NewTexture):
    pass


class XatlasRegenParams(XatlasSettings, MovedTexture):
    pass


class MaintainParams(Params):
    dilation: float = param(8.0, ge=0.0, le=4096.0, unit="texels", doc="How far colours are spread beyond charts.")
    max_flipped: float = param(0.01, ge=0.0, le=1.0, doc="Part of the faces folded over in the atlas before a warning.")
    max_stretch: float = param(4.0, ge=1.0, doc="Spread of texel sizes (95th over 5th percentile) before a warning.")


_FINE = "a texture of {size} x {size}, as fine as the photographs show the surface"


class CarrierOut(NamedTuple):
    carrier: Carrier


class StateOut(NamedTuple):
    state: Stage1State


@node("uv.unwrap", version="1", libraries=("torch", "warp-lang", "scipy"))
def unwrap(ctx: Context, mesh: Mesh, views: Views | None = None, *, p: UnwrapParams) -> CarrierOut:
    """Unwrap a mesh into an atlas of nearly flat discs, laid out as rigidly as possible; give it a grey texture."""
    return _unwrapped(ctx, mesh, views, p)


@node("uv.xatlas_unwrap", version="2", libraries=("xatlas", "torch", "warp-lang", "scipy"))
def xatlas_unwrap(ctx: Context, mesh: Mesh, views: Views | None = None, *, p: XatlasUnwrapParams) -> CarrierOut:
    """Unwrap a mesh into an atlas with the charts of xatlas (slow on large or rough meshes); give it a grey texture."""
    return _unwrapped(ctx, mesh, views, p)


@node("uv.maintain", version="1", libraries=("scipy",))
def maintain(ctx: Context, state: Stage1State, *, p: MaintainParams) -> StateOut:
    """Check the atlas, drop unused UVs and spread the texture beyond its charts."""
    from dataclasses import replace

    from exmesh_graph.errors import GeometryError
    from exmesh_graph.geometry.adjacency import without_unused
    from exmesh_graph.uv.maintain import check_atlas, refill

    report = check_atlas(state.vertices, state.faces, state.uvs, state.uv_faces, state.texture.shape[0])
    if report.welded:
        raise GeometryError(
            f"{report.welded} UV coordinates are shared by different vertices",
            where=f"node {ctx.node}",
            expected="UV islands that stay apart",
            fix="regenerate the atlas (uv.regenerate) and report the operation that did this",
        )
    if report.flipped > p.max_flipped * len(state.faces):
        ctx.warn(f"{report.flipped} of {len(state.faces)} faces are folded over in the atlas: regenerate it")
    if report.stretch > p.max_stretch:
        ctx.warn(f"texel sizes differ by {report.stretch:.1f} over the surface: regenerate the atlas")
    ctx.log(
        f"{report.charts} charts cover {report.covered:.0%}, overlap {report.overlap:.2%}, "
        f"stretch {report.stretch:.2f}, {report.flipped} faces folded over"
    )
    uvs, uv_faces = without_unused(state.uvs, state.uv_faces)
    texture = refill(state.texture, uvs, uv_faces, p.dilation) if p.dilation else state.texture
    return StateOut(replace(state, uvs=uvs, uv_faces=uv_faces, texture=texture))


@node("uv.regenerate", version="1", libraries=("torch", "warp-lang", "scipy"))
def regenerate(ctx: Context, state: Stage1State, views: Views | None = None, *, p: RegenerateParams) -> StateOut:
    """Make a new atlas and move texture and texture moments over, texel by texel."""
    return _regenerated(ctx, state, views, p)


@node("uv.xatlas_regen", version="2", libraries=("xatlas", "torch", "warp-lang", "scipy"))
def xatlas_regen(ctx: Context, state: Stage1State, views: Views | None = None, *, p: XatlasRegenParams) -> StateOut:
    """Make a new atlas with the charts of xatlas and move texture and texture moments over, texel by texel."""
    return _regenerated(ctx, state, views, p)


def _unwrapped(ctx: Context, mesh: Mesh, views: Views | None, p: UnwrapParams | XatlasUnwrapParams) -> CarrierOut:
    import numpy as np

    from exmesh_graph.errors import DataError
    from exmesh_graph.uv.unwrap import unwrap, unwrap_at

    size = p.texture_size
    if size:
        uvs, uv_faces = unwrap(mesh.vertices, mesh.faces, size, p, warn=ctx.warn)
    elif views is None:
        raise DataError(
            "texture_size: 0 asks the photographs, and none are wired in", where=ctx.node,
            fix='wire `views: "@<loader>.train"`, or give texture_size',
        )  # fmt: skip
    else:
        uvs, uv_faces, size = unwrap_at(mesh.vertices, mesh.faces, _texel(mesh, views), p, warn=ctx.warn)
        ctx.log(_FINE.format(size=size))
    texture = np.full((size, size, 3), p.fill, np.float32)
    return CarrierOut(Carrier(mesh.vertices, mesh.faces, uvs, uv_faces, texture))


def _regenerated(
    ctx: Context, state: Stage1State, views: Views | None, p: RegenerateParams | XatlasRegenParams
) -> StateOut:
    from exmesh_graph.uv.unwrap import regenerate

    texel = None if p.texture_size or views is None else _texel(state, views)
    new = regenerate(state, p.texture_size or state.texture.shape[0], p, texel=texel, warn=ctx.warn)
    if texel is not None:
        ctx.log(_FINE.format(size=new.texture.shape[0]))
    return StateOut(new)


def _texel(mesh: Mesh | Stage1State, views: Views) -> float:
    from exmesh_graph.uv.unwrap import shown_texel

    return shown_texel(mesh.vertices, views.intrinsics, views.world_to_camera)
