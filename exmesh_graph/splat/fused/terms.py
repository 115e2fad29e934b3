"""The terms that Gaussians are fitted by, with their gradients in the planes of a drawing: float32 on a CPU.

Equal to `fit`'s plain terms and `consistency`, whose autograd they are tested against. Weighted gradients are written
or added to planes of the caller; values are returned unweighted.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import torch

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.losses import ssim_and_gradient
from exmesh_graph.splat.consistency import View, strongest_edge
from exmesh_graph.splat.fused.draw import Planes
from exmesh_graph.splat.fused.native_terms import MARGIN
from exmesh_graph.splat.render import GRAZING
from exmesh_graph.targets import Targets


class Weights(NamedTuple):
    """Of the terms of a picture: share of 1 - SSIM in the colour's, coverage against the mask."""

    ssim: float
    mask: float


class Surface(NamedTuple):
    """What a view shows: padded planes of depth (0: none) and of the photograph's grey."""

    depth: torch.Tensor
    grey: torch.Tensor


class Terms:
    """Of pictures of one size; keeps their planes between iterations."""

    def __init__(self, height: int, width: int) -> None:
        self.height, self.width = height, width
        self.bands = -(-height // int(_kernels().ROWS_EACH))
        size = height * width + 2 * MARGIN
        self.surfaces = [Surface(torch.zeros(size), torch.zeros(size)) for _ in range(2)]
        self.pulls = torch.zeros(4, size)
        self.to = Planes(
            torch.zeros(height, width, 3), torch.zeros(height, width), torch.zeros(height, width, 3),
            torch.zeros(height, width),
        )  # fmt: skip

    def colour(
        self, planes: Planes, targets: Targets, i: int, weights: Weights, gain: torch.Tensor | None
    ) -> tuple[float, float]:
        """(weighted sum of L1, 1 - SSIM and the mask's L1; mean squared error) against view `i`; sets `to` of colour
        and coverage. `gain` [3] or None: what the picture is multiplied by."""
        pixels = self.height * self.width
        image = planes.colour if gain is None else planes.colour * gain
        box = targets.box(i)
        share, similarity, in_box, bounds = weights.ssim * box.area / pixels, 1.0, image, (0, 0, 0, 0)
        if weights.ssim > 0:
            value, in_box = ssim_and_gradient(box.crop(image), targets.ssim_target(i))
            similarity, bounds = float(value), (box.top, box.bottom, box.left, box.right)
        by_miss = (1 - weights.ssim) / (3 * pixels)
        by_mask = weights.mask / pixels if bool(targets.masked[i]) else 0.0
        totals = torch.empty(self.bands, 3, dtype=torch.float64)
        split(
            _kernels().compare, self.bands, self.height, self.width, *bounds, by_miss, -share, by_mask,
            int(gain is not None), self.pulls if gain is None else gain, image, targets.images[i], planes.alpha,
            targets.alpha[i], in_box, self.to.colour, self.to.alpha, totals, grain=2,
        )  # fmt: skip
        miss, square, uncovered = totals.sum(0).tolist()
        return by_miss * miss + share * (1 - similarity) + by_mask * uncovered, square / (3 * pixels)

    def no_geometry(self) -> None:
        """Clears `to` of normals and distances."""
        self.to.normal.zero_()
        self.to.distance.zero_()

    def normals(self, planes: Planes, view: View, weight: float, strongest: float) -> float:
        """`consistency.single_view_normal`; sets `to` of normals and distances. Leaves the view's depths for
        `neighbour`. `strongest`: the photograph's strongest edge."""
        self._surface(0, planes, view)
        size, lens = (self.height, self.width), _lens(view)
        totals = torch.empty(self.bands, dtype=torch.float64)
        mine = self.surfaces[0]
        split(
            _kernels().compare_normals, self.bands, *size, weight / (self.height * self.width), strongest, lens,
            planes.normal, planes.alpha, mine.depth, mine.grey, self.to.normal, self.pulls, totals, grain=2,
        )  # fmt: skip
        split(
            _kernels().pull_back, self.bands, *size, lens, planes.distance, mine.depth, self.pulls, self.to.normal,
            self.to.distance, grain=2,
        )  # fmt: skip
        return float(totals.sum()) / (self.height * self.width)

    def neighbour(
        self,
        planes: Planes,
        view: View,
        other_planes: Planes,
        other: View,
        pixels: torch.Tensor,
        weights: tuple[float, float],
    ) -> tuple[float, float]:
        """`consistency.multi_view` after `normals` of the view; adds to `to` of normals and distances.

        pixels   int64 [P], none twice;  weights of the geometric and the photometric term
        """
        compared = int((self.surfaces[0].depth[MARGIN + pixels] > 0).sum())
        if compared == 0:
            return 0.0, 0.0
        self._surface(1, other_planes, other)
        relative = other.world_to_camera @ torch.linalg.inv(view.world_to_camera)
        turn, shift = relative[:3, :3], relative[:3, 3]
        forth, back = other.intrinsics.double(), view.intrinsics.double()
        parts = (turn, shift, back[:2], torch.linalg.inv(back)[:2], forth[:2], torch.linalg.inv(forth)[:2],
                 forth @ turn, forth @ shift)  # fmt: skip
        relation = torch.cat([part.reshape(-1) for part in parts]).float()
        k, (mine, theirs) = _kernels(), self.surfaces
        items = -(-len(pixels) // int(k.SAMPLES_EACH))
        totals = torch.empty(items, 2, dtype=torch.float64)
        geometric, photometric = (weight / compared for weight in weights)
        split(
            k.compare_views, items, len(pixels), self.height, self.width, geometric, photometric, pixels, relation,
            planes.normal, planes.distance, mine.depth, mine.grey, theirs.depth, theirs.grey, self.to.normal,
            self.to.distance, totals, grain=2,
        )  # fmt: skip
        found = (totals.sum(0) / compared).tolist()
        return found[0], found[1]

    def _surface(self, which: int, planes: Planes, view: View) -> None:
        split(
            _kernels().depths, self.bands, self.height, self.width, GRAZING, _lens(view), planes.normal,
            planes.distance, planes.alpha, view.image, *self.surfaces[which], grain=2,
        )  # fmt: skip


def strongest(image: torch.Tensor) -> float:
    """The strongest edge of a photograph, as `Terms.normals` takes it."""
    return float(strongest_edge(image))


def _lens(view: View) -> torch.Tensor:
    """From pixels to rays of z = 1: the first two rows of K^-1, float32."""
    return torch.linalg.inv(view.intrinsics.double())[:2].float().contiguous()


@cache
def _kernels() -> Any:
    """Imported after Warp has been set up."""
    warp()
    from exmesh_graph.splat.fused import kernels_terms

    return kernels_terms
