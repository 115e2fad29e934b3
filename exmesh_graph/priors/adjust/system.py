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

from exmesh_graph.io.lens import UNCHANGED, LensChange
from exmesh_graph.priors.adjust.patches import Patches

_SPAN = (-2.0, 0.0, 2.0)
_ROBUST = 0.3
_FLOOR = 1e-3  # of a deviation
_FLAT = 0.01  # a patch whose deviation is less says nothing
_TILT = (0.8, 1.25)  # of a sample's depth over the middle's
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
    matrix = level.intrinsics[view]
    shown_at, local, by_lens = placed(patches, logs, matrix[[0, 1], [0, 1]], level.lens)
    x, y = (torch.from_numpy(matrix[k, k] * shown_at[..., k] + matrix[k, 2]) for k in (0, 1))
    values, shown = _sampled(level.values[view], x, y)
    unit, spread = _unit(values[..., 0])
    shown &= spread > _FLAT
    turn = poses[view, :3, :3]
    from_centre = torch.from_numpy(local @ turn.T)
    places = from_centre + torch.from_numpy(poses[view, :3, 3])
    along = torch.stack([from_centre, *(torch.from_numpy(one @ turn.T) for one in by_lens)], dim=-1)
    count = len(sources) + 1
    size = 6 * count + 2
    curvature, slope = np.zeros((size, size)), np.zeros(size)
    mixed = torch.zeros(len(patches), size, dtype=torch.float64)
    own = torch.full((len(patches),), _DEPTH, dtype=torch.float64)
    own_slope, agreement, compared = torch.zeros_like(own), 0.0, 0.0
    for k, source in enumerate(sources, 1):
        other, slopes, seen, other_spread = _seen(level, int(source), places, along, poses)
        seen &= shown & (other_spread > _FLAT)
        correlation = (other * unit).mean(dim=1)
        weight = torch.where(seen, (1 + 2 * (1 - correlation) / _ROBUST) ** -2, 0.0)
        weighted = slopes * weight[:, None, None]
        product = torch.einsum("pna,pnb->pab", weighted, slopes)
        off = torch.einsum("pna,pn->pa", weighted, other - unit)
        # how twists of both cameras, one against the other, and the lens stand in the columns of `slopes`
        chosen = np.zeros((9, size))
        chosen[:6, :6], chosen[:6, 6 * k : 6 * k + 6], chosen[7:, -2:] = np.eye(6), -np.eye(6), np.eye(2)
        curvature += chosen.T @ product.sum(dim=0).numpy() @ chosen
        slope += off.sum(dim=0).numpy() @ chosen
        mixed += product[:, 6] @ torch.from_numpy(chosen)
        own += product[:, 6, 6]
        own_slope += off[:, 6]
        agreement += float((correlation.clamp(min=0) * seen).sum())
        compared += float(seen.sum())
    twists = [np.arange(6 * one, 6 * one + 6) for one in (view, *sources)]
    rows = np.concatenate([*twists, 6 * len(poses) + np.arange(2)])
    return Share(rows, curvature, slope, mixed.numpy(), own.numpy(), own_slope.numpy(), agreement, compared)


def placed(
    patches: Patches, logs: np.ndarray, focal: np.ndarray, lens: LensChange
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Samples of patches: where their pictures show them, q float64 [P, 9, 2], two pixels being 2 / `focal`; places in
    the camera's axes [P, 9, 3]; and these places' derivatives by g and b."""
    across, down = np.meshgrid(_SPAN, _SPAN)
    steps = np.stack([across.ravel() / focal[0], down.ravel() / focal[1]], axis=1)
    shown = patches.rays[:, None, :2] + steps
    middle = np.einsum("pc,pc->p", patches.normals, patches.rays)[:, None]
    sample = np.einsum("pc,pnc->pn", patches.normals[:, :2], shown) + patches.normals[:, 2:]
    ratio = np.clip(middle / np.where(np.abs(sample) < 1e-6, -1e-6, sample), *_TILT)
    depth = (ratio * (patches.depths * np.exp(logs))[:, None])[..., None]
    rays = lens.rays(shown)
    square = np.square(rays).sum(axis=-1, keepdims=True)
    inward = -depth * rays / (1 + 3 * lens.bend * square)
    flat = np.zeros_like(depth)
    longer, bent = (np.concatenate([inward * part, flat], axis=-1) for part in (1 + lens.bend * square, square))
    return shown, np.concatenate([depth * rays, depth], axis=-1), (longer, bent)


def _seen(
    level: Level, source: int, places: torch.Tensor, along: torch.Tensor, poses: np.ndarray
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """(z' [P, 9], its derivatives by the twist (o, v), by l, g and b [P, 9, 9], whether it is in the picture [P],
    deviation [P]) of `source`; `along` [P, 9, 3, 3], derivatives of `places` by l, g and b."""
    turn = torch.from_numpy(np.ascontiguousarray(poses[source, :3, :3]))  # to the world
    local = (places - torch.from_numpy(poses[source, :3, 3])) @ turn
    matrix, zoom, bend = level.intrinsics[source], level.lens.zoom, level.lens.bend
    depth = local[..., 2].clamp(min=1e-3)
    rays = local[..., :2] / depth[..., None]
    square = rays.square().sum(dim=-1)
    shown_at = zoom * rays * (1 + bend * square)[..., None]
    x, y = (matrix[k, k] * shown_at[..., k] + matrix[k, 2] for k in (0, 1))
    values, shown = _sampled(level.values[source], x, y)
    shown &= (local[..., 2] > 1e-3).all(dim=1)
    outward = zoom * torch.stack([values[..., 1] * matrix[0, 0], values[..., 2] * matrix[1, 1]], dim=-1)
    radial = (outward * rays).sum(dim=-1)
    by_ray = outward * (1 + bend * square)[..., None] + 2 * bend * radial[..., None] * rays
    in_camera = torch.cat([by_ray, -(by_ray * rays).sum(dim=-1, keepdim=True)], dim=-1) / depth[..., None]
    in_world = in_camera @ turn.T
    by_lens = torch.stack([torch.zeros_like(radial), radial * (1 + bend * square), radial * square], dim=-1)
    moving = (in_world[..., None] * along).sum(dim=-2) + by_lens
    slopes = torch.cat([torch.linalg.cross(places, in_world), in_world, moving], dim=-1)
    unit, spread = _unit(values[..., 0])
    # z is of unit deviation and without mean: what only changes these does not change it
    slopes = slopes - slopes.mean(dim=1, keepdim=True)
    over = (spread + _FLOOR)[:, None, None]
    spreading = (unit[..., None] * slopes).mean(dim=1, keepdim=True) * over / (over - _FLOOR).clamp(min=1e-9)
    return unit, (slopes - unit[..., None] * spreading) / over, shown, spread


def _unit(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(z [P, n], deviations [P]) of values [P, n]."""
    off = values - values.mean(dim=1, keepdim=True)
    spread = off.square().mean(dim=1).sqrt()
    return off / (spread + _FLOOR)[:, None], spread


def _sampled(picture: torch.Tensor, x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(bilinear values float64 [P, n, C] of a picture [h, w, C] at pixels, centres at +0.5; bool [P], all inside)."""
    height, width, channels = picture.shape
    x, y = x - 0.5, y - 0.5
    inside = ((x >= 0) & (y >= 0) & (x <= width - 1.001) & (y <= height - 1.001)).all(dim=1)
    x, y = x.clamp(0, width - 1.001), y.clamp(0, height - 1.001)
    left, top = x.long(), y.long()
    across, down = (x - left)[..., None], (y - top)[..., None]
    flat, at = picture.reshape(-1, channels), top * width + left
    upper = flat[at] * (1 - across) + flat[at + 1] * across
    lower = flat[at + width] * (1 - across) + flat[at + width + 1] * across
    return upper * (1 - down) + lower * down, inside
