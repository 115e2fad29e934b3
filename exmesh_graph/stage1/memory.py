"""What a round of Stage I will take, said before it begins: bytes from the sizes of views, pictures and texture.

Counts were measured per pixel and texel (`benchmarks/many_pictures.py` holds prediction against the peak).
"""

from __future__ import annotations

from dataclasses import dataclass

from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.targets import ssim_budget
from exmesh_graph.targets.visits import PIXEL_BYTES
from exmesh_graph.types import Stage1State, Views

#: A picture, its gradient, what is kept of each pixel's face and place in the atlas, the image terms and theirs.
STEP_BYTES = 230
#: Of a picture at full size while it is read, decoded and reduced.
DECODE_BYTES = 40
#: Statistics of a picture for D-SSIM: three planes of three float32 channels (losses.SsimTarget).
SSIM_BYTES = 36
#: float32 values of a texel: colour, gradient, two moments, each of three channels, and temporaries.
TEXEL_BYTES = 80


@dataclass(frozen=True)
class MemoryPlan:
    """Bytes by part; `held` of `views` pictures stay between visits; `before`: the process as it is."""

    parts: dict[str, int]
    held: int
    views: int
    before: int = 0

    @property
    def total(self) -> int:
        return self.before + sum(self.parts.values())

    def __str__(self) -> str:
        parts = {"held before": self.before, **self.parts}
        listed = ", ".join(f"{name} {value / 2**30:.2f}" for name, value in parts.items())
        rest = "" if self.held == self.views else f"; {self.views - self.held} pictures are made at each visit"
        return f"memory: about {self.total / 2**30:.2f} GiB at the peak ({listed}){rest}"


def plan_memory(state: Stage1State, views: Views, settings: RefineSettings, before: int = 0) -> MemoryPlan:
    """The plan of a round on the CPU."""
    pixels = (views.height // settings.downscale) * (views.width // settings.downscale)
    budget = settings.memory_gib * 2**30
    whole = PIXEL_BYTES * pixels * len(views) <= budget
    held = len(views) if whole else int(budget // (PIXEL_BYTES * pixels))
    statistics = SSIM_BYTES * pixels * len(views)
    parts = {
        "pictures": PIXEL_BYTES * pixels * (held if whole else held + 3),
        "decoding": DECODE_BYTES * views.height * views.width,
        "D-SSIM": statistics if statistics <= ssim_budget(budget, len(views), pixels) else SSIM_BYTES * pixels,
        "a step": STEP_BYTES * pixels,
        "texture": TEXEL_BYTES * state.texture.shape[0] * state.texture.shape[1],
    }
    return MemoryPlan(parts, held, len(views), before)
