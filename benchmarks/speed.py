"""Seconds of this checkout against an earlier commit's, each stage on one core and on two: `exmesh bench --speed`.

    python -m benchmarks.speed                          # against the commit before the kernels used all cores
    python -m benchmarks.speed --quick --case stage1    # smaller pictures, two turns
    python -m benchmarks.speed --case minute            # the earlier quickstart, today's minute, and their errors
    python -m benchmarks.speed --against REVISION --json speed.json

Both sides run the same graphs by their own command line, in turns, each with a store of its own; what a case measures
is one node, from the run's own report. An iteration costs the difference between a longer and a shorter run over the
difference of their lengths, so nothing that a node does once counts. Photographs are the sample's, enlarged: their
content hardly matters for time. The other cores' columns are a model, Amdahl's law with the serial share that one core
against two tells, and no measurement.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

from benchmarks.machine import processor
from exmesh_graph.errors import ExmeshError

ROOT = Path(__file__).parents[1]
BEFORE = "8719830"
MODELLED = (8, 32)
VIEWS = 8

_MESH = {
    "views": {"type": "data.blender", "path": "${scene}"},
    "hull": {"type": "init.visual_hull", "views": "@views.train", "resolution": 128},
    "coarse": {"type": "init.clean", "mesh": "@hull.mesh", "faces": 30000},
    "atlas": {"type": "uv.unwrap", "mesh": "@coarse.mesh", "texture_size": 1024},
}
_STAGE1 = {
    **_MESH,
    "texture": {"type": "appearance.uv_texture"},
    "start": {"type": "stage1.init", "carrier": "@atlas.carrier", "views": "@views.train", "appearance": "@texture"},
    "smooth": {"type": "regulariser.bilaplacian"},
    "node": {"type": "stage1.refine", "state": "@start.state", "views": "@views.train", "smoothness": "@smooth",
             "total_iterations": 10000},
}  # fmt: skip
_STAGE2 = {
    **_MESH,
    "light": {"type": "transport.direct", "mesh": "@atlas.carrier", "directions": 128},
    "neutral": {"type": "stage2.init", "carrier": "@atlas.carrier"},
    "node": {"type": "stage2.fit", "carrier": "@atlas.carrier", "views": "@views.train",
             "transport": "@light.transport", "start": "@neutral.asset", "texture_size": 2048, "corrections": 0},
}  # fmt: skip
_PGSR = {
    "views": _MESH["views"],
    "node": {"type": "init.pgsr", "views": "@views.train", "start": "hull", "count": 20000},
}


@dataclass(frozen=True)
class Case:
    """What one node costs: per iteration between two lengths, or as a whole where there are none.

    lengths  far enough apart: what a node does before its first iteration varies by a second
    goal     the share of the earlier commit's time that was asked for
    """

    label: str
    nodes: Mapping[str, Any]
    size: tuple[int, int]
    lengths: tuple[int, int] | None
    goal: float
    sets: Mapping[str, object] = field(default_factory=dict)
    views: int = VIEWS


CASES = {
    "stage1": Case("Stage I iteration, 512 x 512, 30 K faces", _STAGE1, (512, 512), (10, 160), 1 / 8),
    "stage1_large": Case("Stage I iteration, 1600 x 1200, 100 K faces", _STAGE1, (1600, 1200), (8, 40), 1 / 12,
                         {"coarse.faces": 100000, "hull.resolution": 224, "atlas.texture_size": 2048}),
    "stage2": Case("Stage II step, 800 x 800, 2048 maps", _STAGE2, (800, 800), (8, 40), 1 / 6),
    "pgsr": Case("PGSR iteration, 512 x 512, 20 K Gaussians", _PGSR, (512, 512), (8, 104), 1 / 5),
    "load": Case("load 49 pictures of 800 x 600", {"node": _MESH["views"]}, (800, 600), None, 1 / 6, views=49),
}  # fmt: skip
#: Whole runs, and what this checkout's is told. `minute`: the schedule of a minute, which is to be no worse.
WHOLE: dict[str, dict[str, object]] = {"quickstart": {}, "minute": {"budget": "1min", "scored_views": 0}}
ERRORS = ("Chamfer", "Held-out PSNR", "Relit PSNR", "Albedo PSNR (linear)")
SMALLER = {"stage1_large": (800, 600), "stage2": (400, 400), "pgsr": (256, 256)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", default=BEFORE, metavar="REVISION")
    parser.add_argument("--case", action="append", choices=[*CASES, *WHOLE], help="default: all")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="smaller pictures, two turns, no quickstart")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    names = options.case or [*CASES, *([] if options.quick else WHOLE)]
    repeats = 2 if options.quick else options.repeats
    available = sorted(os.sched_getaffinity(0))
    both = available[:2]
    print(f"{processor()}, {len(available)} cores; medians of {repeats}; seconds before are of {options.against}")
    header = ("before", "now", "ratio", "goal", "one core", "two/one", *(f"{n} (model)" for n in MODELLED))
    print(f"{'':48s}" + "".join(f"{word:>11s}" for word in header), flush=True)
    rows: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        before, now = Side(checkout(options.against, work / "before")), Side(checkout("", work / "now"))
        for name in names:
            label, goal, turns, run = prepared(name, options.quick, repeats, work)
            found: dict[str, list[float]] = {"before": [], "now": [], "one core": []}
            for _ in range(turns):
                found["before"].append(run(before, both))
                found["now"].append(run(now, both))
                found["one core"].append(run(now, both[:1]))
            rows[name] = row = figures({key: statistics.median(values) for key, values in found.items()}, goal)
            print(f"{label:48s}" + "".join(shown(key, value) for key, value in row.items()), flush=True)
            if name in WHOLE:
                print("\n".join(f"  {side.root.name}: {side.errors}" for side in (before, now)), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def prepared(name: str, quick: bool, repeats: int, work: Path) -> tuple[str, float, int, Callable[..., float]]:
    """(label, goal, turns, seconds of a side on given cores)."""
    if name in WHOLE:
        label = "quickstart, start to report" + (", now budget=1min" if name == "minute" else "")
        return label, 1 / 3, min(repeats, 2), lambda side, cores: side.whole(WHOLE[name], cores)
    case = CASES[name]
    size = SMALLER.get(name, case.size) if quick else case.size
    label = case.label.replace(f"{case.size[0]} x {case.size[1]}", f"{size[0]} x {size[1]}")
    scene = photographs(work / f"{size[0]}x{size[1]}x{case.views}", size, case.views)
    return label, case.goal, repeats, lambda side, cores: side.measured(name, case, scene, cores)


class Side:
    """One checkout, run by this interpreter with the checkout first on its path, and a store of its own."""

    def __init__(self, root: Path) -> None:
        self.root, self.store = root, root / "store"
        self.errors = ""

    def measured(self, name: str, case: Case, scene: Path, cores: list[int]) -> float:
        """Seconds of the case's node: of an iteration, or of all of it."""
        graph = self.root / f"{name}.yaml"
        params = {"scene": {"type": "path", "default": str(scene)}}
        graph.write_text(json.dumps({"name": name, "params": params, "nodes": case.nodes}), encoding="utf-8")
        sets = dict(case.sets)
        if self.root.name == "now" and case.lengths:
            sets["node.threads"] = len(cores)
        if case.lengths is None:
            return self._node(graph, sets, cores)
        short, long = (self._node(graph, {**sets, "node.iterations": n}, cores) for n in case.lengths)
        return (long - short) / (case.lengths[1] - case.lengths[0])

    def whole(self, sets: Mapping[str, object], cores: list[int]) -> float:
        """Seconds from start to report, from an empty store; the earlier commit's side is told nothing."""
        shutil.rmtree(self.store, ignore_errors=True)
        sets = sets if self.root.name == "now" else {}
        report = self._run(self.root / "graphs" / "quickstart.yaml", sets, cores, [])
        figures = {name: report["headline"][name] for name in ERRORS if name in report["headline"]}
        self.errors = ", ".join(f"{name} {one['value']:.4g} {one['unit']}" for name, one in figures.items())
        return float(report["seconds"]["this_run"])

    def _node(self, graph: Path, sets: Mapping[str, object], cores: list[int]) -> float:
        report = self._run(graph, sets, cores, ["--node", "node", "--force", "node"])
        return next(float(node["seconds"]) for node in report["nodes"] if node["name"] == "node")

    def _run(self, graph: Path, sets: Mapping[str, object], cores: list[int], more: list[str]) -> dict[str, Any]:
        runs = self.root / "runs"
        shutil.rmtree(runs, ignore_errors=True)
        command = [sys.executable, "-c", "from exmesh_graph.cli import main; main()", "run", str(graph),
                   "--store", str(self.store), "--runs", str(runs), *more]  # fmt: skip
        command += [word for key, value in sets.items() for word in ("--set", f"{key}={value}")]
        done = subprocess.run(
            command, cwd=self.root, capture_output=True, text=True, check=False,
            env={**os.environ, "PYTHONPATH": str(self.root)}, preexec_fn=lambda: os.sched_setaffinity(0, cores),
        )  # fmt: skip
        if done.returncode:
            tail = "\n".join((done.stdout + done.stderr).strip().splitlines()[-8:])
            raise ExmeshError(f"exit code {done.returncode}:\n{tail}", where=f"{self.root.name}: {graph.name}")
        return json.loads((runs / "latest" / "report.json").read_text(encoding="utf-8"))


def checkout(revision: str, folder: Path) -> Path:
    """`revision`'s files ("" for those here as they lie) in `folder`, importable before the installed package."""
    folder.mkdir(parents=True)
    if not revision:
        for name in ("exmesh_graph", "nodes", "graphs", "benchmarks", "docs"):
            (folder / name).symlink_to(ROOT / name)
    else:
        archive = subprocess.run(["git", "archive", revision], cwd=ROOT, capture_output=True, check=False)
        if archive.returncode:
            raise ExmeshError(
                f"git has no revision {revision!r} here: {archive.stderr.decode().strip()}", where="--against",
                fix="fetch the whole history (git fetch --unshallow), or name a revision that `git log` shows",
            )  # fmt: skip
        with tarfile.open(fileobj=BytesIO(archive.stdout)) as files:
            files.extractall(folder, filter="data")
    (folder / "exmesh_nodes").symlink_to("nodes")
    return folder


def photographs(folder: Path, size: tuple[int, int], count: int) -> Path:
    """A scene of the sample's first views (again from the first, if there are too few), enlarged to width x height."""
    import numpy as np
    import OpenImageIO as oiio

    if folder.exists():
        return folder
    sample = ROOT / "graphs" / "samples" / "spot"
    (folder / "train").mkdir(parents=True)
    given = json.loads((sample / "transforms_train.json").read_text(encoding="utf-8"))
    width, height = size
    frames = []
    for k in range(count):
        frame = given["frames"][k % len(given["frames"])]
        square = oiio.ImageBuf(str(next(sample.glob(f"{frame['file_path']}*.png"))))
        large = oiio.ImageBufAlgo.resize(square, roi=oiio.ROI(0, height, 0, height, 0, 1, 0, 4)).get_pixels(oiio.UINT8)
        side = (width - height) // 2
        padded = np.pad(large, ((0, 0), (side, width - height - side), (0, 0)))
        name = f"train/{k:03d}"
        oiio.ImageBuf(np.ascontiguousarray(padded)).write(str(folder / f"{name}_rgba.png"))
        frames.append({**frame, "file_path": name})
    angle = float(2 * np.arctan(np.tan(given["camera_angle_x"] / 2) * width / height))
    transforms = {**given, "camera_angle_x": angle, "w": width, "h": height, "frames": frames}
    (folder / "transforms_train.json").write_text(json.dumps(transforms), encoding="utf-8")
    return folder


def figures(seconds: Mapping[str, float], goal: float) -> dict[str, float]:
    """The row of a case; `modelled` cores by Amdahl's law."""
    before, now, one = seconds["before"], seconds["now"], seconds["one core"]
    row = {"before": before, "now": now, "ratio": before / now, "goal": 1 / goal, "one core": one, "two/one": one / now}
    serial = serial_share(one / now)
    return {**row, **{f"{n} cores": one * (serial + (1 - serial) / n) for n in MODELLED}}


def serial_share(speedup: float) -> float:
    """s of Amdahl's law, 1 / (s + (1 - s) / 2) = what two cores gain over one; held in [0, 1] against noise."""
    return min(max(2 / speedup - 1, 0.0), 1.0)


def shown(key: str, value: float) -> str:
    return f"{value:10.1f}x" if key in ("ratio", "goal", "two/one") else f"{value:11.4g}"


if __name__ == "__main__":
    main()
