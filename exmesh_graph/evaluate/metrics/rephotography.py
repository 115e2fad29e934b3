"""How well a surface without a texture foretells held-out photographs: the training photographs, warped over it.

Virtual rephotography (Waechter et al. 2017, "Virtual Rephotography: Novel View Prediction Error for 3D
Reconstruction"): it needs no true surface, and a wrong depth shows as a picture that does not fit. A surface that
cannot be seen from the training views, or not from the held-out ones, has no say.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from scipy.ndimage import binary_erosion, gaussian_filter

from exmesh_graph.errors import DataError
from exmesh_graph.gpu.cores import share
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.raster import project, rasterize_projected
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.types import Views

_DETAIL = 2.0  # pixels
_SPREAD = 10.0  # degrees: how fast a photograph taken from elsewhere loses its say
Surface = tuple[np.ndarray, np.ndarray]
_FOOTPRINTS = 3.0  # depths that differ by fewer pixels' widths at that depth are of one surface


@dataclass(frozen=True)
class Rephotographs:
    """Of each held-out view: linear colour float32 [N, H, W, 3], 0 where there is none, `covered` bool [N, H, W] by the
    surface, `seen` bool [N, H, W] by a training view too."""

    images: np.ndarray
    covered: np.ndarray
    seen: np.ndarray


def rephotograph(
    vertices: np.ndarray, faces: np.ndarray, train: Views, held_out: Views, *, nearest: int = 8
) -> Rephotographs:
    """The held-out views of the mesh (vertices [V, 3], faces [F, 3]), coloured by the training photographs.

    A point's colour is the mean of the training views, of the `nearest` ones in direction, that see it by the mesh's
    own depth, weighted by exp(-(angle / 10 degrees)^2) between their rays to it and the held-out view's.
    """
    mesh = (
        torch.from_numpy(np.ascontiguousarray(vertices, np.float32)),
        torch.from_numpy(np.ascontiguousarray(faces, np.int32)),
    )
    own = share(lambda view: _depth(mesh, train, view), range(len(train)))

    def one(view: int, others: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        depth = _depth(mesh, held_out, view)
        pose = torch.from_numpy(held_out.camera_to_world[view]).float()
        rays = pixel_rays(torch.from_numpy(held_out.intrinsics[view]), held_out.height, held_out.width, depth)
        shown = depth > 0
        points = (depth[shown][:, None] * rays[shown]) @ pose[:3, :3].T + pose[:3, 3]
        here = torch.nn.functional.normalize(points - pose[:3, 3], dim=-1)
        total = torch.zeros(len(points), 4)
        for other in others.tolist():
            colour, sees, there = _fetch(points, train, other, own[other])
            cosine = (here * there).sum(-1).clamp(-1, 1)
            weight = torch.exp(-(torch.rad2deg(torch.acos(cosine)) / _SPREAD).square()) + 1e-6
            total += torch.where(sees[:, None], weight[:, None] * colour, 0.0)
        image, seen = torch.zeros(*depth.shape, 3), torch.zeros_like(shown)
        seen[shown] = known = total[:, 3] > 0
        image[shown] = torch.where(known[:, None], total[:, :3] / total[:, 3:].clamp(min=1e-12), 0.0)
        return image, shown, seen

    made = share(one, range(len(held_out)), _nearest(train, held_out, nearest))
    return Rephotographs(*(torch.stack(items).numpy() for items in zip(*made, strict=True)))


def prediction_psnr(made: Rephotographs, held_out: Views, regions: np.ndarray) -> np.ndarray:
    """PSNR in dB, sRGB, within `regions` bool [N, H, W] of each view that has one; black where nothing was foretold.

    One factor per view and channel (least squares on linear values) is left free: exposure is no matter of shape.
    Raises DataError where no region holds a pixel.
    """
    return prediction_scores(made, held_out, regions).picture


class Scores(NamedTuple):
    """dB of each view, float64 [N]: PSNR; and of what differs from pixel to pixel alone, by its mean difference."""

    picture: np.ndarray
    detail: np.ndarray


def prediction_scores(made: Rephotographs, held_out: Views, regions: np.ndarray) -> Scores:
    """As `prediction_psnr`, and the same of the details: of what a Gaussian of two pixels takes out of the picture.

    Details are paint. What gloss shows changes slowly over a picture: a pit that mirrors it right blurs the paint.
    """
    if not regions.any():
        raise DataError(
            "no pixel of the held-out views is to be compared", where="rephotography", fix="look at the regions"
        )

    def one(image: np.ndarray, truth: np.ndarray, region: np.ndarray) -> tuple[float, float]:
        ours, theirs = image[region].astype(np.float64), truth[region].astype(np.float64)
        gain = (ours * theirs).sum(0) / np.maximum(np.square(ours).sum(0), 1e-12)
        apart = _shown(gain * image) - _shown(truth)
        return (
            -10 * np.log10(max(float(np.square(apart[region]).mean()), 1e-10)),
            -20 * np.log10(max(float(np.abs(_detail(apart, region)).mean()), 1e-5)),
        )

    some = [k for k, region in enumerate(regions) if region.any()]
    pictures = ((made.images[k], held_out.images[k], regions[k]) for k in some)
    scores = share(lambda three: one(*three), pictures)
    return Scores(*np.array(scores).T)


def _detail(picture: np.ndarray, region: np.ndarray) -> np.ndarray:
    """float64 [P, C]: pixels of a region bool [H, W] less what lies around them in it, of a picture [H, W, C]."""
    weight = np.maximum(gaussian_filter(region.astype(np.float64), _DETAIL), 1e-3)
    around = [
        gaussian_filter(part * region, _DETAIL) / weight for part in np.moveaxis(picture.astype(np.float64), -1, 0)
    ]
    return picture[region] - np.stack(around, axis=-1)[region]


class Foretold:
    """How well the photographs foretell every third of them, which is left out, over one surface or another."""

    def __init__(self, views: Views, every: int = 3) -> None:
        """Raises DataError with fewer than five views to leave out."""
        held = np.arange(every // 2, len(views), every)
        if len(held) < 5:
            raise DataError(
                f"{len(views)} views are too few to leave some out", where="rephotography", expected="15 views"
            )
        self.rest = views.subset(np.setdiff1d(np.arange(len(views)), held))
        self.held_out = views.subset(held)
        self.inside = np.stack([_within(alpha > 0.5) for alpha in self.held_out.alpha])

    def scores(self, surface: Surface) -> Scores:
        """Of each left-out view that has a mask, inside it.

        A mask's rim of a pixel has no say: outlines that are off by half a pixel would outweigh what lies between.
        """
        return prediction_scores(rephotograph(*surface, self.rest, self.held_out), self.held_out, self.inside)


def gain(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """(mean gain of the second [N], one part of the `Scores` of a surface, over the first, dB; its standard error)."""
    gains = second - first
    return float(gains.mean()), float(gains.std(ddof=1) / np.sqrt(len(gains)))


def _within(mask: np.ndarray) -> np.ndarray:
    """bool [H, W]: the mask without its rim of a pixel; as it is where nothing else is left."""
    inner = binary_erosion(mask, np.ones((3, 3), bool), border_value=1)
    return inner if inner.any() else mask


def _shown(linear: np.ndarray) -> np.ndarray:
    return linear_to_srgb(np.clip(linear, 0, 1))


def _depth(mesh: tuple[torch.Tensor, torch.Tensor], views: Views, view: int) -> torch.Tensor:
    intrinsics, pose = torch.from_numpy(views.intrinsics[view]), torch.from_numpy(views.world_to_camera[view])
    return rasterize_projected(project(mesh[0], intrinsics, pose), mesh[1], views.height, views.width, bary=False).depth


def _nearest(train: Views, held_out: Views, count: int) -> np.ndarray:
    """Index [N, count] of the training views whose axes point most nearly the same way."""
    cosine = held_out.camera_to_world[:, :3, 2] @ train.camera_to_world[:, :3, 2].T
    return np.argsort(-cosine, axis=1, kind="stable")[:, :count]


def _fetch(
    points: torch.Tensor, views: Views, view: int, depth: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(premultiplied colour and alpha [P, 4], seen bool [P], unit rays [P, 3]) of points [P, 3] in one view."""
    pose = torch.from_numpy(views.world_to_camera[view]).float()
    k = torch.from_numpy(views.intrinsics[view]).float()
    local = points @ pose[:3, :3].T + pose[:3, 3]
    z = local[:, 2].clamp(min=1e-6)
    place = (local / z[:, None]) @ k.T
    at = torch.stack([2 * place[:, 0] / views.width - 1, 2 * place[:, 1] / views.height - 1], dim=-1)
    layers = np.concatenate([views.images[view], views.alpha[view][..., None]], axis=-1)
    stack = torch.cat([torch.from_numpy(np.ascontiguousarray(layers)).float(), depth[..., None]], dim=-1)
    fetch = torch.nn.functional.grid_sample
    image = fetch(stack[..., :4].permute(2, 0, 1)[None], at[None, None], mode="bilinear", align_corners=False)[0, :, 0]
    seen = fetch(stack[..., 4:].permute(2, 0, 1)[None], at[None, None], mode="nearest", align_corners=False)[0, 0, 0]
    footprint = z / k[:2, :2].det().abs().sqrt()
    inside = (local[:, 2] > 0) & (at.abs() < 1).all(-1) & (image[3] > 0.5)
    eye = torch.from_numpy(views.camera_to_world[view][:3, 3]).float()
    rays = torch.nn.functional.normalize(points - eye, dim=-1)
    return image.T, inside & (seen > 0) & ((seen - z).abs() < _FOOTPRINTS * footprint), rays
