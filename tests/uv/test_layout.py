"""Charts: outlines against rasterised faces, stretch against singular values, flat layouts of developable surfaces."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.meshes import grid
from exmesh_graph.geometry.adjacency import components, face_areas, face_normals
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.types.edges import edges_of
from exmesh_graph.uv.charts import partition
from exmesh_graph.uv.flatten import flat_corners, flatten, stretches
from exmesh_graph.uv.layout import _overlaps, lay_out
from exmesh_graph.uv.marks import near, winding


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 12))
def test_winding_and_distance_against_brute_force(seed, corners):
    """A random polygon: even-odd crossings counted with sign, and distances to every edge, centre by centre."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-3, 23, corners), rng.uniform(-3, 18, corners)
    u, v = np.roll(x, -1), np.roll(y, -1)
    got, close = winding(x, y, u, v, (15, 20)), near(x, y, u, v, (15, 20), 1.3)
    for i in range(15):
        for j in range(20):
            around = np.arctan2(v - i, u - j) - np.arctan2(y - i, x - j)
            around = (around + np.pi) % (2 * np.pi) - np.pi
            assert got[i, j] == -round(around.sum() / (2 * np.pi)) or np.isclose(abs(around), np.pi).any()
            t = np.clip(((j - x) * (u - x) + (i - y) * (v - y)) / ((u - x) ** 2 + (v - y) ** 2), 0, 1)
            distance = np.hypot(j - x - t * (u - x), i - y - t * (v - y)).min()
            assert close[i, j] == (distance <= 1.3) or np.isclose(distance, 1.3)


def test_stretches_are_singular_values():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(30, 3))
    faces = np.arange(30).reshape(10, 3)
    shape = flat_corners(points, faces)
    flat = rng.normal(size=30) + 1j * rng.normal(size=30)
    low, high = stretches(shape, faces, flat)
    for f in range(10):
        p = np.array([[z.real, z.imag] for z in shape[f, 1:] - shape[f, 0]]).T
        q = np.array([[z.real, z.imag] for z in flat[faces[f, 1:]] - flat[faces[f, 0]]]).T
        jacobian = q @ np.linalg.inv(p)
        want = np.linalg.svd(jacobian)[1]
        np.testing.assert_allclose([high[f], abs(low[f])], want, rtol=1e-9)
        assert (low[f] > 0) == (np.linalg.det(jacobian) > 0)
    space = np.linalg.norm(points[faces] - np.roll(points[faces], -1, axis=1), axis=2)
    np.testing.assert_allclose(np.abs(shape - np.roll(shape, -1, axis=1)), space)


def test_a_rolled_up_sheet_is_laid_out_as_it_was():
    vertices, faces = grid(30, 8)
    x, z = vertices[:, 0].astype(np.float64), vertices[:, 2].astype(np.float64)
    radius = np.ptp(x) / np.pi  # half a turn
    points = np.stack([radius * np.sin(x / radius), z, radius * np.cos(x / radius)], axis=1)
    start = z + 1j * x * (0.6 + 0.4 * x)
    shape = flat_corners(points, faces)
    low, high = stretches(shape, faces, flatten(shape, faces, len(points), start, rounds=60))
    assert low.min() > 0.995
    assert high.max() < 1.005


def test_thin_parts_are_laid_out_in_few_strips(monkeypatch):
    """Rods six faces around and thin blades, their vertices a little off, in patches of 27 faces as large meshes have
    them, which lie all around a rod. Taking failed charts apart alone left 64."""
    monkeypatch.setattr("exmesh_graph.uv.patches._PATCHES", 200)
    points, faces = _thin_parts(np.random.default_rng(5))
    flat, corners = lay_out(points, faces, 0.45)
    chart = components(corners)
    assert chart.max() < 36
    low, _ = stretches(flat_corners(points, faces), corners, flat[:, 0] + 1j * flat[:, 1])
    assert (low <= 1e-3).mean() < 0.005
    for k in range(int(chart.max()) + 1):
        own = edges_of(np.unique(corners[chart == k], return_inverse=True)[1].reshape(-1, 3))
        euler = len(np.unique(corners[chart == k])) - len(own.vertices) + int((chart == k).sum())
        assert euler == 1
    assert (_overlaps(flat[:, 0] + 1j * flat[:, 1], corners, chart, int(chart.max()) + 1, float(len(faces))) <= 2).all()


def _thin_parts(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two rods and two blades side by side, closed; a mean face area of 1."""
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    for k in range(4):
        sides, rings = (6, 60) if k < 2 else (24, 40)
        angle = 2 * np.pi * np.arange(sides) / sides
        wide, thick = (1.0, 1.0) if k < 2 else (5.0, 0.15)
        ring = np.stack([wide * np.cos(angle), thick * np.sin(angle)], axis=1)
        body = np.concatenate([np.column_stack([ring, np.full(sides, float(h))]) for h in range(rings)])
        ends = np.array([[0.0, 0.0, -0.5], [0.0, 0.0, rings - 0.5]])
        a = (np.arange(sides)[None] + sides * np.arange(rings - 1)[:, None]).reshape(-1)
        b = (np.roll(np.arange(sides), -1)[None] + sides * np.arange(rings - 1)[:, None]).reshape(-1)
        near, last = np.arange(sides), sides * (rings - 1)
        faces = np.concatenate([
            np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1),
            np.stack([np.full(sides, len(body)), np.roll(near, -1), near], 1),
            np.stack([np.full(sides, len(body) + 1), near + last, np.roll(near, -1) + last], 1),
        ])  # fmt: skip
        points = np.concatenate([body, ends]) + np.array([12.0 * k, 0, 0])
        parts.append((points + rng.normal(0, 0.1 if k < 2 else 0.02, points.shape), faces))
    starts = np.cumsum([0] + [len(points) for points, _ in parts[:-1]])
    points = np.concatenate([points for points, _ in parts])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=True)])
    return points * np.sqrt(len(faces) / face_areas(points, faces).sum()), faces


def test_regions_cover_the_mesh_bend_little_and_can_be_halved_to_single_faces():
    vertices, faces = icosphere(3)
    points, edges = vertices.astype(np.float64) * 20, edges_of(faces)
    parts = partition(points, faces, edges, 0.2)
    regions = parts.regions()
    assert set(regions) == set(range(len(parts.roots)))
    assert 9 <= len(parts.roots) <= 24  # a cap that bends by 0.2 is a ninth of the sphere
    normals = face_normals(points, faces)
    for k in range(len(parts.roots)):
        inside = regions == k
        assert components(faces[inside]).max() == 0
        assert 1 - np.linalg.norm(normals[inside].mean(axis=0)) ** 2 < 0.25
    centres = points[faces].mean(axis=1)
    for _ in range(12):
        sizes = np.bincount(parts.regions(), minlength=len(parts.roots))
        assert sizes.sum() == len(faces)
        parts.roots = [
            half
            for k, root in enumerate(parts.roots)
            for half in ([root] if sizes[k] == 1 else parts.halves(root, centres))
        ]
    assert len(parts.roots) == len(faces)


def test_cuts_lie_on_the_creases_of_a_cube():
    n = 10
    vertices, faces = [], []
    for axis in range(3):
        for side in (-1, 1):
            sheet, f = grid(n, n)
            sheet = 2 * sheet[:, [2, 0]] - 1
            points = np.roll(np.stack([side * sheet[:, 0], sheet[:, 1], np.full(len(sheet), side)], axis=1), axis, 1)
            faces.append(f + sum(map(len, vertices)))
            vertices.append(points)
    points, faces = np.concatenate(vertices), np.concatenate(faces)
    _, first, join = np.unique(np.round(points, 6), axis=0, return_index=True, return_inverse=True)
    points, faces = points[first], join.reshape(-1)[faces]
    scaled = points * np.sqrt(len(faces) / 24)
    _, corners = lay_out(scaled, faces, 0.1)
    chart = components(corners)
    assert chart.max() == 5
    normals = np.round(face_normals(points, faces))
    inside = 0
    for k in range(6):
        inside += np.unique(normals[chart == k], axis=0, return_counts=True)[1].max()
    assert inside >= 0.99 * len(faces)  # all but some at the cube's corners


def test_a_spiral_that_lies_over_itself_is_seen():
    # a strip that turns by more than a full circle without folding
    angle = np.linspace(0, 2.4 * np.pi, 60)
    flat = np.concatenate([3 * np.exp(1j * angle), 4 * np.exp(1j * angle)])
    i = np.arange(59)
    faces = np.concatenate([np.stack([i, 60 + i, i + 1], 1), np.stack([i + 1, 60 + i, 61 + i], 1)])
    chart = np.zeros(len(faces), np.int64)
    assert _overlaps(flat, faces, chart, 1, 20.0)[0] > 100
    half = faces[(i % 59 < 25)[np.r_[i, i]]]
    assert _overlaps(flat, half, chart[: len(half)], 1, 20.0)[0] == 0
