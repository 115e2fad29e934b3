"""glTF 2.0 as one binary file (.glb): positions in metres, tangents, maps packed as the format wants them.

Vertices are split where texture coordinates or tangent frames differ. Base colour is sRGB; roughness and metallic share
one picture (green and blue; red, the place of occlusion, is 1); texture coordinates have v down. Tangents are those of
geometry.tangents (MikkTSpace's rules): bitangent = w normal x tangent, w = -1 in mirrored charts. glTF's core has no
environment: the light goes into no file here. Specification: Khronos glTF 2.0, sections 3.7 and 3.9.
"""

from __future__ import annotations

import json
import struct
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.export.content import MeshContent, Placement, file_content
from exmesh_graph.export.folder import new_folder
from exmesh_graph.export.maps import write_map
from exmesh_graph.export.settings import FileSettings
from exmesh_graph.types import Asset, Frame
from exmesh_graph.version import __version__

COMPONENTS = {"int8": 5120, "uint16": 5123, "uint32": 5125, "float32": 5126}
KINDS = ("SCALAR", "VEC2", "VEC3", "VEC4")
_ARRAY, _ELEMENTS = 34962, 34963
_LINEAR, _MIPMAPPED, _CLAMP = 9729, 9987, 33071


def write_gltf(
    folder: Path,
    asset: Asset,
    frame: Frame | None = None,
    settings: FileSettings | None = None,
    *,
    provenance: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write `<name>.glb` into the new `folder`; return what was measured.

    asset and frame as `export.usd.write_usd`; normal maps are written in 8 bits. `provenance` goes into the
    file's `asset.extras`. Equal inputs give equal bytes. Raises DataError, GeometryError or NumericsError.
    """
    settings = settings or FileSettings()
    document, binary, report = gltf_document(asset, frame, settings, provenance)
    with new_folder(folder) as partial:
        file = partial / f"{settings.name}.glb"
        file.write_bytes(glb_bytes(document, binary))
        report["bytes"] = file.stat().st_size
    return report


def gltf_document(
    asset: Asset,
    frame: Frame | None = None,
    settings: FileSettings | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> tuple[dict[str, Any], bytes, dict[str, Any]]:
    """(JSON document, binary chunk, what was measured) of an asset; as `write_gltf`, which writes them."""
    settings = settings or FileSettings()
    asset, prepared, placement, mesh, report = file_content(asset, frame, settings)
    moved = {name: value for name, value in report.items() if name.startswith("recentred_by_")}
    blob = Blob()
    primitive = _primitive(blob, asset, mesh, placement)
    pictures = {"base_color": prepared["base_color"], "orm": _packed(prepared)}
    if "normal" in prepared:
        pictures["normal"] = prepared["normal"]
    images = {key: blob.add(_png(codes, srgb=key == "base_color")) for key, codes in pictures.items()}
    report["vertices_split"] = blob.accessors[0]["count"]
    document = {
        "asset": {
            "version": "2.0",
            "generator": f"exmesh-graph {__version__}",
            "extras": {"scale": report["scale"], **moved, **(provenance or {})},
        },
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": settings.name}],
        "meshes": [{"name": settings.name, "primitives": [primitive]}],
        "materials": [_material(list(images), metallic="metallic" in prepared)],
        "textures": [{"source": number, "sampler": 0, "name": key} for number, key in enumerate(images)],
        "images": [{"bufferView": view, "mimeType": "image/png", "name": key} for key, view in images.items()],
        "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPPED, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        "accessors": blob.accessors,
        "bufferViews": blob.views,
        "buffers": [{"byteLength": len(blob.data)}],
    }
    return document, bytes(blob.data), report


def read_glb(path: Path) -> tuple[dict[str, Any], bytes]:
    """(JSON document, binary chunk) of a .glb; DataError for a broken container."""
    data = path.read_bytes()
    if len(data) < 20 or data[:4] != b"glTF" or struct.unpack_from("<II", data, 4) != (2, len(data)):
        raise DataError("not a whole glTF 2.0 binary file", where=str(path))
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def glb_bytes(document: Mapping[str, Any], binary: bytes) -> bytes:
    """The container of a JSON document and its binary chunk."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    header = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
    return header + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary


class Blob:
    """The binary chunk with its views and accessors."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, data: bytes, target: int | None = None) -> int:
        """A new buffer view, at a multiple of 4 bytes."""
        self.data += bytes(-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        self.views.append(view | ({"target": target} if target else {}))
        self.data += data
        return len(self.views) - 1

    def accessor(self, array: np.ndarray, *, bounds: bool = False) -> int:
        """A new accessor of indices [N] or of an attribute [N, C]; an attribute of integers is normalised."""
        indices, columns = array.ndim == 1, 1 if array.ndim == 1 else array.shape[1]
        codes = not indices and array.dtype.kind in "iu"
        wide = -(-columns * array.itemsize // 4) * 4  # rows of an attribute begin at multiples of four bytes
        rows = np.pad(array, ((0, 0), (0, wide // array.itemsize - columns))) if codes else array
        view = self.add(np.ascontiguousarray(rows).tobytes(), _ELEMENTS if indices else _ARRAY)
        component = COMPONENTS[array.dtype.name]
        entry = {"bufferView": view, "componentType": component, "count": len(array), "type": KINDS[columns - 1]}
        if codes:
            self.views[view]["byteStride"] = wide
            entry["normalized"] = True
        if bounds:
            entry |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        self.accessors.append(entry)
        return len(self.accessors) - 1


def _primitive(blob: Blob, asset: Asset, mesh: MeshContent, placement: Placement) -> dict[str, Any]:
    from exmesh_graph.geometry.tangents import corner_tangents

    tangent, sign = corner_tangents(asset.vertices, asset.faces, asset.uvs, asset.uv_faces)
    corner = np.stack(
        [mesh.faces.reshape(-1), mesh.st_faces.reshape(-1), np.repeat(sign > 0, 3).astype(np.int32)], axis=1
    )
    key = (corner[:, 0].astype(np.int64) * len(mesh.st) + corner[:, 1]) * 2 + corner[:, 2]
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    vertex, st = corner[first, 0], corner[first, 1]
    turned = tangent.reshape(-1, 3)[first].astype(np.float64) @ placement.rotation.T
    normal = _unit(mesh.normals[vertex].astype(np.float64))
    turned = _unit(turned - (turned * normal).sum(-1, keepdims=True) * normal)
    four = np.concatenate([turned, np.where(corner[first, 2:] > 0, 1.0, -1.0)], axis=1)
    coordinates = np.stack([mesh.st[st, 0], 1 - mesh.st[st, 1]], axis=1)
    metres = mesh.points[vertex].astype(np.float64) * placement.metres_per_unit
    attributes = {
        "POSITION": blob.accessor(metres.astype(np.float32), bounds=True),
        "NORMAL": blob.accessor(normal.astype(np.float32)),
        "TEXCOORD_0": blob.accessor(coordinates.astype(np.float32)),
    }
    if asset.normal is not None:  # without a normal map nothing reads them
        attributes["TANGENT"] = blob.accessor(four.astype(np.float32))
    return {"attributes": attributes, "indices": blob.accessor(index.reshape(-1).astype(np.uint32)), "material": 0}


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-30)


def _packed(maps: Mapping[str, np.ndarray]) -> np.ndarray:
    """uint8 [R, R, 3]: 255, roughness, metallic (0 without a map)."""
    roughness = maps["roughness"][..., 0]
    metallic = maps["metallic"][..., 0] if "metallic" in maps else np.zeros_like(roughness)
    return np.stack([np.full_like(roughness, 255), roughness, metallic], axis=-1)


def _png(codes: np.ndarray, *, srgb: bool) -> bytes:
    """The bytes of a PNG file, read back and compared."""
    with tempfile.TemporaryDirectory(prefix="exmesh-gltf-") as folder:
        file = Path(folder) / "map.png"
        write_map(file, codes, srgb=srgb)
        return file.read_bytes()


def _material(names: list[str], *, metallic: bool) -> dict[str, Any]:
    material: dict[str, Any] = {
        "name": "surface",
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": names.index("base_color")},
            "metallicRoughnessTexture": {"index": names.index("orm")},
            "metallicFactor": 1.0 if metallic else 0.0,
        },
    }
    if "normal" in names:
        material["normalTexture"] = {"index": names.index("normal")}
    return material
