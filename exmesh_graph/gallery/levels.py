"""A mesh, carrier or asset as binary glTF in levels, for a live page: the first is small and quick, the last is whole.

Made for speed, not for keeping: attributes quantised (KHR_mesh_quantization), pictures as lossy WebP, coordinates of
the normalised world in every level, so that one camera fits all; an asset has its light beside it, as
`export.gltf_compact` puts it. `export.gltf` writes the files that are for keeping.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from exmesh_graph.export.gltf import Blob, glb_bytes
from exmesh_graph.gallery.models import LIGHT_WIDTH, equirectangular
from exmesh_graph.geometry.adjacency import area_weighted_normals, components
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.types import Asset, Carrier, Mesh

FEW_FACES = 20_000
_WHOLE_AT_ONCE = 40_000
SIDES = (512, 1024)
"""Sides of maps at most, in the first levels."""
_LINEAR, _MIPMAPPED, _CLAMP = 9729, 9987, 33071


@dataclass(frozen=True)
class Level:
    """What a level keeps: about so many faces (0: all), and maps of so many texels at a side at most (0: all)."""

    faces: int
    side: int


def levels_of(mesh: Mesh) -> list[Level]:
    """The levels of a mesh, the smallest first; the last is whole."""
    maps = mesh.base_color if isinstance(mesh, Asset) else mesh.texture if isinstance(mesh, Carrier) else None
    return levels_for(len(mesh.faces), 0 if maps is None else max(maps.shape[:2]))


def levels_for(faces: int, side: int) -> list[Level]:
    """The levels of a mesh of so many faces with maps of so many texels at their longer side."""
    many = faces > _WHOLE_AT_ONCE
    levels = [Level(FEW_FACES if many else 0, SIDES[0] if side > SIDES[0] else 0)]
    if many or side > SIDES[0]:
        levels.append(Level(0, SIDES[1] if side > SIDES[1] else 0))
    if side > SIDES[1]:
        levels.append(Level(0, 0))
    return levels


def model_level(mesh: Mesh, level: Level) -> tuple[bytes, int]:
    """(binary glTF, faces in it). Positions are 16-bit over the longest side, normals 8-bit, UVs 16-bit with v down."""
    textured = isinstance(mesh, Carrier) and len(mesh.uvs) > 0 and len(mesh.uv_faces) == len(mesh.faces) > 0
    with ThreadPoolExecutor(1) as beside:  # the pictures, while faces are drawn together
        drawing = beside.submit(_encoded, mesh, level.side) if textured and isinstance(mesh, Carrier) else None
        if level.faces and len(mesh.faces) > level.faces:
            mesh = clustered(mesh, level.faces)
        return _glb(mesh, textured, drawing.result if drawing else dict), len(mesh.faces)


def _glb(mesh: Mesh, textured: bool, pictures: Callable[[], dict[str, bytes]]) -> bytes:
    blob = Blob()
    index, vertex, uv = _corners(mesh) if textured and isinstance(mesh, Carrier) else _alone(mesh)
    points = mesh.vertices.astype(np.float64)
    low = points.min(axis=0) if len(points) else np.zeros(3)
    size = float((points - low).max()) if len(points) else 1.0
    size = size if size > 0 else 1.0
    normals = area_weighted_normals(mesh.vertices, mesh.faces) if len(mesh.faces) else np.zeros_like(points)
    attributes = {
        "POSITION": blob.accessor(_codes((points[vertex] - low) / size), bounds=True),
        "NORMAL": blob.accessor(np.round(127 * np.asarray(normals, np.float64)[vertex]).astype(np.int8)),
    }
    material: dict[str, Any] = {"name": "clay", "doubleSided": True, "pbrMetallicRoughness": {
        "baseColorFactor": [0.8, 0.77, 0.72, 1], "metallicFactor": 0, "roughnessFactor": 0.9}}  # fmt: skip
    images: dict[str, bytes] = {}
    if textured and isinstance(mesh, Carrier):
        coordinates = np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)
        attributes["TEXCOORD_0"] = blob.accessor(_codes(coordinates.astype(np.float64)))
        images = pictures()
        material = _material(list(images), lit=isinstance(mesh, Asset))
    short = len(vertex) <= 65535
    indices = blob.accessor(index.astype(np.uint16 if short else np.uint32))
    views = [blob.add(data) for data in images.values()]
    scene: dict[str, Any] = {"nodes": [0]}
    if isinstance(mesh, Asset):
        light = equirectangular(mesh.environment, LIGHT_WIDTH)
        told = {"bufferView": blob.add(light.tobytes()), "width": light.shape[1], "height": light.shape[0]}
        scene["extras"] = {"light": told}
    used = ["KHR_mesh_quantization", *(["EXT_texture_webp"] if images else [])]
    document = {
        "asset": {"version": "2.0", "generator": "exmesh-graph"},
        "extensionsUsed": used + (["KHR_materials_unlit"] if images and not isinstance(mesh, Asset) else []),
        "extensionsRequired": used,
        "scene": 0, "scenes": [scene],
        "nodes": [{"mesh": 0, "translation": low.tolist(), "scale": [size] * 3}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [material],
        "accessors": blob.accessors, "bufferViews": blob.views, "buffers": [{"byteLength": len(blob.data)}],
    }  # fmt: skip
    if images:
        document |= {
            "textures": [{"sampler": 0, "name": name, "extensions": {"EXT_texture_webp": {"source": number}}}
                         for number, name in enumerate(images)],
            "images": [{"bufferView": view, "mimeType": "image/webp"} for view in views],
            "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPPED, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        }  # fmt: skip
    return glb_bytes(document, bytes(blob.data))


def clustered(mesh: Mesh, faces: int) -> Mesh:
    """The mesh with the vertices of each cell of a grid drawn together: coarse, quick, seams kept where they are.

    UVs are means over a cell within a chart. Not for keeping: what is thin may tear.
    """
    points = mesh.vertices.astype(np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    area = float(np.linalg.norm(np.cross(*_edges(points[mesh.faces])), axis=1).sum()) / 2
    cell = max(np.sqrt(2 * max(area, 1e-30) / faces), 1e-9 * float((high - low).max() or 1.0))
    place = ((points - low) / cell).astype(np.int64)
    spans = place.max(axis=0) + 1
    _, owner = np.unique((place[:, 0] * spans[1] + place[:, 1]) * spans[2] + place[:, 2], return_inverse=True)
    owner = owner.reshape(-1)
    vertices = _means(points, owner)
    corners = owner[mesh.faces]
    whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    first = np.unique(np.sort(corners[whole], axis=1), axis=0, return_index=True)[1]
    kept = np.flatnonzero(whole)[np.sort(first)]
    small = corners[kept].astype(np.int32)
    if not isinstance(mesh, Carrier) or not len(mesh.uv_faces):
        return Mesh(vertices.astype(np.float32), small)
    cell_of, chart_of = np.zeros(len(mesh.uvs), np.int64), np.zeros(len(mesh.uvs), np.int64)
    cell_of[mesh.uv_faces] = corners
    chart_of[mesh.uv_faces] = components(mesh.uv_faces)[:, None]
    _, uv_owner = np.unique(cell_of * (chart_of.max() + 1) + chart_of, return_inverse=True)
    uv_owner = uv_owner.reshape(-1)
    uvs = _means(mesh.uvs.astype(np.float64), uv_owner)
    changed = {"vertices": vertices.astype(np.float32), "faces": small, "uvs": uvs.astype(np.float32),
               "uv_faces": uv_owner[mesh.uv_faces[kept]].astype(np.int32)}  # fmt: skip
    if isinstance(mesh, Asset):
        return replace(mesh, **changed)
    return Carrier(texture=mesh.texture, **changed)


def webp(picture: np.ndarray, quality: int = 88) -> bytes:
    """uint8 [H, W, 3] or display values in [0, 1], [H, W(, 3)], as lossy WebP."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(bytes_of(picture)).convert("RGB").save(out, "WEBP", quality=quality, method=0)
    return out.getvalue()


def bytes_of(picture: np.ndarray) -> np.ndarray:
    """Display values in [0, 1] as uint8; uint8 as it is."""
    if picture.dtype == np.uint8:
        return picture
    return (np.clip(np.nan_to_num(picture), 0, 1) * 255 + 0.5).astype(np.uint8)


def reduced(image: np.ndarray, side: int) -> np.ndarray:
    """Means of whole blocks until no side exceeds `side`; 0: as it is. Summed row by row: quick on large maps."""
    factor = -(-max(image.shape[:2]) // side) if side else 1
    if factor <= 1:
        return image
    height, width = (n // factor * factor for n in image.shape[:2])
    total = np.zeros((height // factor, width // factor, *image.shape[2:]), np.float32)
    cut = image[:height, :width]
    step = max(factor // 4, 1)  # of a large block sixteen texels and more tell its mean well enough for a look
    places = range(0, factor, step)
    for row in places:
        for column in places:
            total += cut[row::factor, column::factor]
    return total / len(places) ** 2


def _encoded(mesh: Carrier, side: int) -> dict[str, bytes]:
    """The maps as WebP by name, base colour first."""
    return {name: webp(picture, 88 if side else 95) for name, picture in _pictures(mesh, side)}


def _pictures(mesh: Carrier, side: int) -> list[tuple[str, np.ndarray]]:
    """The maps of a carrier or asset as pictures, base colour first."""
    if not isinstance(mesh, Asset):
        return [("texture", reduced(mesh.texture, side))]
    rough = reduced(mesh.roughness, side)
    metal = np.zeros_like(rough) if mesh.metallic is None else reduced(mesh.metallic, side)
    maps = [
        ("base_color", linear_to_srgb(np.clip(reduced(mesh.base_color, side), 0, 1))),
        ("orm", np.stack([np.ones_like(rough), rough, metal], axis=-1)),
    ]
    if mesh.normal is not None:
        maps.append(("normal", 0.5 + 0.5 * reduced(mesh.normal, side)))
    return maps


def _material(names: list[str], *, lit: bool) -> dict[str, Any]:
    if not lit:
        return {"name": "appearance", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}},
                "extensions": {"KHR_materials_unlit": {}}}  # fmt: skip
    material: dict[str, Any] = {"name": "surface", "pbrMetallicRoughness": {
        "baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}}}  # fmt: skip
    if "normal" in names:
        material["normalTexture"] = {"index": names.index("normal")}
    return material


def _corners(mesh: Carrier) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(index [3 F], vertex of each new one, its UVs): vertices split where texture coordinates differ."""
    key = mesh.faces.astype(np.int64).reshape(-1) * len(mesh.uvs) + mesh.uv_faces.reshape(-1)
    found, index = np.unique(key, return_inverse=True)
    return index.reshape(-1), found // len(mesh.uvs), mesh.uvs[found % len(mesh.uvs)]


def _alone(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return mesh.faces.reshape(-1), np.arange(len(mesh.vertices)), np.zeros((0, 2))


def _codes(unit: np.ndarray) -> np.ndarray:
    return np.round(np.clip(unit, 0, 1) * 65535.0).astype(np.uint16)


def _edges(corner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]


def _means(values: np.ndarray, owner: np.ndarray) -> np.ndarray:
    counts = np.maximum(np.bincount(owner), 1)
    return np.stack([np.bincount(owner, values[:, k]) for k in range(values.shape[1])], axis=1) / counts[:, None]
