"""A binary glTF of this project in about 60 % of its bytes, for pages: quantised attributes, lossless WebP pictures.

Positions are 16-bit over the longest side of the bounding box (half a step is 8e-6 of it), texture coordinates 16-bit,
normals and tangents 8-bit (0.3 degrees). Extensions of glTF 2.0: KHR_mesh_quantization, EXT_texture_webp, and
KHR_materials_unlit for a texture that holds appearance, not material.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from exmesh_graph.export.gltf import COMPONENTS, KINDS, Blob, glb_bytes


def compact_glb(
    document: Mapping[str, Any],
    binary: bytes,
    *,
    unlit: bool = False,
    light: np.ndarray | None = None,
    eye: np.ndarray | None = None,
) -> bytes:
    """The bytes of a smaller .glb with the one mesh of `document` (what export.gltf writes).

    unlit  base colour is shown as it is; the other maps are left out
    light  float16 [h, w, 4] beside the mesh, named in the scene's `extras.light` with its width and height, since glTF
           has no lat-long environment
    eye    [3], a direction from which to look at first, in `extras.eye`
    """
    blob = Blob()
    (mesh,) = document["meshes"]
    (primitive,) = mesh["primitives"]
    arrays = {name: _array(document, binary, number) for name, number in primitive["attributes"].items()}
    low = arrays["POSITION"].min(axis=0).astype(np.float64)
    size = float((arrays["POSITION"] - low).max()) or 1.0
    codes = {"POSITION": _codes((arrays["POSITION"] - low) / size), "TEXCOORD_0": _codes(arrays["TEXCOORD_0"])}
    for name in ("NORMAL", *(["TANGENT"] if "TANGENT" in arrays and not unlit else [])):
        codes[name] = np.round(127 * arrays[name].astype(np.float64)).astype(np.int8)
    index = _array(document, binary, primitive["indices"])[:, 0]
    short = len(arrays["POSITION"]) <= 65535  # 65535 itself restarts a primitive
    indices = blob.accessor(index.astype(np.uint16 if short else np.uint32))
    attributes = {name: blob.accessor(array, bounds=name == "POSITION") for name, array in codes.items()}
    kept = 1 if unlit else len(document["images"])  # base colour comes first
    images = []
    for image in document["images"][:kept]:
        view = document["bufferViews"][image["bufferView"]]
        data = as_webp(_part(binary, view), lossless=True, quality=30)  # of effort: the same pixels in two thirds
        images.append({**image, "bufferView": blob.add(data), "mimeType": "image/webp"})
    extras: dict[str, Any] = {} if eye is None else {"eye": [float(x) for x in eye]}
    if light is not None:
        at = blob.add(np.ascontiguousarray(light, np.float16).tobytes())
        extras["light"] = {"bufferView": at, "width": light.shape[1], "height": light.shape[0]}
    needed = ["KHR_mesh_quantization", "EXT_texture_webp"]
    result = {
        **document,
        "extensionsUsed": needed + ["KHR_materials_unlit"] * unlit,
        "extensionsRequired": needed,
        "scenes": [{"nodes": [0], "extras": extras}],
        "nodes": [{**document["nodes"][0], "translation": low.tolist(), "scale": [size] * 3}],
        "meshes": [{**mesh, "primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "textures": [
            {"name": texture["name"], "sampler": 0, "extensions": {"EXT_texture_webp": {"source": texture["source"]}}}
            for texture in document["textures"][:kept]
        ],
        "images": images,
        "accessors": blob.accessors,
        "bufferViews": blob.views,
        "buffers": [{"byteLength": len(blob.data)}],
    }
    if unlit:
        base = document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
        result["materials"] = [
            {"name": "appearance", "pbrMetallicRoughness": {"baseColorTexture": base},
             "extensions": {"KHR_materials_unlit": {}}}
        ]  # fmt: skip
    return glb_bytes(result, bytes(blob.data))


def as_webp(png: bytes, **options: Any) -> bytes:
    """A picture as WebP; `options` are Pillow's."""
    from PIL import Image

    out = io.BytesIO()
    Image.open(io.BytesIO(png)).save(out, "WEBP", method=2, **options)
    return out.getvalue()


def _codes(unit: np.ndarray) -> np.ndarray:
    return np.round(np.clip(unit, 0, 1) * 65535.0).astype(np.uint16)


def _array(document: Mapping[str, Any], binary: bytes, number: int) -> np.ndarray:
    """[N, C] of an accessor as export.gltf writes them: float32 or uint32 without gaps."""
    entry = document["accessors"][number]
    kind = next(name for name, component in COMPONENTS.items() if component == entry["componentType"])
    data = _part(binary, document["bufferViews"][entry["bufferView"]])
    return np.frombuffer(data, kind).reshape(entry["count"], 1 + KINDS.index(entry["type"]))


def _part(binary: bytes, view: Mapping[str, Any]) -> bytes:
    return binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
