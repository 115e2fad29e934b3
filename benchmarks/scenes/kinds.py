"""What a scene is made of: the recipe that `make` follows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from benchmarks.scenes.model import Painter
from benchmarks.scenes.shapes import Solid


@dataclass(frozen=True)
class Recipe:
    """solids   makes the object
    paint    what the object is painted with
    light    of the photographs: ("studio" | "day" | ..., seed) or a name of `lights.WORLDS` with columns to turn it by
    relit    the lights of the relit test views: {name: seed of a procedural one}
    heights  lowest and highest camera, z over distance
    texels   side of the maps
    ground   names of solids that are no part of the object: then there are no masks, and the light is in the pictures
    level    radiance of every light, summed over all directions: the exposure
    wander   exposure, white balance and a moving shadow in the training pictures
    """

    solids: Callable[[], Sequence[Solid]]
    paint: Painter
    light: tuple[str, int]
    seed: int
    heights: tuple[float, float] = (-0.5, 0.95)
    texels: int = 1024
    ground: tuple[str, ...] = ()
    level: float = 7.6
    wander: bool = False
    relit: dict[str, int] = field(default_factory=dict)

    def lights(self) -> dict[str, tuple[str, int]]:
        """The relit views' lights: each kind turned as the scene's seed says."""
        kinds = self.relit or {name: self.seed + k for k, name in enumerate(("sun", "overcast", "lamps", "coloured"))}
        return {name: (name, seed) for name, seed in kinds.items()}
