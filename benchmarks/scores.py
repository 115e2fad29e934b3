"""The table of all scenes of a role: every figure that a graph reports, beside its floor.

    python -m benchmarks.scores --role score --data FOLDER --out FOLDER       # all scenes for scoring
    python -m benchmarks.scores --role choose --scene chair --data FOLDER --out FOLDER --graph graphs/exmeshpp.yaml
    python -m benchmarks.scores --role score --data FOLDER --out FOLDER --dry        # what it would do, and how long

`exmesh bench --scenes score` is the same. FOLDER of --data holds the scenes' folders (several may be given); scenes
that lie in the repository are found without. Says beforehand how long it will take, and by what it knows
(`scores_time`). Finished nodes come from the store (--store, in --out by default), so an interrupted table goes on; a
scene that fails is told, and the others go on. Writes table.md and table.json after every scene. Scenes without masks
are scored by masks that lie beside them for scoring only, and begin by `init.auto` where a graph begins with a hull.
"""

from __future__ import annotations

import argparse
import json
import resource
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.register import Role, Scene, of_role, scenes
from benchmarks.scores_time import Memory, clock, modelled, work_of

ROOT = Path(__file__).parent.parent
QUICKSTART, SAMPLE = ROOT / "graphs" / "quickstart.yaml", ROOT / "graphs" / "samples" / "chair"
#: What is added to the command that makes scenes under photographed skies.
WORLDS = " --worlds bpy-5.0.1-cp311-cp311-manylinux_2_28_x86_64.whl"
#: Laid over the graph where a scene has no masks.
NO_MASKS = """\
# Written by benchmarks.scores: the graph below, begun without masks.
extends: {graph}
name: {name}_no_masks
nodes:
  views: {{true_mesh: "{mesh}"}}    # what the masks mark, without the table
{start}  # for scoring only
  region: {{type: evaluate.region, views: "@views.test", train: "@views.train", masks: {masks}}}
  rounds:
    nodes:
      refine: {{region: "@coarse.mesh"}}
      progress: {{region: "@region.region"}}
  settle: {{region: "@coarse.mesh"}}
  look: {{region: "@region.region"}}
  score: {{region: "@region.region"}}
"""
#: And where that begins with a visual hull.
FROM_STEREO = """\
  hull: null
  coarse: {type: init.auto, views: "@masked.train", faces: 8000, iterations: 0}
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
    missing = [scene for scene in wanted if place_of(scene, data) is None]
    if not there:
        places = ", ".join(map(str, data)) or "the repository"
        raise ValueError(f"no scene of the role {role!r} is in {places}; {making(missing, data)}")
    if missing:
        say(f"not there, left out: {', '.join(scene.name for scene in missing)}; {making(missing, data)}")
    out.mkdir(parents=True, exist_ok=True)
    store, chosen = store or out / "store", dict(settings or {})
    memory = Memory(out / "seconds.json")
    way = " ".join([graph.stem, *(f"{key}={value}" for key, value in sorted(chosen.items()))])
    work = work_of(graph, chosen, SAMPLE)
    times = {scene.name: memory.expected(way, scene, modelled(scene, work)) for scene, _ in there}
    count = f"{len(there)} scene{'s' if len(there) > 1 else ''}"
    say(f"{memory.machine}; {count} by {graph.name}, about {clock(sum(times.values()))} in all")
    for scene, _ in there:
        say(f"  {scene.name:14s} {clock(times[scene.name]):>8s}  {scene.kind}")
    say(f"Expected {memory.basis(way)}. What is in {store} already takes no time.")
    if dry:
        return []
    record: dict[str, Any] = {
        "processor": memory.machine, "role": role, "graph": graph.name, "settings": chosen, "commit": commit(),
        "command": command_of(role, graph, asked, chosen), "missing": [scene.name for scene in missing], "rows": [],
    }  # fmt: skip
    rows: list[dict[str, Any]] = record["rows"]
    before = {row["scene"]: row for row in _read(out / "table.json").get("rows", [])}
    for number, (scene, folder) in enumerate(there, 1):
        row = _run(scene, folder, graph, out, store, chosen, before.get(scene.name, {}).get("processor_seconds"))
        if "failed" not in row:
            memory.keep(way, scene.name, row["seconds"], modelled(scene, work))
        rows.append(row)
        left = sum(memory.expected(way, later, modelled(later, work)) for later, _ in there[number:])
        say(line(row) + (f"; about {clock(left)} left" if left else ""))
        _write(out / "table.json", record)
        (out / "table.md").write_text(markdown(record), encoding="utf-8")
    return rows


def making(missing: Sequence[Scene], data: Sequence[Path]) -> str:
    """The commands that make the scenes, in words."""
    command = "python -m benchmarks.scenes make"
    names = [scene.name for scene in missing if scene.made.startswith(command)]
    worlds = any("Poly Haven" in scene.licence for scene in missing if scene.name in names)
    others = [f"{scene.name}: {scene.made}" for scene in missing if scene.name not in names]
    told = [f"`{command} {' '.join(names)} --out {data[0] if data else 'FOLDER'}{WORLDS if worlds else ''}`"]
    return "made by " + "; ".join([*(told if names else []), *others]) + " (docs/scenes.md)"


def place_of(scene: Scene, data: Sequence[Path]) -> Path | None:
    """Where the scene lies: below one of `data`, or in the repository."""
    places = [folder / scene.name for folder in data] + ([ROOT / scene.where] if scene.where else [])
    return next((place for place in places if (place / "transforms_train.json").is_file()), None)


def commit() -> str:
    """The commit of the checkout, with + where files differ from it; empty where there is no git."""
    try:
        said = [
            subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
            for words in (["rev-parse", "--short", "HEAD"], ["status", "--porcelain"])
        ]
    except OSError:
        return ""
    return said[0] + ("+" if said[1] else "")


def command_of(role: Role, graph: Path, names: Sequence[str], settings: Mapping[str, Any]) -> str:
    """The command that makes the table again, without the folders of this machine."""
    words = ["python", "-m", "benchmarks.scores", "--role", role]
    words += [word for name in names for word in ("--scene", name)]
    if graph != QUICKSTART:
        words += ["--graph", str(graph.relative_to(ROOT) if graph.is_relative_to(ROOT) else graph)]
    words += [word for key, value in settings.items() for word in ("--set", f"{key}={json.dumps(value)}")]
    return shlex.join(words) + " --data FOLDER --out OUT"


def _run(
    scene: Scene, folder: Path, graph: Path, out: Path, store: Path, settings: dict[str, Any], before: float | None
) -> dict[str, Any]:
    """A row. `seconds` are those of all nodes as they were when they ran; `processor_seconds` of this call and, where
    it found nodes in the store, of the calls `before`: None where these left no row."""
    import exmesh_graph as ex
    from exmesh_graph.graph.language.extends import load_merged
    from exmesh_graph.graph.problems import Problems

    if not scene.masks:
        masks = folder.resolve() / "masks"
        start = FROM_STEREO if "hull" in load_merged(graph, Problems())["nodes"] else ""
        scored_by = masks if masks.is_dir() else "null"
        mesh = "mesh/object.obj" if (folder / "mesh" / "object.obj").is_file() else ""
        text = NO_MASKS.format(graph=graph.resolve(), name=graph.stem, masks=scored_by, start=start, mesh=mesh)
        graph = out / f"{graph.stem}_{scene.name}.yaml"
        graph.write_text(text, encoding="utf-8")
    row: dict[str, Any] = {"scene": scene.name, "role": scene.role, "kind": scene.kind}
    began, busy = time.perf_counter(), _processor_seconds()
    try:
        run = ex.run(graph, scene=str(folder.resolve()), set=settings, store=store, runs=out / "runs")
    except Exception as error:  # whatever it is: a night's table is not lost to one scene
        lines = str(error).strip().splitlines()
        spent = _processor_seconds() - busy + (before or 0)
        row |= {"seconds": round(time.perf_counter() - began, 1), "processor_seconds": round(spent, 1)}
        return row | {"failed": lines[0] if lines else repr(error)}
    figures = {
        label: {"value": metric.value, "unit": metric.unit, "floor": metric.floor}
        for label, metric in run.metrics.items()
        if isinstance(metric.value, int | float) and not isinstance(metric.value, bool)
    }
    nodes, spent = run.record["nodes"], _processor_seconds() - busy
    ran = [node["state"] == "done" for node in nodes]
    if not all(ran):
        spent = None if before is None else before + (spent if any(ran) else 0)
    return row | {
        "seconds": round(sum(node["seconds"] for node in nodes), 1),
        "processor_seconds": None if spent is None else round(spent, 1),
        "seed": next(iter(run.record["resolved"]["nodes"].values()))["seed"],
        "run": str(run.folder),
        "figures": figures,
    }


def _processor_seconds() -> float:
    """Of this process and of those it has ended."""
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(spent.ru_utime + spent.ru_stime for spent in map(resource.getrusage, kinds))


def line(row: dict[str, Any]) -> str:
    """A row for people."""
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
    heads = ["scene", "kind", *heads, "seconds", "of processors"]
    seeds = sorted({row["seed"] for row in rows if "seed" in row})
    lines = [
        f"Scenes for {'scoring' if record['role'] == 'score' else 'choosing'}, by `{record['graph']}`, on "
        f"{record['processor']}, seed {', '.join(map(str, seeds))}, commit {record['commit']}: `{record['command']}`. "
        "In brackets what an uninformed guess scores.",
        "",
        "| " + " | ".join(heads) + " |",
        "| " + " | ".join(["---"] * len(heads)) + " |",
    ]
    for row in rows:
        if "failed" in row:
            cells = [f"failed: {row['failed']}"] + [""] * (len(labels) - 1)
        else:
            cells = [_number(row["figures"][label]) if label in row["figures"] else "" for label in labels]
        spent = "" if row["processor_seconds"] is None else f"{row['processor_seconds']:.0f}"
        cells = [f"`{row['scene']}`", row["kind"], *cells, f"{row['seconds']:.0f}", spent]
        lines.append("| " + " | ".join(cells) + " |")
    if record["missing"]:
        lines += ["", f"Not there, not scored: {', '.join(record['missing'])}."]
    return "\n".join(lines) + "\n"


def _number(figure: dict[str, Any]) -> str:
    text = f"{figure['value']:.4g}"
    return text if figure["floor"] is None else f"{text} ({figure['floor']:.3g})"


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
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        return 130
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
