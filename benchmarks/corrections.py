"""What rays of a correction cost and how far the factor is off: of all pixels, and at crossings of rows and columns.

    exmesh run graphs/exmeshpp.yaml --set scene=FOLDER/vase        # or any graph with Stage II on large pictures
    python -m benchmarks.corrections runs/latest --views 8

The materials and the light of the run's `pbr`, some of its views. Both ways take `correction_samples` rays of a pixel
together; what they are compared with takes 256 of each. Suns are compared with rays of every pixel.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import torch

import exmesh_graph as ex
from benchmarks.machine import processor
from exmesh_graph.gpu.cores import share
from exmesh_graph.gpu.torch_setup import sharing
from exmesh_graph.shading import envmap
from exmesh_graph.shading.operators import at_surface
from exmesh_graph.shading.suns import find_suns
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.light.correction import measured_specular_scale
from exmesh_graph.stage2.light.fitted_suns import view_transfer
from exmesh_graph.stage2.light.precomputed import PrecomputedLight
from exmesh_graph.stage2.maps import Appearance
from exmesh_graph.stage2.settings import DecompositionSettings

EVERY = 1 << 40
"""Crossings that no view has: all pixels are measured."""
MANY = 256


class Row(NamedTuple):
    """Seconds on the clock, all cores; mean and root mean square error of the factor, of a sun's irradiance."""

    what: str
    seconds: float
    mean: float
    rms: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--views", type=int, default=8)
    options = parser.parse_args()
    run = ex.open_run(options.run)
    views, asset = run["balanced"].views, run["pbr"].asset
    chosen = list(range(0, len(views), max(1, len(views) // options.views)))[: options.views]
    settings = DecompositionSettings(
        iterations=1, texture_size=asset.base_color.shape[0], environment_height=asset.environment.shape[0],
        metallic=asset.metallic is not None,
    )  # fmt: skip
    model = Decomposition(run["settle"].state, views.subset(chosen), run["bounce"].transport, settings, "cpu", 0, asset)
    print(f"{len(chosen)} views of {sum(model.buffers.pixels)} pixels, {processor()}")
    print(f"{'':28s}{'s':>8s}{'mean':>10s}{'rms':>10s}")
    with sharing(0):
        for row in (*factors(model, None), *suns(model, None)):
            print(f"{row.what:28s}{row.seconds:8.2f}{row.mean:10.2g}{row.rms:10.2g}")


@torch.no_grad()
def factors(model: Decomposition, crossings: int | None) -> list[Row]:
    """The factor by rays of all pixels and at crossings, against many rays of all pixels."""
    light = model.light
    assert isinstance(light, PrecomputedLight)
    now = Appearance(model.maps, model.maps.values(), envmap.radiance_of(model.environment))
    prepared = light.prepare(now)
    leaving = light.lattice_sends(now.maps, now.values) * prepared.irradiance
    settings = light.settings

    def found(samples: int, count: int | None, seed: int) -> Callable[[ViewBuffer], torch.Tensor]:
        light.settings = settings.replaced(correction_samples=samples)
        return lambda buffer: measured_specular_scale(
            light, buffer, now.maps.read(now.values, buffer.texel, buffer.texel_weight), prepared, now.environment,
            lambda face, bary: at_surface(light.operators.light, leaving, face, bary),
            torch.Generator().manual_seed(seed + buffer.number), count,
        )  # fmt: skip

    _, exact = _timed(found(MANY, EVERY, 1 << 20), model.buffers)
    rows = []
    for what, count in (("factor, all pixels", EVERY), ("factor, crossings", crossings)):
        seconds, values = _timed(found(settings.correction_samples, count, 0), model.buffers)
        rows.append(_row(what, seconds, values, exact))
    light.settings = settings
    return rows


@torch.no_grad()
def suns(model: Decomposition, crossings: int | None) -> list[Row]:
    """The irradiance of the fit's small suns by rays of all pixels and at crossings; empty where there are none."""
    light = model.light
    assert isinstance(light, PrecomputedLight)
    found = find_suns(envmap.radiance_of(model.environment), len(light.operators.light.directions))
    if not len(found):
        return []

    def traced(count: int | None) -> Callable[[ViewBuffer], torch.Tensor]:
        return lambda buffer: view_transfer(found, buffer, buffer.samples(model.geometry), light.tracer, count)

    seconds, exact = _timed(traced(EVERY), model.buffers)
    fewer, values = _timed(traced(crossings), model.buffers)
    return [
        _row(f"{len(found)} suns, all pixels", seconds, exact, exact),
        _row(f"{len(found)} suns, crossings", fewer, values, exact),
    ]


def _timed(
    task: Callable[[ViewBuffer], torch.Tensor], buffers: Iterable[ViewBuffer]
) -> tuple[float, list[torch.Tensor]]:
    @torch.no_grad()  # a thread's own switch
    def one(buffer: ViewBuffer) -> torch.Tensor:
        return task(buffer)

    began = time.perf_counter()
    found = list(share(one, buffers))
    return time.perf_counter() - began, found


def _row(what: str, seconds: float, values: list[torch.Tensor], exact: list[torch.Tensor]) -> Row:
    apart = torch.cat([(a - b).reshape(-1) for a, b in zip(values, exact, strict=True)]).double()
    return Row(what, seconds, float(apart.abs().mean()), float(apart.square().mean().sqrt()))


if __name__ == "__main__":
    main()
