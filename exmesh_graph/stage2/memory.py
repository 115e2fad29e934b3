"""What a fit will take, said before it begins: bytes from the sizes of views, maps and light.

Counts were measured per pixel, texel and point (`benchmarks/stage2_memory.py` holds prediction against the peak).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from exmesh_graph.resources import memory_to_spare
from exmesh_graph.stage2.gbuffer import SSIM_BYTES
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.types import Carrier, Transport, Views

#: A view's buffer: indices int64, weights float32, target, pairs, the precomputed light's part without its factor.
PIXEL_BYTES = 195
#: The specular factor, which stays for all views; float32 [3].
FACTOR_BYTES = 12
#: Temporaries of a step (forward, backward, D-SSIM) or of making a buffer, for each pixel of its view.
STEP_BYTES = 2400
#: float32 columns for each channel of a texel: parameter, gradient, two moments, the guard's copy of three, values,
#: their gradient and temporaries of Adam and sigmoid.
TEXEL_COLUMNS = 14
#: Survey and result: masks, row table, evidence, whole maps, for each texel of the square.
ATLAS_BYTES = 120
#: For the views' buffers where `memory_gib` is auto.
LEAST_BUDGET = 4 * 2**30


@dataclass(frozen=True)
class MemoryPlan:
    """Bytes by part; `held` of `views` view buffers stay in memory; `before`: the process as it is."""

    parts: dict[str, int]
    held: int
    views: int
    before: int = 0

    @property
    def total(self) -> int:
        return self.before + sum(self.parts.values())

    def figures(self) -> dict[str, float]:
        """GiB by part, and `total`."""
        parts = {"held before": self.before, **self.parts, "total": self.total}
        return {name: round(value / 2**30, 3) for name, value in parts.items()}

    def __str__(self) -> str:
        listed = ", ".join(f"{name} {value:.2f}" for name, value in self.figures().items() if name != "total")
        anew = self.views - self.held
        rest = f"; {anew} views' buffers are made at each visit (memory_gib)" if anew else ""
        return f"memory: about {self.total / 2**30:.2f} GiB at the peak ({listed}){rest}"


def buffer_budget(settings: DecompositionSettings, device: torch.device | str = "cpu") -> float:
    """Bytes that the views' buffers may take on `device`."""
    if settings.memory_gib != "auto":
        return float(settings.memory_gib) * 2**30
    on = torch.device(device)
    free = torch.cuda.mem_get_info(on)[0] if on.type == "cuda" else memory_to_spare()
    return max(free / 2, LEAST_BUDGET)


def plan_memory(
    carrier: Carrier, views: Views, transport: Transport | None, settings: DecompositionSettings, before: int = 0
) -> MemoryPlan:
    """The plan of a fit; `transport` None where light is sampled in every step."""
    pixels = [int((alpha >= settings.min_coverage).sum()) for alpha in views.alpha]
    box = [_box_area(alpha >= settings.min_coverage) for alpha in views.alpha]
    sizes = [PIXEL_BYTES * n + FACTOR_BYTES * n + SSIM_BYTES * b for n, b in zip(pixels, box, strict=True)]
    held = int((np.cumsum(sizes) <= buffer_budget(settings)).sum())
    largest = max(pixels, default=0)
    size = settings.texture_size or carrier.texture.shape[0]
    texels = min(size * size, 4 * sum(pixels))
    channels = 4 + settings.metallic + 2 * settings.normal_map
    environment = 8 * settings.environment_height**2 * 3 * 4 * TEXEL_COLUMNS
    light = 0 if transport is None else _transport_bytes(transport, settings.normal_map)
    parts = {
        "view buffers": sum(sizes[:held]) + (0 if held == len(views) else max(sizes)),
        "specular factors": FACTOR_BYTES * sum(pixels[held:]),
        "maps and their optimiser": texels * channels * 4 * TEXEL_COLUMNS + ATLAS_BYTES * size * size + environment,
        "light transport": light,
        "a step": largest * STEP_BYTES,
    }
    return MemoryPlan(parts, held, len(views), before)


def _box_area(inside: np.ndarray) -> int:
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    return 0 if len(rows) == 0 else int((rows[-1] - rows[0] + 1) * (columns[-1] - columns[0] + 1))


def _transport_bytes(light: Transport, normal_map: bool) -> int:
    """Operators T (float32), visibility (bytes), M and its transpose (CSR with int64 columns); for a normal map T and M
    again for each axis."""
    points, directions = len(light.points), len(light.directions)
    entries = 0 if light.gather_point is None else len(light.gather_point)
    axes = 3 * normal_map
    return points * directions * (4 + 1 + 4 + 4 * axes) + (2 + axes) * 12 * entries
