"""Planar Gaussians drawn to a picture, differentiable in all of their parameters: torch in and out, Warp inside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.limits import check_near, check_size
from exmesh_graph.gpu.warp_runtime import launch
from exmesh_graph.splat.fused.draw import Camera, Splat, numbers
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.runtime import kernels

NEAR = 1e-2
"""Least depth of a drawn Gaussian's mean in world units; the normalised world has the object in the unit sphere."""

TILE = {"cpu": 32, "cuda": 4}
"""Side of a tile in pixels; it changes the speed and not the picture."""

PAIRS = 1 << 22
"""(Gaussian, tile) pairs above which tiles are enlarged: about 100 bytes each."""


COVERED = 0.5
"""Coverage from which on a pixel has a depth."""

GRAZING = 0.05
"""Cosine of a ray and its plane below which there is no depth."""


@dataclass
class DrawnGaussians:
    """What a drawing says of each Gaussian.

    box       int32 [G, 4], first and last column and row reached (x0, y0, x1, y1); x1 < x0 where not drawn
    weight    [G], sum over the pixels of the blending weight: 0 for what is not seen
    middle    int32 [H, W], the Gaussian at which half of the light is gone; -1 where less than half is covered
    gradient  [G, 2], filled by the backward pass: |dL/d(x, y)| on screen of the mean in pixels, and the length of the
              sums over pixels of |dL/dx| and |dL/dy|, which do not cancel (the absolute-gradient rule)
    """

    box: torch.Tensor
    weight: torch.Tensor
    middle: torch.Tensor
    gradient: torch.Tensor

    @property
    def seen(self) -> torch.Tensor:
        """bool [G]."""
        return self.weight > 0


class Render(NamedTuple):
    """colour [H, W, 3] over black; alpha [H, W]; normal [H, W, 3] in camera axes and distance [H, W], both blended
    with the weights that sum up to alpha, hence not of unit length; `drawn`, what became of each Gaussian."""

    colour: torch.Tensor
    alpha: torch.Tensor
    normal: torch.Tensor
    distance: torch.Tensor
    drawn: DrawnGaussians


def render(
    gaussians: Gaussians,
    intrinsics: torch.Tensor,
    world_to_camera: torch.Tensor,
    height: int,
    width: int,
    *,
    near: float = NEAR,
    degree: int | None = None,
    tile: int | None = None,
    native: bool = True,
) -> Render:
    """Draw `gaussians` (float32; float64 for tests) to height x width pixels.

    intrinsics  [3, 3] in pixels, any principal point and skew;  world_to_camera [4, 4], rigid, OpenCV axes
    degree      of the harmonics in use, at most the stored one (default)
    tile        pixels; None: `TILE` of the device. Enlarged where the pairs of Gaussians and tiles would pass `PAIRS`
    native      whether float32 on a CPU takes the native passes (`fused.draw`), or Warp's kernels as all else does

    A Gaussian is drawn where its mean is deeper than `near`, its opacity at a pixel at least 1/255, and what is before
    it not opaque (transmittance >= 1e-4). Gaussians of equal depth are blended in their order. The same inputs give
    the same bytes. Raises ValueError for sizes beyond 32-bit indices, near <= 0, shapes or types that do not match.
    """
    check_near(near)
    check_size(pixels=height * width, gaussians=len(gaussians), colours=gaussians.sh.numel())
    stored = gaussians.degree
    degree = stored if degree is None else degree
    if not 0 <= degree <= stored:
        raise ValueError(f"harmonics of degree {degree} were asked for, the Gaussians hold degree {stored}")
    for name, tensor in gaussians.tensors().items():
        if tensor.dtype != gaussians.means.dtype or len(tensor) != len(gaussians):
            raise ValueError(f"{name} is {tensor.dtype} {tuple(tensor.shape)}, the means are {gaussians.means.dtype} "
                             f"{tuple(gaussians.means.shape)}")  # fmt: skip
    device = gaussians.means.device
    camera = numbers(intrinsics.to(device), world_to_camera.to(device))
    drawn = DrawnGaussians(
        torch.zeros((len(gaussians), 4), dtype=torch.int32, device=device),
        gaussians.means.new_zeros(len(gaussians)),
        torch.full((height, width), -1, dtype=torch.int32, device=device),
        gaussians.means.new_zeros((len(gaussians), 2)),
    )
    camera, tile = camera.to(gaussians.means.dtype), tile or TILE[device.type]
    if native and device.type == "cpu" and camera.dtype == torch.float32:
        seen_by = Camera(camera, height, width, near, degree, tile)
        colour, alpha, normal, distance = Splat.apply(*gaussians.tensors().values(), seen_by, PAIRS, drawn)
        return Render(colour, alpha, normal, distance, drawn)
    view = (camera, height, width, near, degree, tile)
    planes = _Splat.apply(*(t.contiguous() for t in gaussians.tensors().values()), view, drawn)
    return Render(planes[..., :3], planes[..., 7], planes[..., 3:6], planes[..., 6], drawn)


def plane_depth(
    normal: torch.Tensor, distance: torch.Tensor, alpha: torch.Tensor, rays: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """(depth [H, W] along the camera's axis, valid bool [H, W]) of blended normals, distances and coverage.

    A picture holds N = sum w n and D = sum w d of planes n . x = d in camera axes. The ray r of a pixel (z = 1) meets
    the blended plane at depth z = D / (N . r): weights cancel, so that depth lies on the plane however transparent the
    pixel is, and not at Gaussians' centres (Chen et al. 2024, unbiased depth). Plain torch, differentiable.

    Not valid, and 0, where less than half is covered or the plane is seen at less than about 3 degrees.
    """
    facing = (normal * rays).sum(-1)
    with torch.no_grad():
        length = (normal.square().sum(-1) * rays.square().sum(-1)).sqrt()
        valid = (alpha > COVERED) & (facing < -GRAZING * length) & (distance < 0)
    return torch.where(valid, distance / torch.where(valid, facing, -1.0), 0.0), valid


class _Pairs(NamedTuple):
    """Which Gaussian is drawn in which tile.

    order     int64 [n], the drawn Gaussians, nearest first
    first     int64 [n + 1], their first slots: one for each touched tile
    of        int32 [slots], a slot's Gaussian
    sorted    int64 [slots], slots by tile and then by depth;  start int64 [tiles + 1], where each tile's begin
    """

    order: torch.Tensor
    first: torch.Tensor
    of: torch.Tensor
    sorted: torch.Tensor
    start: torch.Tensor
    tile: int
    across: int


class _Splat(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, means, scales, rotations, opacities, sh, view, drawn):
        camera, height, width, near, degree, tile = view
        count, pixels = len(means), height * width
        screen, shape, feature = means.new_empty((count, 2)), means.new_empty((count, 4)), means.new_empty((count, 8))
        depth = means.new_empty(count)
        drawn.box[:, 2] = -1
        projection, blending = (kernels(of, means.dtype) for of in ("project", "blend"))
        parameters = (means, scales, rotations, opacities, sh, degree, camera, height, width)
        out, left = means.new_zeros((pixels, 8)), means.new_ones(pixels)
        last = torch.zeros(pixels, dtype=torch.int32, device=means.device)
        ctx.pairs = None
        if count and pixels:
            launch(projection.project, count, *parameters, near, screen, shape, feature, drawn.box, depth)
            pairs = _pairs(drawn.box, depth, height, width, tile, blending)
            if len(pairs.order):
                lists = (pairs.start, pairs.sorted, pairs.of, screen, shape, feature, drawn.box)
                weights = means.new_zeros(len(pairs.of))
                size = (pairs.tile, pairs.across, height, width)
                launch(
                    blending.blend, len(pairs.start) - 1, *lists, *size, out, left, last, drawn.middle.view(-1), weights
                )
                launch(blending.sum_slots, len(pairs.order), pairs.order, pairs.first, weights, drawn.weight)
                ctx.pairs = pairs
                ctx.lists, ctx.rest, ctx.drawn = lists, (left, last), drawn
        ctx.view = view
        ctx.save_for_backward(means, scales, rotations, opacities, sh)
        return out.view(height, width, 8)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad):
        means, scales, rotations, opacities, sh = saved = ctx.saved_tensors
        camera, height, width, _, degree, _ = ctx.view
        grads = [torch.zeros_like(tensor) for tensor in saved]
        pairs = ctx.pairs
        if pairs is not None:
            projection, blending = kernels("project", means.dtype), kernels("blend", means.dtype)
            slots = means.new_empty((len(pairs.of), 16))
            left, last = ctx.rest
            left = left.clone()  # consumed below, and backward may run again
            behind = torch.zeros_like(left)
            grad = grad.reshape(-1, 8).contiguous()
            size = (pairs.tile, pairs.across, height, width)
            launch(blending.blend_adjoint, len(pairs.start) - 1, *ctx.lists, *size, last, grad, left, behind, slots)
            launch(
                projection.project_adjoint, len(pairs.order), pairs.order, pairs.first, slots,
                means, scales, rotations, opacities, sh, degree, camera, height, width,
                ctx.lists[5], ctx.lists[4], *grads, ctx.drawn.gradient,
            )  # fmt: skip
        return *grads, None, None


def _pairs(box: torch.Tensor, depth: torch.Tensor, height: int, width: int, tile: int, tiling: Any) -> _Pairs:
    """Sort by depth, then list the touched tiles of each Gaussian and sort these by tile."""
    order = torch.nonzero(box[:, 2] >= box[:, 0])[:, 0]
    order = order[torch.argsort(depth[order], stable=True)]
    reached = box[order]
    while True:
        low, high = (torch.div(corner, tile, rounding_mode="floor") for corner in (reached[:, :2], reached[:, 2:]))
        touched = (high - low + 1).prod(dim=1)
        first = torch.nn.functional.pad(touched.cumsum(0, dtype=torch.int64), (1, 0))
        total = int(first[-1])
        if total <= PAIRS or tile >= max(height, width):
            break
        tile *= 2
    check_size(**{"pairs of Gaussians and tiles": total})
    across, down = -(-width // tile), -(-height // tile)
    tile_of = torch.empty(total, dtype=torch.int32, device=box.device)
    of = torch.empty(total, dtype=torch.int32, device=box.device)
    if total:
        launch(tiling.list_tiles, len(order), order, box, first, tile, across, tile_of, of)
    by_tile, slots = torch.sort(tile_of, stable=True)
    bounds = torch.arange(across * down + 1, dtype=torch.int32, device=box.device)
    start = torch.searchsorted(by_tile, bounds)
    return _Pairs(order, first, of, slots, start, tile, across)
