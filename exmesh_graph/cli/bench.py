"""`exmesh bench`: what this machine does, and how all scenes score, by the checkout's own `benchmarks/`."""

from __future__ import annotations

import runpy
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import typer

from exmesh_graph.errors import GraphError


def bench(
    suites: Annotated[
        list[str] | None, typer.Argument(metavar="[kernels|stages|quickstart|framework]...", help="Default: all.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="All of it in under three minutes on two quiet cores.")
    ] = False,
    history: Annotated[Path, typer.Option(metavar="DIR", help="Where results are kept.")] = Path("bench"),
    compare: Annotated[
        str | None, typer.Option(metavar="FILE", help="An earlier result, or `latest` of its kind in the history.")
    ] = None,
    json_: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the result here as well.")] = None,
    scenes: Annotated[
        Literal["score", "choose"] | None,
        typer.Option(help="Instead: the table of all scenes for scoring, or for choosing; an interrupted one goes on."),
    ] = None,
    data: Annotated[
        list[Path] | None, typer.Option(metavar="DIR", help="With --scenes: their folders lie here. Default: scenes.")
    ] = None,
    scene: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="With --scenes: this one only; may be repeated.")
    ] = None,
    graph: Annotated[
        Path | None, typer.Option(metavar="FILE", help="With --scenes: the graph. Default: graphs/quickstart.yaml.")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="NODE.PARAMETER=VALUE", help="With --scenes: for all scenes.")
    ] = None,
    dry: Annotated[bool, typer.Option("--dry", help="With --scenes: say what would run, and how long.")] = False,
    speed: Annotated[
        bool,
        typer.Option("--speed", help="Instead: seconds of each stage beside an earlier commit's, one core and two."),
    ] = False,
    against: Annotated[
        str | None, typer.Option(metavar="REVISION", help="With --speed: the earlier commit. Default: 8719830.")
    ] = None,
    root: Annotated[Path, typer.Option(metavar="DIR", help="The repository.")] = Path(),
) -> None:
    """Measure this machine: kernels, stages, quickstart, framework; or an earlier commit beside it; or score scenes."""
    for needed in ("benchmarks/bench.py", "graphs"):
        if not (root / needed).exists():
            raise GraphError(
                f"there is no {needed} in {root.resolve()}", where="command line",
                fix="run `exmesh bench` in a checkout of the repository, or give --root",
            )  # fmt: skip
    if speed:
        others = {
            " ".join(suites or []): suites,
            "--compare": compare,
            "--scenes": scenes,
            "--data": data,
            "--dry": dry,
        }
        _refuse(others, "does not go with --speed", "leave one of them out")
        words = (["--quick"] if quick else []) + (["--against", against] if against else [])
        _benchmark("speed", words + (["--json", str(json_.resolve())] if json_ else []), root)
        return
    _refuse({"--against": against}, "goes with --speed", "add --speed")
    if scenes is None:
        only: dict[str, object] = {"--data": data, "--scene": scene, "--graph": graph, "--set": set_, "--dry": dry}
        _refuse(only, "goes with --scenes", "add --scenes score, or --scenes choose")
        measure = runpy.run_path(str(root / "benchmarks" / "bench.py"))["measure"]
        measure(suites or [], quick=quick, history=history, compare=compare, json_file=json_, root=root)
        return
    only = {" ".join(suites or []): suites, "--quick": quick, "--compare": compare, "--json": json_}
    _refuse(only, "measures the machine, --scenes scores scenes", "leave one of them out")
    words = ["--role", scenes, "--out", str((history / scenes).resolve())]
    words += [word for folder in data or [root / "scenes"] for word in ("--data", str(folder.resolve()))]
    words += [word for name in scene or [] for word in ("--scene", name)]
    words += [word for text in set_ or [] for word in ("--set", text)]
    words += (["--graph", str(graph.resolve())] if graph else []) + (["--dry"] if dry else [])
    _benchmark("scores", words, root)


def _refuse(options: Mapping[str, object], what: str, fix: str) -> None:
    for name, given in options.items():
        if given:
            raise GraphError(f"{name} {what}", where="command line", fix=fix)


def _benchmark(name: str, words: list[str], root: Path) -> None:
    """Run `python -m benchmarks.NAME` in the checkout, which shows itself and ends on Ctrl-C; exit as it does."""
    process = subprocess.Popen([sys.executable, "-m", f"benchmarks.{name}", *words], cwd=root)
    while True:
        try:
            code = process.wait()
            break
        except KeyboardInterrupt:
            continue
    if code:
        raise typer.Exit(code)
