"""Stage II: base colour, roughness (metallic) and environment on the frozen carrier, eq. 14 to 24.

Every step renders one training view (stage2.decomposition) under its light model (stage2.light), compares it in linear
light (stage2.objective) and moves the texels and the environment by Adam. Maps are sigmoids of free
parameters, the environment is `envmap.radiance_of` them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import torch

from exmesh_graph.optim import Adam
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.guard import Guard
from exmesh_graph.stage2.metal import agree_on_metal, agreeing, metal_alone
from exmesh_graph.stage2.objective import indirect_strength, weighted_terms
from exmesh_graph.stage2.palette import METAL_WIDER, gather_colors, gathering, light_follows
from exmesh_graph.stage2.pictures import view_psnr
from exmesh_graph.stage2.result import finished_asset
from exmesh_graph.stage2.schedule import GLOSSY, glossy_first, learning_rates, light_waits, lit_first
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.types import Asset, Carrier, Transport, Views

if TYPE_CHECKING:
    from exmesh_graph.shading.settings import MonteCarloSettings

Progress = Callable[..., None]
Checkpoint = Callable[[int, dict[str, Any]], None]
Resumed = tuple[int, Mapping[str, Any]]


class Prior(Protocol):
    """What a fit takes as `prior`."""

    def settle(self, model: Decomposition) -> str:
        """Move the maps of a fit that has ended; says what was done."""


def fit(
    carrier: Carrier,
    views: Views,
    transport: Transport | MonteCarloSettings,
    settings: DecompositionSettings | None = None,
    *,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    resumed: Resumed | None = None,
    warn: Callable[[str], None] | None = None,
    log: Callable[[str], None] | None = None,
    start: Asset | None = None,
    prior: Prior | None = None,
) -> tuple[Asset, dict[str, list[float]]]:
    """Decompose the carrier's appearance into materials and light.

    transport  precomputed light of the carrier's mesh, or the settings of light that is sampled in every step
    start      maps and light to start from, of the same carrier: `stage2.init.neutral_asset` (what None means too),
               whose light is scaled to the photographs, or an asset that was fitted before, kept as it is
    prior      settles what the pictures leave open, after the last step (stage2.alike, stage2.together)
    Returns the asset and curves over iterations (`iteration`, `loss`, `image`, `psnr`: sRGB over the view's pixels).
    A call that was cut off goes on with the same arguments and `resumed`, what `checkpoint(step, state)` was last
    given, and ends with the same bytes.
    A view or step that is not finite is left out or taken back, and said by `warn` (stage2.guard).
    Raises GeometryError when `transport` or `start` belongs to another mesh, DataError when no pixel sees the mesh and
    NumericsError, naming step, view and term, when the guard cannot keep the fit finite.
    """
    settings = settings or DecompositionSettings()
    model = Decomposition(carrier, views, transport, settings, device, seed, start)
    curves = _optimise(model, seed, progress, checkpoint, resumed, warn, log)
    told = prior.settle(model) if prior is not None else ""
    if told and log:
        log(told)
    if model.exposure is not None and log:
        gains = (f"{name} {float(model.exposure.gain(k)):.3f}" for k, name in enumerate(views.names))
        log(f"exposure found: {', '.join(gains)}")
    return finished_asset(carrier, model), curves


def _optimise(
    model: Decomposition,
    seed: int,
    progress: Progress | None,
    checkpoint: Checkpoint | None,
    resumed: Resumed | None,
    warn: Callable[[str], None] | None,
    log: Callable[[str], None] | None,
) -> dict[str, list[float]]:
    """All steps; the common factor ends folded into maps and environment. Returns the curves."""
    settings = model.settings
    alone, glossy = lit_first(settings), glossy_first(settings)
    given = model.maps.parameter[:, 3].detach().clone()
    generator = torch.Generator().manual_seed(seed)
    optimiser = Adam([model.maps.parameter, model.environment, model.factor.parameter], learning_rates(settings))
    refresh = {round(settings.iterations * (i + 1) / (settings.corrections + 1)) for i in range(settings.corrections)}
    curves: dict[str, list[float]] = {"iteration": [], "loss": [], "image": [], "psnr": []}
    order: list[int] = []
    first = 0
    guard = Guard(model, optimiser, lambda view, step: weighted_terms(model, view, step)[0], warn)
    if resumed is None:
        if glossy:
            model.maps.polish(GLOSSY)
        if model.neutral or not settings.corrections:
            model.start()
        else:
            model.measure(settings.indirect_weight, generator)
        guard.start()
    else:
        first, kept = resumed
        curves, order = kept["curves"], kept["order"]
        optimiser.restore(kept["optimiser"])
        generator.set_state(kept["generator"])
        model.restore(kept)
        guard.restore(kept["guard"])
    seen = model.buffers.evidence.weight
    for step in range(first, settings.iterations):
        if step == glossy > 0:
            with torch.no_grad():
                model.maps.parameter[:, 3] = given
            optimiser.forget()
            guard.renew()
        if time := agreeing(settings, step):
            turned = agree_on_metal(model.maps, seen, settings.metal_share, model.places, again=time > 1)
            if log:
                log(f"texels about one another agree on metal: {turned} of {len(model.maps.texels)} changed sides")
        if gathering(settings, step):
            model.settle_factor()
            moved = gather_colors(model.maps, seen, settings.palette_width, METAL_WIDER)
            optimiser.forget()
            guard.renew()
            if log:
                log(f"base colours gather about their paints: moved by {100 * moved:.1f} % on the mean")
        if step in refresh:
            model.settle_factor()
            model.measure(indirect_strength(settings, step), generator)
        if not order:
            order = torch.randperm(len(model.buffers), generator=generator).tolist()
        buffer = model.buffers[order.pop()]
        if len(buffer.pixel) == 0:
            continue
        terms, predicted = weighted_terms(model, buffer, step)
        loss = torch.stack(list(terms.values())).sum()
        loss.backward()
        if not guard.passes(terms, buffer, step):
            continue
        if model.exposure is not None and step >= alone:
            model.exposure.follow(buffer, predicted, step / settings.iterations)
        if light_waits(settings, step):
            model.environment.grad = None
        gradient = model.maps.parameter.grad
        if gradient is not None and metal_alone(settings, step):
            gradient[:, :4] = 0
        if step < alone or light_follows(settings, step):
            model.maps.parameter.grad = model.factor.parameter.grad = None
        elif step == alone > 0:
            optimiser.forget()  # what the sky's moments and the count of steps hold is of another problem
        optimiser.step(guard.scale * settings.rate_decay ** (step / settings.iterations))
        model.maps.spare = gradient
        if not settings.keep_light:
            model.factor.bound(model.maps.parameter, model.maps.parameter[:, 4] if settings.metallic else None)
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
                progress(step + 1, settings.iterations, **figures)
        if checkpoint is not None:
            changed = {"optimiser": optimiser.state(), "generator": generator.get_state(), **model.state()}
            checkpoint(step + 1, {**changed, "guard": guard.state(), "curves": curves, "order": order})
    guard.finish()
    model.settle_factor()
    return curves
