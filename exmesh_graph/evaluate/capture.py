"""What a set of photographs covers of a surface, and which further ones would help most.

A patch of the surface is seen by a view that shows at least half of it, not too flat. What fewer than three views see
is guessed by its neighbours: its shape by smoothness, its gloss not at all. New places are chosen greedily: first the
one that shows most of it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from exmesh_graph.geometry.adjacency import face_areas, face_normals
from exmesh_graph.geometry.patches import patches
from exmesh_graph.raster import shown_faces
from exmesh_graph.types import Mesh, Views

ENOUGH = 3
"""Views that must see a patch: two give its place, a third says whether they agree."""
_CELLS, _SIDE = 40, 320
_COSINE = 0.3
_SHOWN = 0.5
_PLACES, _MOST, _WORTH = 150, 4, 0.02
_UNDER = -20.0
_BLOWN, _WHITE = 0.15, 0.98


class Coverage(NamedTuple):
    """What N views see of P patches.

    area    float64 [P], of the faces of a patch together
    seen    bool [N, P]
    """

    area: np.ndarray
    seen: np.ndarray


class Place(NamedTuple):
    """Where further photographs would help.

    direction  unit vector from the object to the camera
    gain       share of the surface that the place shows and too few views see yet
    """

    direction: np.ndarray
    gain: float


def coverage(views: Views, mesh: Mesh) -> Coverage:
    """Which views see which patches of `mesh`."""
    scale = _SIDE / max(views.width, views.height)
    size = round(views.height * scale), round(views.width * scale)
    surface = _Surface(mesh)
    shrink = np.diag([scale, scale, 1.0])
    seen = [surface.seen(shrink @ views.intrinsics[i], views.world_to_camera[i], *size) for i in range(len(views))]
    return Coverage(surface.area, np.stack(seen))


def places(views: Views, mesh: Mesh, found: Coverage) -> list[Place]:
    """At most four places from which photographs like those of `views` would show what too few of them see."""
    surface, total = _Surface(mesh), max(float(found.area.sum()), 1e-30)
    eyes = views.camera_to_world[:, :3, 3]
    middle = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    far = float(np.median(np.linalg.norm(eyes - middle, axis=1)))
    wide = float(np.median(views.intrinsics[:, 0, 0])) / max(views.width, views.height) * _SIDE
    camera = np.array([[wide, 0, _SIDE / 2], [0, wide, _SIDE / 2], [0, 0, 1.0]])
    directions = _sphere(_PLACES)
    shows = np.stack([surface.seen(camera, _looking(middle + far * d, d), _SIDE, _SIDE) for d in directions])
    lacking = np.where(found.seen.sum(0) < ENOUGH, found.area, 0.0) / total
    chosen: list[Place] = []
    while len(chosen) < _MOST:
        gains = shows @ lacking
        best = int(gains.argmax())
        if gains[best] < _WORTH:
            break
        chosen.append(Place(directions[best], float(gains[best])))
        lacking = np.where(shows[best], 0.0, lacking)
    return chosen


def capture_figures(views: Views, mesh: Mesh) -> dict[str, Any]:
    """Figures of `evaluate.capture`: how much of the surface is seen by how many views, `advice` on further photographs
    as rows {name, value, reason}, and views that are blown out."""
    found = coverage(views, mesh)
    share = found.area / max(float(found.area.sum()), 1e-30)
    often = found.seen.sum(0)
    seen = {n: float(share[often >= n].sum()) for n in (1, 2, ENOUGH)}
    middle = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    rows = [_row(place, views, middle) for place in places(views, mesh, found)]
    if not rows:
        reason = f"At least {ENOUGH} photographs see {seen[ENOUGH]:.0%} of the surface; no place shows more."
        rows = [{"name": "more photographs", "value": "none needed", "reason": reason}]
    blown = _blown(views, mesh)
    if blown:
        names = ", ".join(list(blown)[:6]) + (f" and {len(blown) - 6} more" if len(blown) > 6 else "")
        reason = f"More than {_BLOWN:.0%} of the object is pure white in {names}: shape and colour are lost there."
        rows.append({"name": "exposure", "value": "less", "reason": reason})
    return {
        "headline": [{"label": f"Seen by {ENOUGH} photographs or more", "value": 100 * seen[ENOUGH], "unit": "%"}],
        "seen": {f"by {n} or more": value for n, value in seen.items()},
        "blown_out": blown,
        "advice": rows,
    }


def _row(place: Place, views: Views, middle: np.ndarray) -> dict[str, Any]:
    """How a person would be told: beside which photograph, how far round and up."""
    towards = views.camera_to_world[:, :3, 3] - middle
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    nearest = int((towards @ place.direction).argmax())
    (round_new, up_new), (round_old, up_old) = _angles(place.direction), _angles(towards[nearest])
    aside = (round_new - round_old + 180) % 360 - 180
    steps = []
    if abs(up_new - up_old) >= 5:
        steps.append(f"{abs(up_new - up_old):.0f} degrees {'above' if up_new > up_old else 'below'}")
    if abs(aside) >= 5 and abs(up_new) < 75:
        steps.append(f"{abs(aside):.0f} degrees to the {'right' if aside > 0 else 'left'} of")
    value = f"{ENOUGH} from {' and '.join(steps) or 'beside'} {views.names[nearest]}"
    turned = " Seen from below: lift the object, or turn it over for a second set." if up_new < _UNDER else ""
    reason = f"They would show {place.gain:.0%} of the surface that fewer than {ENOUGH} photographs see now.{turned}"
    return {"name": "more photographs", "value": value, "reason": reason}


def _angles(direction: np.ndarray) -> tuple[float, float]:
    """(degrees round the vertical, to the right as a photographer walks who looks at the object; degrees up)."""
    x, y, z = direction
    return float(np.degrees(np.arctan2(x, z))), float(np.degrees(np.arcsin(np.clip(y, -1, 1))))


def _blown(views: Views, mesh: Mesh) -> dict[str, float]:
    """Share of pure white among what a view shows of the surface, where it is large."""
    shares = {}
    for i, name in enumerate(views.names):
        where = views.intrinsics[i], views.world_to_camera[i]
        face = shown_faces(mesh.vertices, mesh.faces, *where, views.height, views.width)
        inside = (face >= 0) & (np.asarray(views.alpha[i]) > 0.99)
        white = np.asarray(views.images[i])[inside].min(-1) >= _WHITE
        if white.size and white.mean() > _BLOWN:
            shares[name] = round(float(white.mean()), 3)
    return shares


class _Surface:
    """A mesh in patches, drawn to see which of them a camera sees."""

    def __init__(self, mesh: Mesh) -> None:
        corners = np.asarray(mesh.vertices, np.float64)
        self.patch = patches(corners, mesh.faces, _CELLS)
        self.count = int(self.patch.max(initial=-1)) + 1
        self.face_area, self.face_normal = face_areas(corners, mesh.faces), face_normals(corners, mesh.faces)
        self.middle = corners[mesh.faces].mean(1)
        self.area = np.bincount(self.patch, self.face_area, self.count)
        self.mesh = mesh

    def seen(self, camera: np.ndarray, pose: np.ndarray, height: int, width: int) -> np.ndarray:
        """bool [P]: patches of which the camera shows at least half, by pixels against what their faces would cover."""
        face = shown_faces(self.mesh.vertices, self.mesh.faces, camera, pose, height, width)
        pixels = np.bincount(self.patch[face[face >= 0]], minlength=self.count)
        eye = -pose[:3, :3].T @ pose[:3, 3]
        ray = eye - self.middle
        away = np.linalg.norm(ray, axis=1)
        cosine = np.clip(np.einsum("fi,fi->f", self.face_normal, ray) / np.maximum(away, 1e-12), 0, 1)
        covers = self.face_area * cosine * camera[0, 0] * camera[1, 1] / np.maximum(away, 1e-6) ** 2
        expected = np.bincount(self.patch, covers, self.count)
        facing = np.bincount(self.patch, self.face_area * cosine, self.count) > _COSINE * self.area
        return facing & (pixels >= np.maximum(_SHOWN * expected, 1))


def _sphere(count: int) -> np.ndarray:
    """float64 [count, 3]: directions spread evenly (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    up, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - up**2)
    return np.stack([ring * np.sin(turn), up, ring * np.cos(turn)], axis=1)


def _looking(eye: np.ndarray, back: np.ndarray) -> np.ndarray:
    """World to camera, float64 [4, 4], of a camera at `eye` that looks along -back."""
    side = np.cross(-back, [0.0, 1.0, 0.0] if abs(back[1]) < 0.99 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([side, np.cross(-back, side), -back])
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose
