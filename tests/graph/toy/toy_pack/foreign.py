"""Wire types of a pack with other conventions than the project's, and nodes that make and take them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

from exmesh_graph.graph import Context, Params, facets, node, param
from exmesh_graph.types import Asset, Carrier, DepthMaps, EnvMap, Files, Mesh, Transport, UsdAsset, Views


class OpenGLViews(Views):
    """Camera axes of OpenGL: y up, z backward."""

    type_name: ClassVar[str] = "OpenGLViews"
    conventions: ClassVar[Mapping[str, Any]] = {**Views.conventions, "camera": "opengl"}


class EncodedViews(Views):
    """Pictures as in an 8-bit file."""

    type_name: ClassVar[str] = "EncodedViews"
    conventions: ClassVar[Mapping[str, Any]] = {**Views.conventions, "color": "srgb"}


class ZUpMesh(Mesh):
    """Z up."""

    type_name: ClassVar[str] = "ZUpMesh"
    conventions: ClassVar[Mapping[str, Any]] = {**Mesh.conventions, "up": "z"}


class SceneMesh(Mesh):
    """In the units of the scene."""

    type_name: ClassVar[str] = "SceneMesh"
    conventions: ClassVar[Mapping[str, Any]] = {**Mesh.conventions, "units": "scene"}


class LinearCarrier(Carrier):
    """A texture of linear colours."""

    type_name: ClassVar[str] = "LinearCarrier"
    conventions: ClassVar[Mapping[str, Any]] = {**Carrier.conventions, "color": "linear"}


class RayDepths(DepthMaps):
    """Distances along rays."""

    type_name: ClassVar[str] = "RayDepths"
    conventions: ClassVar[Mapping[str, Any]] = {**DepthMaps.conventions, "depth": "ray"}


class LightProbe(EnvMap):
    """An angular map."""

    type_name: ClassVar[str] = "LightProbe"
    conventions: ClassVar[Mapping[str, Any]] = {**EnvMap.conventions, "environment": "angular"}


class EncodedAsset(Asset):
    """Base colour as in an 8-bit file."""

    type_name: ClassVar[str] = "EncodedAsset"
    conventions: ClassVar[Mapping[str, Any]] = {**Asset.conventions, "maps": "srgb"}


class ZUpUsd(UsdAsset):
    """A stage that says Z up."""

    type_name: ClassVar[str] = "ZUpUsd"
    conventions: ClassVar[Mapping[str, Any]] = {"up": "z"}


class MakeParams(Params):
    foreign: bool = param(False, doc="Return the foreign type where the output says the common one.")
    scale: float = param(1.0, doc="Size of the mesh.")


class ForeignOut(NamedTuple):
    opengl: OpenGLViews
    encoded: EncodedViews
    z_up: ZUpMesh
    scene: SceneMesh
    linear: LinearCarrier
    rays: RayDepths
    probe: LightProbe
    painted: EncodedAsset
    z_usd: ZUpUsd


class CommonOut(NamedTuple):
    views: Views
    mesh: Mesh
    carrier: Carrier
    depths: DepthMaps
    sky: EnvMap
    asset: Asset
    light: Transport
    usd: Annotated[UsdAsset, facets(up="y")]


class MeshOut(NamedTuple):
    mesh: Annotated[Mesh, facets(units=None)]


class ViewsOut(NamedTuple):
    views: Views


class DoneOut(NamedTuple):
    files: Files


@node("foreign.make", version="1")
def make(ctx: Context) -> ForeignOut:
    """Everything foreign; never run."""
    raise NotImplementedError


@node("foreign.common", version="1")
def common(ctx: Context) -> CommonOut:
    """Everything as the project has it; never run."""
    raise NotImplementedError


@node("foreign.use", version="1")
def use(
    ctx: Context,
    views: Views | None = None,
    mesh: Mesh | None = None,
    unwrapped: Annotated[Mesh | None, facets(uv=True)] = None,
    carrier: Carrier | None = None,
    depths: DepthMaps | None = None,
    sky: EnvMap | None = None,
    asset: Asset | None = None,
    usd: Annotated[UsdAsset | None, facets(up="y")] = None,
    either: Views | DepthMaps | None = None,
    opengl: Annotated[Views | None, facets(camera="opengl")] = None,
) -> DoneOut:
    """Takes what the project's nodes take."""
    root = ctx.scratch / "out"
    root.mkdir()
    return DoneOut(Files(Path(root)))


@node("foreign.mesh", version="1")
def mesh(ctx: Context, *, p: MakeParams) -> MeshOut:
    """A triangle whose units nobody knows, with UVs or without."""
    import numpy as np

    vertices = p.scale * np.eye(3, dtype=np.float32)
    return MeshOut((ZUpMesh if p.foreign else Mesh)(vertices, np.array([[0, 1, 2]], np.int32)))


@node("foreign.views", version="1")
def views(ctx: Context, *, p: MakeParams) -> ViewsOut:
    """One view."""
    import numpy as np

    kind = OpenGLViews if p.foreign else Views
    image, alpha = np.zeros((1, 2, 2, 3), np.float32), np.ones((1, 2, 2), np.float32)
    return ViewsOut(kind(("a",), image, alpha, np.eye(3)[None], np.eye(4)[None], "train"))
