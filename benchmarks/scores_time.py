"""How long a table of scenes will take: what was measured on this machine, and a model where nothing was.

A run's processor-bound nodes are modelled by what they do: views loaded, Stage I iterations, Stage II steps, scoring
(`modelled`). How many seconds of this machine a modelled second is comes from the scenes that were scored on it before;
before there is one, from a short measurement of the machine itself (`speed`).
"""

from __future__ import annotations

import json
import os
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.machine import processor
from benchmarks.register import Scene

#: Seconds where REFERENCE was measured (two cores of an AMD EPYC with other work beside it).
FIXED = 40.0  # loading libraries, atlas, export, pages
PER_MEGAPIXEL = 6.0  # of training views: loading, the hull, the light traced
NO_MASKS = 150.0  # a start without masks in place of a hull
PER_ITERATION = (0.03, 0.12)  # Stage I: so many, and so many a megapixel of the picture
PER_STEP = (0.05, 0.25)  # Stage II, likewise
PER_PICTURE = (1.0, 10.0)  # scored pictures, under the light of the photographs and four others; likewise
#: Seconds of `reference` there, and of how many repeats its median is. Where it takes 0.004 s (an EPYC), six scenes for
#: scoring took 191 s on the mean (processor seconds over 1.5), where the model says 536.
REFERENCE, REPEATS = 0.0112, 20


@dataclass(frozen=True)
class Work:
    """What a graph does on any scene: iterations of Stage I, steps of Stage II, by what pictures are reduced."""

    iterations: int
    steps: int
    downscale: int = 1


def work_of(graph: Path, settings: Mapping[str, Any], scene: Path) -> Work:
    """What `graph` with its settings would do on a scene; nothing is run. Raises GraphErrors for faults of either."""
    import exmesh_graph as ex

    nodes = [(bound.definition.type, bound.params) for bound in ex.check(graph, scene=str(scene), set=dict(settings))
             .nodes.values()]  # fmt: skip
    kinds = ("stage1.refine", "stage2.fit", "stage2.retouch")
    count = {kind: sum(p.iterations for name, p in nodes if name == kind) for kind in kinds}
    scales = [p.downscale for name, p in nodes if name == "data.blender"]
    return Work(count["stage1.refine"], count["stage2.fit"] + count["stage2.retouch"], scales[0] if scales else 1)


def modelled(scene: Scene, work: Work) -> float:
    """Seconds of a scene on the machine that the constants above were measured on."""
    view = scene.pixels[0] * scene.pixels[1] / work.downscale**2 / 1e6
    return (
        FIXED
        + PER_MEGAPIXEL * view * scene.views[0]
        + (0 if scene.masks else NO_MASKS)
        + work.iterations * (PER_ITERATION[0] + PER_ITERATION[1] * view)
        + work.steps * (PER_STEP[0] + PER_STEP[1] * view)
        + 5 * scene.views[1] * (PER_PICTURE[0] + PER_PICTURE[1] * view)
    )


class Memory:
    """Seconds of earlier scenes on this machine, in a file: {machine: {way: {scene: [seconds, as modelled]}}}.

    A way is a graph with its settings. Other machines' seconds stay in the file and are not used."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.machine = f"{processor()}, {len(os.sched_getaffinity(0))} cores"
        self.all = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        self._speed: float | None = None

    @property
    def ways(self) -> dict[str, dict[str, list[float]]]:
        return self.all.setdefault(self.machine, {})

    def keep(self, way: str, scene: str, seconds: float, model: float) -> None:
        """Remember what a scene took."""
        self.ways.setdefault(way, {})[scene] = [round(seconds, 1), round(model, 1)]
        self.file.write_text(json.dumps(self.all, indent=1) + "\n", encoding="utf-8")

    def expected(self, way: str, scene: Scene, model: float) -> float:
        """Seconds of the scene: as measured, else the model at the rate of this way, of any way, of this machine."""
        known = self.ways.get(way, {})
        if scene.name in known:
            return known[scene.name][0]
        rates = [seconds / m for seconds, m in known.values()]
        rates = rates or [seconds / m for other in self.ways.values() for seconds, m in other.values()]
        return model * (statistics.median(rates) if rates else self.speed())

    def basis(self, way: str) -> str:
        """What `expected` rests on, for people."""
        known = self.ways.get(way, {})
        if known:
            return f"by the seconds of {', '.join(known)}, measured on this machine"
        count = sum(len(scenes) for scenes in self.ways.values())
        if count:
            return f"by scenes of other graphs or settings ({count}), measured on this machine"
        return f"by a model, and this machine's speed measured now ({1 / self.speed():.2f} of the model's machine)"

    def speed(self) -> float:
        """Seconds of this machine in a second of the model's."""
        if self._speed is None:
            self._speed = reference() / REFERENCE
        return self._speed


def reference() -> float:
    """Seconds on the clock of a fixed piece of Stage I: a textured sphere, drawn and differentiated.

    The median of many: what runs beside it now and then is no part of the machine.
    """
    import torch

    from benchmarks.raster import sphere
    from exmesh_graph.raster import project, rasterize_projected, shade

    vertices, faces, uvs = sphere(20_480)
    vertices.requires_grad_()
    texture = torch.full((512, 512, 3), 0.5, requires_grad=True)
    side = 256
    intrinsics = torch.tensor([[1.37 * side, 0, side / 2], [0, 1.37 * side, side / 2], [0, 0, 1]])
    pose = torch.eye(4)
    pose[2, 3] = 3.7

    def once() -> None:
        points = project(vertices, intrinsics, pose)
        fragments = rasterize_projected(points.detach(), faces, side, side)
        shade(points, faces, uvs, faces, texture, fragments.face_id).square().mean().backward()

    once()  # what compiles or loads on first use is no part of it
    seconds = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        once()
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds)


def clock(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{seconds:.0f} s" if seconds < 90 else f"{minutes} min" if minutes < 90 else f"{minutes / 60:.1f} h"
