"""Closed solids out of charts: tubes, turned bodies, rounded boxes, leaves, and level sets of a distance.

A chart is a patch of surface with smooth normals and texture coordinates in units of length; a solid is the charts that
close it. All lengths are the object's own; `model.assemble` unites the solids and scales the whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from exmesh_graph.native import import_open3d


@dataclass(frozen=True)
class Chart:
    """points, normals float64 [N, 3]; flat [N, 2], the patch laid flat, in lengths; faces int [M, 3], seen from outside
    counter-clockwise."""

    points: np.ndarray
    normals: np.ndarray
    flat: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class Solid:
    """A closed surface; `name` is what the painter knows it by."""

    name: str
    charts: tuple[Chart, ...]

    def moved(self, shift: Sequence[float] = (0, 0, 0), turn: np.ndarray | None = None, name: str = "") -> Solid:
        """Turned by the rotation [3, 3], then shifted."""
        matrix = np.eye(3) if turn is None else turn
        charts = (
            replace(c, points=c.points @ matrix.T + np.asarray(shift, float), normals=c.normals @ matrix.T)
            for c in self.charts
        )
        return Solid(name or self.name, tuple(charts))

    def scaled(self, size: float) -> Solid:
        """So many times as large about the origin."""
        charts = (replace(c, points=c.points * size, flat=c.flat * size) for c in self.charts)
        return Solid(self.name, tuple(charts))


def grid(points: np.ndarray, normals: np.ndarray) -> Chart:
    """The chart of points [A, B, 3] with normals [A, B, 3], laid flat by its mean lengths along either axis."""
    rows, columns = points.shape[:2]
    along = [np.linalg.norm(np.diff(points, axis=axis), axis=-1) for axis in (0, 1)]
    down = np.concatenate([[0], np.cumsum(along[0].max(1))])
    across = np.concatenate([[0], np.cumsum(along[1].max(0))])
    flat = np.stack(np.meshgrid(across, down), axis=-1)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return _outward(Chart(points.reshape(-1, 3), normals.reshape(-1, 3), flat.reshape(-1, 2), faces))


def _outward(chart: Chart) -> Chart:
    """Without degenerate faces, the rest turned with the normals."""
    corners = np.round(chart.points, 7)[chart.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces = chart.faces[np.linalg.norm(across, axis=1) > 1e-12]
    side = (across * chart.normals[chart.faces].mean(1)).sum()
    return replace(chart, faces=faces if side > 0 else faces[:, ::-1])


def tube(name: str, path: np.ndarray, radius: float | np.ndarray, *, sides: int = 14, closed: bool = False) -> Solid:
    """A round rod along points [N, 3]; open ones end in flat discs, `closed` ones in themselves."""
    path = np.asarray(path, float)
    radii = np.broadcast_to(np.asarray(radius, float), (len(path),))
    if closed:
        path, radii = np.concatenate([path, path[:1]]), np.concatenate([radii, radii[:1]])
    tangent = np.gradient(path, axis=0)
    if closed:
        tangent[0] = tangent[-1] = path[1] - path[-2]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    first, second = _frames(tangent, closed)
    angle = np.linspace(0, 2 * np.pi, sides + 1)[None, :, None]
    outward = np.cos(angle) * first[:, None] + np.sin(angle) * second[:, None]
    outward[:, -1] = outward[:, 0]
    body = grid(path[:, None] + radii[:, None, None] * outward, outward)
    if closed:
        return Solid(name, (body,))
    ends = (_disc(path[k] + radii[k] * outward[k], path[k], sign * tangent[k]) for k, sign in ((0, -1), (-1, 1)))
    return Solid(name, (body, *ends))


def rod(name: str, start: Sequence[float], end: Sequence[float], radius: float, *, sides: int = 14) -> Solid:
    """A straight rod with flat ends."""
    path = np.linspace(np.asarray(start, float), np.asarray(end, float), 9)
    return tube(name, path, radius, sides=sides)


def _frames(tangent: np.ndarray, closed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Two directions across each tangent, turning as little as possible; a closed path's ends meet."""
    start = np.cross(tangent[0], np.eye(3)[np.abs(tangent[0]).argmin()])
    across = [start / np.linalg.norm(start)]
    for here in tangent[1:]:
        level = across[-1] - (across[-1] @ here) * here
        across.append(level / np.linalg.norm(level))
    first = np.array(across)
    second = np.cross(tangent, first)
    if closed:
        missing = math.atan2(-(first[0] @ second[-1]), first[0] @ first[-1])
        angle = -np.linspace(0, missing, len(tangent))[:, None]
        first, second = np.cos(angle) * first + np.sin(angle) * second, np.cos(angle) * second - np.sin(angle) * first
        first[-1], second[-1] = first[0], second[0]
    return first, second


def _disc(rim: np.ndarray, middle: np.ndarray, normal: np.ndarray) -> Chart:
    """The flat disc within a rim [N, 3] whose last point is its first."""
    points = np.concatenate([rim, [middle]])
    right = rim[0] - middle
    right /= max(np.linalg.norm(right), 1e-12)
    flat = (points - middle) @ np.stack([right, np.cross(normal, right)], axis=1)
    around = np.arange(len(rim) - 1)
    faces = np.stack([around, around + 1, np.full_like(around, len(rim))], axis=1)
    return _outward(Chart(points, np.broadcast_to(normal, points.shape).copy(), flat - flat.min(0), faces))


def turned(name: str, *profiles: Sequence[tuple[float, float]], sides: int = 72) -> Solid:
    """A body turned about z: stretches of (radius, height), one after another from the axis to the axis with the
    outside on the right (outwards below, then up, then inwards). Each stretch is smooth, edges lie between them."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    round_ = np.stack([np.cos(angle), np.sin(angle)], -1)
    round_[-1] = round_[0]
    charts = []
    for profile in profiles:
        line = np.asarray(profile, float)
        slope = np.gradient(line, axis=0)
        slope /= np.linalg.norm(slope, axis=1, keepdims=True)
        points = np.concatenate(
            [line[:, None, :1] * round_, np.broadcast_to(line[:, None, 1:], (len(line), sides + 1, 1))], -1
        )
        normals = np.concatenate(
            [slope[:, None, 1:] * round_, np.broadcast_to(-slope[:, None, :1], (len(line), sides + 1, 1))], -1
        )
        charts.append(grid(points, normals))
    return Solid(name, tuple(charts))


def smooth(*points: tuple[float, float], count: int = 24) -> list[tuple[float, float]]:
    """A smooth stretch of a profile through the points (a monotone curve by the length of its polygon)."""
    from scipy.interpolate import PchipInterpolator

    line = np.asarray(points, float)
    where = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return [tuple(p) for p in PchipInterpolator(where, line)(np.linspace(0, where[-1], count))]


def ball(name: str, middle: Sequence[float], radii: Sequence[float], *, sides: int = 40) -> Solid:
    """An ellipsoid."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)
    unit = turned(name, list(zip(np.cos(angle).clip(0), np.sin(angle), strict=True)), sides=sides)
    chart, scale = unit.charts[0], np.asarray(radii, float)
    normals = chart.normals / scale
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mean = float(np.mean(scale))
    return Solid(name, (Chart(chart.points * scale + middle, normals, chart.flat * mean, chart.faces),))


def box(name: str, half: Sequence[float], edge: float = 0.02, *, steps: int = 4) -> Solid:
    """A box of half sizes `half` about the origin, its edges rounded by the radius `edge`."""
    half = np.asarray(half, float)
    inner = half - edge
    charts = []
    for axis in range(3):
        across = [(axis + 1) % 3, (axis + 2) % 3]
        lines = []
        for k in across:
            bend = inner[k] + edge * np.tan(np.linspace(0, np.pi / 4, steps + 1))
            lines.append(np.concatenate([-bend[::-1], bend]))
        for sign in (-1, 1):
            outer = np.zeros((len(lines[0]), len(lines[1]), 3))
            outer[..., axis] = sign * half[axis]
            outer[..., across[0]], outer[..., across[1]] = np.meshgrid(*lines, indexing="ij")
            near = np.clip(outer, -inner, inner)
            normals = outer - near
            normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
            charts.append(grid(near + edge * normals, normals))
    return Solid(name, tuple(charts))


def leaf(name: str, length: float, width: float, thick: float, bend: float) -> Solid:
    """A pointed leaf from the origin along +x, its upper side to +z, bent down by `bend` radians at the tip."""
    along, across = np.linspace(0, 1, 17), np.linspace(-1, 1, 9)
    outline = width * np.sin(np.pi * along**0.8) ** 0.9 + 1e-4
    outline[[0, -1]] = 0
    s, t = np.meshgrid(along, across, indexing="ij")
    angle = bend * s
    x = length * np.where(abs(bend) > 1e-6, np.sin(angle) / (bend or 1), s)
    z = -length * np.where(abs(bend) > 1e-6, (1 - np.cos(angle)) / (bend or 1), 0) + 0.25 * width * t**2
    middle = np.stack([x, outline[:, None] * t, z], -1)
    du, dv = np.gradient(middle, axis=0), np.gradient(middle, axis=1)
    up = np.cross(du, dv)
    length_of = np.linalg.norm(up, axis=-1, keepdims=True)
    up = np.where(length_of > 1e-9, up / np.maximum(length_of, 1e-9), [0.0, 0.0, 1.0])
    swell = (thick * np.sqrt(np.clip(1 - t**2, 0, 1)) * np.sqrt(np.clip(1 - (2 * s - 1) ** 2, 0, 1)))[..., None]
    return Solid(name, (grid(middle + swell * up, up), grid(middle - swell * up, -up)))


def level_set(
    name: str, distance: Callable[[np.ndarray], np.ndarray], reach: float, *, cells: int = 160, faces: int = 30000
) -> Solid:
    """The surface where `distance` is 0, within +- reach, by marching cubes, decimated, in charts."""
    import xatlas
    from skimage.measure import marching_cubes

    o3d = import_open3d()
    axis = np.linspace(-reach, reach, cells, dtype=np.float32)
    values = np.stack([distance(np.stack(np.broadcast_arrays(x, axis[:, None], axis[None]), -1)) for x in axis])
    points, triangles, _, _ = marching_cubes(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(-reach + points.astype(float) * (axis[1] - axis[0])),
        o3d.utility.Vector3iVector(triangles.astype(np.int32)),
    )
    if len(triangles) > faces:
        mesh = mesh.simplify_quadric_decimation(faces)
    points, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    atlas, options = xatlas.Atlas(), xatlas.PackOptions()
    options.padding, options.resolution = 4, 1024
    atlas.add_mesh(points.astype(np.float32), triangles.astype(np.uint32))
    atlas.generate(pack_options=options)
    source, triangles, flat = atlas[0]
    points, triangles = points[source], triangles.astype(np.int64)
    step = 0.5 * (axis[1] - axis[0])
    normals = np.stack([distance(points + step * unit) - distance(points - step * unit) for unit in np.eye(3)], axis=-1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-9)
    corner, spread = points[triangles], flat[triangles].astype(float)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum()
    edge1, edge2 = spread[:, 1] - spread[:, 0], spread[:, 2] - spread[:, 0]
    laid = np.abs(edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0]).sum()
    return Solid(name, (Chart(points, normals, flat.astype(float) * math.sqrt(area / laid), triangles),))


def turn(axis: int, degrees: float) -> np.ndarray:
    """Rotation [3, 3] about x, y or z (0, 1, 2), counter-clockwise seen from the axis' tip."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def blend(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Union of two distances, rounded over `width`."""
    near = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - near**2 * width / 4


def carve(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """`a` without `b`, the edge rounded over `width`."""
    return -blend(-a, b, width)


def ellipsoid(p: np.ndarray, middle: Sequence[float], radii: Sequence[float]) -> np.ndarray:
    """About the signed distance of points [..., 3] to an ellipsoid."""
    scaled = np.linalg.norm((p - np.asarray(middle)) / np.asarray(radii), axis=-1)
    return (scaled - 1) * min(radii)


def capsule(p: np.ndarray, start: Sequence[float], end: Sequence[float], radius: float) -> np.ndarray:
    """Signed distance of points [..., 3] to a rod with round ends."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    share = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(p - a - share[..., None] * (b - a), axis=-1) - radius


def block(p: np.ndarray, middle: Sequence[float], half: Sequence[float], edge: float) -> np.ndarray:
    """Signed distance of points [..., 3] to a box whose edges are rounded by `edge`."""
    q = np.abs(p - np.asarray(middle)) - (np.asarray(half) - edge)
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0) - edge
