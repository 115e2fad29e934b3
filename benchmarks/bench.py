"""What `exmesh bench` does: kernels, stages, the quickstart and the framework on this machine; history, comparison.

Every suite is a separate process of the benchmarks beside this file. Figures keep the names that the benchmark gives
them, joined with dots. A result is one JSON file in the history's folder.
"""

from __future__ import annotations

import contextlib
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import typer

from exmesh_graph.errors import ExmeshError, GraphError

SCHEMA = "exmesh.bench.v1"
KERNELS, STAGES = ("raster", "rays", "losses"), ("topology", "atlas")
SUITES = ("kernels", "stages", "quickstart", "framework")
#: The quickstart cut down to about a minute; its seconds per node stand for the stages, its figures say it still works.
SHORT = ("rounds.repeat=2", "rounds.refine.iterations=20", "settle.iterations=20", "coarse.resolution=48", "faces=6000",
         "coarse.faces=1000", "texels=128", "pbr.iterations=10", "pbr.texture_size=128",
         "score.max_views=2", "light.directions=64", "look.max_views=2", "shape.samples=5000")  # fmt: skip
_FAR = 1.25
_REMEMBERED = 10


def measure(
    suites: list[str], *, quick: bool, history: Path, compare: str | None, json_file: Path | None, root: Path
) -> None:
    """Run suites (none: all), show and keep their figures; `root` is the checkout, `compare` a result or `latest`."""
    chosen = list(dict.fromkeys(suites or SUITES))
    unknown = [name for name in chosen if name not in SUITES]
    if unknown:
        raise GraphError(f"there is no suite {unknown[0]!r}", where="command line", expected=", ".join(SUITES))
    before = _earlier(history, compare, quick) if compare else None  # a bad name is said before minutes are spent
    noise = _noise(history, quick, before) if before else {}
    begun, processor = time.perf_counter(), _processor_seconds()
    result: dict[str, Any] = {**_about(root), "quick": quick, "suites": {}}
    for name in chosen:
        if name in result["suites"] and quick:  # one short run gives stages and quickstart
            continue
        for suite, figures in _run(name, quick, root):
            if suite in chosen:
                result["suites"].setdefault(suite, {}).update(figures)
                _show(suite, figures, (before or {}).get("suites", {}).get(suite, {}), noise.get(suite, {}))
    result["seconds"] = round(time.perf_counter() - begun, 1)
    result["processor_seconds"] = round(_processor_seconds() - processor, 1)
    history.mkdir(parents=True, exist_ok=True)
    text = json.dumps(result, indent=1, ensure_ascii=False) + "\n"
    written = history / f"{result['when'].replace(':', '')}{'-quick' if quick else ''}.json"
    for file in (written, *((json_file,) if json_file else ())):
        file.write_text(text, encoding="utf-8")
    typer.echo(f"\n{result['seconds']:g} s, {result['processor_seconds']:g} s of processor time; {written}")


def flat(values: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """(name.of.figure, number) of every number in nested maps and lists; a list's entries by their text, else place."""
    if isinstance(values, Mapping):
        for key, value in values.items():
            yield from flat(value, f"{name}.{key}" if name else str(key))
    elif isinstance(values, list):
        for place, value in enumerate(values):
            words = [str(v) for v in value.values() if isinstance(v, str)] if isinstance(value, Mapping) else []
            yield from flat(value, f"{name}.{' '.join(words) or place}")
    elif isinstance(values, int | float) and not isinstance(values, bool):
        yield name, float(values)


def changes(figures: Mapping[str, float], before: Mapping[str, float]) -> dict[str, float]:
    """Ratio now / before of every figure both have and that was above 0."""
    return {name: value / before[name] for name, value in figures.items() if before.get(name, 0) > 0}


def ranges(results: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, tuple[float, float]]]:
    """{suite: {figure: (least, greatest)}} over results; figures above 0 only."""
    spans: dict[str, dict[str, tuple[float, float]]] = {}
    for result in results:
        for suite, figures in result["suites"].items():
            kept = spans.setdefault(suite, {})
            for name, value in figures.items():
                if value > 0:
                    low, high = kept.get(name, (value, value))
                    kept[name] = min(low, value), max(high, value)
    return spans


def _processor_seconds() -> float:
    """Of all ended child processes."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def _run(name: str, quick: bool, root: Path) -> Iterator[tuple[str, dict[str, float]]]:
    short = ["--quick"] if quick else []
    if name == "kernels":
        for part in KERNELS:
            yield name, _script(part, short, root)
    elif name == "framework":
        yield name, _script(name, short, root)
    elif name == "stages" and not quick:
        for part in STAGES:
            yield name, _script(part, ["--quick"], root)
    else:
        seconds, figures = _quickstart(SHORT if quick else (), root)
        yield "stages", seconds
        yield "quickstart", figures


def _script(name: str, options: list[str], root: Path) -> dict[str, float]:
    """The figures of `python -m benchmarks.<name>`."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.json"
        _call([sys.executable, "-m", f"benchmarks.{name}", *options, "--json", str(out)], root)
        return dict(flat(json.loads(out.read_text(encoding="utf-8")), name))


def _quickstart(sets: tuple[str, ...], root: Path) -> tuple[dict[str, float], dict[str, float]]:
    """(seconds per node of the graph, headline figures and cost) of a run from an empty store."""
    from exmesh_graph.report.drawing.svg import fold_name

    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", "from exmesh_graph.cli import main; main()", "run", "graphs/quickstart.yaml"]
        options = [word for text in sets for word in ("--set", text)]
        _call([*command, *options, "--store", f"{folder}/store", "--runs", f"{folder}/runs"], root)
        report = json.loads((Path(folder) / "runs" / "latest" / "report.json").read_text(encoding="utf-8"))
    seconds: dict[str, float] = {}
    for node in report["nodes"]:
        name = f"seconds.{fold_name(node['name'])}"
        seconds[name] = seconds.get(name, 0.0) + node["seconds"]
    figures = {
        label: float(entry["value"])
        for label, entry in report["headline"].items()
        if isinstance(entry["value"], int | float) and not isinstance(entry["value"], bool)
    }
    figures["seconds, wall"] = float(report["seconds"]["this_run"])
    figures["peak memory of a node, MB"] = max(node["peak_memory"] for node in report["nodes"]) / 1e6
    return seconds, figures


def _call(command: list[str], root: Path) -> None:
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    if done.returncode:
        tail = "\n".join((done.stderr or done.stdout).strip().splitlines()[-6:])
        raise ExmeshError(
            f"the benchmark failed with exit code {done.returncode}:\n{tail}", where=" ".join(command[1:4]),
            fix=f"run it alone in {root.resolve()}",
        )  # fmt: skip


def _show(
    suite: str, figures: Mapping[str, float], before: Mapping[str, float], noise: Mapping[str, tuple[float, float]]
) -> None:
    ratios = changes(figures, before)
    typer.echo(f"\n{suite}")
    width = max((len(name) for name in figures), default=0)
    for name, value in figures.items():
        line = f"  {name:<{width}}{value:>14.6g}"
        if name in ratios:
            line += f"{before[name]:>14.6g}  x {ratios[name]:.2f}"
            if not 1 / _FAR < ratios[name] < _FAR:
                low, high = noise.get(name, (before[name], before[name]))
                line += "  (seen before)" if low <= value <= high else "  <--"
        typer.echo(line)


def _noise(history: Path, quick: bool, before: Mapping[str, Any]) -> dict[str, dict[str, tuple[float, float]]]:
    """Between which values each figure lay in the last results of this kind by the machine of `before`."""
    alike = []
    for file in _of_kind(history, quick)[-_REMEMBERED:]:
        with contextlib.suppress(GraphError):  # a file that is no result is refused only where it is named
            earlier = _read(file, quick)
            if _machine(earlier) == _machine(before):
                alike.append(earlier)
    return ranges(alike)


def _machine(result: Mapping[str, Any]) -> list[Any]:
    facts = result.get("machine", {})
    return [facts.get(name) for name in ("processor", "cpus", "memory_gib")]


def _of_kind(history: Path, quick: bool) -> list[Path]:
    return sorted(f for f in history.glob("*.json") if f.stem.endswith("-quick") == quick)


def _earlier(history: Path, name: str, quick: bool) -> dict[str, Any]:
    file = Path(name)
    if name == "latest":
        kept = _of_kind(history, quick)
        if not kept:
            raise GraphError(f"{history} holds no earlier {'quick ' if quick else ''}result", where="--compare",
                             fix="leave --compare out this time")  # fmt: skip
        file = kept[-1]
    return _read(file, quick)


def _read(file: Path, quick: bool) -> dict[str, Any]:
    try:
        result = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError) as error:
        raise GraphError(f"the earlier result cannot be read ({error})", where=str(file)) from error
    if not isinstance(result, dict) or result.get("schema") != SCHEMA:
        raise GraphError("this is no result of `exmesh bench`", where=str(file), expected=f'"schema": "{SCHEMA}"')
    if result["quick"] != quick:
        raise GraphError(f"the earlier result was made {'with' if result['quick'] else 'without'} --quick",
                         where=str(file), fix="compare runs of one kind")  # fmt: skip
    return result


def _about(root: Path) -> dict[str, Any]:
    from exmesh_graph.report.collect import library_versions
    from exmesh_graph.resources import machine_facts

    when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    try:
        git = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"], cwd=root, capture_output=True, text=True, check=False
        )
        commit = git.stdout.strip()
    except OSError:  # no git here
        commit = ""
    return {"schema": SCHEMA, "when": when, "commit": commit, "machine": machine_facts(),
            "versions": library_versions()}  # fmt: skip
