"""Plain tables of the command line: node types, and why a node is a hit."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Mapping, Sequence

import typer

from exmesh_graph.api.described import ParameterInfo, TypeInfo
from exmesh_graph.api.why import Why


def show_nodes(types: Mapping[str, TypeInfo], broken: Mapping[str, str]) -> None:
    """All node types, one line each."""
    width = max(map(len, types), default=0)
    for name, info in types.items():
        typer.echo(f"{name:<{width + 2}}{info.title}".rstrip())
    for module, why in broken.items():
        typer.echo(f"cannot import {module}: {why}", err=True)


def show_node(info: TypeInfo) -> None:
    """Ports, parameters with units and ranges, and the documentation of one node type."""
    kind = ["component"] if info.component else []
    typer.echo(f"{info.type}  ({', '.join([*kind, f'version {info.version}', *info.traits])})")
    if info.doc:
        typer.echo(textwrap.indent(info.doc, "  "))
    for title, ports in (("components" if info.component else "inputs", info.inputs), ("outputs", info.outputs)):
        if title == "outputs" and info.component:
            continue
        typer.echo(f"{title}:")
        for port in ports:
            typer.echo(f"  {port.name}: {port.type}{'  (optional)' if port.optional else ''}")
    typer.echo("parameters:")
    for parameter in info.parameters:
        typer.echo("  " + _parameter(parameter))


def _parameter(one: ParameterInfo) -> str:
    notes = [*one.limits, *(["not part of the key"] if one.tuning else [])]
    shown = "required" if one.default is None else f"= {one.default}"
    tail = f"  ({', '.join(notes)})" if notes else ""
    return f"{one.name}: {one.type} {shown}{f' {one.unit}' if one.unit else ''}{tail}  {one.doc}".rstrip()


def show_why(why: Why, words: Sequence[str] = ()) -> None:
    """The state of a node, its key, and what differs from the nearest earlier record.

    `words` of the command line name the graph, for the next command.
    """
    typer.echo(f"{why.node}: {why.state}")
    if why.key is None:
        typer.echo(f"  {why.reason}; its key is known only when that has run")
        typer.echo("  " + shlex.join(["exmesh", "why", why.waits_for, *words]))
        return
    typer.echo(f"  key {why.key}")
    if why.made:
        typer.echo(f"  made {why.made}")
    for line in why.lines:
        typer.echo(f"  {line}")
    typer.echo("  the key depends on:")
    for field, value in why.depends_on.items():
        if field == "code":
            typer.echo("    code: " + ", ".join(value))
        else:
            typer.echo(f"    {field}: {', '.join(value)}" if isinstance(value, list) else f"    {field} {value}")
