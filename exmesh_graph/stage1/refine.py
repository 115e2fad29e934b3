"""The loop of Stage I on a fixed topology: one view per iteration moves vertices and texels.

    L = (1 - l_ssim) L1(I) + l_ssim D-SSIM(I) + w_a L_m(alpha) + l_d L_d + l_s L_s + l_b L_b

(the paper's L_I), with I the display image over black. Image terms are means over all pixels of the view.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
import torch

from exmesh_graph import losses
from exmesh_graph.errors import GeometryError, NumericsError
from exmesh_graph.raster import barycentrics
from exmesh_graph.stage1.gains import fit_gain, initial_gains
from exmesh_graph.stage1.optimiser import texture_step, vertex_areas, vertex_step
from exmesh_graph.stage1.regularise import (
    REFERENCE_DECAY,
    Smoother,
    Smoothness,
    deviation,
    smoother,
    smoothness,
)
from exmesh_graph.stage1.render import Picture, Surface, draw, surface_of
from exmesh_graph.stage1.schedule import decayed, view_at
from exmesh_graph.stage1.targets import Targets, prepare_targets
from exmesh_graph.types import DepthMaps, Stage1State, Views

Progress = Callable[..., None]
Checkpoint = Callable[[int, dict[str, Any]], None]
Resumed = tuple[int, Mapping[str, Any]]

GRAZED = 0.05
"""A texel whose gradient stays below this share of a full pixel's is only grazed by lookups, not seen."""


@dataclass(frozen=True)
class RefineSettings:
    """Settings of `refine`; meanings and units are those of the node `stage1.refine`."""

    iterations: int = 500
    total_iterations: int = 0
    vertex_lr: float = 0.02
    texture_lr: float = 0.02
    decay: float = 0.05
    ssim_weight: float = 0.2
    silhouette: Literal["l1", "bce"] = "l1"
    silhouette_weight: float = 5.0
    smoothness: Smoothness = "bilaplacian"
    smoothness_weight: float = 0.3
    deviation_weight: float = 0.0
    depth_weight: float = 0.0
    gradient_decay: float = 0.95
    uv_gradient: bool = True
    gains: bool = False
    downscale: int = 1
    fill_unseen: bool = True


class Curve(NamedTuple):
    """Means over blocks of iterations: the last iteration of each block, its loss and its PSNR in dB."""

    iteration: list[int]
    loss: list[float]
    psnr: list[float]


def refine(
    state: Stage1State,
    views: Views,
    settings: RefineSettings,
    *,
    seed: int = 0,
    depths: DepthMaps | None = None,
    progress: Progress | None = None,
    where: str = "stage1.refine",
    device: torch.device | str = "cpu",
    checkpoint: Checkpoint | None = None,
    resumed: Resumed | None = None,
) -> tuple[Stage1State, dict[str, Any]]:
    """Optimise vertices and texture of `state` against `views` for `settings.iterations` iterations.

    Returns the new state and its history: {"iteration", "loss", "psnr"} as lists (means over blocks), "gains" per view
    name where they are fitted. Same inputs and seed give the same bytes on a CPU, also when a call was cut off and
    another one with the same arguments goes on from `resumed`, what `checkpoint(step, state)` was last given. Raises
    NumericsError with step, view and term if anything is not finite, and GeometryError for a carrier without faces.
    """
    if len(state.faces) == 0:
        raise GeometryError("the carrier has no faces", where=where, fix="look at the node that made its mesh")
    targets = prepare_targets(views, downscale=settings.downscale, depths=depths, device=device)
    return _Loop(state, targets, settings, seed, where, device).run(progress, checkpoint, resumed)


class _Loop:
    def __init__(
        self,
        state: Stage1State,
        targets: Targets,
        settings: RefineSettings,
        seed: int,
        where: str,
        device: torch.device | str,
    ) -> None:
        self.state, self.targets, self.settings, self.seed, self.where = state, targets, settings, seed, where
        self.surface: Surface = surface_of(state, device)
        self.surface.vertices.requires_grad_()
        self.surface.texture.requires_grad_()
        self.vertex_m, self.vertex_v, self.texture_m, self.texture_v, self.gradient_ema = (
            torch.tensor(np.asarray(array, np.float32), device=device)
            for array in (state.vertex_m, state.vertex_v, state.texture_m, state.texture_v, state.gradient_ema)
        )
        vertices = self.surface.vertices.detach()
        self.smoother: Smoother = smoother(vertices, self.surface.edges.edges)
        # moments are kept per unit of area: splitting a face does not change them (see `vertex_areas`)
        self.per_area = 1 / vertex_areas(vertices, self.surface.faces)[:, None]
        # the running mean that L_b measures from starts anew with every call, hence after every change of topology
        self.reference = vertices.clone()
        # what one pixel's L1 puts on the texel it shows
        self.pixel_gradient = 1 / (3 * targets.height * targets.width)
        self.touched = torch.zeros(self.surface.texture.shape[:2], dtype=torch.bool, device=device)
        self.gains = initial_gains(self.surface, targets) if settings.gains else None

    def run(
        self, progress: Progress | None, checkpoint: Checkpoint | None, resumed: Resumed | None
    ) -> tuple[Stage1State, dict[str, Any]]:
        count = self.settings.iterations
        block = max(1, math.ceil(count / 50))
        curve = Curve([], [], [])
        sums = [0.0, 0.0]
        first = 0
        if resumed is not None:
            first, kept = resumed
            curve, sums = Curve(*kept["curve"]), list(kept["sums"])
            for name, tensor in self.changing().items():
                tensor.detach().copy_(kept["tensors"][name])
        for k in range(first, count):
            loss, error = self.step(k)
            sums = [sums[0] + loss, sums[1] + error]
            if (k + 1) % block == 0 or k + 1 == count:
                size = k % block + 1
                curve.iteration.append(self.state.iteration + k + 1)
                curve.loss.append(sums[0] / size)
                curve.psnr.append(-10 * math.log10(max(sums[1] / size, 1e-10)))
                sums = [0.0, 0.0]
                if progress is not None:
                    progress(k + 1, count, loss=curve.loss[-1], psnr=curve.psnr[-1])
            if checkpoint is not None:
                checkpoint(k + 1, {"tensors": self.changing(), "curve": list(curve), "sums": sums})
        return self.result(), self.history(curve)

    def changing(self) -> dict[str, torch.Tensor]:
        """All that steps change, in place: with the arguments of the call it determines what follows."""
        found = {
            "vertices": self.surface.vertices,
            "texture": self.surface.texture,
            "vertex_m": self.vertex_m,
            "vertex_v": self.vertex_v,
            "texture_m": self.texture_m,
            "texture_v": self.texture_v,
            "gradient_ema": self.gradient_ema,
            "reference": self.reference,
            "touched": self.touched,
        }
        return found if self.gains is None else {**found, "gains": self.gains}

    def step(self, k: int) -> tuple[float, float]:
        """One iteration: (loss, mean squared error of the display image)."""
        settings, targets, surface = self.settings, self.targets, self.surface
        iteration = self.state.iteration + k
        view = view_at(iteration, len(targets), self.seed)
        picture = draw(
            surface,
            targets.intrinsics[view],
            targets.world_to_camera[view],
            targets.height,
            targets.width,
            uv_gradient=settings.uv_gradient,
        )
        terms, error = self.terms(view, picture)
        loss = torch.stack(list(terms.values())).sum()
        value = float(loss.detach())
        if not math.isfinite(value):
            bad = [name for name, term in terms.items() if not math.isfinite(float(term.detach()))]
            raise self.broken(iteration, view, f"the loss (term {', '.join(bad)}) is not finite")
        vertex_grad, texture_grad = torch.autograd.grad(loss, (surface.vertices, surface.texture))
        norm = vertex_grad.norm(dim=1)
        if not math.isfinite(float(norm.sum() + texture_grad.sum())):
            raise self.broken(iteration, view, "a gradient is not finite")

        # paper eq. 1
        self.gradient_ema.lerp_(norm, 1 - settings.gradient_decay)
        self.touched |= (texture_grad.abs() > GRAZED * self.pixel_gradient).any(dim=-1)
        total = settings.total_iterations or (self.state.iteration + settings.iterations)
        vertex_rate = decayed(settings.vertex_lr, settings.decay, iteration, total) * self.smoother.mean_edge
        texture_rate = decayed(settings.texture_lr, settings.decay, iteration, total)
        vertex_step(
            surface.vertices,
            vertex_grad * self.per_area,
            self.vertex_m,
            self.vertex_v,
            self.state.vertex_steps + k + 1,
            vertex_rate,
        )
        texture_step(
            surface.texture,
            texture_grad,
            self.texture_m,
            self.texture_v,
            self.state.texture_steps + k + 1,
            texture_rate,
            epsilon=GRAZED * self.pixel_gradient,
        )
        if settings.deviation_weight > 0:
            self.reference.lerp_(surface.vertices.detach(), 1 - REFERENCE_DECAY)
        return value, error

    def terms(self, view: int, picture: Picture) -> tuple[dict[str, torch.Tensor], float]:
        """The weighted terms of the loss by name, and the mean squared error."""
        settings, targets = self.settings, self.targets
        image, target, mask = picture.colour, targets.images[view], targets.alpha[view]
        if self.gains is not None:
            self.gains[view] = fit_gain(image.detach(), target, mask, self.gains[view])
            image = image * (self.gains[view] / self.gains.mean(dim=0))
        if not targets.has_masks:
            # nothing is known of the background: let the photograph itself stand there
            image = image + (1 - picture.alpha[..., None]) * target
        terms = {"l1": (1 - settings.ssim_weight) * losses.l1(image, target)}
        if settings.ssim_weight > 0:
            box = targets.box(view)
            share = box.area / mask.numel()
            terms["d_ssim"] = settings.ssim_weight * share * losses.d_ssim(box.crop(image), targets.ssim_target(view))
        if targets.has_masks and settings.silhouette_weight > 0:
            of = losses.silhouette_l1 if settings.silhouette == "l1" else losses.silhouette_bce
            terms["silhouette"] = settings.silhouette_weight * of(picture.alpha, mask)
        if targets.depth is not None and settings.depth_weight > 0:
            terms["depth"] = settings.depth_weight * self.depth_term(view, picture)
        vertices = self.surface.vertices
        if settings.smoothness_weight > 0:
            terms["smoothness"] = settings.smoothness_weight * smoothness(vertices, self.smoother, settings.smoothness)
        if settings.deviation_weight > 0:
            terms["deviation"] = settings.deviation_weight * deviation(vertices, self.reference, self.smoother)
        error = float((image.detach() - target).square().mean())
        return terms, error

    def depth_term(self, view: int, picture: Picture) -> torch.Tensor:
        """Paper eq. 9 over the pixels that are covered, inside the mask and have a reference depth."""
        reference = self.targets.depth
        assert reference is not None
        face_id = picture.fragments.face_id.view(-1)
        known = (face_id >= 0) & (reference[view].view(-1) > 0) & (self.targets.alpha[view].view(-1) > 0.5)
        pixels = torch.nonzero(known)[:, 0]
        faces = self.surface.faces.long()
        bary = barycentrics(picture.projected, faces, face_id[pixels], pixels, self.targets.width)
        z = (bary * picture.projected[faces[face_id[pixels].long()], 2]).sum(-1)
        seen = torch.ones_like(z, dtype=torch.bool)
        return losses.pearson_depth(z, reference[view].view(-1)[pixels], seen)

    def broken(self, iteration: int, view: int, what: str) -> NumericsError:
        return NumericsError(
            what,
            where=f"{self.where}, iteration {iteration}, view {self.targets.names[view]!r}",
            expected="finite losses and gradients",
            fix="lower vertex_lr, raise smoothness_weight, or clean the mesh before this round",
        )

    def result(self) -> Stage1State:
        settings = self.settings
        texture = self.surface.texture.detach()
        if settings.fill_unseen and settings.iterations > 0:
            from exmesh_graph.stage1.init import fill_unseen

            texture = fill_unseen(texture, self.touched)
        return replace(
            self.state,
            vertices=self.surface.vertices.detach().cpu().numpy(),
            texture=texture.cpu().numpy(),
            vertex_m=self.vertex_m.cpu().numpy(),
            vertex_v=self.vertex_v.cpu().numpy(),
            texture_m=self.texture_m.cpu().numpy(),
            texture_v=self.texture_v.cpu().numpy(),
            gradient_ema=self.gradient_ema.cpu().numpy(),
            iteration=self.state.iteration + settings.iterations,
            vertex_steps=self.state.vertex_steps + settings.iterations,
            texture_steps=self.state.texture_steps + settings.iterations,
        )

    def history(self, curve: Curve) -> dict[str, Any]:
        values: dict[str, Any] = {
            "iteration": curve.iteration,
            "loss": [round(x, 7) for x in curve.loss],
            "psnr": [round(x, 3) for x in curve.psnr],
            "faces": len(self.state.faces),
            "vertices": len(self.state.vertices),
        }
        if self.gains is not None:
            relative = (self.gains / self.gains.mean(dim=0)).cpu().tolist()
            values["gains"] = {
                name: [round(g, 4) for g in gain] for name, gain in zip(self.targets.names, relative, strict=True)
            }
        return values
