"""`exmesh check-usd`: judging finished assets."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("check-usd")(check_usd)


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

    found = [(file, problem) for file in files for problem in validate_usd(file)]
    if blender is not None:
        from exmesh_graph.export.blender import judged

        broken = {file for file, problem in found if problem.level == "error"}  # these may crash it
        found += [(file, problem) for file in files if file not in broken for problem in judged(file, blender)]
    errors, warnings = (sum(problem.level == level for _, problem in found) for level in ("error", "warning"))
    if as_json:
        typer.echo(json.dumps([{"file": str(file), **asdict(problem)} for file, problem in found], indent=1))
    else:
        for file, problem in found:
            typer.echo(f"{file}: {problem}")
        typer.echo(f"{len(files)} file{'s'[: len(files) > 1]}, {errors} errors, {warnings} warnings")
    raise typer.Exit(1 if errors else 0)
