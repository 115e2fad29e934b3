"""Does the light move with the camera? What colours of one place in several views tell.

Under light that stands still, a matt place looks the same from everywhere, and gloss goes by the mirrored direction.
Under light that moves, the place's brightness follows its normal as the moving frame (shading.moving) sees it. So three
models of the colours c of places i in views v are fitted, each with the same 18 numbers for all places:

    c_iv = a_i g(d_iv) + h(r_iv)          g, h: spherical harmonics up to the second order

r is the mirrored direction of view, in the world or in the frame; d is r where the light stands still (Fresnel's
brightening of rims takes part in it), and the normal in the frame where it moves.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.io.vertical import turntable_axis
from exmesh_graph.shading.moving import light_turns
from exmesh_graph.stage2.gbuffer import build_view
from exmesh_graph.stage2.surface import CarrierGeometry, SurfaceSamples
from exmesh_graph.types import Carrier, Views

Moves = Literal["turntable", "camera"]

#: Texels of the maps that make one place, along a side of the atlas; views that a place must be seen by.
_SIDE, _LEAST_VIEWS = 64, 3
#: Pixels seen under a smaller cosine, and covered less, tell of what lies beside them.
_COSINE, _COVERED = 0.15, 0.99
#: Of the mean brightness: darkness below which errors are no longer taken relatively.
_DARK = 0.1
_ROUNDS = 8


class Told(NamedTuple):
    """Of what colours of one place differ by from view to view, the share that is left by a light that stands, one that
    turns as beside a turntable (None: no axis), and one that is fixed to the camera."""

    still: float
    turntable: float | None
    camera: float

    def hint(self) -> float:
        """The least left by a light that moves, over what one that stands leaves."""
        moving = self.camera if self.turntable is None else min(self.camera, self.turntable)
        return moving / max(self.still, 1e-12)


def axis_for(moves: Moves | Literal[False], views: Views | None) -> np.ndarray | None:
    """What types.Asset.light_axis is of a light that `moves` with the cameras of `views`.

    Raises DataError where it takes views and there are none, or these tell no axis.
    """
    if moves is False:
        return None
    if moves == "camera":
        return np.zeros(3, np.float32)
    if views is None:
        raise DataError(
            "light that moves as beside a turntable turns about an axis, which no cameras tell",
            expected="the training views", fix='views: "@views.train", or set light_moves: false',
        )  # fmt: skip
    axis = turntable_axis(views.camera_to_world)
    if axis is None:
        raise DataError(
            "light_moves is turntable, but the cameras stand around no axis",
            expected="pictures held level, from more than one side",
            fix="set light_moves: camera, or false for a light that stands still",
        )
    return axis.astype(np.float32)


def tell(carrier: Carrier, views: Views) -> Told | None:
    """What a few coarse `views` tell; None where no place is seen often enough."""
    places = _seen(carrier, views)
    if places is None:
        return None
    poses = views.camera_to_world
    axis = turntable_axis(poses)

    def left(turns: np.ndarray | None) -> float:
        of = np.eye(3)[None] if turns is None else turns[places.view]
        mirrored = np.einsum("nij,nj->ni", np.broadcast_to(of, (len(places.view), 3, 3)), places.mirrored)
        facing = mirrored if turns is None else np.einsum("nij,nj->ni", of, places.normal)
        return _left(places, _harmonics(facing), _harmonics(mirrored))

    turntable = None if axis is None else left(light_turns(axis, poses))
    return Told(left(None), turntable, left(light_turns(np.zeros(3), poses)))


class _Places(NamedTuple):
    """Means over the pixels of a view on one place: place and view int64 [N], luminance and weight [N], unit normal and
    mirrored direction [N, 3]."""

    place: np.ndarray
    view: np.ndarray
    colour: np.ndarray
    weight: np.ndarray
    normal: np.ndarray
    mirrored: np.ndarray


class _Dark:
    """A light that keeps nothing of a view."""

    def texels(self, size: int) -> torch.Tensor:
        """None."""
        return torch.zeros(0, dtype=torch.int64)

    def view(self, surface: SurfaceSamples, pixel: torch.Tensor, width: int, number: int) -> None:
        """Nothing."""


def _seen(carrier: Carrier, views: Views) -> _Places | None:
    geometry, rows = CarrierGeometry(carrier, "cpu"), []
    for number in range(len(views)):
        buffer = build_view(geometry, _Dark(), views, number, _SIDE, 0.5)
        surface = buffer.samples(geometry)
        usable = ~buffer.clipped.any(1) & (buffer.n_v > _COSINE) & (buffer.coverage > _COVERED)
        usable &= torch.isfinite(buffer.target).all(1)
        nearest = buffer.texel.long().gather(1, buffer.texel_weight.argmax(1, keepdim=True))[:, 0]
        values = torch.cat([buffer.target.mean(1, keepdim=True), surface.normal, surface.reflected], 1)
        found, index = nearest[usable].unique(return_inverse=True)
        sums = torch.zeros(len(found), 7).double().index_add_(0, index, values[usable].double())
        pixels = torch.bincount(index, minlength=len(found)).double()
        means = np.asarray(sums / pixels[:, None])
        rows.append((np.asarray(found), np.full(len(found), number), means, np.asarray(pixels)))
    place, view, mean, count = (np.concatenate([row[k] for row in rows]) for k in range(4))
    if len(place) == 0:
        return None
    often = np.bincount(place)[place] >= _LEAST_VIEWS
    if not often.any():
        return None
    place, view, mean, count = place[often], view[often], mean[often], count[often]
    _, place = np.unique(place, return_inverse=True)
    level = _mean(place, mean[:, 0], count)
    weight = count / (level[place] ** 2 + (_DARK * level.mean()) ** 2 + 1e-12)
    return _Places(place, view, mean[:, 0], weight, _unit(mean[:, 1:4]), _unit(mean[:, 4:]))


def _left(places: _Places, facing: np.ndarray, mirrored: np.ndarray) -> float:
    """The share of the squared differences from each place's mean that the model leaves: alternately the harmonics'
    factors and the places' a, each by least squares."""
    place, colour, weight = places.place, places.colour, places.weight
    a = _mean(place, colour, weight)
    whole = float((weight * (colour - a[place]) ** 2).sum())
    root, terms = np.sqrt(weight), facing.shape[1]
    g, h = np.ones_like(colour), np.zeros_like(colour)
    for _ in range(_ROUNDS):
        design = np.concatenate([a[place, None] * facing, mirrored], axis=1)
        factors = np.linalg.lstsq(root[:, None] * design, root * colour, rcond=1e-6)[0]
        g, h = facing @ factors[:terms], mirrored @ factors[terms:]
        a = _mean(place, (colour - h) * g, weight) / _mean(place, g * g, weight).clip(1e-9)
    return float((weight * (colour - h - a[place] * g) ** 2).sum()) / max(whole, 1e-12)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True).clip(1e-9)


def _mean(place: np.ndarray, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return np.bincount(place, weight * values) / np.bincount(place, weight).clip(1e-30)


def _harmonics(direction: np.ndarray) -> np.ndarray:
    """[N, 9] of unit directions [N, 3], in no particular scale."""
    x, y, z = direction.T
    return np.stack([np.ones_like(x), x, y, z, x * y, y * z, x * z, 3 * z * z - 1, x * x - y * y], axis=1)
