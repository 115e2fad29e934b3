"""What the commands share: their common options, and how a graph and a store are opened."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.declare.packs import Packs
    from exmesh_graph.graph.language.check import Checked
    from exmesh_graph.graph.variants import CheckedVariant

GraphFile = Annotated[Path, typer.Argument(metavar="GRAPH", help="The graph file (YAML).")]
Sets = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Change a graph parameter, or node.param; repeatable."),
]
VariantName = Annotated[
    str | None, typer.Option("--variant", metavar="NAME", help="A variant that the graph file declares.")
]
Targets = Annotated[
    list[str] | None, typer.Option("--node", metavar="NODE", help="Only what this node needs; repeatable.")
]
StoreFolder = Annotated[
    Path | None, typer.Option("--store", help="The artifact store (default: $EXMESH_STORE or ./.exmesh).")
]
SharedUrl = Annotated[
    str | None,
    typer.Option("--shared", metavar="URL", help="A store that machines share, behind this one ($EXMESH_SHARED)."),
]
RunsFolder = Annotated[Path, typer.Option("--runs", help="Where run folders go.")]


class BackendName(enum.Enum):
    local = "local"
    ray = "ray"


BackendChoice = Annotated[
    BackendName, typer.Option("--backend", help="Where nodes run: worker processes of this machine, or a Ray cluster.")
]
RayAddress = Annotated[
    str | None,
    typer.Option("--address", help="With ray: the cluster's address, or auto; by default a new one on this machine."),
]


def checked_graph(
    graph: Path, sets: list[str] | None, variant: str | None = None, store: Path | None = None
) -> tuple[Checked, Packs]:
    """A graph file, or one of its variants, checked against the session's packs."""
    from exmesh_graph.graph.session import current_session

    checked = current_session().check(graph, sets or [], variant, store)
    _show_warnings(checked.notes)
    return checked, checked.packs


def checked_variants(
    graph: Path, sets: list[str] | None, store: Path | None = None, **options: Any
) -> tuple[list[CheckedVariant], Packs]:
    """A graph file and all variants that it declares, checked; `options` are those of `check_variants`."""
    from exmesh_graph.graph.declare.packs import current
    from exmesh_graph.graph.session import current_session

    rows = current_session().check_variants(graph, sets or [], store, **options)
    _show_warnings(note for row in rows for note in row.checked.notes)
    return rows, current()


def _show_warnings(notes: Iterable[str]) -> None:
    for note in dict.fromkeys(notes):
        typer.echo(f"warning: {note}", err=True)


def open_store(folder: Path | None, shared: str | None = None) -> Store:
    """The store that --store, $EXMESH_STORE or the working folder names."""
    from exmesh_graph.graph.session import current_session

    return current_session().open_store(folder, shared)


def show_notes(store: Store) -> None:
    """What the store found doubtful."""
    for note in store.notes:
        typer.echo(f"store: {note}", err=True)


def named(checked: Checked, names: list[str] | None) -> list[str]:
    """Names of nodes that the graph has. Raises GraphError with the nearest names."""
    from exmesh_graph.errors import GraphError
    from exmesh_graph.graph.problems import nearest

    for name in names or []:
        if name in checked.components:
            users = [node for node, bound in checked.nodes.items() if any(c.name == name for c in bound.plugged())]
            what = f"{name} is a component, which never runs by itself"
            raise GraphError(what, where="command line", fix=f"name a node that uses it: {', '.join(users[:8])}")
        if name not in checked.nodes:
            close = nearest(name, checked.nodes) or list(checked.nodes)
            raise GraphError(f"the graph has no node {name!r}", where="command line", expected=", ".join(close[:8]))
    return list(names or [])
