"""Commands for those who write graphs and nodes: `exmesh nodes`, `schema`, `stubs`, `new-node`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from exmesh_graph.cli.options import AsJson, put_json


def register(app: typer.Typer) -> None:
    """Add the commands of this module to the `exmesh` command."""
    app.command()(nodes)
    app.command()(schema)
    app.command()(stubs)
    app.command("new-node")(new_node)


def nodes(
    type: Annotated[str | None, typer.Argument(help="A node type, for its ports and parameters.")] = None,
    markdown: Annotated[
        Path | None, typer.Option("--markdown", metavar="DIR", help="Write a page for every family of nodes.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the node types, or describe one."""
    from exmesh_graph.api import described
    from exmesh_graph.cli.show import show_node, show_nodes

    if markdown is not None:
        from exmesh_graph.cli.pages import write_pages

        typer.echo(f"{len(write_pages(described.node_types(), markdown))} pages in {markdown}")
        return
    types = described.node_types() if type is None else {type: described.describe(type)}
    if as_json:
        put_json(described.as_json(types))
    elif type is None:
        show_nodes(types, described.broken_modules())
    else:
        show_node(types[type])


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


def schema(
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE", help="Write it to a file.")] = None,
) -> None:
    """Print the JSON schema of graph files with the node types at hand, for editors."""
    from exmesh_graph.api.described import schema_text

    text = schema_text()
    if output is None:
        typer.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")
        typer.echo(str(output))


def stubs(
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE", help="Write it to a file.")] = None,
    install: Annotated[bool, typer.Option("--install", help="Write it where editors look: into the package.")] = False,
) -> None:
    """Print the types of all node types at hand, with which editors complete graphs that are built in Python."""
    from exmesh_graph.api.stubs import SHIPPED, stub_text

    text, target = stub_text(), SHIPPED if install else output
    if target is None:
        typer.echo(text, nl=False)
    else:
        target.write_text(text, encoding="utf-8")
        typer.echo(str(target))
