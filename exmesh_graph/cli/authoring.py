"""Commands for those who write graphs and nodes: `exmesh nodes`, `schema`, `stubs`, `new-node`."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exmesh_graph.cli.options import AsJson, put_json

if TYPE_CHECKING:
    from exmesh_graph.api.described import ParameterInfo, TypeInfo

Output = Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE", help="Write it to a file.")]


def nodes(
    type: Annotated[str | None, typer.Argument(help="A node type, for its ports and parameters.")] = None,
    markdown: Annotated[
        Path | None, typer.Option("--markdown", metavar="DIR", help="Write a page for every family of nodes.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the node types, or describe one."""
    from exmesh_graph.api import described

    if markdown is not None:
        from exmesh_graph.cli.pages import write_pages

        typer.echo(f"{len(write_pages(described.node_types(), markdown))} pages in {markdown}")
        return
    types = described.node_types() if type is None else {type: described.describe(type)}
    if as_json:
        put_json(described.as_json(types))
    elif type is None:
        _show_nodes(types, described.broken_modules())
    else:
        _show_node(types[type])


def _show_nodes(types: Mapping[str, TypeInfo], broken: Mapping[str, str]) -> None:
    """All node types, one line each."""
    width = max(map(len, types), default=0)
    for name, info in types.items():
        typer.echo(f"{name:<{width + 2}}{info.title}".rstrip())
    for module, why in broken.items():
        typer.echo(f"cannot import {module}: {why}", err=True)


def _show_node(info: TypeInfo) -> None:
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


def new_node(
    type: Annotated[str, typer.Argument(help="The new type, family.name: geometry.smooth.")],
    into: Annotated[
        Path,
        typer.Option(
            "--into", metavar="DIR", help="The package of your nodes; pyproject.toml and tests/ lie beside it."
        ),
    ] = Path("my_nodes/my_nodes"),
) -> None:
    """Write a working node with its test, in a package that graphs find once it is installed."""
    from exmesh_graph.api.described import node_types
    from exmesh_graph.cli.scaffold import offered, write_node
    from exmesh_graph.errors import GraphError

    if type in node_types():
        raise GraphError(f"there is a node type {type!r} already", fix=f"exmesh nodes {type}")
    made = write_node(type, into)
    for path in made:
        typer.echo(str(path))
    root, package = into.resolve().parent, into.resolve().name
    if not offered(root / "pyproject.toml", package):
        typer.echo(f"{root / 'pyproject.toml'} is not from here and must list the package {package!r} and say:")
        typer.echo(f'  [project.entry-points."exmesh.nodes"]\n  {package} = "{package}"')
    typer.echo(f"test it: pytest {root / 'tests'}\ninstall it: pip install -e {root}\nsee it: exmesh nodes {type}")


def schema(output: Output = None) -> None:
    """Print the JSON schema of graph files with the node types at hand, for editors."""
    from exmesh_graph.api.described import schema_text

    _put_text(schema_text(), output)


def stubs(
    output: Output = None,
    install: Annotated[bool, typer.Option("--install", help="Write it where editors look: into the package.")] = False,
) -> None:
    """Print the types of all node types at hand, with which editors complete graphs that are built in Python."""
    from exmesh_graph.api.stubs import SHIPPED, stub_text

    _put_text(stub_text(), SHIPPED if install else output)


def _put_text(text: str, target: Path | None) -> None:
    """Print a text, or write it to a file."""
    if target is None:
        typer.echo(text, nl=False)
    else:
        target.write_text(text, encoding="utf-8")
        typer.echo(str(target))
