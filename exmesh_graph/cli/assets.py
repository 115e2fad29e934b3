"""`exmesh check-usd` and `exmesh view`: judging and looking at finished assets."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer


def check_usd(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help=".usda, .usdc or .usdz files.")],
    blender: Annotated[
        Path | None,
        typer.Option(metavar="PYTHON", help="A Python with bpy: also render each file's first camera in Blender."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="A list of problems for programs.")] = False,
) -> None:
    """Judge USD files by OpenUSD's validators, own rules (docs/usd.md), and Blender on demand. Exit code 1: errors."""
    from exmesh_graph.export.usd import validate_usd

    judged_problems = [(file, problem) for file in files for problem in validate_usd(file)]
    if blender is not None:
        from exmesh_graph.export.blender import judged

        broken = {file for file, problem in judged_problems if problem.level == "error"}  # these may crash it
        judged_problems += [
            (file, problem) for file in files if file not in broken for problem in judged(file, blender)
        ]
    errors, warnings = (sum(problem.level == level for _, problem in judged_problems) for level in ("error", "warning"))
    if as_json:
        typer.echo(json.dumps([{"file": str(file), **asdict(problem)} for file, problem in judged_problems], indent=1))
    else:
        for file, problem in judged_problems:
            typer.echo(f"{file}: {problem}")
        typer.echo(f"{len(files)} file{'s'[: len(files) > 1]}, {errors} errors, {warnings} warnings")
    raise typer.Exit(1 if errors else 0)


def view(
    run: Annotated[Path, typer.Argument(help="A run folder, or a USD file with its light.")] = Path("runs/latest"),
    light: Annotated[
        list[Path] | None, typer.Option("--light", metavar="FILE", help="A further lat-long EXR or HDR; repeatable.")
    ] = None,
    convention: Annotated[str, typer.Option(help="Of these files: openexr or blender.")] = "openexr",
    out: Annotated[Path | None, typer.Option("--out", help="The page (default: view.html beside the asset).")] = None,
    show: Annotated[bool, typer.Option("--open/--no-open", help="Open it in the browser.")] = True,
) -> None:
    """Write one page that shows the asset under its light in any browser, without a network."""
    import webbrowser

    from exmesh_graph.errors import DataError, ExmeshError
    from exmesh_graph.export.usd import read_usd
    from exmesh_graph.io.envmaps import canonical_from_blender, read_environment
    from exmesh_graph.report.view.page import view_page

    if convention not in ("openexr", "blender"):
        raise ExmeshError(f"unknown convention {convention!r}", expected="openexr or blender")
    file = run
    if run.is_dir():
        packages = [path for path in sorted(run.glob("*.usdz")) if not path.stem.endswith("_ar")]
        if not packages:
            raise DataError(
                "the folder holds no USD package", where=str(run),
                fix="give a run whose graph exports USD, or a .usdz file",
            )  # fmt: skip
        file = packages[0]
    if not file.is_file():
        raise DataError("there is no such run or file", where=str(file), fix="exmesh status lists the runs")
    lights = {path.stem: read_environment(path) for path in light or ()}
    if convention == "blender":
        lights = {name: canonical_from_blender(radiance) for name, radiance in lights.items()}
    page = view_page(read_usd(file).asset(), file.resolve().parent.name, lights)
    target = (out or file.with_name("view.html")).resolve()
    target.write_text(page, encoding="utf-8")
    typer.echo(str(target))
    if show:
        webbrowser.open(target.as_uri())
