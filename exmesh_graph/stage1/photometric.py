"""Open what no outline shows: move a coarse mesh along its normals to where the photographs agree.

Plane sweeping on a mesh: a small square patch in a vertex's tangent plane slides along the normal; at the true surface
its pictures in the views that see the vertex correlate best (normalised cross-correlation, per channel free of
brightness and contrast). Vertices move only where that is clearly better than where they are and neighbours say so too:
outlines place a hull's rims and round parts far better than correlation could.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from exmesh_graph.geometry.adjacency import area_weighted_normals
from exmesh_graph.raster import project, rasterize_projected, sample_texture
from exmesh_graph.stage1.settings import PhotometricSettings
from exmesh_graph.targets import Targets
from exmesh_graph.types.edges import edges_of

_CHUNK = 256
_CONTRAST = 0.01
"""Deviation of display colour within a patch below which there is nothing to compare."""
_FACING = 0.2
"""Least cosine between a normal and the direction to a camera that counts as seeing the vertex."""
_AGREES, _CLEAR, _GAIN = 0.8, 0.6, 0.15
"""A vertex whose patches correlate this well stays; an offset is taken from `_CLEAR` on, if it gains so much."""
_OFFSETS = 17
"""Offsets tried in a pass."""
_PATCH, _SPACING = 7, 1.5
"""Samples along a patch's side, and their distance in pixels."""
_OTHERS = 6
"""Other views compared with the one that sees the vertex best."""


def sweep(
    vertices: np.ndarray,
    faces: np.ndarray,
    targets: Targets,
    settings: PhotometricSettings,
    progress: Callable[..., None] | None = None,
) -> tuple[np.ndarray, dict[str, float]]:
    """(vertices float32 [V, 3] moved, figures): `known`, the share of vertices that at least three views see and that
    have something to compare; `moved`, the share that left its place by more than a tenth of an edge; `correlation`,
    the mean of the known ones at the start of the last pass.

    A vertex that nothing is known of follows its neighbours. Faces and their order stay.
    """
    start = moved = np.asarray(vertices, np.float32)
    figures: dict[str, float] = {}
    edges = edges_of(faces).vertices
    edge = float(np.linalg.norm(start[edges[:, 0]] - start[edges[:, 1]], axis=1).mean())
    offsets = np.linspace(-settings.reach, settings.reach / 4, _OFFSETS) * edge
    for number in range(settings.passes):
        normals = area_weighted_normals(moved, faces).astype(np.float32)
        score = correlations(moved, faces, normals, offsets, targets)
        best, weight = _evidence(score, offsets, edges)
        offset = _interpolate(best, weight, edges, settings.smoothness)
        moved = (moved + offset[:, None] * normals).astype(np.float32)
        known = np.isfinite(score).all(axis=1)
        figures = {
            "known": float(known.mean()),
            "moved": float((np.linalg.norm(moved - start, axis=1) > 0.1 * edge).mean()),
            "correlation": float(score[known, np.abs(offsets).argmin()].mean()) if known.any() else 0.0,
        }
        if progress is not None:
            progress(number + 1, settings.passes, **figures)
    return moved, figures


@torch.no_grad()
def correlations(
    vertices: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray,
    offsets: np.ndarray,
    targets: Targets,
) -> np.ndarray:
    """float32 [V, K]: mean over the better half of the views of the correlation at each of K offsets (world units).

    NaN for vertices that fewer than three views see or whose patch is blank in the view that sees it best.
    """
    device = targets.device
    points, directions = torch.from_numpy(vertices).to(device), torch.from_numpy(normals).to(device)
    chosen, seen, pixel = _choose_views(points, torch.from_numpy(faces).to(device), directions, targets, _OTHERS)
    across = torch.nn.functional.normalize(
        torch.linalg.cross(directions, torch.eye(3, device=device)[directions.abs().argmin(dim=1)]), dim=1
    )
    upright = torch.linalg.cross(directions, across)
    line = torch.linspace(-1, 1, _PATCH, device=device) * (_PATCH - 1) / 2 * _SPACING
    a, b = (x.reshape(-1) for x in torch.meshgrid(line, line, indexing="ij"))
    shift = torch.from_numpy(offsets).to(points)
    cameras = targets.intrinsics @ targets.world_to_camera[:, :3]
    sheet = torch.empty((len(targets), targets.height, targets.width, 4), device=device)
    for plane, image, alpha in zip(sheet, targets.images, targets.alpha, strict=True):
        plane[..., :3], plane[..., 3] = image, alpha
    sheet = sheet.reshape(-1, targets.width, 4)
    here = int(np.abs(offsets).argmin())
    scores = []
    for start in range(0, len(points), _CHUNK):
        part = slice(start, start + _CHUNK)
        size = pixel[part, None, None]
        square = size * (a[None, :, None] * across[part, None] + b[None, :, None] * upright[part, None])
        slid = points[part, None] + shift[None, :, None] * directions[part, None]
        samples = slid[:, :, None] + square[:, None]  # [c, K, P, 3]
        pictures = [_photograph(samples, view, cameras, sheet, targets) for view in chosen[part].unbind(1)]
        # what reaches over the outline correlates by its outline alone
        whole = [picture[..., 3].amin(dim=-1) > 0.9 for picture in pictures]
        patches = [_patch(picture[..., :3]) for picture in pictures]
        ncc = torch.stack([(patches[0] * other).sum((-1, -2)) for other in patches[1:]], dim=-1)
        both = torch.stack([whole[0] & other for other in whole[1:]], dim=-1)
        valid = seen[part, 1:] & seen[part, :1] & both[:, here]
        ncc = torch.where(both, ncc, 0.0)
        ncc = torch.where(valid[:, None], ncc, -2.0).sort(dim=-1, descending=True).values
        half = ((valid.sum(1) + 1) // 2).clamp(min=1)
        counted = (torch.arange(ncc.shape[-1], device=device) < half[:, None]).to(ncc)
        score = (ncc * counted[:, None]).sum(-1) / half[:, None]
        blank = patches[0].square().sum((-1, -2)).amin(dim=1) < 0.15
        scores.append(torch.where(((valid.sum(1) < 2) | blank)[:, None], torch.nan, score))
    return torch.cat(scores).cpu().numpy()


def _choose_views(
    points: torch.Tensor, faces: torch.Tensor, normals: torch.Tensor, targets: Targets, others: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Per vertex the views that look at it most directly: (view [V, 1 + M], whether it is seen [V, 1 + M], width of a
    pixel there in world units [V])."""
    facing = []
    width = torch.full((len(points),), torch.inf, device=points.device)
    for i in range(len(targets)):
        projected = project(points, targets.intrinsics[i], targets.world_to_camera[i])
        depth = rasterize_projected(projected, faces, targets.height, targets.width).depth
        z = projected[:, 2].clamp(min=1e-6)
        x, y = projected[:, 0] / z, projected[:, 1] / z
        inside = (projected[:, 2] > 1e-6) & (x > 2) & (x < targets.width - 2) & (y > 2) & (y < targets.height - 2)
        row, column = y.clamp(0, targets.height - 1).long(), x.clamp(0, targets.width - 1).long()
        camera = targets.world_to_camera[i].to(points)
        towards = torch.nn.functional.normalize(-camera[:3, :3].T @ camera[:3, 3] - points, dim=1)
        cosine = (towards * normals).sum(1)
        pixel = z / targets.intrinsics[i, 0, 0].to(z)
        slack = 3 * pixel / cosine.clamp(min=0.2)
        visible = inside & (cosine > _FACING) & (depth[row, column] > 0) & (z < depth[row, column] + slack)
        facing.append(torch.where(visible, cosine, 0.0))
        width = torch.where(visible, torch.minimum(width, pixel), width)
    cosine, chosen = torch.stack(facing, dim=1).topk(min(1 + others, len(targets)), dim=1)
    return chosen, cosine > 0, torch.where(width.isfinite(), width, 1.0)


def _photograph(
    samples: torch.Tensor, view: torch.Tensor, cameras: torch.Tensor, sheet: torch.Tensor, targets: Targets
) -> torch.Tensor:
    """Colour and coverage [c, K, P, 4] of points [c, K, P, 3], row n in view[n]; `sheet`: all photographs, stacked."""
    camera = cameras[view].to(samples)
    projected = torch.einsum("cij,ckpj->ckpi", camera[:, :, :3], samples) + camera[:, None, None, :, 3]
    z = projected[..., 2].clamp(min=1e-6)
    x = (projected[..., 0] / z).clamp(0.5, targets.width - 0.5)
    y = (projected[..., 1] / z).clamp(0.5, targets.height - 0.5) + targets.height * view[:, None, None]
    uv = torch.stack([x / targets.width, 1 - y / len(sheet)], dim=-1)
    return sample_texture(sheet, uv.contiguous())


def _patch(colours: torch.Tensor, contrast: float = _CONTRAST) -> torch.Tensor:
    """Patches [c, K, P, 3] without mean and of length 1; shorter where the deviation is not above `contrast`."""
    centred = colours - colours.mean(dim=2, keepdim=True)
    power = centred.square().sum((-1, -2), keepdim=True)
    return centred / (power + contrast**2 * centred.shape[-2] * 3).sqrt()


def _evidence(score: np.ndarray, offsets: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(offset to take float64 [V], its weight): the best of the scores shared with neighbours, refined by a parabola.

    0 with weight 1 where the patches agree already or nothing is better; weight 0 where the case is not clear.
    """
    known = np.isfinite(score[:, :1])
    values = np.where(known, score, 0.0).astype(np.float64)
    total, number = values.copy(), known.astype(np.float64)
    for a, b in (edges.T, edges.T[::-1]):
        np.add.at(total, a, values[b])
        np.add.at(number, a, known[b].astype(np.float64))
    shared = total / np.maximum(number, 1)
    best = shared.argmax(axis=1)
    inner = np.clip(best, 1, len(offsets) - 2)
    rows = np.arange(len(score))
    left, middle, right = (shared[rows, inner + k] for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    shift = np.where(bend < -1e-9, 0.5 * (left - right) / np.where(bend < -1e-9, bend, 1.0), 0.0)
    spacing = offsets[1] - offsets[0]
    place = np.where(best == inner, offsets[inner] + np.clip(shift, -1, 1) * spacing, offsets[best])
    here = shared[:, np.abs(offsets).argmin()]
    gain = shared[rows, best] - here
    any_known = number[:, 0] > 0
    clear = any_known & (shared[rows, best] > _CLEAR) & (gain > _GAIN) & (here < _AGREES)
    backing = np.bincount(edges[:, 0], clear[edges[:, 1]], len(score))
    backing += np.bincount(edges[:, 1], clear[edges[:, 0]], len(score))
    clear &= backing >= 2
    stays = any_known & ~clear & ((here >= _AGREES) | (gain < _GAIN / 3))
    return np.where(clear, place, 0.0), np.where(clear, 3 * gain, stays.astype(np.float64))


def _interpolate(best: np.ndarray, weight: np.ndarray, edges: np.ndarray, smoothness: float) -> np.ndarray:
    """argmin over d of sum w (d - best)^2 + smoothness sum over edges (d_i - d_j)^2, held at 0 by a trace."""
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import spsolve

    n = len(best)
    ends = np.concatenate([edges, edges[:, ::-1]])
    adjacency = coo_matrix((np.ones(len(ends)), ends.T), (n, n)).tocsr()
    laplacian = diags(np.asarray(adjacency.sum(1)).ravel()) - adjacency
    matrix = diags(weight + 1e-3) + smoothness * laplacian
    return np.asarray(spsolve(matrix.tocsc(), weight * best))
