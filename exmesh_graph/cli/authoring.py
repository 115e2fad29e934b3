"""Commands for those who write graphs and nodes: `exmesh nodes`, `schema`, `new-node`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the commands of this module to the `exmesh` command."""
    app.command()(nodes)
    app.command()(schema)


def nodes(
    type: Annotated[str | None, typer.Argument(help="A node type, for its ports and parameters.")] = None,
) -> None:
    """List the node types, or describe one."""
    from exmesh_graph.cli.show import show_node, show_nodes
    from exmesh_graph.graph.packs import load_packs

    packs = load_packs()
    if type is None:
        show_nodes(packs)
    else:
        show_node(packs, type)


def schema(
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE", help="Write it to a file.")] = None,
) -> None:
    """Print the JSON schema of graph files with the node types at hand, for editors."""
    from exmesh_graph.graph.language.schema import schema_text
    from exmesh_graph.graph.packs import load_packs

    text = schema_text(load_packs())
    if output is None:
        typer.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")
        typer.echo(str(output))
