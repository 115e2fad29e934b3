"""What the commands share: their common options."""

from __future__ import annotations

import enum
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.store import Store

GraphFile = Annotated[Path, typer.Argument(metavar="GRAPH", help="The graph file (YAML).")]
Sets = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Change a graph parameter, or node.param; repeatable."),
]
VariantName = Annotated[
    str | None, typer.Option("--variant", metavar="NAME", help="A variant that the graph file declares.")
]
Targets = Annotated[
    list[str] | None,
    typer.Option("--node", "--until", metavar="NODE", help="Only what this node needs; repeatable, `*` for anything."),
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


AsJson = Annotated[bool, typer.Option("--json", help="For programs (docs/running.md has the fields).")]


def show_notes(store: Store) -> None:
    """What the store found doubtful."""
    for note in store.notes:
        typer.echo(f"store: {note}", err=True)


def put_json(value: Any) -> None:
    """Print what programs read."""
    typer.echo(json.dumps(value, indent=1, ensure_ascii=False, default=str))
