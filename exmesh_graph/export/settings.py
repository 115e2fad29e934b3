"""Settings of exported files: parameters of the nodes that write them, declared once. Imports nothing heavy."""

from __future__ import annotations

from typing import Literal

from exmesh_graph.params import Params, param


class MapSettings(Params):
    """How textures are written (`export.maps`)."""

    roughness_floor: float = param(
        0.04,
        ge=0.0,
        le=1.0,
        doc="Lowest roughness written: below it, highlights are spikes that renderers disagree about; how many texels "
        "were raised is reported.",
    )
    dilation: int = param(8, ge=0, le=64, unit="texels", doc="Padding of the charts, so that mip levels do not bleed.")


class _Name(Params):
    name: str = param("asset", doc="Name of the asset and its files: letters, digits and _.")


class FileSettings(MapSettings, _Name):
    """A glTF or OBJ file (`export.gltf`, `export.obj`)."""

    recentre: bool = param(
        False, doc="Put the object's middle at the origin, for scenes far from theirs; the move is kept in the asset."
    )


class ExportSettings(FileSettings):
    """A USD asset (`export.usd`)."""

    up_axis: Literal["Y", "Z"] = param(
        "Y", doc="Z turns points, cameras and light; many tools turn Y-up by themselves."
    )
    normal_bits: Literal[8, 16] = param(8, unit="bits", doc="Depth of the normal map.")
    clip: bool = param(
        False, doc="Clip base colour to [0, 1] and light to half floats; else values outside are errors."
    )
    require_scale: bool = param(False, doc="Refuse an asset whose metric scale is not known.")
    require_closed: bool = param(False, doc="Refuse an open or non-manifold mesh.")
    gate: bool = param(True, doc="Refuse to publish a file that fails the checks; false is noted in the asset.")


class ComposeSettings(Params):
    """Assets on a table top (`export.usd.compose`)."""

    height: float = param(0.3, gt=0, unit="m", doc="Every piece is scaled to this height.")
    turn: tuple[float, ...] = param(
        (), unit="rad", doc="Turn of each piece about the vertical, in the order of the ports."
    )
    gap: float = param(0.15, ge=0, doc="Room between the pieces, in heights.")
    table_color: tuple[float, float, float] = param((0.30, 0.19, 0.11), doc="Base colour of the table, linear.")
    table_roughness: float = param(0.35, ge=0, le=1, doc="Roughness of the table.")
    width: int = param(640, ge=16, le=8192, unit="px", doc="Width of the camera's picture.")
