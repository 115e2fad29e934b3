"""How a map is edited: the parameters of the node, declared once. Imports nothing heavy."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from exmesh_graph.params import Params, param

Channel = Literal["base_color", "roughness", "metallic"]
Operation = Literal["set", "scale", "paint"]


class EditParams(Params):
    """`edit.material` and `apply_edit`."""

    channel: Channel = param("base_color", doc="The map to change.")
    operation: Operation = param("set", doc="Set to `value`, scale by it, or paint `picture` over.")
    value: tuple[float, ...] = param((), doc="One number, or for base_color three (linear RGB), for set and scale.")
    picture: Path | None = param(
        None, doc="RGBA picture for paint: a decal on the ball, or in the atlas's layout where the region is no ball."
    )
    mask: Path | None = param(None, doc="Region: a picture in the atlas's layout (row 0 is v = 1), white is changed.")
    center: tuple[float, float, float] | None = param(
        None, doc="Region: middle of a ball, normalised units (scene units where a frame is wired)."
    )
    view: str = param("", doc="Region: the ball's middle is what this view shows at `pixel`; needs wired views.")
    pixel: tuple[float, float] | None = param(None, unit="px", doc="x to the right, y down.")
    radius: float = param(0.0, ge=0, doc="Radius of the ball, in the units of `center`.")
    feather: float = param(0.0, ge=0, le=1, doc="Share of the radius over which the edit fades out.")
