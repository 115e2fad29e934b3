"""A result as one small .glb that a report page carries: quantised mesh, maps at most `MAP_SIZE`, light beside it."""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import DataError, ExmeshError
from exmesh_graph.export.gltf import gltf_document
from exmesh_graph.export.gltf_compact import compact_glb
from exmesh_graph.export.inputs import clipped
from exmesh_graph.export.lod import resized
from exmesh_graph.gallery.pictures import GalleryWriter
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.types import Asset, Carrier

MAP_SIZE, LIGHT_WIDTH = 512, 128
MAX_FACES = 200_000
"""About 4 MB; a page with a larger mesh would be slow to open."""


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


def asset_model(asset: Asset, eye: np.ndarray | None = None) -> bytes:
    """The finished asset with its light. Faces stay as they are; values out of range are clipped.

    eye  [3], a direction from which the viewer looks at first
    Raises DataError for more than `MAX_FACES` faces, and what export.gltf raises.
    """
    small, _ = clipped(_small(asset))
    return _model(small, eye, light=equirectangular(small.environment, LIGHT_WIDTH))


def carrier_model(carrier: Carrier, eye: np.ndarray | None = None) -> bytes:
    """A mesh with its RGB texture, to be shown as it is: what Stage I knows. Raises as `asset_model`."""
    color = srgb_to_linear(np.clip(carrier.texture, 0, 1)).astype(np.float32)
    height, width = color.shape[:2]
    asset = Asset(
        vertices=carrier.vertices, faces=carrier.faces, uvs=carrier.uvs, uv_faces=carrier.uv_faces,
        texture=carrier.texture, base_color=color, roughness=np.ones((height, width), np.float32),
        seen=np.ones((height, width), bool),  # Stage I fills the texels between charts itself
        environment=np.zeros((1, 2, 3), np.float32),
    )  # fmt: skip
    return _model(_small(asset), eye, light=None)


def equirectangular(radiance: np.ndarray, width: int) -> np.ndarray:
    """Canonical lat-long [H, W, 3] as three.js reads it: float16 [h, w, 4], centre at +X, the lowest row first.

    Reduced by a whole factor, to `width` or the next larger.
    """
    step = max(radiance.shape[1] // width, 1)
    rows, columns = radiance.shape[0] // step, radiance.shape[1] // step
    small = radiance[: rows * step, : columns * step].reshape(rows, step, columns, step, 3).mean(axis=(1, 3))
    turned = np.roll(small, columns // 4, axis=1)[::-1]
    return np.concatenate([np.clip(turned, 0, 65504), np.ones((rows, columns, 1))], axis=-1).astype(np.float16)


def _small(asset: Asset) -> Asset:
    """Maps reduced to the largest divisor of their size up to `MAP_SIZE`; those with none near it stay."""
    if len(asset.faces) > MAX_FACES:
        raise DataError(f"the mesh has {len(asset.faces)} faces", expected=f"at most {MAX_FACES} in a page",
                        fix="`exmesh view` shows it whole")  # fmt: skip
    height, width = asset.base_color.shape[:2]
    size = next(n for n in range(min(MAP_SIZE, width), 0, -1) if width % n == 0)
    return resized(asset, size) if height == width and 2 * size > MAP_SIZE else asset


def _model(asset: Asset, eye: np.ndarray | None, light: np.ndarray | None) -> bytes:
    document, binary, _ = gltf_document(asset)
    return compact_glb(document, binary, unlit=light is None, light=light, eye=eye)
