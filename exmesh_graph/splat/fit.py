"""The loop that fits planar Gaussians to photographs: one view an iteration, a neighbour beside it later on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import torch

from exmesh_graph.errors import GeometryError, NumericsError
from exmesh_graph.optim import decayed, view_at
from exmesh_graph.splat.density import Density, control, reset_opacity
from exmesh_graph.splat.fused.step import FusedStep
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.optimiser import GaussianAdam
from exmesh_graph.splat.pictures import Pictures
from exmesh_graph.splat.plain import PlainStep
from exmesh_graph.targets import Targets

if TYPE_CHECKING:
    from exmesh_graph.splat.settings import PgsrSettings

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


class _Fit:
    def __init__(self, gaussians: Gaussians, targets: Targets, settings: PgsrSettings, seed: int, where: str) -> None:
        self.targets, self.settings, self.seed, self.where = targets, settings, seed, where
        self.adam = GaussianAdam(gaussians)
        self.density = Density(len(gaussians), gaussians.means)
        self.pictures = Pictures(targets, settings, seed)
        fuses = gaussians.means.device.type == "cpu" and gaussians.means.dtype == torch.float32
        self.way = (FusedStep if fuses else PlainStep)(self.pictures, self.adam)
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
            self.pictures.gains.factors = kept["gains"].to(self.pictures.gains.factors)
            self.history, sums = {name: list(v) for name, v in kept["history"].items()}, list(kept["sums"])
        for k in range(first, count):
            loss, error = self.step(k)
            sums = [sums[0] + loss, sums[1] + error]
            if k + 1 in self.rounds:
                control(self.adam, self.density, settings, self.pictures.generator(k, 1))
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
                    "gains": self.pictures.gains.factors,
                })  # fmt: skip
        result: dict[str, Any] = dict(self.history)
        result["alone"] = [self.targets.names[i] for i, near in enumerate(self.pictures.near) if len(near) == 0]
        if settings.gains:
            result["gains"] = self.pictures.gains.named()
        return self.adam.gaussians, result

    def step(self, k: int) -> tuple[float, float]:
        """One iteration: (loss, mean squared error of the picture)."""
        i = view_at(k, len(self.targets), self.seed)
        value, error = self.way.loss(i, k)
        if not math.isfinite(value):
            raise NumericsError(
                "the loss is not finite", where=f"{self.where}, iteration {k}, view {self.targets.names[i]!r}",
                expected="finite losses", fix="lower mean_rate, or look at this view's picture and camera",
            )  # fmt: skip
        self.way.update(self.density, self.rates(k))
        return value, error

    def rates(self, k: int) -> dict[str, float]:
        s = self.settings
        return {
            "means": decayed(s.mean_rate, s.mean_decay, k, s.iterations), "scales": s.scale_rate,
            "rotations": s.rotation_rate, "opacities": s.opacity_rate, "sh": s.colour_rate,
            "sh_rest": s.colour_rate / 20,
        }  # fmt: skip
