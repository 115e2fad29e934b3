"""Coarser levels of detail: fewer faces on the same atlas, the fine mesh's normals baked, smaller maps.

The atlas stays, so the maps do; a texel's normal is that of the fine mesh at the same texture coordinate (with its
normal map, if any), written in the coarse mesh's tangent frame (MikkTSpace: frames interpolated, not normalised).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.adjacency import angle_weighted_normals, signed_areas_2d
from exmesh_graph.geometry.decimate import decimate
from exmesh_graph.geometry.tangents import corner_tangents
from exmesh_graph.types import Asset, Views

_MARGIN = 1.5  # texels around charts that bilinear lookups read
_LOWEST = 0.1  # least z of a baked normal: a coarse face may look away from the fine surface


def reduced(asset: Asset, faces: int, texture_size: int = 0) -> Asset:
    """`asset` with about `faces` faces, the fine normals baked, and maps of `texture_size` (0: as they are).

    The mesh keeps more faces where seams do not let it lose them; look at the result.
    """
    coarse = decimate(asset.vertices, asset.faces, asset.uvs, asset.uv_faces, faces)
    result = replace(asset, vertices=coarse.vertices, faces=coarse.faces, uvs=coarse.uvs, uv_faces=coarse.uv_faces)
    if coarse.count:
        result = replace(result, normal=baked_normals(asset, result))
    return resized(result, texture_size) if texture_size else result


def baked_normals(fine: Asset, coarse: Asset) -> np.ndarray:
    """float32 [R, R, 3]: the fine surface's normals in the tangent frames of the coarse one on the same atlas.

    (0, 0, 1) where the coarse atlas has no chart.
    """
    size = fine.base_color.shape[0]
    world, seen = _fine_normals(fine, size)
    (tangent, bitangent, normal), inside = _frames(coarse, size)
    # n ~ x T + y B + z N with frames that are not orthonormal: solve, then normalise
    frame = np.stack([tangent, bitangent, normal], axis=-1)[inside]
    vector = np.linalg.solve(frame, world[inside][..., None])[..., 0]
    vector[:, 2] = np.maximum(vector[:, 2], _LOWEST * np.linalg.norm(vector[:, :2], axis=1))
    vector[~seen[inside]] = [0, 0, 1]
    vector /= np.maximum(np.linalg.norm(vector, axis=1, keepdims=True), 1e-12)
    result = np.tile(np.array([0, 0, 1.0], np.float32), (size, size, 1))
    result[inside] = vector
    return result


def resized(asset: Asset, size: int) -> Asset:
    """All maps at `size` x `size`: means of the texels that lie in charts, so that what lies between does not bleed in.

    Raises DataError for a size that does not divide the maps' own.
    """
    from exmesh_graph.uv.raster import coverage_counts

    old = asset.base_color.shape[0]
    if size < 1 or old % size or asset.base_color.shape[1] != old:
        raise DataError(
            f"maps of {old} texels cannot be reduced to {size}", where="texture_size", expected=f"a divisor of {old}"
        )
    if size == old:
        return asset
    weight = ((coverage_counts(asset.uvs, asset.uv_faces, old) > 0) | asset.seen).astype(np.float32)

    def blocks(layers: np.ndarray) -> np.ndarray:
        return layers.reshape(size, old // size, size, old // size, -1).sum(axis=(1, 3))

    total = blocks(weight)

    def mean(texture: np.ndarray) -> np.ndarray:
        layers = texture.reshape(old, old, -1).astype(np.float32)
        plain = blocks(layers) / (old // size) ** 2
        inside = blocks(layers * weight[..., None]) / np.maximum(total, 1)
        return np.where(total > 0, inside, plain).reshape(size, size, *texture.shape[2:]).astype(np.float32)

    given = {name: getattr(asset, name) for name in ("base_color", "roughness", "metallic", "confidence", "normal")}
    maps = {name: mean(texture) for name, texture in given.items() if texture is not None}
    if "normal" in maps:
        maps["normal"] /= np.maximum(np.linalg.norm(maps["normal"], axis=-1, keepdims=True), 1e-12)
    return replace(asset, **maps, seen=blocks(asset.seen.astype(np.float32))[..., 0] > 0)


def footprint_size(asset: Asset, views: Views, percentile: float = 95.0) -> int:
    """The power of two at which a texel is no larger than a pixel for `percentile` of the surface, in its closest view.

    Faces that look away or lie behind a camera do not count; occlusion is not looked at. At most the maps' own size.
    """
    corner = asset.vertices.astype(np.float64)[asset.faces]
    chart = 2 * np.abs(signed_areas_2d(asset.uvs, asset.uv_faces))
    largest = np.zeros(len(corner))  # pixels of a face in the view that shows it largest
    for intrinsics, pose in zip(views.intrinsics, views.world_to_camera, strict=True):
        seen = (corner @ pose[:3, :3].T + pose[:3, 3]) @ intrinsics.T
        depth = seen[..., 2]
        pixel = seen[..., :2] / np.maximum(depth, 1e-9)[..., None]
        e, f = pixel[:, 1] - pixel[:, 0], pixel[:, 2] - pixel[:, 0]
        area = np.where((depth > 0).all(axis=1), f[:, 0] * e[:, 1] - f[:, 1] * e[:, 0], 0)  # y down: front is positive
        largest = np.maximum(largest, area)
    good = (chart > 0) & (largest > 0)
    if not good.any():
        raise DataError("no view sees a face of the asset", where="views", fix="wire in views of this asset")
    side = np.sqrt(largest[good] / chart[good])
    order = np.argsort(side)
    share = np.cumsum(largest[good][order]) / largest[good].sum()
    needed = side[order][min(np.searchsorted(share, percentile / 100), len(order) - 1)]
    return int(min(2 ** int(np.ceil(np.log2(max(needed, 1)))), max(asset.base_color.shape[:2])))


def _frames(asset: Asset, size: int) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """((T, B, N) float64 [R, R, 3] each, inside): interpolated over the faces, not normalised."""
    from exmesh_graph.uv.raster import rasterize_atlas

    faces, weights = rasterize_atlas(asset.uvs, asset.uv_faces, size, margin=_MARGIN)
    inside = faces >= 0
    face, bary = faces[inside], weights[inside].astype(np.float64)
    tangents, sign = corner_tangents(asset.vertices, asset.faces, asset.uvs, asset.uv_faces)
    normals = angle_weighted_normals(asset.vertices, asset.faces)[asset.faces]
    tangent = np.einsum("nk,nkx->nx", bary, tangents[face].astype(np.float64))
    normal = np.einsum("nk,nkx->nx", bary, normals[face].astype(np.float64))
    bitangent = sign[face][:, None] * np.cross(normal, tangent)
    grid = [np.zeros((size, size, 3)) for _ in range(3)]
    for target, value in zip(grid, (tangent, bitangent, normal), strict=True):
        target[inside] = value
    return (grid[0], grid[1], grid[2]), inside


def _fine_normals(asset: Asset, size: int) -> tuple[np.ndarray, np.ndarray]:
    """(world normals float64 [R, R, 3], inside) of the mesh bent by its normal map."""
    (tangent, bitangent, normal), inside = _frames(asset, size)
    if asset.normal is None:
        return normal, inside
    bent = asset.normal.astype(np.float64)
    return bent[..., :1] * tangent + bent[..., 1:2] * bitangent + bent[..., 2:] * normal, inside
