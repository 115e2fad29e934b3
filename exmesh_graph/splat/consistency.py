"""What planar Gaussians must agree on: their own normals and depth, and the depth and the photographs of a neighbour.

Terms of PGSR (Chen et al. 2024, sections 3.3 and 3.4), all means over the picture or over the sampled pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import torch

from exmesh_graph.priors.depth_filter import normals_of_depth
from exmesh_graph.splat.render import Render, plane_depth

_PATCH = 3  # half the side of compared patches: 7 x 7
_MISMATCH = 0.9
_CONTRAST = 0.01


class View(NamedTuple):
    """A picture with its camera: image [H, W, 3] display colour, rays [H, W, 3], float32 intrinsics [3, 3] and
    world_to_camera [4, 4] in float64."""

    image: torch.Tensor
    rays: torch.Tensor
    intrinsics: torch.Tensor
    world_to_camera: torch.Tensor


def flattening(scales: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Mean thickness (world units) of the Gaussians seen: exp of the smallest of log scales [G, 3]."""
    if not bool(seen.any()):
        return scales.new_zeros(())
    return scales[seen].amin(dim=1).exp().mean()


def single_view_normal(drawing: Render, view: View) -> torch.Tensor:
    """Mean over the picture of w |n(depth) alpha - N|_1, w small at edges of the photograph."""
    depth, valid = plane_depth(drawing.normal, drawing.distance, drawing.alpha, view.rays)
    normals, inner = normals_of_depth(depth, valid, view.rays)
    difference = (normals * drawing.alpha.detach()[..., None] - drawing.normal).abs().sum(-1)
    return torch.where(inner, edge_weight(view.image) * difference, 0.0).mean()


def multi_view(
    drawing: Render, view: View, other_drawing: Render, other: View, pixels: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """(geometric, photometric) terms at flat pixel indices `pixels` [P] of `view`; the neighbour is held fixed.

    Geometric: a pixel's point is looked up in the neighbour's depth map, and the point found there brought back; phi is
    by how many pixels it misses. Mean of w phi, w = exp(-phi) where phi < 1 pixel, else 0.
    Photometric: mean of w (1 - NCC^2), where below 0.9, of 7 x 7 grey patches under the homography of the plane seen.
    Both are 0 where nothing is comparable.
    """
    height, width = drawing.alpha.shape
    depth, valid = plane_depth(drawing.normal, drawing.distance, drawing.alpha, view.rays)
    with torch.no_grad():
        other_depth, _ = plane_depth(other_drawing.normal, other_drawing.distance, other_drawing.alpha, other.rays)
    pixels = pixels[valid.reshape(-1)[pixels]]
    nothing = depth.new_zeros(())
    if len(pixels) == 0:
        return nothing, nothing
    like = depth.detach()
    relative = other.world_to_camera @ torch.linalg.inv(view.world_to_camera)
    turn, shift = relative[:3, :3].to(like), relative[:3, 3].to(like)
    forth, back = other.intrinsics.to(like), view.intrinsics.to(like)

    ray = view.rays.reshape(-1, 3)[pixels]
    moved = (depth.reshape(-1)[pixels, None] * ray) @ turn.T + shift
    place, inside = _pixel(moved, forth, height, width)
    seen_depth, known = _depth_at(other_depth, place, inside)
    there = seen_depth[:, None] * _ray(place, forth)
    returned, _ = _pixel((there - shift) @ turn, back, height, width)
    here = torch.stack([pixels % width, pixels // width], dim=1).to(like) + 0.5
    miss = ((returned - here).square().sum(1) + 1e-12).sqrt()
    with torch.no_grad():
        weight = torch.where(known & (miss < 1), torch.exp(-miss), 0.0)
    near = torch.nonzero(weight)[:, 0]
    if len(near) == 0:
        return nothing, nothing
    geometric = (weight[near] * miss[near]).sum() / len(pixels)

    plane = drawing.normal.reshape(-1, 3)[pixels[near]] / drawing.distance.reshape(-1)[pixels[near], None]
    score, compared = patch_mismatch(view, other, plane, pixels[near], forth @ turn, forth @ shift)
    with torch.no_grad():
        share = torch.where(compared & (score < _MISMATCH), weight[near], 0.0)
    return geometric, (share * score).sum() / len(pixels)


def edge_weight(image: torch.Tensor, floor: float = 0.02) -> torch.Tensor:
    """[H, W] in [0, 1]: 1 where the picture [H, W, 3] is flat, 0 at its strongest edge; (1 - g / max g)^2.

    `floor` is the least maximum in display units: noise on a flat picture is no edge.
    """
    slope = _slope(image)
    return (1 - slope / slope.max().clamp(min=floor)).square()


def strongest_edge(image: torch.Tensor, floor: float = 0.02) -> torch.Tensor:
    """The largest slope of a picture [H, W, 3] in display units a pixel, at least `floor`."""
    return _slope(image).max().clamp(min=floor)


def _slope(image: torch.Tensor) -> torch.Tensor:
    grey = image.mean(-1)
    slope = torch.zeros_like(grey)
    if min(grey.shape) >= 3:
        across = (grey[1:-1, 2:] - grey[1:-1, :-2]) / 2
        down = (grey[2:, 1:-1] - grey[:-2, 1:-1]) / 2
        slope[1:-1, 1:-1] = torch.hypot(across, down)
    return slope


def patch_mismatch(
    view: View, other: View, plane: torch.Tensor, pixels: torch.Tensor, linear: torch.Tensor, offset: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """(1 - NCC^2 [P], bool [P] whether there is something to compare) of patches around `pixels`.

    plane  [P, 3], N / D: a ray r of the patch meets the plane at r / (plane . r), and the neighbour sees that point at
           linear r + offset (plane . r), homogeneous pixels: the plane's homography
    """
    height, width = view.image.shape[:2]
    steps = torch.arange(-_PATCH, _PATCH + 1, device=pixels.device)
    row, column = pixels // width, pixels % width
    rows, columns = (row[:, None, None] + steps[:, None]).expand(-1, -1, 7), column[:, None, None] + steps
    columns = columns.expand_as(rows)
    inside = (row >= _PATCH) & (row < height - _PATCH) & (column >= _PATCH) & (column < width - _PATCH)
    flat = (rows.clamp(0, height - 1) * width + columns.clamp(0, width - 1)).reshape(len(pixels), 49)
    mine = view.image.mean(-1).reshape(-1)[flat]
    rays = view.rays.reshape(-1, 3)[flat]
    ahead = (rays * plane[:, None]).sum(-1, keepdim=True)
    seen = rays @ linear.T + ahead * offset
    front = (seen[..., 2] * ahead[..., 0] > 0).all(1)  # the same sign: before the neighbour's camera
    place = seen[..., :2] / torch.where(front[:, None], seen[..., 2], 1.0)[..., None]
    size = place.new_tensor([width, height])
    inside = inside & front & ((place > 1) & (place < size - 1)).all(2).all(1)
    theirs = torch.nn.functional.grid_sample(
        other.image.mean(-1)[None, None], (2 * place / size - 1)[None].clamp(-2, 2), mode="bilinear",
        padding_mode="border", align_corners=False,
    )[0, 0]  # fmt: skip
    a, b = mine - mine.mean(1, keepdim=True), theirs - theirs.mean(1, keepdim=True)
    a_power, b_power = a.square().mean(1), b.square().mean(1)
    enough = inside & (a_power > _CONTRAST**2) & (b_power.detach() > _CONTRAST**2)
    correlation = (a * b).mean(1).square() / torch.where(enough, a_power * b_power, 1.0)
    return torch.where(enough, (1 - correlation).clamp(0, 2), 0.0), enough


def _pixel(
    points: torch.Tensor, intrinsics: torch.Tensor, height: int, width: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """(pixel coordinates [P, 2], bool [P] before the camera and a pixel inside the picture) of points [P, 3]."""
    front = points[:, 2] > 1e-6
    image = points / torch.where(front, points[:, 2], 1.0)[:, None] @ intrinsics.T
    place = image[:, :2]
    size = place.new_tensor([width, height])
    return place, front & ((place > 0.5) & (place < size - 0.5)).all(1)


def _ray(place: torch.Tensor, intrinsics: torch.Tensor) -> torch.Tensor:
    homogeneous = torch.cat([place, torch.ones_like(place[:, :1])], dim=1)
    return homogeneous @ torch.linalg.inv(intrinsics).T


def _depth_at(depth: torch.Tensor, place: torch.Tensor, inside: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(bilinear depth [P], known [P]): known where all four pixels around have one."""
    height, width = depth.shape
    x, y = (place[:, 0] - 0.5).clamp(0, width - 1.001), (place[:, 1] - 0.5).clamp(0, height - 1.001)
    left, top = x.detach().floor().long(), y.detach().floor().long()
    s, t = x - left, y - top
    flat = depth.reshape(-1)
    corner = top * width + left
    a, b, c, d = (flat[corner + step] for step in (0, 1, width, width + 1))
    known = inside & (a > 0) & (b > 0) & (c > 0) & (d > 0)
    return (a * (1 - s) + b * s) * (1 - t) + (c * (1 - s) + d * s) * t, known
