"""The photographs as solvers see them: display-referred, over black, at the working resolution, one gain per view."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.gpu.cores import share
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.losses import Box, SsimTarget, mask_box, ssim_target
from exmesh_graph.raster import project, rasterize_projected, shown_vertices
from exmesh_graph.targets.visits import PIXEL_BYTES, Plane, shown
from exmesh_graph.types import DepthMaps, Mesh, Views
from exmesh_graph.types.pictures import LARGE

GAIN_RATE = 0.3
GAIN_LIMITS = (0.5, 2.0)
MEMORY_GIB = 4.0
SSIM_CACHE_BYTES = 1 << 30


class Shown(NamedTuple):
    """Whether each view shows each vertex of a mesh, bool [N, V], and how many pixels of all views show its faces."""

    vertices: torch.Tensor
    pixels: int


@dataclass
class Targets:
    """N views on one device.

    images           float32 [N, H, W, 3], sRGB(clip(rgb / alpha)) * alpha
    alpha            float32 [N, H, W];  both are Planes where they do not fit into memory: `images[i]` in either case
    intrinsics       float64 [N, 3, 3], world_to_camera float64 [N, 4, 4]
    names            as in Views
    masked           bool [N] on the CPU, views whose mask is known
    depth            float32 [N, H, W] or None, the reference of L_d; 0 where unknown
    inside           bool [N, H, W] or None, the pixels that count where there are no masks
    ssim_bytes       what the views' SSIM statistics may take
    """

    images: torch.Tensor | Plane
    alpha: torch.Tensor | Plane
    intrinsics: torch.Tensor
    world_to_camera: torch.Tensor
    names: tuple[str, ...]
    masked: torch.Tensor
    depth: torch.Tensor | None = None
    inside: torch.Tensor | None = None
    ssim_bytes: float = SSIM_CACHE_BYTES
    _boxes: dict[int, Box] = field(default_factory=dict)
    _ssim: dict[int, SsimTarget] = field(default_factory=dict)
    _shown: tuple[torch.Tensor, torch.Tensor, Shown] | None = None

    def __len__(self) -> int:
        return len(self.names)

    @property
    def height(self) -> int:
        return self.alpha.shape[1]

    @property
    def width(self) -> int:
        return self.alpha.shape[2]

    @property
    def device(self) -> torch.device:
        return self.images.device

    def expect(self, view: int) -> None:
        """Say which view comes next, so that it can be made meanwhile."""
        if isinstance(self.images, Plane):
            self.images.visited.expect(view)

    def box(self, view: int) -> Box:
        """The box around the view's mask, grown by SSIM's half window."""
        if view not in self._boxes:
            self._boxes[view] = mask_box(self.alpha[view] > 0 if self.inside is None else self.inside[view])
        return self._boxes[view]

    def shown(self, vertices: torch.Tensor, faces: torch.Tensor) -> Shown:
        """What the views show of a mesh, [V, 3] and integer [F, 3]; the last answer is kept, for when the same is asked
        again."""
        vertices, kept = vertices.detach(), self._shown
        if kept and torch.equal(kept[0], vertices) and torch.equal(kept[1], faces):
            return kept[2]
        whole, size = faces.long(), (self.height, self.width)

        @torch.no_grad()  # a thread's own switch
        def one(k: torch.Tensor, pose: torch.Tensor) -> tuple[torch.Tensor, int]:
            face_id = rasterize_projected(project(vertices, k, pose), faces, *size, bary=False).face_id
            return shown_vertices(face_id, whole, len(vertices)), int((face_id >= 0).sum())

        seen, pixels = zip(*share(one, self.intrinsics, self.world_to_camera), strict=True)
        found = Shown(torch.stack(seen), sum(pixels))
        self._shown = vertices.clone(), faces, found
        return found

    def ssim_target(self, view: int) -> SsimTarget:
        """SSIM statistics of the view inside its box; kept where all of them fit into `ssim_bytes`."""
        if view in self._ssim:
            return self._ssim[view]
        box = self.box(view)
        statistics = ssim_target(box.crop(self.images[view]))
        if len(self) * box.area * 3 * 3 * 4 <= self.ssim_bytes:
            self._ssim[view] = statistics
        return statistics


def prepare_targets(
    views: Views,
    *,
    downscale: int = 1,
    depths: DepthMaps | None = None,
    region: Mesh | None = None,
    device: torch.device | str = "cpu",
    memory_gib: float = MEMORY_GIB,
) -> Targets:
    """Bring `views` to display colour at 1 / `downscale` of their size (exact area means in linear light).

    region      a surface for views without masks: only pixels that show it count (`Targets.inside`)
    memory_gib  what images and alpha may take; of a larger set the rest is made at each visit, with the same values.
                What they leave of it, and a gigabyte in any case, is for SSIM's statistics

    Sizes that `downscale` does not divide lose their last rows or columns. Raises DataError for views without
    pixels, and for depth maps that belong to other views or have another size.
    """
    if len(views) == 0:
        raise DataError("there are no views", where="stage1", expected="at least one training view")
    height, width = views.height // downscale, views.width // downscale
    if height == 0 or width == 0:
        raise DataError(
            f"downscale {downscale} leaves nothing of {views.width} x {views.height} pixels", where="stage1"
        )
    images, alpha = shown(views, downscale, device, memory_gib * 2**30)
    # pixel centres lie at +0.5, so a smaller image of the same view is a plain scaling of K's first two rows
    intrinsics = torch.from_numpy(np.array(views.intrinsics, np.float64))
    intrinsics[:, :2] /= downscale
    world_to_camera = torch.from_numpy(views.world_to_camera)
    return Targets(
        images=images,
        alpha=alpha,
        intrinsics=intrinsics,
        world_to_camera=world_to_camera,
        names=views.names,
        masked=tensor_of(views.masked),
        depth=None if depths is None else _depth(depths, views, downscale, height, width).to(device),
        ssim_bytes=ssim_budget(memory_gib * 2**30, len(views), height * width),
        inside=None if region is None else _covered(region, intrinsics, world_to_camera, height, width, device),
    )


def ssim_budget(memory: float, views: int, pixels: int) -> float:
    """Bytes for SSIM's statistics of so many `views`: what their pictures leave of `memory`, a gigabyte in any case."""
    return max(SSIM_CACHE_BYTES, memory - PIXEL_BYTES * views * pixels)


def reduction_to_hold(views: Views) -> int:
    """The least `downscale` at which all views together are below what is kept in memory (`types.pictures.LARGE`)."""
    sizes = ((k, (views.height // k) * (views.width // k)) for k in range(1, views.height + views.width))
    return next(k for k, pixels in sizes if PIXEL_BYTES * len(views) * pixels <= LARGE)


def shown_pixels(mesh: Mesh, views: Views) -> torch.Tensor:
    """bool [N, H, W], where each view shows the mesh."""
    intrinsics = torch.from_numpy(np.array(views.intrinsics, np.float64))
    return _covered(mesh, intrinsics, torch.from_numpy(views.world_to_camera), views.height, views.width, "cpu")


class Gains:
    """One factor per view and channel, for photographs of wandering exposure: `factors` [N, 3], fitted by `follow`.

    Used relative to their mean: together they cannot brighten the picture.
    """

    def __init__(self, targets: Targets) -> None:
        self.targets = targets
        self.factors = torch.ones((len(targets), 3), device=targets.device)

    def follow(self, view: int, image: torch.Tensor, rate: float = GAIN_RATE) -> None:
        """Let the view's factor approach the one that takes `image` [H, W, 3] to its photograph."""
        targets = self.targets
        self.factors[view] = fit_gain(image, targets.images[view], targets.alpha[view], self.factors[view], rate)

    def relative(self, view: int) -> torch.Tensor:
        """The view's factor [3] over the mean of all."""
        return self.factors[view] / self.factors.mean(dim=0)

    def named(self) -> dict[str, list[float]]:
        """The relative factors by view name."""
        relative = (self.factors / self.factors.mean(dim=0)).cpu().tolist()
        return dict(zip(self.targets.names, relative, strict=True))


def fit_gain(
    image: torch.Tensor, target: torch.Tensor, mask: torch.Tensor, before: torch.Tensor, rate: float = GAIN_RATE
) -> torch.Tensor:
    """The least-squares factor [3] from `image` to `target` [H, W, 3] inside `mask` [H, W], approached by `rate`.

    In display space a change of exposure is close to a factor too. Stays at `before` where the image is black.
    """
    weight = mask[..., None]
    power = (weight * image.square()).sum(dim=(0, 1))
    fitted = (weight * image * target).sum(dim=(0, 1)) / power.clamp(min=1e-12)
    fitted = torch.where(power > 1e-6, fitted, before).clamp(*GAIN_LIMITS)
    return torch.lerp(before, fitted, rate)


def _covered(
    mesh: Mesh,
    intrinsics: torch.Tensor,
    world_to_camera: torch.Tensor,
    height: int,
    width: int,
    device: torch.device | str,
) -> torch.Tensor:
    """bool [N, H, W], where each view shows the mesh."""
    vertices = tensor_of(np.asarray(mesh.vertices, np.float32)).to(device)
    faces = tensor_of(np.asarray(mesh.faces, np.int32)).to(device)

    def shown(k: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        return rasterize_projected(project(vertices, k, pose), faces, height, width, bary=False).face_id >= 0

    return torch.stack(share(shown, intrinsics, world_to_camera))


def _depth(depths: DepthMaps, views: Views, downscale: int, height: int, width: int) -> torch.Tensor:
    place = {name: i for i, name in enumerate(depths.names)}
    missing = [name for name in views.names if name not in place]
    if missing:
        raise DataError(
            f"no depth map for view {missing[0]!r} ({len(missing)} missing)",
            where="stage1.refine, port depths",
            expected="one depth map per training view, by name",
        )
    if depths.depth.shape[1:] != (views.height, views.width):
        raise DataError(
            f"depth maps are {depths.depth.shape[2]} x {depths.depth.shape[1]} pixels",
            where="stage1.refine, port depths",
            expected=f"{views.width} x {views.height}, as the views",
        )
    chosen = depths.depth[[place[name] for name in views.names]]
    # nearest sample, not a mean: depths must not be mixed across an edge
    middle = downscale // 2
    sampled = chosen[:, middle::downscale, middle::downscale][:, :height, :width]
    return torch.from_numpy(np.ascontiguousarray(sampled, np.float32))
