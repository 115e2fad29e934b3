"""The loop that fits planar Gaussians to photographs: one view an iteration, a neighbour beside it later on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from exmesh_graph.errors import GeometryError, NumericsError
from exmesh_graph.losses import d_ssim, l1
from exmesh_graph.optim import decayed, view_at
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.splat.consistency import View, flattening, multi_view, single_view_normal
from exmesh_graph.splat.density import Density, control, reset_opacity
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.optimiser import GaussianAdam
from exmesh_graph.splat.render import Render, render
from exmesh_graph.targets import Gains, Targets

if TYPE_CHECKING:
    from exmesh_graph.splat.settings import PgsrSettings

_NEIGHBOURS, _WIDEST = 8, 45.0
_GAINS_FROM = 0.2

Progress = Callable[..., None]
Checkpoint = Callable[[int, dict[str, Any]], None]


def fit(
    gaussians: Gaussians,
    targets: Targets,
    settings: PgsrSettings,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    where: str = "init.pgsr",
    checkpoint: Checkpoint | None = None,
    resumed: tuple[int, Mapping[str, Any]] | None = None,
) -> tuple[Gaussians, dict[str, Any]]:
    """Fit `gaussians` (on the targets' device; changed in place) and return them with the history of the fit.

    History: lists "iteration", "loss", "psnr", "gaussians" (about fifty blocks), "gains" by view name where fitted,
    and "alone", the views without a neighbour for the multi-view terms. Same inputs and seed give the same bytes on a
    CPU, also when cut off and continued from `resumed`, what `checkpoint(step, state)` was last given.
    Raises NumericsError with iteration and view if a loss is not finite, GeometryError where no Gaussian is left.
    """
    return _Fit(gaussians, targets, settings, seed, where).run(progress, checkpoint, resumed)


def control_rounds(settings: PgsrSettings) -> tuple[int, ...]:
    """Iterations after which Gaussians are split and pruned."""
    first, last = settings.densify_from * settings.iterations, settings.densify_to * settings.iterations
    gap = (last - first) / max(settings.densify_rounds - 1, 1)
    return tuple(sorted({max(1, round(first + i * gap)) for i in range(settings.densify_rounds)}))


def active_degree(settings: PgsrSettings, iteration: int) -> int:
    """Harmonics in use: a degree more with each fifth of the iterations."""
    return min(settings.degree, 5 * iteration // max(settings.iterations, 1))


class _Fit:
    def __init__(self, gaussians: Gaussians, targets: Targets, settings: PgsrSettings, seed: int, where: str) -> None:
        self.targets, self.settings, self.seed, self.where = targets, settings, seed, where
        self.adam = GaussianAdam(gaussians)
        self.density = Density(len(gaussians), gaussians.means)
        self.gains = Gains(targets)
        self.rays: dict[bytes, torch.Tensor] = {}
        self.near = nearest_views(targets.world_to_camera)
        self.rounds = set(control_rounds(settings))
        self.history: dict[str, list] = {"iteration": [], "loss": [], "psnr": [], "gaussians": []}

    def run(self, progress, checkpoint, resumed) -> tuple[Gaussians, dict[str, Any]]:
        settings, count = self.settings, self.settings.iterations
        block = max(1, math.ceil(count / 50))
        sums, first = [0.0, 0.0], 0
        if resumed is not None:
            first, kept = resumed
            self.adam.restore(kept["adam"])
            self.density.restore(kept["density"])
            self.gains.factors = kept["gains"].to(self.gains.factors)
            self.history, sums = {name: list(v) for name, v in kept["history"].items()}, list(kept["sums"])
        for k in range(first, count):
            loss, error = self.step(k)
            sums = [sums[0] + loss, sums[1] + error]
            if k + 1 in self.rounds:
                control(self.adam, self.density, settings, self.generator(k, 1))
                if len(self.adam.gaussians) == 0:
                    raise GeometryError(
                        "no Gaussian is left", where=f"{self.where}, iteration {k}",
                        expected="an object that the views show",
                        fix="look at masks and cameras; start from other points",
                    )  # fmt: skip
                self.density = Density(len(self.adam.gaussians), self.adam.gaussians.means)
            if settings.reset_at > 0 and k + 1 == round(settings.reset_at * count):
                reset_opacity(self.adam)
            if (k + 1) % block == 0 or k + 1 == count:
                size = k % block + 1
                entry = (k + 1, round(sums[0] / size, 7), round(-10 * math.log10(max(sums[1] / size, 1e-10)), 3),
                         len(self.adam.gaussians))  # fmt: skip
                for values, value in zip(self.history.values(), entry, strict=True):
                    values.append(value)
                sums = [0.0, 0.0]
                if progress is not None:
                    progress(k + 1, count, loss=entry[1], psnr=entry[2], gaussians=entry[3])
            if checkpoint is not None:
                checkpoint(k + 1, {
                    "adam": self.adam.state(), "density": self.density.state(), "history": self.history, "sums": sums,
                    "gains": self.gains.factors,
                })  # fmt: skip
        result: dict[str, Any] = dict(self.history)
        result["alone"] = [self.targets.names[i] for i, near in enumerate(self.near) if len(near) == 0]
        if settings.gains:
            result["gains"] = self.gains.named()
        return self.adam.gaussians, result

    def generator(self, k: int, purpose: int) -> torch.Generator:
        """Random numbers of an iteration: no state to carry through a checkpoint."""
        return torch.Generator().manual_seed(int(np.random.SeedSequence([self.seed, k, purpose]).generate_state(1)[0]))

    def view(self, i: int) -> View:
        t = self.targets
        camera = t.intrinsics[i].cpu().numpy().tobytes()  # views of one camera share their rays
        if camera not in self.rays:
            self.rays[camera] = pixel_rays(t.intrinsics[i], t.height, t.width, t.images)
        return View(t.images[i], self.rays[camera], t.intrinsics[i], t.world_to_camera[i])

    def draw(self, gaussians: Gaussians, i: int, k: int) -> Render:
        t = self.targets
        degree = active_degree(self.settings, k)
        return render(gaussians, t.intrinsics[i], t.world_to_camera[i], t.height, t.width, degree=degree)

    def step(self, k: int) -> tuple[float, float]:
        """One iteration: (loss, mean squared error of the picture)."""
        settings, targets = self.settings, self.targets
        i = view_at(k, len(targets), self.seed)
        leaves = self.adam.gaussians.map(lambda t: t.detach().requires_grad_())
        drawing = self.draw(leaves, i, k)
        loss, error = self.colour(drawing, i, k)
        loss = loss + settings.flatten_weight * flattening(leaves.scales, drawing.drawn.seen)
        if k >= settings.geometry_from * settings.iterations:
            loss = loss + self.geometry(drawing, i, k)
        value = float(loss.detach())
        if not math.isfinite(value):
            raise NumericsError(
                "the loss is not finite", where=f"{self.where}, iteration {k}, view {targets.names[i]!r}",
                expected="finite losses", fix="lower mean_rate, or look at this view's picture and camera",
            )  # fmt: skip
        tensors = leaves.tensors()
        gradients = torch.autograd.grad(loss, list(tensors.values()))
        self.density.add(drawing, targets.width)
        by_name = dict(zip(tensors, gradients, strict=True))
        self.adam.step(by_name, drawing.drawn.seen, self.rates(k))
        return value, error

    def colour(self, drawing: Render, i: int, k: int) -> tuple[torch.Tensor, float]:
        """.8 L1 + .2 (1 - SSIM) of the display picture, and the mask's L1 where it is known."""
        targets, weight = self.targets, self.settings.ssim_weight
        image, target = drawing.colour, targets.images[i]
        if self.settings.gains:
            if k >= _GAINS_FROM * self.settings.iterations:  # before, the picture is too dark to tell
                self.gains.follow(i, image.detach())
            image = image * self.gains.relative(i)
        loss = (1 - weight) * l1(image, target)
        if weight > 0:
            box = targets.box(i)
            share = box.area / (targets.height * targets.width)
            loss = loss + 2 * weight * share * d_ssim(box.crop(image), targets.ssim_target(i))
        if bool(targets.masked[i]):
            loss = loss + self.settings.mask_weight * l1(drawing.alpha, targets.alpha[i])
        return loss, float((image.detach() - target).square().mean())

    def geometry(self, drawing: Render, i: int, k: int) -> torch.Tensor:
        settings = self.settings
        view = self.view(i)
        loss = settings.normal_weight * single_view_normal(drawing, view)
        near = self.near[i]
        if len(near) == 0 or settings.geometric_weight == settings.photometric_weight == 0:
            return loss
        generator = self.generator(k, 0)
        other = int(near[int(torch.randint(len(near), (1,), generator=generator))])
        with torch.no_grad():
            other_drawing = self.draw(self.adam.gaussians, other, k)
        covered = torch.nonzero(drawing.alpha.detach().reshape(-1) > 0.5)[:, 0]
        if len(covered) > settings.samples:
            chosen = torch.randperm(len(covered), generator=generator)[: settings.samples].to(covered.device)
            covered = covered[chosen]
        # means over the picture in PGSR, as the colour's is: the sampled mean times the covered share
        share = float((drawing.alpha.detach() > 0.5).float().mean())
        geometric, photometric = multi_view(drawing, view, other_drawing, self.view(other), covered)
        return loss + share * (settings.geometric_weight * geometric + settings.photometric_weight * photometric)

    def rates(self, k: int) -> dict[str, float]:
        s = self.settings
        return {
            "means": decayed(s.mean_rate, s.mean_decay, k, s.iterations), "scales": s.scale_rate,
            "rotations": s.rotation_rate, "opacities": s.opacity_rate, "sh": s.colour_rate,
            "sh_rest": s.colour_rate / 20,
        }  # fmt: skip


def nearest_views(world_to_camera: torch.Tensor) -> list[np.ndarray]:
    """For each view the up to eight nearest in direction, less than 45 degrees away and not at the same place."""
    poses = torch.linalg.inv(world_to_camera.cpu().double()).numpy()
    forward, centre = poses[:, :3, 2], poses[:, :3, 3]
    angle = np.degrees(np.arccos(np.clip(forward @ forward.T, -1, 1)))
    apart = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
    reach = np.linalg.norm(centre - centre.mean(0), axis=1).max()
    usable = (angle < _WIDEST) & (apart > 1e-3 * reach)
    np.fill_diagonal(usable, False)
    order = np.argsort(np.where(usable, angle, np.inf), axis=1, kind="stable")
    return [row[usable[i, row]][:_NEIGHBOURS] for i, row in enumerate(order)]
