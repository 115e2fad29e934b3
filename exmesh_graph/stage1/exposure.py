"""Exposure and white balance of the photographs, from what they show of one surface, and taken out of them.

Linear light of a camera is the scene's, times one factor for each channel: shutter, gain and white balance. So the
means c [N, P, 3] of patch p in view n obey log c_np = s_p + g_n but for gloss and shadows, which absolute errors bear.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exmesh_graph.geometry.patches import patches
from exmesh_graph.gpu.cores import share
from exmesh_graph.io.picture_files import with_pictures
from exmesh_graph.io.train_size import factor_for, reduced
from exmesh_graph.raster import shown_faces
from exmesh_graph.stage1.settings import BalanceSettings
from exmesh_graph.types import Mesh, Views

_SIDE = 320
"""Pixels of the longer side at which patches are read: an exposure is a mean over hundreds of them."""
_LEAST_PIXELS = 4
_DARK, _BRIGHT = 0.005, 0.97
"""Linear values beyond which a pixel tells nothing of its exposure: black is offset and noise, white is cut off."""
_LEAST_PATCHES = 12
CELLS = 40
_ROUNDS, _CONVERGED, _SMALL = 50, 1e-4, 0.01
_NEIGHBOURS = 4
_MAD = 1.4826  # median absolute deviation to standard deviation, of normal errors


class Exposures(NamedTuple):
    """What N views tell of their exposures.

    log_gains  float64 [N, 3], natural logarithms of the factors, of zero mean over the views that are known
    known      bool [N], whether a view shares enough patches with others; the factors of one that does not are 1
    rough      standard deviation in stops by which a view's brightness differs from those nearest to it, robust:
               exposure changes from picture to picture, gloss and light only slowly along the cameras' path
    spread     standard deviation in stops of what patches of one view say about it, robust: gloss moves some of them,
               exposure all
    """

    log_gains: np.ndarray
    known: np.ndarray
    rough: float
    spread: float

    @property
    def stops(self) -> np.ndarray:
        """float64 [N, 3]: the factors as powers of two."""
        return self.log_gains / np.log(2)


def exposures(views: Views, mesh: Mesh) -> Exposures:
    """The exposures of `views` by what each shows of the surface of `mesh`; a rough one is enough."""
    values = np.log(patch_colours(views, mesh))
    log_gains, known = separate(values)
    rough = _roughness(log_gains, known, views.camera_to_world[:, :3, 3])
    return Exposures(log_gains, known, rough, _spread(values[known], log_gains[known]))


def wander(found: Exposures, settings: BalanceSettings) -> tuple[bool, float]:
    """(whether exposures wander, the deviation in stops of a view's brightness from which on they do)."""
    much = max(settings.wander, settings.beyond_gloss * found.spread)
    return found.rough >= much, much


def patch_colours(views: Views, mesh: Mesh) -> np.ndarray:
    """float64 [N, P, 3]: mean linear colour of each patch in each view, NaN where a view does not show it in full light
    on at least four pixels, of reduced pictures, inside its mask."""
    views = reduced(views, factor_for(views, _SIDE, 0))
    patch = patches(mesh.vertices, mesh.faces, CELLS)
    count = int(patch.max()) + 1

    def one(view: int) -> np.ndarray:
        where = views.intrinsics[view], views.world_to_camera[view]
        face = shown_faces(mesh.vertices, mesh.faces, *where, views.height, views.width)
        rgb = np.asarray(views.images[view])
        told = (face >= 0) & (views.alpha[view] > 0.99) & (rgb.max(-1) < _BRIGHT) & (rgb.min(-1) > _DARK)
        shown, linear = patch[face[told]], rgb[told]
        pixels = np.bincount(shown, minlength=count)
        total = np.stack([np.bincount(shown, linear[:, c], minlength=count) for c in range(3)], axis=-1)
        return np.where(pixels[:, None] >= _LEAST_PIXELS, total / np.maximum(pixels, 1)[:, None], np.nan)

    return np.stack(share(one, range(len(views))))


def separate(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(log gains float64 [N, C], known bool [N]) of `values` [N, P, C], logarithms, NaN where a view does not show a
    patch: the least sum of absolute errors, by least squares with weights made anew (Weiszfeld)."""
    shared = np.isfinite(values[..., 0])
    shared &= shared.sum(0) >= 2
    known = shared.sum(1) >= _LEAST_PATCHES
    gains = np.zeros((len(values), values.shape[-1]))
    if known.sum() < 2:
        return gains, np.zeros(len(values), bool)
    shared = shared[known]
    used = shared.sum(0) >= 2
    shared, kept = shared[:, used], values[known][:, used]
    for c in range(values.shape[-1]):
        value = np.where(shared, kept[..., c], 0.0)
        weight, found = shared.astype(np.float64), np.zeros(len(value))
        for _ in range(_ROUNDS):
            before = found
            found, surface = _least_squares(value, weight)
            apart = np.abs(value - surface - found[:, None])
            weight = shared / np.maximum(apart, _SMALL)
            if np.abs(found - before).max() < _CONVERGED:
                break
        gains[known, c] = found
    return gains, known


def _least_squares(value: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(g [N] of zero mean, s [P]) that minimise the sum of weight (value - s - g)^2 [N, P]."""
    total = np.maximum(weight.sum(0), 1e-300)
    share = weight / total
    mean = (share * value).sum(0)
    left = np.diag(weight.sum(1)) - weight @ share.T
    right = (weight * (value - mean)).sum(1)
    gains = np.linalg.lstsq(left, right, rcond=1e-10)[0]
    gains -= gains.mean()
    return gains, mean - (share * gains[:, None]).sum(0)


def balanced(views: Views, log_gains: np.ndarray) -> Views:
    """The views as one camera of fixed exposure and white balance sees them: linear light over the factors."""
    factors = np.exp(-log_gains).astype(np.float32)
    pictures = ((views.images[i] * factor, views.alpha[i], None) for i, factor in enumerate(factors))
    return with_pictures(views, pictures, views.height, views.width)


def _roughness(log_gains: np.ndarray, known: np.ndarray, places: np.ndarray) -> float:
    """Robust standard deviation, in stops, of brightness against the mean of the nearest cameras'."""
    stops, where = log_gains[known].mean(-1) / np.log(2), places[known]
    near = min(_NEIGHBOURS, len(stops) - 1)
    if near < 1:
        return 0.0
    away = np.linalg.norm(where[:, None] - where, axis=-1)
    order = np.argsort(away, axis=1, kind="stable")[:, 1 : near + 1]
    apart = stops - stops[order].mean(1)
    return float(_MAD * np.median(np.abs(apart)) / np.sqrt(1 + 1 / near))


def _spread(values: np.ndarray, log_gains: np.ndarray) -> float:
    """Robust standard deviation, in stops, of the patches' brightness [N, P] from surface and exposure."""
    apart = (values.mean(-1) - log_gains.mean(-1)[:, None])[:, np.isfinite(values[..., 0]).sum(0) >= 2] / np.log(2)
    if not apart.size:
        return 0.0
    return float(_MAD * np.nanmedian(np.abs(apart - np.nanmedian(apart, axis=0))))
