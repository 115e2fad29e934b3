"""What the patches of one view say of the cameras: residuals, derivatives and normal equations.

A patch is 3 x 3 samples, two pixels apart, of a plane of known normal at depth d exp(l) along the ray of its middle. Of
its values e in a picture z = (e - mean e) / (deviation of e + 0.001) is compared; with z' of where another camera shows
the same places,

    r = z' - z,    sum over patches, other views and samples of w r^2,    w = (1 + 2 (1 - c) / 0.3)^-2

with the correlation c of the two (Geman and McClure's weight of 2 (1 - c), the mean of r^2). A camera moves by a twist
(o, v) of the world, X -> X + o x X + v. Points go with the camera whose patch it is: what counts is its twist less that
of the other, and along the ray dX / dl = X - centre. All lenses change by g and b (`io.lens.LensChange`): a pixel
keeps its depth while its ray turns, and what another camera shows moves outward:

    du / dg = -u (1 + b r^2) / (1 + 3 b r^2),    du / db = -u r^2 / (1 + 3 b r^2)    where q stays
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from exmesh_graph.gpu.warp_runtime import launch
from exmesh_graph.io.lens import UNCHANGED, LensChange
from exmesh_graph.priors.adjust.patches import Patches

_SPAN = (-2.0, 0.0, 2.0)
ROBUST = 0.3
FLOOR = 1e-3  # of a deviation
FLAT = 0.01  # a patch whose deviation is less says nothing
_TILT = (0.8, 1.25)  # of a sample's depth over the middle's
_LOG = 6  # the unknown l among nine
_UNSEEN = -1.5
_DEPTH = 1.0
"""Weight of l^2 of a step, beside a curvature of the photographs of some hundreds."""


@dataclass(frozen=True)
class Level:
    """Even pictures of one size: gray float32 [N, h, w], their values and slopes along x and y [N, h, w, 3], intrinsics
    float64 [N, 3, 3] in their pixels; `lens`, what their lenses are other than these say."""

    gray: np.ndarray
    values: torch.Tensor
    intrinsics: np.ndarray
    lens: LensChange = UNCHANGED

    def through(self, lens: LensChange) -> Level:
        """With other lenses."""
        return replace(self, lens=lens)

    def halved(self) -> Level:
        """At half the size: means of four pixels."""
        count, height, width = self.gray.shape
        even = self.gray[:, : height // 2 * 2, : width // 2 * 2]
        small = even.reshape(count, height // 2, 2, width // 2, 2).mean(axis=(2, 4))
        intrinsics = self.intrinsics.copy()
        intrinsics[:, :2] /= 2
        return level_of(small, intrinsics)


def level_of(gray: np.ndarray, intrinsics: np.ndarray) -> Level:
    down, across = np.gradient(gray, axis=(1, 2))
    return Level(gray, torch.from_numpy(np.stack([gray, across, down], axis=-1).astype(np.float32)), intrinsics)


@dataclass(frozen=True)
class Share:
    """Normal equations of one view's patches, its own depths to be eliminated.

    rows       int [6 (S + 1) + 2], which of all unknowns: the view's own twist, those of its S sources, g and b
    curvature  float64 [6 (S + 1) + 2, same], slope, of these alone
    mixed      float64 [P, 6 (S + 1) + 2], depth with them; own [P], depths alone; own_slope [P]
    agreement  sum of the correlations of what can be compared, negative ones as 0; `compared`, how many
    """

    rows: np.ndarray
    curvature: np.ndarray
    slope: np.ndarray
    mixed: np.ndarray
    own: np.ndarray
    own_slope: np.ndarray
    agreement: float
    compared: float

    def add(self, curvature: np.ndarray, slope: np.ndarray) -> None:
        """To the equations of all twists, the depths eliminated (Schur complement)."""
        over = self.mixed / self.own[:, None]
        curvature[np.ix_(self.rows, self.rows)] += self.curvature - self.mixed.T @ over
        slope[self.rows] += self.slope - over.T @ self.own_slope

    def depths(self, twists: np.ndarray) -> np.ndarray:
        """[P], the change of l that goes with these twists, g and b [6 N + 2]."""
        return np.asarray(-(self.own_slope + self.mixed @ twists[self.rows]) / self.own)


def share_of(
    level: Level, view: int, patches: Patches, logs: np.ndarray, sources: np.ndarray, poses: np.ndarray
) -> Share | None:
    """Of `patches` of `view` in `sources` [S] (-1: none) under camera-to-world `poses`; None: it has none of either.

    Patches are as pictures show them (`Patches.as_shown`), whatever lenses `level` has.
    """
    sources = sources[sources >= 0]
    if len(patches) == 0 or len(sources) == 0:
        return None
    products, slopes, alike = compared(level, view, patches, logs, sources, poses)
    count, size = len(sources) + 1, 6 * (len(sources) + 1) + 2
    curvature, slope, mixed = np.zeros((size, size)), np.zeros(size), np.zeros((len(patches), size))
    for k in range(1, count):
        # how twists of both cameras, one against the other, and the lens stand among the unknowns
        chosen = np.zeros((9, size))
        chosen[:6, :6], chosen[:6, 6 * k : 6 * k + 6], chosen[7:, -2:] = np.eye(6), -np.eye(6), np.eye(2)
        curvature += chosen.T @ products[:, k - 1].sum(axis=0) @ chosen
        slope += slopes[:, k - 1].sum(axis=0) @ chosen
        mixed += products[:, k - 1, _LOG] @ chosen
    own, own_slope = _DEPTH + products[:, :, _LOG, _LOG].sum(axis=1), slopes[:, :, _LOG].sum(axis=1)
    twists = [np.arange(6 * one, 6 * one + 6) for one in (view, *sources)]
    rows = np.concatenate([*twists, 6 * len(poses) + np.arange(2)])
    seen = alike > _UNSEEN
    return Share(rows, curvature, slope, mixed, own, own_slope, float(alike.clip(min=0).sum()), float(seen.sum()))


def compared(
    level: Level, view: int, patches: Patches, logs: np.ndarray, sources: np.ndarray, poses: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each patch in each of `sources` [S], all >= 0: sums over its samples of w s s^T [P, S, 9, 9] and of w s r
    [P, S, 9], s the derivatives of z' by the twist (o, v) of the patch's camera against that of the source, by l, g and
    b; and the correlation [P, S], -2 where either does not show it all, or shows no paint. In one kernel;
    `reference.compared` is the same in plain torch."""
    from exmesh_graph.priors.adjust.kernels import compare

    shape = len(patches), len(sources)
    shown, local = placed(patches, logs, level.intrinsics[view][[0, 1], [0, 1]], level.lens)
    products, slopes = torch.zeros(*shape, 9, 9, dtype=torch.float64), torch.zeros(*shape, 9, dtype=torch.float64)
    alike = torch.empty(shape, dtype=torch.float64)
    _, height, width = level.gray.shape
    cameras = (torch.from_numpy(np.ascontiguousarray(part)) for part in (level.intrinsics, poses))
    launch(
        compare, len(patches), 0, len(sources), width, height, view, level.lens.zoom, level.lens.bend, FLAT, FLOOR,
        ROBUST, level.values, *cameras, torch.from_numpy(sources.astype(np.int32)), torch.from_numpy(shown),
        torch.from_numpy(local), products, slopes, alike,
    )  # fmt: skip
    return products.numpy(), slopes.numpy(), alike.numpy()


def placed(patches: Patches, logs: np.ndarray, focal: np.ndarray, lens: LensChange) -> tuple[np.ndarray, np.ndarray]:
    """Samples of patches: where their pictures show them, q float64 [P, 9, 2], two pixels being 2 / `focal`, and their
    places in the camera's axes [P, 9, 3]."""
    across, down = np.meshgrid(_SPAN, _SPAN)
    steps = np.stack([across.ravel() / focal[0], down.ravel() / focal[1]], axis=1)
    shown = patches.rays[:, None, :2] + steps
    middle = np.einsum("pc,pc->p", patches.normals, patches.rays)[:, None]
    sample = np.einsum("pc,pnc->pn", patches.normals[:, :2], shown) + patches.normals[:, 2:]
    ratio = np.clip(middle / np.where(np.abs(sample) < 1e-6, -1e-6, sample), *_TILT)
    depth = (ratio * (patches.depths * np.exp(logs))[:, None])[..., None]
    return shown, np.concatenate([depth * lens.rays(shown), depth], axis=-1)
