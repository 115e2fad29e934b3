"""The models of a Gallery, which the page's viewer turns."""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import ExmeshError
from exmesh_graph.gallery.glb import MAP_SIZE, asset_model, carrier_model
from exmesh_graph.gallery.pictures import GalleryWriter
from exmesh_graph.types import Asset, Carrier


def add_model(
    writer: GalleryWriter, mesh: Carrier, title: str, eye: np.ndarray | None = None, *, by_texture: bool = False
) -> None:
    """Enter the mesh for the page's viewer, or say below the last picture why it cannot be shown there.

    An asset is shown by its materials, unless `by_texture`; `eye` is a direction to look from at first.
    """
    asset = mesh if isinstance(mesh, Asset) and not by_texture else None
    try:
        data = asset_model(asset, eye) if asset else carrier_model(mesh, eye)
    except ExmeshError as error:  # a result that cannot be exported is scored and shown all the same
        writer.remark(f"No model to turn: {error.what}.")
        return
    maps = asset.base_color if asset else mesh.texture
    size = f"{len(mesh.faces)} faces, maps of {maps.shape[1]} x {maps.shape[0]} texels (here at most {MAP_SIZE})."
    writer.claim("model.glb", title, size).write_bytes(data)
