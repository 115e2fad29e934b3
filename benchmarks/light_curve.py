"""Error against seconds of the Monte Carlo light, for every choice it offers; draws the picture of
docs/monte_carlo.md.

    python -m benchmarks.light_curve --svg docs/pictures/light_curve.svg
    python -m benchmarks.light_curve --quick

Scene: `light_scene` (an open box, a ball and a ring partly of metal, a real sky), direct plus one bounce. Seconds:
forward and backward (to vertex materials and sky), best of --repeats; error: RMSE over RMS of the image against a
converged one, over as many seeds. Choices: where the N_d direct samples go, N_b secondary rays, N_s light samples at
their hits, the bounce at half or full resolution, rays fresh or cached (a cached step traces nothing, and repeats its
slot's noise). The lower hull is the convex one in the logarithms, for fresh rays and for cached ones. Exits with 1
unless the estimator's defaults lie within --slack of the fresh one.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import escape

import torch

from benchmarks import light_scene
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo import Drawn, MonteCarloLight
from exmesh_graph.shading.settings import MonteCarloSettings

SAMPLERS = ("environment", "brdf", "mis", "cosine")


@dataclass(frozen=True)
class Choice:
    sampler: str
    direct: int
    rays: int
    at_hit: int
    half: bool = True
    cached: bool = False

    @property
    def name(self) -> str:
        bounce = f"{self.rays} x {self.at_hit} {'half' if self.half else 'full'}"
        return f"{self.sampler} {self.direct}, {bounce}{', cached' if self.cached else ''}"

    @property
    def settings(self) -> MonteCarloSettings:
        return MonteCarloSettings(
            technique=self.sampler,  # type: ignore[arg-type]
            samples=self.direct,
            secondary_rays=self.rays,
            secondary_samples=self.at_hit,
        )


#: On the lower hull of error against seconds, and the paper's counts (the settings' defaults).
DENSE, PAPER = Choice("mis", 64, 16, 4), Choice("environment", 8, 16, 4)


def choices(quick: bool) -> list[Choice]:
    """The grid: samplers by N_d, then the bounce's counts and resolution, then cached rays."""
    if quick:
        return list(dict.fromkeys([DENSE, PAPER, Choice("mis", 4, 4, 1), Choice("mis", 8, 4, 1, True, True)]))
    grid = [Choice(sampler, count, 16, 4) for sampler in SAMPLERS for count in (4, 8, 16, 32, 64, 128)]
    for sampler, count in (("environment", 32), ("mis", 8), ("mis", 32), ("mis", 128)):
        for rays, at_hit in ((4, 1), (8, 1), (16, 1), (16, 4), (32, 1), (32, 4)):
            grid += [Choice(sampler, count, rays, at_hit, half) for half in (True, False)]
    for sampler in ("environment", "mis"):
        grid += [Choice(sampler, count, 16, 4, True, True) for count in (8, 32, 128)]
    return list(dict.fromkeys([DENSE, PAPER, *grid]))


def main() -> int:
    options = arguments()
    torch.set_num_threads(options.threads)
    scene = light_scene.build(options.size, metallic=True)
    bench = Bench(scene, options)
    print(f"{len(scene.pixel)} points, {options.threads} threads, {options.clock} clock", flush=True)
    rows = []
    for choice in choices(options.quick):
        rows.append({**asdict(choice), "name": choice.name, **bench.measure(choice)})
        print(
            f"  {choice.name}: {1000 * rows[-1]['seconds']:.1f} ms, {rows[-1]['error']:.2%}",
            file=sys.stderr,
            flush=True,
        )
    for cached in (False, True):
        chosen = [row for row in rows if row["cached"] == cached]
        for row in chosen:
            row["above_hull"] = above(row, hull(chosen))
    print(f"{'':36}{'ms':>9}{'error':>9}{'above hull':>12}")
    for row in sorted(rows, key=lambda r: (r["cached"], r["seconds"])):
        mark = {DENSE.name: "  dense", PAPER.name: "  paper"}.get(row["name"], "")
        on = "on it" if row["above_hull"] < 1e-9 else f"{row['above_hull']:.0%}"
        print(f"{row['name']:36}{1000 * row['seconds']:9.1f}{row['error']:9.2%}{on:>12}{mark}")
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    if options.svg:
        options.svg.parent.mkdir(parents=True, exist_ok=True)
        options.svg.write_text(picture(rows, scene, options.threads), encoding="utf-8")
    distance = next(row["above_hull"] for row in rows if row["name"] == DENSE.name)
    print(f"defaults ({DENSE.name}): {distance:.1%} above the hull, limit {options.slack:.0%}")
    return int(distance > options.slack)


class Bench:
    def __init__(self, scene: light_scene.Scene, options: argparse.Namespace) -> None:
        self.scene, self.repeats = scene, options.repeats
        self.clock = time.process_time if options.clock == "cpu" else time.perf_counter
        self.points, self.coarse, self.tracer = scene.points(), scene.coarse(), scene.tracer(options.threads)
        self.weights = torch.rand(len(scene.pixel), 3, generator=torch.Generator().manual_seed(0))
        best = Choice("mis", 128, 64, 2, half=False)
        self.reference = sum(self.step(best, 10_000 + k)[0] for k in range(options.reference)) / options.reference

    def measure(self, choice: Choice) -> dict[str, float]:
        """Best seconds of a step and the mean error of its image."""
        self.step(choice, 0)
        seconds, squares = [], []
        for seed in range(self.repeats):
            kept = self.draw(choice, seed) if choice.cached else None
            image, took = self.step(choice, seed, kept)
            seconds.append(took)
            squares.append(float(((image - self.reference) ** 2).mean() / (self.reference**2).mean()))
        return {"seconds": min(seconds), "error": math.sqrt(sum(squares) / len(squares))}

    def draw(self, choice: Choice, seed: int) -> Drawn:
        scene = self.scene
        light = MonteCarloLight(scene.surface, self.tracer, choice.settings)
        material = scene.material(scene.attributes, scene.face, scene.bary)
        coarse = self.coarse if choice.half else None
        return light.draw(self.points, material, scene.query(scene.attributes), EnvSampler(scene.sky), seed, coarse)

    def step(self, choice: Choice, seed: int, drawn: Drawn | None = None) -> tuple[torch.Tensor, float]:
        """One image and the seconds it took with its backward pass."""
        scene = self.scene
        attributes, sky = scene.attributes.clone().requires_grad_(), scene.sky.clone().requires_grad_()
        began = self.clock()
        drawn = drawn or self.draw(choice, seed)
        light = MonteCarloLight(scene.surface, self.tracer, choice.settings)
        material = scene.material(attributes, scene.face, scene.bary)
        image = light.shade(drawn, self.points, material, scene.query(attributes), sky)
        (image * self.weights).sum().backward()
        return image.detach(), self.clock() - began


def hull(rows: list[dict]) -> list[tuple[float, float]]:
    """The lower left convex hull of (log seconds, log error), from the fastest to the most exact."""
    points = sorted((math.log(row["seconds"]), math.log(row["error"])) for row in rows)
    lower: list[tuple[float, float]] = []
    for point in points:
        if lower and point[1] >= lower[-1][1]:
            continue
        while len(lower) > 1 and _turn(lower[-2], lower[-1], point) <= 0:
            lower.pop()
        lower.append(point)
    return lower


def above(row: dict, lower: list[tuple[float, float]]) -> float:
    """By how much the row's error lies above the hull at its seconds, as a ratio minus one."""
    x, y = math.log(row["seconds"]), math.log(row["error"])
    for (x0, y0), (x1, y1) in pairwise(lower):
        if x0 <= x <= x1:
            return math.exp(y - (y0 + (y1 - y0) * (x - x0) / (x1 - x0))) - 1
    return math.exp(y - lower[-1][1]) - 1


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


COLOURS = {"environment": "#1f77b4", "brdf": "#d18f00", "mis": "#c0392b", "cosine": "#2e8b57"}
WIDTH, HEIGHT, LEFT, TOP, RIGHT, BOTTOM = 760, 460, 70, 46, 24, 54


def picture(rows: list[dict], scene: light_scene.Scene, threads: int) -> str:
    """The rows as an SVG: seconds to the right, error upwards, both logarithmic."""
    xs, ys = [row["seconds"] for row in rows], [row["error"] for row in rows]
    x_low, x_high = math.log(min(xs) / 1.25), math.log(max(xs) * 1.25)
    y_low, y_high = math.log(min(ys) / 1.15), math.log(max(ys) * 1.15)

    def place(x: float, y: float) -> tuple[float, float]:
        across = LEFT + (x - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT)
        return across, HEIGHT - BOTTOM - (y - y_low) / (y_high - y_low) * (HEIGHT - TOP - BOTTOM)

    def text(x: float, y: float, words: str, anchor: str = "start", extra: str = "") -> str:
        return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {extra}>{escape(words)}</text>'

    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
        text(
            LEFT,
            18,
            "Direct and one-bounce light: error of the image against milliseconds of a step",
            extra='font-size="14"',
        ),
        text(LEFT, 36, f"forward and backward, {len(scene.pixel)} points, CPU threads: {threads}", extra='fill="#555"'),
    ]
    for value in _ticks(x_low, x_high):
        x, _ = place(math.log(value), y_low)
        out.append(f'<path d="M{x:.1f} {TOP}V{HEIGHT - BOTTOM}" stroke="#e4e4e4"/>')
        out.append(text(x, HEIGHT - BOTTOM + 18, f"{1000 * value:g}", "middle"))
    for value in _ticks(y_low, y_high):
        _, y = place(x_low, math.log(value))
        out.append(f'<path d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}" stroke="#e4e4e4"/>')
        out.append(text(LEFT - 8, y + 4, f"{100 * value:g} %", "end"))
    out.append(text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 12, "milliseconds", "middle"))
    for cached, dash in ((False, ""), (True, ' stroke-dasharray="5 4"')):
        line = [place(*p) for p in hull([row for row in rows if row["cached"] == cached])]
        path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in line)
        out.append(f'<path d="{path}" fill="none" stroke="#444" stroke-width="1.2"{dash}/>')
    for row in rows:
        x, y = place(math.log(row["seconds"]), math.log(row["error"]))
        colour = COLOURS[row["sampler"]]
        fill = "white" if row["cached"] else colour
        style = f'fill="{fill}" stroke="{colour}" stroke-width="1.5" fill-opacity="0.85"'
        title = f"<title>{escape(row['name'])}: {1000 * row['seconds']:.1f} ms, {row['error']:.2%}</title>"
        shape = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.5" {style}>{title}</circle>'
        if not row["half"]:
            shape = f'<rect x="{x - 4:.1f}" y="{y - 4:.1f}" width="8" height="8" {style}>{title}</rect>'
        out.append(shape)
        label = {DENSE.name: "mis 64", PAPER.name: "paper's counts"}.get(row["name"])
        if label:
            out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8.5" fill="none" stroke="#000"/>')
            out.append(text(x + 12, y - 8, label, extra='font-weight="bold"'))
    for number, (name, colour) in enumerate(COLOURS.items()):
        y = TOP + 16 + 17 * number
        out.append(f'<circle cx="{WIDTH - 214}" cy="{y - 4}" r="4.5" fill="{colour}"/>' + text(WIDTH - 204, y, name))
    y = TOP + 16 + 17 * len(COLOURS)
    out.append(text(WIDTH - 219, y, "● half, ■ full-resolution bounce", extra='font-size="11"'))
    out.append(text(WIDTH - 219, y + 16, "hollow, dashed: cached rays", extra='font-size="11"'))
    return "\n".join([*out, "</svg>"]) + "\n"


def _ticks(low: float, high: float) -> list[float]:
    """1, 2, 5 times powers of ten between exp(low) and exp(high)."""
    values = [step * 10.0**power for power in range(-6, 4) for step in (1, 2, 5)]
    return [value for value in values if low <= math.log(value) <= high]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.light_curve",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--size", type=int, default=128, help="pixels on a side")
    parser.add_argument("--repeats", type=int, default=6, help="seeds a choice")
    parser.add_argument(
        "--reference", type=int, default=40, help="images of mis 128, 64 x 2 averaged into the reference"
    )
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument(
        "--clock", choices=["wall", "cpu"], default="wall", help="cpu: seconds over all cores, for a busy machine"
    )
    parser.add_argument("--slack", type=float, default=0.05, help="how far the defaults may lie above the hull")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--svg", type=Path, help="draw the picture there")
    parser.add_argument("--out", type=Path, help="write the rows as JSON")
    options = parser.parse_args()
    if options.quick:
        options.size, options.repeats, options.reference, options.slack = 48, 3, 6, 1.0
    return options


if __name__ == "__main__":
    sys.exit(main())
