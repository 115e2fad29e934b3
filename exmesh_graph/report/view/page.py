"""One HTML file with an asset, its lights and three.js in it: opens by double-click, works offline.

The asset goes in as glTF (export.gltf); lights as half floats in the layout that three.js expects of equirectangular
pictures: centre at +X and the lowest row first, where ours have +Z and the highest row.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np

from exmesh_graph.export.gltf import glb_bytes, gltf_document
from exmesh_graph.gallery.models import equirectangular
from exmesh_graph.io.envmaps import canonical_directions
from exmesh_graph.report.templates import asset_text, data_uri, page_of
from exmesh_graph.report.widgets import MODULES
from exmesh_graph.types import Asset

LIGHT_WIDTH = 512
"""Lights are reduced to this width: three.js blurs them for each roughness anyway."""


def view_page(asset: Asset, title: str, lights: Mapping[str, np.ndarray] | None = None) -> str:
    """The page as HTML. `lights`: name -> canonical lat-long float32 [H, W, 3], beside its own and two plain ones.

    Raises DataError or GeometryError for an asset that cannot be exported.
    """
    document, binary, _ = gltf_document(asset)
    named = {"recovered": asset.environment, **(lights or {}), "studio": studio(), "overcast": overcast()}
    data = {
        "title": title,
        "glb": base64.b64encode(glb_bytes(document, binary)).decode(),
        "lights": [{"name": name, **_encoded(radiance)} for name, radiance in named.items()],
        "faces": len(asset.faces),
        "maps": list(asset.base_color.shape[:2]),
    }
    scripts = {name: asset_text(__package__, file).encode() for name, file in MODULES.items()}
    # addresses of data, since pages opened from a disk may not load modules from files
    modules = {name: data_uri("text/javascript", text) for name, text in scripts.items()}
    return page_of(__package__, "view.html", title=title, data=data, modules=modules)


def studio(height: int = 64) -> np.ndarray:
    """A dark room with a large warm lamp on one side, a cool one on the other and a lamp above: float32 [H, 2H, 3]."""
    direction = canonical_directions(height, 2 * height)
    light = np.full((height, 2 * height, 3), 0.08)
    for toward, width, color in (
        ((1.0, 0.6, 0.8), 0.5, (5.0, 4.5, 4.0)),
        ((-1.0, 0.2, 0.6), 0.4, (1.6, 2.0, 2.6)),
        ((0.0, 1.0, -0.3), 0.35, (2.5, 2.5, 2.5)),
    ):
        axis = np.array(toward) / np.linalg.norm(toward)
        edge = np.clip((direction @ axis - np.cos(width)) / 0.06, 0, 1)
        light = light + edge[..., None] * np.array(color)
    return light.astype(np.float32)


def overcast(height: int = 64) -> np.ndarray:
    """A gray sky (the CIE's: three times as bright above as at the horizon) over darker ground: float32 [H, 2H, 3]."""
    up = canonical_directions(height, 2 * height)[..., 1:2]
    sky = np.where(up > 0, (1 + 2 * up) / 3, 0.12)
    return (1.3 * sky * np.array([0.95, 1.0, 1.06])).astype(np.float32)


def _encoded(radiance: np.ndarray) -> dict[str, Any]:
    """RGBA half floats, base64, as three.js reads them."""
    rgba = equirectangular(radiance, LIGHT_WIDTH)
    return {"width": rgba.shape[1], "height": rgba.shape[0], "data": base64.b64encode(rgba.tobytes()).decode()}
