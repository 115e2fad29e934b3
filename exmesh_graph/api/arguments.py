"""What callers give for an argument: told apart early, so that a wrong one is an error with place, expected and fix."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from exmesh_graph.api.values import Node, Wire, here, told
from exmesh_graph.errors import GraphError


def wrong(what: str, value: Any, expected: str, fix: str = "") -> NoReturn:
    """Raise a GraphError, placed at the line that called into this package."""
    raise GraphError(f"{what} cannot be {told(value)}", where=str(here()), expected=expected, fix=fix)


def path_of(value: Any, what: str, expected: str = "a path", fix: str = "") -> Path:
    """A path. Raises GraphError for what is none."""
    if not isinstance(value, str | os.PathLike):
        wrong(what, value, expected, fix)
    return Path(value)


def file_of(graph: Any) -> Path:
    """The path of a graph file. Raises GraphError with what to give instead."""
    fix = ""
    if isinstance(graph, Node | Wire):
        fix = "give the graph that it belongs to; nodes=... names what to run"
    elif isinstance(graph, Mapping) and hasattr(graph, "folder"):  # a run
        fix = 'give its graph: run.folder / "graph.yaml" where it was built in Python, or call ex.open_run(folder)'
    elif isinstance(graph, Mapping):
        fix = 'build it: g = ex.Graph("name"), g.add(...); or write it to a file'
    elif hasattr(graph, "resolved"):  # a checked graph
        fix = "give what was checked: the graph itself, or its file"
    elif isinstance(graph, Iterable) and not isinstance(graph, str | os.PathLike):
        fix = "one graph after the other; ex.sweep(graph) runs all variants of one"
    return path_of(graph, "a graph", "the path of a graph file, or an ex.Graph", fix)


def by_name(given: Sequence[Any], called: str, names: Iterable[str] = ()) -> None:
    """Refuse arguments that were given by position where only names are taken."""
    if given:
        words = ", ".join(f"{name}=..." for name in list(names)[:6])
        what = f"{called} takes inputs and parameters by name, and {told(given[0])} has none"
        raise GraphError(what, where=str(here()), expected=words or "name=value", fix="write the name before it")


def node_names(names: Any) -> list[str]:
    """Nodes as callers name them (by name, by node, by one of its outputs; one or several, None: none) as names."""
    several = [names] if isinstance(names, str | Node | Wire) else names if names is not None else ()
    if not isinstance(several, Iterable):
        wrong("nodes", names, "the name of a node, or several")
    return [one.node if isinstance(one, Wire) else str(one).removeprefix("@") for one in several]


def checked_options(workers: Any, tokens: Any, progress: Any, listener: Any) -> None:
    """Options of a run that are no paths. Raises GraphError."""
    if workers is not None and (isinstance(workers, bool) or not isinstance(workers, int) or workers < 0):
        wrong("workers", workers, "a whole number from 0 (all in this process), or None: what the machine can take")
    if isinstance(tokens, Mapping):
        for name, count in tokens.items():
            if isinstance(count, bool) or not isinstance(count, int | float):
                wrong(f"the token {name}", count, 'a number: {"cpu": 4}')
    elif tokens is not None and not isinstance(tokens, str):
        wrong("tokens", tokens, 'numbers by name, {"cpu": 4}, or "cpu=4"')
    if not isinstance(progress, bool) and progress != "auto":
        wrong("progress", progress, '"auto", True or False')
    if listener is not None and not callable(listener):
        wrong("listener", listener, "a function that takes an event, which is a mapping")
