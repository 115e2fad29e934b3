"""`exmesh bench`: what this machine does, measured by the checkout's own `benchmarks/bench.py`."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Annotated

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
    root: Annotated[Path, typer.Option(metavar="DIR", help="The repository.")] = Path(),
) -> None:
    """Measure this machine: kernels, stages, quickstart, framework; peers where they are installed."""
    for needed in ("benchmarks/bench.py", "graphs"):
        if not (root / needed).exists():
            raise GraphError(
                f"there is no {needed} in {root.resolve()}", where="command line",
                fix="run `exmesh bench` in a checkout of the repository, or give --root",
            )  # fmt: skip
    measure = runpy.run_path(str(root / "benchmarks" / "bench.py"))["measure"]
    measure(suites or [], quick=quick, history=history, compare=compare, json_file=json_, root=root)
