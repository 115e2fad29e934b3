"""The cost of planes and one half-iteration in plain numpy, float64, a pixel at a time: what the kernel is held to.

Formulas stand here once more, without vectors, layouts and linear windows' bookkeeping. Slow: for small pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exmesh_graph.priors.patch_match.propagate import TILT

WORST, FLAT = 2.0, 0.5  # a hypothesis refuted; a variance, in grey levels squared, that says nothing
_SPREAD = 0.12 * 255 * np.sqrt(2)
_REACH = (
    ((0, -1), (-1, -2), (1, -2), (0, -3), (0, -5)), ((0, 1), (-1, 2), (1, 2), (0, 3), (0, 5)),
    ((-1, 0), (-2, -1), (-2, 1), (-3, 0), (-5, 0)), ((1, 0), (2, -1), (2, 1), (3, 0), (5, 0)),
)  # fmt: skip


@dataclass(frozen=True)
class Scene:
    """Grey levels 0 to 255 float64 [N, H, W] (whole numbers in the sources), inside bool [N, H, W], and of `sources`
    matrices [N, S, 24], chosen [N, S] and bounds [N, 4]; best, radius and step as in `propagate.Comparison`.

    found [N, 3, H, W], weight and far: of the geometric term; weight 0: none.
    """

    grey: np.ndarray
    inside: np.ndarray
    matrices: np.ndarray
    chosen: np.ndarray
    bounds: np.ndarray
    best: int
    radius: int
    step: int
    found: np.ndarray | None = None
    weight: float = 0.0
    far: float = 3.0


def plane_cost(scene: Scene, view: int, column: int, row: int, plane: Sequence[float]) -> float:
    """Mean of the `best` least costs of a plane (w, du, dv) at a pixel of `view`; WORST for what no source shows."""
    costs = sorted(
        source_cost(scene, view, slot, column, row, plane)
        for slot in range(scene.chosen.shape[1])
        if scene.chosen[view, slot] >= 0
    )[: scene.best]
    return float(np.mean(costs + [WORST] * (scene.best - len(costs))))


def source_cost(scene: Scene, view: int, slot: int, column: int, row: int, plane: Sequence[float]) -> float:
    """1 - correlation of the window with its image in one source, and the geometric term."""
    source, m = int(scene.chosen[view, slot]), scene.matrices[view, slot].astype(float)
    height, width = scene.grey.shape[1:]
    w, du, dv = (float(value) for value in plane)
    forth, shift = m[:9].reshape(3, 3), m[9:12]
    x, y = column + 0.5, row + 0.5
    point = forth @ (x, y, 1.0) + shift * w
    refuted = WORST + scene.weight * scene.far
    if point[2] <= 1e-6:
        return refuted
    at = point[:2] / point[2]
    if not (0 < at[0] < width and 0 < at[1] < height) or not scene.inside[source, int(at[1]), int(at[0])]:
        return refuted
    across, down = ((forth[:, k] + shift * slope) for k, slope in ((0, du), (1, dv)))
    jacobian = np.stack([(d[:2] - at * d[2]) / point[2] for d in (across, down)], axis=1)
    offsets, here, there = [], [], []
    for j in range(-scene.radius, scene.radius + 1):
        for i in range(-scene.radius, scene.radius + 1):
            c, r = column + i * scene.step, row + j * scene.step
            if not (0 <= c < width and 0 <= r < height and scene.inside[view, r, c]):
                continue
            offsets.append((i, j))
            here.append(scene.grey[view, r, c])
            there.append(_bilinear(scene.grey[source], at + jacobian @ (i * scene.step, j * scene.step)))
    g, s, away = np.array(here), np.array(there), (np.array(offsets) ** 2).sum(axis=1)
    weights = np.exp(-(((g - scene.grey[view, row, column]) / _SPREAD) ** 2) - away / (2 * scene.radius**2))
    weights /= weights.sum()
    a, b = g - weights @ g, s - weights @ s
    cost = 1 - weights @ (a * b) / np.sqrt((weights @ a**2 + FLAT) * (weights @ b**2 + FLAT))
    return float(cost + (scene.weight * _miss(scene, source, m, at, (x, y)) if scene.weight > 0 else 0.0))


def half_iteration(scene: Scene, planes: np.ndarray, colour: int) -> np.ndarray:
    """Planes [N, 4, H, W] (w, du, dv, cost) after pixels of `colour` took the better of their neighbours' planes and
    of the plane through the four nearest; without random trials. The cost of a plane that is kept stays."""
    out = planes.copy()
    height, width = planes.shape[2:]
    for view, row, column in np.argwhere(scene.inside):
        if (row + column) % 2 != colour:
            continue

        def neighbour(i: int, j: int, v: int = view, r: int = row, c: int = column) -> np.ndarray | None:
            known = 0 <= r + j < height and 0 <= c + i < width and scene.inside[v, r + j, c + i]
            return planes[v, :, r + j, c + i] if known else None

        tries = []
        for side in _REACH:
            there = [(neighbour(i, j), i, j) for i, j in side]
            known = [(one, i, j) for one, i, j in there if one is not None]
            if known:
                (w, du, dv, _), i, j = min(known, key=lambda item: item[0][3])
                tries.append((w - i * du - j * dv, du, dv))
        cross = [neighbour(*side[0]) for side in _REACH]
        if all(one is not None for one in cross):
            up, low, left, right = (float(one[0]) for one in cross if one is not None)
            tries.append(((up + low + left + right) / 4, (right - left) / 2, (low - up) / 2))
        low, high, _, focal = scene.bounds[view].astype(float)
        for w, du, dv in tries:
            if low <= w <= high and max(abs(du), abs(dv)) * focal <= TILT * w:
                cost = plane_cost(scene, view, column, row, (w, du, dv))
                if cost < out[view, 3, row, column]:
                    out[view, :, row, column] = w, du, dv, cost
    return out


def _bilinear(picture: np.ndarray, at: np.ndarray) -> float:
    height, width = picture.shape
    u, v = np.clip(at[0] - 0.5, 0, width - 1.001), np.clip(at[1] - 0.5, 0, height - 1.001)
    i, j = int(u), int(v)
    a, b = u - i, v - j
    (p, q), (r, s) = picture[j : j + 2, i : i + 2]
    return float((1 - b) * ((1 - a) * p + a * q) + b * ((1 - a) * r + a * s))


def _miss(scene: Scene, source: int, m: np.ndarray, at: np.ndarray, pixel: tuple[float, float]) -> float:
    """Pixels by which the point that the source shows at `at` misses `pixel`, at most `far`; far where it has none."""
    assert scene.found is not None
    column, row = int(at[0]), int(at[1])
    w, du, dv = scene.found[source, :, row, column].astype(float)
    inverse = w + du * (at[0] - 0.5 - column) + dv * (at[1] - 0.5 - row)
    back = m[12:21].reshape(3, 3) @ (*at, 1.0) + m[21:] * inverse
    if w <= 0 or back[2] <= 1e-6:
        return scene.far
    return float(min(np.hypot(*(back[:2] / back[2] - pixel)), scene.far))


def agreement(
    planes: np.ndarray, normals: np.ndarray, matrices: np.ndarray, chosen: np.ndarray, view: int, column: int, row: int,
    *, tolerance: float, miss: float = 1.7, cosine: float = 0.5,
) -> list[float]:  # fmt: skip
    """The pixel's inverse depth as each view that agrees has it (`agree.agreed_planes`)."""
    height, width = planes.shape[2:]
    w, du, dv = planes[view, :, row, column].astype(float)
    pixel, values = np.array([column + 0.5, row + 0.5]), []
    for other, m in zip(chosen[view], matrices[view].astype(float), strict=True):
        point = m[:9].reshape(3, 3) @ (*pixel, 1.0) + m[9:12] * w
        if other < 0 or w <= 0 or point[2] <= 1e-6:
            continue
        at = point[:2] / point[2]
        if not (0 <= at[0] < width and 0 <= at[1] < height):
            continue
        i, j = int(at[0]), int(at[1])
        there = planes[other, :, j, i].astype(float)
        inverse = there[0] + there[1] * (at[0] - 0.5 - i) + there[2] * (at[1] - 0.5 - j)
        back = m[12:21].reshape(3, 3) @ (*at, 1.0) + m[21:] * inverse
        if there[0] <= 0 or inverse <= 0 or back[2] <= 1e-6:
            continue
        off = back[:2] / back[2] - pixel
        value = inverse / back[2] - du * off[0] - dv * off[1]
        facing = normals[view, row, column].astype(float) @ normals[other, j, i].astype(float)
        if np.hypot(*off) < miss and abs(value - w) < tolerance * w and facing > cosine:
            values.append(float(value))
    return values
