"""A mesh or asset to turn in an output: the report's viewer in a frame of its own, three.js and the model inside it."""

from __future__ import annotations

from dataclasses import fields

from exmesh_graph.notebook.cells import frame
from exmesh_graph.types import Asset, Carrier, Mesh

_HEIGHT = 404
_STYLE = """html { background: var(--bg); } body { margin: 0; padding: 4px; max-width: none; } .viewer { margin: 0; }
.viewer h2, .viewer .note:not(.caption) { display: none; } .viewer .stage { height: 330px; min-height: 0; }"""


def turning(mesh: Mesh, title: str = "") -> str:
    """HTML of a frame in which the mesh turns: an Asset under its own light, a Carrier with its texture, a bare mesh
    as clay. Raises DataError for more faces than a page bears (gallery.models.MAX_FACES), GeometryError for none.
    """
    from exmesh_graph.gallery.models import asset_model, carrier_model

    if isinstance(mesh, Asset):
        data = asset_model(mesh)
    elif isinstance(mesh, Carrier):
        data = carrier_model(mesh)
    else:
        data = asset_model(_clay(mesh))
    return glb_frame(data, title or f"{len(mesh.faces)} faces.", clay=not isinstance(mesh, Carrier))


def glb_frame(data: bytes, caption: str, *, clay: bool = False) -> str:
    """HTML of a frame with a .glb that this project wrote; `clay`: its maps say nothing."""
    from exmesh_graph.report.contents import GalleryItem
    from exmesh_graph.report.templates import asset_text
    from exmesh_graph.report.widgets import viewer_section

    section = viewer_section([("model", GalleryItem("", "model.glb", "model", caption, data))])
    style = asset_text("exmesh_graph.report", "style.css") + _STYLE
    if clay:
        style += "label:has(input:is([value=base_color], [value=roughness])) { display: none !important; }"
    return frame(f"<!DOCTYPE html><meta charset=utf-8><style>{style}</style><body>{section}", _HEIGHT)


def _clay(mesh: Mesh) -> Asset:
    """The mesh in one matte colour under a plain sky; its one UV serves all corners."""
    import numpy as np

    from exmesh_graph.report.view.page import overcast

    return Asset(
        **{f.name: getattr(mesh, f.name) for f in fields(Mesh)},
        uvs=np.full((1, 2), 0.5, np.float32),
        uv_faces=np.zeros_like(mesh.faces),
        texture=np.full((4, 4, 3), 0.6, np.float32),
        base_color=np.full((4, 4, 3), (0.62, 0.6, 0.56), np.float32),
        roughness=np.full((4, 4), 0.7, np.float32),
        seen=np.ones((4, 4), bool),
        environment=overcast(16),
    )
