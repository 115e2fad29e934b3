"""From solids to one textured mesh: united without hidden surface, scaled, packed into one atlas, painted."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.scenes.shapes import Chart, Solid
from exmesh_graph.native import import_open3d

RADIUS = 1.2
#: Texels left between charts.
GUTTER = 4

#: (points [N, 3] in the object's own lengths, normals [N, 3], solid's name [N]) -> (base colour [N, 3] linear,
#: roughness [N], metallic [N])
Painter = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Model:
    """vertices, normals float32 [V, 3]; uv float32 [V, 2], v up; faces int32 [F, 3], counter-clockwise from outside.

    base uint8 [S, S, 3] sRGB, roughness, metallic uint8 [S, S]: row 0 is v = 1, texel centres at half integers;
    object uint8 [S, S]: 255 on the object, 0 on its ground."""

    vertices: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    faces: np.ndarray
    base: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    object: np.ndarray

    def of_object(self) -> np.ndarray:
        """Rows of `faces` that belong to the object."""
        size = len(self.object)
        middle = self.uv[self.faces].mean(1)
        column = np.clip((middle[:, 0] * size).astype(int), 0, size - 1)
        return np.flatnonzero(self.object[np.clip(((1 - middle[:, 1]) * size).astype(int), 0, size - 1), column] > 127)


def assemble(solids: Sequence[Solid], painter: Painter, size: int, ground: Sequence[str] = ()) -> Model:
    """Unite the solids, scale them into the sphere of RADIUS about the origin, paint `size` x `size` texels."""
    charts = [chart for solid in solids for chart in solid.charts]
    boxes = np.array([chart.flat.max(0) - chart.flat.min(0) for chart in charts])
    corners, scale = pack(boxes, size)
    owner = np.full((size, size), -1)
    placed, number = [], 0
    names = np.array([solid.name for solid in solids])
    for which, solid in enumerate(solids):
        mine = []
        for chart in solid.charts:
            low = corners[number]
            wide, high = np.ceil(boxes[number] * scale).astype(int) + GUTTER
            owner[low[1] : low[1] + high, low[0] : low[0] + wide] = which
            flat = (chart.flat - chart.flat.min(0)) * scale + low + GUTTER / 2
            mine.append(replace(chart, flat=flat / size))
            number += 1
        placed.append(_joined(mine))
    points, normals, uv, faces = _united(placed)
    middle = (points.min(0) + points.max(0)) / 2
    grow = RADIUS / np.linalg.norm(points - middle, axis=1).max()
    texel, face, bary = texels(uv, faces, size)
    where = (points[faces[face]] * bary[..., None]).sum(1)
    facing = (normals[faces[face]] * bary[..., None]).sum(1)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True).clip(1e-9)
    part = names[owner.reshape(-1)[texel]]
    base, rough, metal = painter(where, facing, part)
    maps = np.zeros((size * size, 6))
    maps[texel, :3] = encode(np.broadcast_to(base, (len(texel), 3)))
    maps[texel, 3], maps[texel, 4], maps[texel, 5] = rough, metal, ~np.isin(part, ground)
    maps = np.round(255 * np.clip(spread(maps, texel, size), 0, 1)).astype(np.uint8)[::-1]
    base, rough, metal, own = (np.ascontiguousarray(maps[..., k]) for k in (slice(3), 3, 4, 5))
    vertices, normals, uv = (np.round(a, 6).astype(np.float32) for a in ((points - middle) * grow, normals, uv))
    return Model(vertices, normals, uv, faces.astype(np.int32), base, rough, metal, own)


def pack(boxes: np.ndarray, size: int) -> tuple[np.ndarray, float]:
    """Lower left texels [N, 2] of boxes [N, 2], in shelves, and the largest scale (texels per length) that fits."""

    def shelves(scale: float) -> np.ndarray | None:
        wanted = np.ceil(boxes * scale).astype(int) + GUTTER
        corners, x, y, tall = np.zeros((len(boxes), 2), int), 0, 0, 0
        for k in np.argsort(-wanted[:, 1], kind="stable"):
            if x + wanted[k, 0] > size:
                x, y, tall = 0, y + tall, 0
            if wanted[k, 0] > size or y + wanted[k, 1] > size:
                return None
            corners[k] = x, y
            x, tall = x + wanted[k, 0], max(tall, wanted[k, 1])
        return corners

    low, high = 0.0, size / math.sqrt(boxes.prod(1).sum())
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if shelves(middle) is not None else (low, middle)
    corners = shelves(low)
    assert corners is not None, "even empty boxes do not fit"
    return corners, low


def _joined(charts: Sequence[Chart]) -> tuple[np.ndarray, np.ndarray]:
    """(rows [N, 8] of position, uv, normal; faces [M, 3]) of all charts."""
    rows, faces, count = [], [], 0
    for chart in charts:
        rows.append(np.concatenate([chart.points, chart.flat, chart.normals], axis=1))
        faces.append(chart.faces + count)
        count += len(chart.points)
    return np.concatenate(rows), np.concatenate(faces)


def _united(placed: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, ...]:
    """(points, normals, uv, faces) of the union's outer surface: texture coordinates and normals go with it."""
    import manifold3d

    solids = []
    for rows, faces in placed:
        place = np.round(rows[:, :3], 5)
        _, first, back = np.unique(place, axis=0, return_index=True, return_inverse=True)
        target = first[back.reshape(-1)]
        doubled = np.flatnonzero(target != np.arange(len(rows)))
        rows = np.concatenate([rows[target, :3], rows[:, 3:]], axis=1)
        mesh = manifold3d.Mesh(
            rows.astype(np.float32),
            faces.astype(np.uint32),
            doubled.astype(np.uint32),
            target[doubled].astype(np.uint32),
        )
        solid = manifold3d.Manifold(mesh)
        if solid.status() != manifold3d.Error.NoError:
            raise ValueError(f"a solid of {len(faces)} faces is not closed: {solid.status()}")
        solids.append(solid)
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add).to_mesh()
    rows, faces = np.asarray(whole.vert_properties, np.float64), np.asarray(whole.tri_verts, np.int64)
    normals = rows[:, 5:] / np.linalg.norm(rows[:, 5:], axis=1, keepdims=True).clip(1e-9)
    return rows[:, :3], normals, rows[:, 3:5], faces


def texels(uv: np.ndarray, faces: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The texels whose centres lie under a face: (texel [N] flat, row 0 at v = 0; face [N]; barycentrics [N, 3])."""
    o3d = import_open3d()
    flat = np.concatenate([uv * size, np.zeros((len(uv), 1))], axis=1).astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(flat), o3d.core.Tensor(faces.astype(np.uint32)))
    x, y = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    rays = np.zeros((size * size, 6), np.float32)
    rays[:, 0], rays[:, 1], rays[:, 2], rays[:, 5] = x.ravel(), y.ravel(), 1, -1
    found = scene.cast_rays(o3d.core.Tensor(rays))
    hit = np.flatnonzero(np.isfinite(found["t_hit"].numpy()))
    bary = found["primitive_uvs"].numpy()[hit]
    bary = np.concatenate([1 - bary.sum(1, keepdims=True), bary], axis=1)
    return hit, found["primitive_ids"].numpy()[hit].astype(np.int64), bary


def spread(maps: np.ndarray, texel: np.ndarray, size: int) -> np.ndarray:
    """Maps [S * S, C] as [S, S, C]; texels that no face covers take the nearest one's value."""
    from scipy.ndimage import distance_transform_edt

    empty = np.ones(size * size, bool)
    empty[texel] = False
    row, column = distance_transform_edt(empty.reshape(size, size), return_distances=False, return_indices=True)
    return maps.reshape(size, size, -1)[row, column]


def encode(linear: np.ndarray) -> np.ndarray:
    """sRGB of linear values (IEC 61966-2-1)."""
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def decode(srgb: np.ndarray) -> np.ndarray:
    """Linear values of sRGB."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
