"""The table of all scenes of a role: every figure that a graph reports, beside its floor.

    python -m benchmarks.scores --role score --data FOLDER --out FOLDER       # all scenes for scoring
    python -m benchmarks.scores --role choose --scene chair --data FOLDER --out FOLDER --graph graphs/exmeshpp.yaml
    python -m benchmarks.scores --role score --data FOLDER --out FOLDER --dry        # what it would do, and how long

FOLDER of --data holds the scenes' folders (several may be given); scenes that lie in the repository are found without.
Says beforehand how long it will take: from the seconds that scenes took before, which --out keeps; a scene without is
taken to need as many a pixel of a training view as the others, or as the model says. Finished nodes come from the store
(--store, in --out by default), so an interrupted table goes on. Writes table.md and table.json after every scene.
Scenes without masks are begun by `init.auto` in place of a visual hull.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.machine import processor
from benchmarks.register import Role, Scene, of_role, scenes

ROOT = Path(__file__).parent.parent
QUICKSTART = ROOT / "graphs" / "quickstart.yaml"
#: Seconds of a run where nothing was measured: so many, and so many a million pixels of training views (quickstart on
#: two cores of an AMD EPYC of 2022 with other work beside it).
MODEL = (100.0, 30.0)
#: Laid over the graph where a scene has no masks.
NO_MASKS = """\
# Written by benchmarks.scores: the graph below, begun without masks.
extends: {graph}
name: {name}_no_masks
nodes:
  hull: null
  coarse: {{type: init.auto, views: "@views.train", faces: 8000}}
  rounds:
    nodes:
      refine: {{region: "@coarse.mesh"}}
  settle: {{region: "@coarse.mesh"}}
"""


def score_scenes(
    role: Role,
    out: Path,
    *,
    data: Sequence[Path] = (),
    names: Iterable[str] = (),
    graph: Path = QUICKSTART,
    store: Path | None = None,
    settings: dict[str, Any] | None = None,
    dry: bool = False,
    say: Callable[[str], None] = print,
) -> list[dict[str, Any]]:
    """Run `graph` on all scenes of the role that are there; the rows of the table, one a scene.

    data   folders that hold scenes' folders by name;  names: these scenes only
    store  of results, in `out` by default; settings: as `--set` of `exmesh run`, the same for all scenes
    dry    say what would be done, and do nothing

    Raises ValueError for a scene of another role, or where none is there."""
    asked = list(names)
    wrong = [name for name in asked if name not in scenes() or scenes()[name].role != role]
    if wrong:
        raise ValueError(f"{', '.join(wrong)}: not in benchmarks/scenes.yaml with the role {role!r}")
    wanted = [scene for scene in of_role(role) if (not asked or scene.name in asked) and scene.layout == "blender"]
    there = [(scene, folder) for scene in wanted if (folder := place_of(scene, data)) is not None]
    missing = [scene.name for scene in wanted if place_of(scene, data) is None]
    if missing:
        say(f"not there, left out: {', '.join(missing)} (docs/scenes.md says how each is made)")
    if not there:
        raise ValueError(f"no scene of the role {role!r} is in {', '.join(map(str, data)) or 'the repository'}")
    out.mkdir(parents=True, exist_ok=True)
    memory = _read(out / "seconds.json")
    way = " ".join([graph.stem, *(f"{key}={value}" for key, value in sorted((settings or {}).items()))])
    times = {scene.name: expected(scene, way, memory) for scene, _ in there}
    say(f"{processor()}; {len(there)} scenes by {graph.name}, about {clock(sum(times.values()))} in all")
    for scene, _ in there:
        say(f"  {scene.name:14s} {clock(times[scene.name]):>8s}  {scene.kind}")
    if dry:
        return []
    rows = []
    for scene, folder in there:
        row = _run(scene, folder, graph, out, store or out / "store", settings or {})
        rows.append(row)
        if row["ran"] and "failed" not in row:  # a run that was read from the store says nothing of its seconds
            memory.setdefault(way, {})[scene.name] = round(row["seconds"], 1)
            _write(out / "seconds.json", memory)
        say(line(row))
        record = {"processor": processor(), "role": role, "graph": graph.name, "rows": rows}
        _write(out / "table.json", record)
        (out / "table.md").write_text(markdown(record), encoding="utf-8")
    return rows


def place_of(scene: Scene, data: Sequence[Path]) -> Path | None:
    """Where the scene lies: below one of `data`, or in the repository."""
    places = [folder / scene.name for folder in data] + ([ROOT / scene.where] if scene.where else [])
    return next((place for place in places if (place / "transforms_train.json").is_file()), None)


def expected(scene: Scene, way: str, memory: dict[str, dict[str, float]]) -> float:
    """Seconds of a scene by a graph with its settings: as measured before, else scaled from others by the pixels of
    training views, else by MODEL."""
    known = memory.get(way, {})
    if scene.name in known:
        return known[scene.name]
    if known:
        return sum(known.values()) / sum(megapixels(scenes()[name]) for name in known) * megapixels(scene)
    return MODEL[0] + MODEL[1] * megapixels(scene)


def megapixels(scene: Scene) -> float:
    return scene.pixels[0] * scene.pixels[1] * scene.views[0] / 1e6


def _run(scene: Scene, folder: Path, graph: Path, out: Path, store: Path, settings: dict[str, Any]) -> dict[str, Any]:
    import exmesh_graph as ex
    from exmesh_graph.errors import ExmeshError

    if not scene.masks:
        text = NO_MASKS.format(graph=graph.resolve(), name=graph.stem)
        graph = out / f"{graph.stem}_{scene.name}.yaml"
        graph.write_text(text, encoding="utf-8")
    began = time.perf_counter()
    row: dict[str, Any] = {"scene": scene.name, "role": scene.role, "kind": scene.kind}
    try:
        run = ex.run(graph, scene=str(folder.resolve()), set=settings, store=store, runs=out / "runs")
    except (ExmeshError, OSError) as error:
        lines = str(error).strip().splitlines()
        return row | {"seconds": time.perf_counter() - began, "ran": True, "failed": lines[0] if lines else repr(error)}
    figures = {
        label: {"value": metric.value, "unit": metric.unit, "floor": metric.floor}
        for label, metric in run.metrics.items()
        if isinstance(metric.value, int | float) and not isinstance(metric.value, bool)
    }
    seconds = time.perf_counter() - began
    return row | {"seconds": seconds, "ran": seconds > 20, "run": str(run.folder), "figures": figures}


def line(row: dict[str, Any]) -> str:
    if "failed" in row:
        return f"{row['scene']}: FAILED after {clock(row['seconds'])}: {row['failed']}"
    shown = ", ".join(f"{label} {_number(f)}" for label, f in row["figures"].items())
    return f"{row['scene']} ({clock(row['seconds'])}): {shown}"


def markdown(record: dict[str, Any]) -> str:
    """The table: a row a scene, a column a figure, floors in brackets."""
    rows = record["rows"]
    labels = list(dict.fromkeys(label for row in rows for label in row.get("figures", {})))
    units = {label: f["unit"] for row in rows for label, f in row.get("figures", {}).items()}
    heads = [f"{label} [{units[label]}]" if units[label] else label for label in labels]
    lines = [
        f"Scenes for {'scoring' if record['role'] == 'score' else 'choosing'}, by `{record['graph']}`, on "
        f"{record['processor']}. In brackets what an uninformed guess scores.",
        "",
        "| " + " | ".join(["scene", "kind", *heads, "seconds"]) + " |",
        "| " + " | ".join(["---"] * (len(heads) + 3)) + " |",
    ]
    for row in rows:
        if "failed" in row:
            cells = [f"failed: {row['failed']}"] + [""] * (len(labels) - 1)
        else:
            cells = [_number(row["figures"][label]) if label in row["figures"] else "" for label in labels]
        lines.append("| " + " | ".join([f"`{row['scene']}`", row["kind"], *cells, f"{row['seconds']:.0f}"]) + " |")
    return "\n".join(lines) + "\n"


def _number(figure: dict[str, Any]) -> str:
    text = f"{figure['value']:.4g}"
    return text if figure["floor"] is None else f"{text} ({figure['floor']:.3g})"


def clock(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{seconds:.0f} s" if seconds < 90 else f"{minutes} min" if minutes < 90 else f"{minutes / 60:.1f} h"


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def _write(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def main() -> int:
    options = arguments()
    try:
        rows = score_scenes(
            options.role, options.out, data=options.data, names=options.scene, graph=options.graph, dry=options.dry,
            store=options.store, settings=dict(options.set),
        )  # fmt: skip
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    return int(any("failed" in row for row in rows))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scores", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--role", choices=["score", "choose"], default="score")
    parser.add_argument("--scene", action="append", default=[], metavar="NAME", help="this scene only; may be repeated")
    parser.add_argument("--data", type=Path, action="append", default=[], help="folder of scenes; may be repeated")
    parser.add_argument("--graph", type=Path, default=QUICKSTART)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--store", type=Path, help="default: OUT/store")
    parser.add_argument("--set", type=_assignment, action="append", default=[], metavar="NODE.PARAMETER=VALUE")
    parser.add_argument("--dry", action="store_true", help="say what would be done and how long it takes")
    return parser.parse_args()


def _assignment(text: str) -> tuple[str, Any]:
    name, _, value = text.partition("=")
    try:
        return name, json.loads(value)
    except json.JSONDecodeError:
        return name, value


if __name__ == "__main__":
    sys.exit(main())
