"""The loop of Stage I on a fixed topology: one view per iteration moves vertices and the appearance model's values."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch

from exmesh_graph.errors import DataError, GeometryError, NumericsError
from exmesh_graph.optim import EPSILON, SECOND, adam_step, decayed, view_at
from exmesh_graph.stage1.appearance.model import AppearanceModel, Surface
from exmesh_graph.stage1.diagnose import diagnose
from exmesh_graph.stage1.gloss import firmness
from exmesh_graph.stage1.regularise import PreparedSmoothness, Smoothness, mean_edge
from exmesh_graph.stage1.render import draw, painter_of, surface_of
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian
from exmesh_graph.stage1.terms import Terms
from exmesh_graph.stage1.unseen import followed, unseen
from exmesh_graph.stage1.vertices import serves, step
from exmesh_graph.targets import Targets, prepare_targets
from exmesh_graph.types import DepthMaps, Mesh, Stage1State, Views

_LAST = 0.99  # of the schedule: rounds that are shares of it end near its end

Progress = Callable[..., None]
Checkpoint = Callable[[int, dict[str, Any]], None]
Resumed = tuple[int, Mapping[str, Any]]


class LossCurve(NamedTuple):
    """Means over blocks of iterations: the last iteration of each block, its loss and its PSNR in dB."""

    iteration: list[int]
    loss: list[float]
    psnr: list[float]


def refine(
    state: Stage1State,
    views: Views,
    settings: RefineSettings,
    *,
    smoothness: Smoothness | None = None,
    seed: int = 0,
    depths: DepthMaps | None = None,
    region: Mesh | None = None,
    appearance: AppearanceModel | None = None,
    progress: Progress | None = None,
    where: str = "stage1.refine",
    device: torch.device | str = "cpu",
    checkpoint: Checkpoint | None = None,
    resumed: Resumed | None = None,
) -> tuple[Stage1State, dict[str, Any]]:
    """Optimise vertices and appearance of `state` against `views` for `settings.iterations` iterations.

    `smoothness` is the L_s (default: `smoothness.Bilaplacian`).
    `region` is a surface, the coarse start say: with views without masks, only pixels that show it count.
    `appearance`, made for this call, colours the surface in place of the model that the state holds.

    Returns the new state and its history: {"iteration", "loss", "psnr"} as lists (means over blocks), "gains" per view
    name where they are fitted, and after the last round of the schedule "suspects" and "dark" (`diagnose`). Same inputs
    and seed give the same bytes on a CPU, also when a call was cut off and another one with the same arguments goes on
    from `resumed`, what `checkpoint(step, state)` was last given. Raises NumericsError with step, view and term if
    anything is not finite, GeometryError for a carrier without faces, and DataError for a region where there are masks.
    """
    if len(state.faces) == 0:
        raise GeometryError("the carrier has no faces", where=where, fix="look at the node that made its mesh")
    if region is not None and views.has_masks:
        raise DataError(
            "a region was given for views that have masks", where=where, expected="views without masks",
            fix="take the wire to `region` away: the masks say what counts",
        )  # fmt: skip
    targets = prepare_targets(
        views, downscale=settings.downscale, depths=depths, region=region, device=device, memory_gib=settings.memory_gib
    )
    firm = None
    if settings.gloss_firmness > 0 and settings.iterations > 0 and appearance is None:
        firm = torch.from_numpy(firmness(views, state, settings.gloss_firmness)).to(device)
    loop = _Loop(state, targets, settings, smoothness or Bilaplacian(), seed, where, device, appearance, firm)
    new, history = loop.run(progress, checkpoint, resumed)
    if appearance is None and settings.iterations > 0 and new.iteration >= _LAST * settings.total_iterations:
        history |= diagnose(surface_of(new, device), targets, gains=settings.gains)
    return new, history


def vertex_areas(vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """A third of the area of the faces around each vertex [V], held above 1e-3 of the mean.

    A vertex's gradient is proportional to the surface it carries. Adam's moments of gradient / area therefore mean
    the same before and after a split, where those of the raw gradient would be stale for 1 / (1 - beta) iterations
    and the steps too short by the factor that areas fell.
    """
    corners = vertices.double()[faces.long()]
    area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1) / 6
    total = area.new_zeros(len(vertices))
    for k in range(3):
        total.index_add_(0, faces[:, k].long(), area)
    floor = 1e-3 * total.mean() + torch.finfo(total.dtype).tiny
    return total.clamp(min=floor).to(vertices.dtype)


class _Loop:
    def __init__(
        self,
        state: Stage1State,
        targets: Targets,
        settings: RefineSettings,
        smoothness: Smoothness,
        seed: int,
        where: str,
        device: torch.device | str,
        appearance: AppearanceModel | None = None,
        firm: torch.Tensor | None = None,
    ) -> None:
        self.state, self.targets, self.settings, self.seed, self.where = state, targets, settings, seed, where
        self.surface: Surface = surface_of(state, device)
        if appearance is not None:
            self.surface = self.surface._replace(appearance=appearance)
        self.appearance = self.surface.appearance
        self.surface.vertices.requires_grad_()
        self.appearance.prepare(self.surface, targets)
        for leaf in self.appearance.leaves():
            leaf.requires_grad_()
        self.vertex_m, self.vertex_v, self.gradient_ema = (
            torch.tensor(np.asarray(array, np.float32), device=device)
            for array in (state.vertex_m, state.vertex_v, state.gradient_ema)
        )
        vertices = self.surface.vertices.detach()
        self.mean_edge = mean_edge(vertices, self.surface.edges.edges)
        # moments are kept per unit of area: splitting a face does not change them (see `vertex_areas`)
        self.per_area = 1 / vertex_areas(vertices, self.surface.faces)[:, None]
        # what one pixel's L1 puts on the texel it shows
        self.pixel_gradient = 1 / (3 * targets.height * targets.width)
        self.painter = painter_of(self.surface, targets.height, targets.width)
        fused = self.painter is not None
        self.terms = Terms(self.surface, targets, settings, smoothness, fused=fused, firmness=firm)
        self.held: torch.Tensor | None = None
        filtered = self.terms.smoothness is not None and self.terms.smoothness.filter is not None
        if settings.hold_unseen and settings.iterations > 0 and not filtered:  # a filter takes all along by itself
            hidden = unseen(self.surface, targets)
            self.held = hidden if bool(hidden.any()) else None
            self.vertex_m[hidden] = 0
        self.curve, self.sums = LossCurve([], [], []), [0.0, 0.0]

    def run(
        self, progress: Progress | None, checkpoint: Checkpoint | None, resumed: Resumed | None
    ) -> tuple[Stage1State, dict[str, Any]]:
        count = self.settings.iterations
        block = max(1, math.ceil(count / 50))
        first = 0
        if resumed is not None:
            first, kept = resumed
            self.restore(kept)
        curve, sums = self.curve, self.sums
        for k in range(first, count):
            loss, error = self.step(k)
            sums[:] = [sums[0] + loss, sums[1] + error]
            if (k + 1) % block == 0 or k + 1 == count:
                size = k % block + 1
                curve.iteration.append(self.state.iteration + k + 1)
                curve.loss.append(sums[0] / size)
                curve.psnr.append(-10 * math.log10(max(sums[1] / size, 1e-10)))
                sums[:] = [0.0, 0.0]
                if progress is not None:
                    progress(k + 1, count, loss=curve.loss[-1], psnr=curve.psnr[-1])
            if checkpoint is not None:
                checkpoint(k + 1, self.kept())
        return self.result(), self.history(curve)

    def kept(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {"tensors": self.changing(), "curve": list(self.curve), "sums": self.sums}

    def restore(self, kept: Mapping[str, Any]) -> None:
        """Go on from `kept`."""
        self.curve, self.sums = LossCurve(*kept["curve"]), list(kept["sums"])
        for name, tensor in self.changing().items():
            tensor.detach().copy_(kept["tensors"][name])

    def changing(self) -> dict[str, torch.Tensor]:
        """All that steps change, in place: with the arguments of the call it determines what follows."""
        return {
            "vertices": self.surface.vertices,
            "vertex_m": self.vertex_m,
            "vertex_v": self.vertex_v,
            "gradient_ema": self.gradient_ema,
            **self.appearance.changing(),
            **self.terms.changing(),
        }

    def step(self, k: int) -> tuple[float, float]:
        """One iteration: (loss, mean squared error of the display image).

        Equation: 1.
        """
        settings, targets, surface = self.settings, self.targets, self.surface
        iteration = self.state.iteration + k
        view = view_at(iteration, len(targets), self.seed)
        if k + 1 < settings.iterations:
            targets.expect(view_at(iteration + 1, len(targets), self.seed))
        picture = draw(
            surface,
            targets.intrinsics[view],
            targets.world_to_camera[view],
            targets.height,
            targets.width,
            uv_gradient=settings.uv_gradient,
            painter=self.painter,
        )
        terms, error = self.terms.of(view, picture, surface.vertices)
        loss = torch.stack(list(terms.values())).sum()
        value = float(loss.detach())
        if not math.isfinite(value):
            bad = [name for name, term in terms.items() if not math.isfinite(float(term.detach()))]
            raise self.broken(iteration, view, f"the loss (term {', '.join(bad)}) is not finite")
        vertex_grad, *value_grads = torch.autograd.grad(loss, (surface.vertices, *self.appearance.leaves()))
        if self.held is not None:
            vertex_grad[self.held] = 0
        total = settings.total_iterations or (self.state.iteration + settings.iterations)
        rate = decayed(settings.vertex_lr, settings.vertex_decay, iteration, total, settings.vertex_hold)
        finite = math.isfinite(self.move(vertex_grad, k, rate * self.mean_edge))
        rate = decayed(settings.texture_lr, settings.texture_decay, iteration, total)
        finite &= self.appearance.step(value_grads, self.state.texture_steps + k + 1, rate, self.pixel_gradient)
        if not finite:  # the state is lost; what was stored of it is not
            raise self.broken(iteration, view, "a gradient is not finite")
        self.terms.follow(surface.vertices)
        return value, error

    def move(self, gradient: torch.Tensor, k: int, rate: float) -> float:
        """Step the vertices, through the smoothness's filter where it has one, and follow the size of their gradients.

        Returns the sum of these sizes, which is not finite if a gradient is not.

        Equation: 1.
        """
        prepared = self.terms.smoothness or PreparedSmoothness(None)
        smooth, decay = prepared.filter, self.settings.gradient_decay
        count = self.state.vertex_steps + k + 1
        vertices, moments = self.surface.vertices, (self.vertex_m, self.vertex_v)
        if smooth is None and serves(vertices):
            return step(
                vertices, gradient, self.per_area, self.gradient_ema, moments, count, rate, decay=decay,
                epsilon=self.silent(count),
            )  # fmt: skip
        norm = gradient.norm(dim=1)
        self.gradient_ema.lerp_(norm, 1 - decay)
        if smooth is None:
            adam_step(vertices, gradient * self.per_area, *moments, count, rate, epsilon=self.silent(count))
            return float(norm.sum())
        with torch.no_grad():
            moved = torch.zeros_like(gradient)
            # one factor for all vertices keeps a symmetric filter's steps downhill
            per_area = self.per_area.reciprocal().mean().reciprocal() if prepared.uniform else self.per_area
            adam_step(moved, smooth(gradient * per_area), *moments, count, rate, uniform=prepared.uniform)
            vertices.add_(smooth(moved))
        return float(norm.sum())

    def silent(self, count: int) -> float:
        """The gradient (per unit of area) below which steps shorten: a share of the vertices' median, by their moments.

        The gradient of an L1 keeps its size however small the error is: its mean square says how sharply photographs
        place a vertex. With masks the outline holds the shape, and full steps everywhere bring it there sooner.
        """
        if self.settings.evidence == 0 or count < 2 or bool(self.targets.masked.any()):
            return EPSILON
        median = float(self.vertex_v.median()) / (1 - SECOND ** (count - 1))
        return max(EPSILON, self.settings.evidence * math.sqrt(median))

    def broken(self, iteration: int, view: int, what: str) -> NumericsError:
        return NumericsError(
            what,
            where=f"{self.where}, iteration {iteration}, view {self.targets.names[view]!r}",
            expected="finite losses and gradients",
            fix="lower vertex_lr, raise the smoothness's weight, or clean the mesh before this round",
        )

    def result(self) -> Stage1State:
        settings = self.settings
        vertices = self.surface.vertices.detach()
        if self.held is not None:
            along = followed(
                vertices.cpu().numpy(), self.state.vertices, self.held.cpu().numpy(),
                self.surface.edges.edges.cpu().numpy(),
            )  # fmt: skip
            vertices = torch.from_numpy(along).to(vertices.device)
        state = replace(
            self.state,
            vertices=vertices.cpu().numpy(),
            vertex_m=self.vertex_m.cpu().numpy(),
            vertex_v=self.vertex_v.cpu().numpy(),
            gradient_ema=self.gradient_ema.cpu().numpy(),
            iteration=self.state.iteration + settings.iterations,
            vertex_steps=self.state.vertex_steps + settings.iterations,
            texture_steps=self.state.texture_steps + settings.iterations,
        )
        if settings.iterations == 0:
            return state
        surface = self.surface._replace(vertices=vertices)
        return replace(state, **self.appearance.fields(surface, state.texture.shape[0], settings.fill_unseen))

    def history(self, curve: LossCurve) -> dict[str, Any]:
        values: dict[str, Any] = {
            "iteration": curve.iteration,
            "loss": [round(x, 7) for x in curve.loss],
            "psnr": [round(x, 3) for x in curve.psnr],
            "faces": len(self.state.faces),
            "vertices": len(self.state.vertices),
        }
        gains = self.terms.relative_gains()
        return values if gains is None else {**values, "gains": gains}
