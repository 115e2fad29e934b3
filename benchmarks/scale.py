"""How time and memory grow with faces, views, pixels, samples and texels: figures, and exponents fitted to them.

    python -m benchmarks.scale                                        # five to eight minutes of one core
    python -m benchmarks.scale --only pixels texels --quick            # the three smallest sizes
    python -m benchmarks.scale --json scale.json --svg docs/pictures/scale.svg

Every size runs in a process of its own, forked off after the kernels are compiled: processor seconds (the least of
three where one takes less than a second) and how far its memory rose above what it began with. The exponent is the
slope of the straight line through the logarithms: 1 is linear. Fits leave out times below a millisecond and memory
below 4 MiB. Where time grows faster than n^1.1 a line says why.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks import scale_work as w
from exmesh_graph.report.charts import line_chart

SHORT_SECONDS, LEAST_SECONDS, LEAST_MIB = 1.0, 1e-3, 4.0
CACHE = "working sets leave the processor's caches, and edges are ordered by sorting (n log n)"
WHY = {
    "D-SSIM with gradient": "the blur's fields leave the caches between 10^5 and 10^6 pixels; linear from there on",
    "faces under texels": "its buffers grow into fresh memory from 10^6 to 4 x 10^6 texels; linear beyond",
    "split, one round": CACHE,
    "merge, one round": CACHE,
    "new atlas": "one sparse factorisation over all charts, whose fill grows faster than the faces, and " + CACHE,
    "transport, 64 directions": "each vertex beyond 12 000 is a point of its own, and deeper trees cost a ray log n",
}


@dataclass
class Curve:
    """An operation at growing sizes of one axis."""

    axis: str
    name: str
    sizes: list[int]
    seconds: list[float] = field(default_factory=list)
    mib: list[float] = field(default_factory=list)

    def told(self) -> dict[str, Any]:
        """The figures and the exponents fitted to them; None where too little can be fitted."""
        time_slope = slope(self.sizes, self.seconds, LEAST_SECONDS)
        steep = time_slope is not None and time_slope > 1.1
        why = WHY.get(self.name, "not known") if steep else ""
        return {**vars(self), "time": time_slope, "memory": slope(self.sizes, self.mib, LEAST_MIB), "why": why}


def main() -> None:
    """Measure, fit, print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scale", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=list(AXES), default=list(AXES))
    parser.add_argument("--quick", action="store_true", help="the three smallest sizes of each")
    parser.add_argument("--largest", type=int, default=1_000_000, help="faces at most; an atlas gets a third of them")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--svg", type=Path, help="draw time over size here")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for axis in options.only:
        sizes, operations = AXES[axis]
        sizes = [size for size in sizes if axis != "faces" or size <= options.largest]
        for name, make in operations.items():
            most = options.largest / 3 if name == "new atlas" else math.inf
            chosen = [size for size in sizes if size <= most][: 3 if options.quick else None]
            make(chosen[0])()  # compiles the kernels before anything is forked
            curve = Curve(axis, name, chosen)
            for size in chosen:
                seconds, mib = alone(make, size)
                curve.seconds.append(seconds)
                curve.mib.append(mib)
            rows.append(curve.told())
            show(rows[-1])
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    if options.svg:
        options.svg.write_text(picture(rows), encoding="utf-8")


def show(row: dict[str, Any]) -> None:
    """One line of sizes, one of milliseconds, one of MiB, with the exponents."""
    print(f"\n{row['axis']}: {row['name']}")
    print("  size   " + "".join(f"{size:>12,d}" for size in row["sizes"]))
    print("  ms     " + "".join(f"{1000 * s:12.4g}" for s in row["seconds"]) + "   time ~ n^" + _power(row["time"]))
    print(
        "  MiB    " + "".join(f"{m:12.4g}" for m in row["mib"]) + "   memory ~ n^" + _power(row["memory"]), flush=True
    )
    if row["why"]:
        print(f"  why: {row['why']}")


def slope(sizes: Sequence[float], values: Sequence[float], least: float) -> float | None:
    """Least-squares slope of log values over log sizes, of values from `least` on; None for fewer than three."""
    kept = [(math.log(size), math.log(value)) for size, value in zip(sizes, values, strict=True) if value >= least]
    if len(kept) < 3:
        return None
    x, y = np.array(kept).T
    return float(np.polyfit(x, y, 1)[0])


def alone(make: Callable[[int], w.Work], size: int) -> tuple[float, float]:
    """(processor seconds, MiB gained) of the work of that size, in a forked process; its preparation is not counted."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_measured, args=(make, size, theirs))
    child.start()
    theirs.close()
    try:
        found = ours.recv()
    except EOFError:
        raise SystemExit(f"the process that measured size {size} ended early: too little memory?") from None
    finally:
        child.join()
    return found


def _measured(make: Callable[[int], w.Work], size: int, pipe: Any) -> None:
    work = make(size)
    before = _resident()
    resource_before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    seconds = []
    for _ in range(3):
        begun = time.process_time()
        work()
        seconds.append(time.process_time() - begun)
        if seconds[-1] > SHORT_SECONDS:
            break
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    # where preparing took more than the work, the peak tells nothing and what stayed resident is the best there is
    gained = peak - before if peak > resource_before else max(0.0, _resident() - before)
    pipe.send((min(seconds), gained))
    pipe.close()


def _resident() -> float:
    """MiB that this process has in memory."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def squares(*sides: int) -> list[int]:
    return [side * side for side in sides]


AXES: dict[str, tuple[list[int], dict[str, Callable[[int], w.Work]]]] = {
    "faces": (
        [10_000, 30_000, 100_000, 300_000, 1_000_000],
        {"rasterise at 512 x 512": w.rasterise, "a picture with gradients, 512 x 512": lambda n: w.colour(n, 512),
         "split, one round": w.splitting, "merge, one round": w.merging, "new atlas": w.unwrapping,
         "transport, 64 directions": w.tracing},
    ),
    "views": ([10, 30, 100, 250, 500], {"visual hull, 64 voxels": w.carving, "seen faces, 256 x 256": w.counting}),
    "pixels": (
        squares(128, 256, 512, 1024, 2048),
        {"a picture with gradients, 20 000 faces": lambda n: w.colour(20_000, round(math.sqrt(n))),
         "D-SSIM with gradient": w.similarity},
    ),
    "samples": (
        [16, 32, 64, 128, 256],
        {"Monte Carlo light with gradients": w.lighting, "transport, 20 000 faces": lambda n: w.tracing(20_000, n)},
    ),
    "texels": (
        squares(256, 512, 1024, 2048, 4096),
        {"faces under texels": w.atlas_map, "spread beyond charts": w.spreading, "Adam's step": w.optimising},
    ),
}  # fmt: skip
COLOURS = ("#1f6f8b", "#b3541e", "#5b7f2b", "#7a4f9a", "#b38f00", "#444444")


def picture(rows: Sequence[dict[str, Any]]) -> str:
    """Time over size, both logarithmic, a panel per axis, as SVG with its own colours."""
    axes = list(dict.fromkeys(row["axis"] for row in rows))
    wide, high = 360, 330
    columns = min(3, len(axes))
    lines = -(-len(axes) // columns)
    style = "".join(f".c{k % 4}.l{k}{{stroke:{c};fill:none}}text.l{k}{{fill:{c}}}" for k, c in enumerate(COLOURS))
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide * columns} {high * lines}" '
        f'font-family="sans-serif" font-size="11"><style>{style}.grid{{stroke:#e3e6e8}}.title{{font-weight:600}}'
        '.curve{stroke-width:1.8}</style><rect width="100%" height="100%" fill="white"/>'
    ]
    for index, axis in enumerate(axes):
        members = [row for row in rows if row["axis"] == axis]
        curves = [(row["name"], row["sizes"], [1000 * s for s in row["seconds"]]) for row in members]
        chart = line_chart(curves, title="milliseconds", x_label=axis, log="xy", width=wide - 10, height=220)
        for k in range(len(members)):
            chart = chart.replace(f'class="curve c{k % 4}"', f'class="curve c{k % 4} l{k}"', 1)
        x, y = index % columns * wide, index // columns * high
        parts.append(chart.replace("<svg ", f'<svg x="{x}" y="{y}" ', 1))
        for k, row in enumerate(members):
            words = escape(f"{row['name']}: n^{_power(row['time'])}")
            parts.append(f'<text class="l{k}" x="{x + 20}" y="{y + 234 + 15 * k}">{words}</text>')
    return "".join(parts) + "</svg>\n"


def _power(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


if __name__ == "__main__":
    main()
