"""Commands for those who write graphs and nodes: `exmesh nodes`."""

from __future__ import annotations

from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the commands of this module to the `exmesh` command."""
    app.command()(nodes)


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
