"""The few coarse pictures that a probe looks at: some to fit, others kept out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from exmesh_graph.types import Views

#: Views to fit and to keep out, object pixels of a coarse view, and from how many views on whole ones are kept out.
FITTED, HELD, VIEW_PIXELS, ENOUGH = 12, 4, 2000, 6
#: Where whole views cannot be spared, one pixel in five of each is kept out, none beside another.
APART = 5


@dataclass(frozen=True)
class Sample:
    """Coarse views: the first `fitted` rows are fitted, the rest held out. `factor` pixels became one."""

    views: Views
    fitted: int
    factor: int


def sample_views(views: Views, fitted: int = FITTED, held: int = HELD, view_pixels: int = VIEW_PIXELS) -> Sample:
    """Some views, evenly over their order, reduced so that the object covers about `view_pixels` of each.

    With fewer than `ENOUGH` views none can be spared: every fifth pixel of each is kept out instead.
    """
    count = len(views)
    if count >= ENOUGH:
        held = min(held, max(2, count // 4))
        chosen = np.unique(np.linspace(0, count - 1, min(count, fitted + held)).round().astype(int))
        middle = (np.arange(held) + 0.5) * len(chosen) / held
        out = np.zeros(len(chosen), bool)
        out[middle.astype(int)] = True
        order = np.concatenate([chosen[~out], chosen[out]])
        coarse, factor = _coarse(views, order, view_pixels)
        return Sample(coarse, int((~out).sum()), factor)
    coarse, factor = _coarse(views, np.arange(count), view_pixels)
    row, column = np.indices(coarse.alpha.shape[1:])
    kept_out = (row + 2 * column) % APART == 0
    doubled = coarse.subset(np.concatenate([np.arange(count)] * 2))
    alpha = doubled.alpha * np.where(np.arange(2 * count)[:, None, None] < count, ~kept_out, kept_out)
    return Sample(replace(doubled, alpha=alpha.astype(np.float32)), count, factor)


def _coarse(views: Views, order: np.ndarray, view_pixels: int) -> tuple[Views, int]:
    inside = max(float((views.alpha[order] > 0.5).mean(axis=0).sum()), 1.0)
    factor = max(1, min(round(np.sqrt(inside / view_pixels)), min(views.height, views.width) // 8))
    height, width = views.height // factor, views.width // factor

    def mean(values: np.ndarray) -> np.ndarray:
        cut = values[order][:, : height * factor, : width * factor]
        blocks = cut.reshape(len(order), height, factor, width, factor, *values.shape[3:])
        return blocks.mean(axis=(2, 4), dtype=np.float64).astype(np.float32)

    intrinsics = np.array(views.intrinsics[order], np.float64)
    intrinsics[:, :2] /= factor
    chosen = views.subset(order)
    return replace(chosen, images=mean(views.images), alpha=mean(views.alpha), intrinsics=intrinsics), factor
