"""Stage II: base colour, roughness (metallic) and environment on the frozen carrier, eq. 14 to 24.

Every step renders one training view (stage2.model) under its light model (stage2.light), compares it in linear light
(stage2.terms) and moves the texels and the environment by Adam. Maps are sigmoids, the environment a softplus, of free
parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch

from exmesh_graph.errors import NumericsError
from exmesh_graph.stage2.adam import Adam
from exmesh_graph.stage2.model import Model
from exmesh_graph.stage2.result import finished_asset
from exmesh_graph.stage2.settings import FitSettings
from exmesh_graph.stage2.terms import indirect_strength, view_psnr, weighted_terms
from exmesh_graph.types import Asset, Carrier, Transport, Views

Progress = Callable[[int, int, dict[str, float]], None]
Checkpoint = Callable[[int, dict[str, Any]], None]
Resumed = tuple[int, Mapping[str, Any]]


def fit(
    carrier: Carrier,
    views: Views,
    transport: Transport,
    settings: FitSettings | None = None,
    *,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    resumed: Resumed | None = None,
) -> tuple[Asset, dict[str, list[float]]]:
    """Decompose the carrier's appearance into materials and light.

    Returns the asset and curves over iterations (`iteration`, `loss`, `image`, `psnr`: sRGB over the view's pixels).
    A call that was cut off goes on with the same arguments and `resumed`, what `checkpoint(step, state)` was last
    given, and ends with the same bytes.
    Raises GeometryError when `transport` belongs to another mesh, DataError when no pixel sees the mesh and
    NumericsError, naming step, view and term, when a loss stops being finite.
    """
    settings = settings or FitSettings()
    model = Model(carrier, views, transport, settings, device)
    generator = torch.Generator().manual_seed(seed)
    optimiser = Adam([model.maps.parameter, model.environment], [settings.material_rate, settings.environment_rate])
    refresh = {round(settings.iterations * (i + 1) / (settings.corrections + 1)) for i in range(settings.corrections)}
    curves: dict[str, list[float]] = {"iteration": [], "loss": [], "image": [], "psnr": []}
    order: list[int] = []
    first = 0
    if resumed is None:
        model.start()
    else:
        first, kept = resumed
        curves, order = kept["curves"], kept["order"]
        _restore(model, optimiser, generator, kept)
    for step in range(first, settings.iterations):
        if step in refresh:
            model.measure(indirect_strength(settings, step), generator)
        if not order:
            order = torch.randperm(len(model.buffers), generator=generator).tolist()
        buffer = model.buffers[order.pop()]
        if len(buffer.pixel) == 0:
            continue
        terms, predicted = weighted_terms(model, buffer, step)
        loss = torch.stack(list(terms.values())).sum()
        _check(terms, step, buffer.name)
        loss.backward()
        optimiser.step(settings.rate_decay ** (step / settings.iterations))
        if step % 10 == 0 or step == settings.iterations - 1:
            figures = {
                "loss": float(loss.detach()),
                "image": float(terms["image"].detach()),
                "psnr": view_psnr(predicted, buffer),
            }
            curves["iteration"].append(step)
            for name, value in figures.items():
                curves[name].append(value)
            if progress:
                progress(step + 1, settings.iterations, figures)
        if checkpoint is not None:
            checkpoint(step + 1, {**_changing(model, optimiser, generator), "curves": curves, "order": order})
    return finished_asset(carrier, model), curves


def _changing(model: Model, optimiser: Adam, generator: torch.Generator) -> dict[str, Any]:
    """All that steps change: with the arguments of `fit` it determines what follows."""
    return {
        "parameters": optimiser.parameters,
        "first": optimiser.first,
        "second": optimiser.second,
        "steps": optimiser.steps,
        "generator": generator.get_state(),
        "light": model.light.state(model.buffers),
    }


@torch.no_grad()
def _restore(model: Model, optimiser: Adam, generator: torch.Generator, kept: Mapping[str, Any]) -> None:
    for name in ("parameters", "first", "second"):
        for tensor, value in zip(getattr(optimiser, name), kept[name], strict=True):
            tensor.copy_(value)
    optimiser.steps = kept["steps"]
    generator.set_state(kept["generator"])
    model.light.restore(model.buffers, kept["light"])


def _check(terms: dict[str, torch.Tensor], step: int, view: str) -> None:
    for name, value in terms.items():
        if not bool(torch.isfinite(value)):
            raise NumericsError(
                f"the {name} term is {float(value.detach())}",
                where=f"stage2 step {step}, view {view}",
                expected="a finite loss",
                fix="lower material_rate and environment_rate; check the view's image for NaN",
            )
