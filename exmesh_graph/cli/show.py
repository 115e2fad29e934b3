"""Plain tables of the command line: node types, why, status."""

from __future__ import annotations

import json
import shlex
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from exmesh_graph.api.board import clock
from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Signature, signature
from exmesh_graph.graph.language.check import Checked
from exmesh_graph.graph.problems import nearest
from exmesh_graph.graph.run.plan import plan
from exmesh_graph.graph.run.why import differences, explain, record_time


def show_nodes(packs: Packs) -> None:
    """All node types, one line each."""
    width = max((len(name) for name in packs.types), default=0)
    for name, definition in packs.types.items():
        doc = (definition.function.__doc__ or "").strip().splitlines()
        typer.echo(f"{name:<{width + 2}}{doc[0] if doc else ''}".rstrip())
    for module, why in packs.broken.items():
        typer.echo(f"cannot import {module}: {why}", err=True)


def show_node(packs: Packs, name: str) -> None:
    """Ports, parameters with units and ranges, and the documentation of one node type."""
    if name not in packs.types:
        close = ", ".join(nearest(name, packs.types))
        broken = "".join(f"\n  cannot import {module}: {why}" for module, why in packs.broken.items())
        raise ExmeshError(f"there is no node type {name!r}{broken}", expected=close, fix="exmesh nodes lists all")
    definition = packs.types[name]
    found = signature(definition)
    kind = ["component"] if found.component else []
    typer.echo(f"{name}  ({', '.join([*kind, f'version {definition.version}', *traits(definition)])})")
    if found.doc:
        typer.echo(textwrap.indent(found.doc, "  "))
    titles = (
        [("components", found.inputs)] if found.component else [("inputs", found.inputs), ("outputs", found.outputs)]
    )
    for title, ports in titles:
        typer.echo(f"{title}:")
        for port in ports.values():
            typer.echo(f"  {port.name}: {port}{'  (optional)' if port.optional else ''}")
    typer.echo("parameters:")
    for field in (name for name in found.params.model_fields if name not in found.inputs):
        typer.echo("  " + _parameter(found, field))


def traits(definition: NodeDef) -> list[str]:
    """What is worth knowing of a node type beside its ports: `not deterministic`, `resumable`, `takes gpu 1`."""
    found = [] if definition.deterministic else ["not deterministic"]
    found += ["resumable"] if definition.resumable else []
    return found + [
        f"takes {name} {amount:g}" for name, amount in definition.resources.items() if (name, amount) != ("cpu", 1)
    ]


def _parameter(found: Signature, name: str) -> str:
    kind, default, limits, unit, doc, tuning = parameter_facts(found, name)
    notes = [*limits, *(["not part of the key"] if tuning else [])]
    shown = "required" if default is None else f"= {default}"
    tail = f"  ({', '.join(notes)})" if notes else ""
    return f"{name}: {kind} {shown}{f' {unit}' if unit else ''}{tail}  {doc}".rstrip()


def parameter_facts(found: Signature, name: str) -> tuple[str, str | None, list[str], str, str, bool]:
    """(type, default as text or None, limits, unit, meaning, whether it stays out of the key) of a parameter."""
    info = found.params.model_fields[name]
    kind = getattr(info.annotation, "__name__", "") if isinstance(info.annotation, type) else str(info.annotation)
    kind = kind.replace("typing.", "").replace("pathlib.", "")
    default = None if info.is_required() else repr(info.get_default(call_default_factory=True))
    limits = []
    for limit in info.metadata:
        for word, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="), ("multiple_of", "multiple of")):
            if getattr(limit, word, None) is not None:
                limits.append(f"{sign} {getattr(limit, word)}")
        for word in ("min_length", "max_length"):
            if getattr(limit, word, None) is not None:
                limits.append(f"{word} {getattr(limit, word)}")
    if name in found.decided_by():
        limits.append(f"or auto, by {found.decided_by()[name]}")
    extra = found.extra(name)
    return kind, default, limits, str(extra.get("unit") or ""), info.description or "", bool(extra.get("tuning"))


def show_why(graph: Checked, name: str, store: Store, words: Sequence[str] = ()) -> None:
    """The state of a node, its key, and what differs from the nearest earlier record.

    `words` of the command line name the graph, for the next command.
    """
    steps = {step.name: step for step in plan(graph, store, graph.needed_for([name]), reasons=False)}
    step, bound = steps[name], graph.nodes[name]
    typer.echo(f"{name}: {step.state}")
    if step.preimage is None:
        typer.echo(f"  {step.reason}; its key is known only when that has run")
        above = step.reason.removeprefix("waits for ").split(",")[0]
        typer.echo("  " + shlex.join(["exmesh", "why", above, *words]))
        return
    typer.echo(f"  key {step.key}")
    if step.action is not None:
        info = step.action.info
        typer.echo(f"  made {record_time(step.action)} by {info.get('node')} of {info.get('graph')} "
                   f"in {clock(float(info.get('seconds', 0)))}")  # fmt: skip
        for line in differences(step.preimage, step.action, bound):
            typer.echo(f"  {line}")
    else:
        for line in explain(bound, step.preimage, store):
            typer.echo(f"  {line}")
    typer.echo("  the key depends on:")
    for field in ("type", "version", "seed"):
        typer.echo(f"    {field} {step.preimage[field]}")
    for field in ("params", "libraries", "sources", "inputs", "components"):
        values: dict[str, Any] = step.preimage.get(field, {})
        if values:
            typer.echo(f"    {field}: {', '.join(values)}")
    typer.echo("    code: " + ", ".join(fingerprint(bound.definition).parts))


def read_run(folder: Path) -> dict[str, Any]:
    """The record of a run folder. Raises ExmeshError where there is none, or none that can be read."""
    path = folder / "run.json"
    if not path.is_file():
        raise ExmeshError(f"{folder} is no run folder", fix="exmesh status lists the runs")
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        return {**record, "state": record["state"], "nodes": record["nodes"], "started": record["started"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        what = f"run.json cannot be read: {type(error).__name__}: {error}"
        raise ExmeshError(what, where=str(path), fix="run the graph again: what is in the store is kept") from error
