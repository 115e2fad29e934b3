"""What every function of the front door begins with: a graph from a file or from Python, checked, and a store."""

from __future__ import annotations

import contextlib
import json
import math
import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from exmesh_graph.api.arguments import file_of, path_of, wrong
from exmesh_graph.api.builder import Graph
from exmesh_graph.api.values import Node, Wire, here, plain
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.problems import GraphErrors, Problems
from exmesh_graph.graph.session import current_session

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.language.check import Checked
    from exmesh_graph.graph.session import Session
    from exmesh_graph.graph.variants.checked import CheckedVariant

T = TypeVar("T")
Source = str | os.PathLike[str] | Graph
Settings = Mapping[str, Any] | Iterable[str] | None
Folder = str | os.PathLike[str] | None
Names = Iterable[str | Node | Wire[Any]] | str | Node | Wire[Any] | None


def checked_graph(
    graph: Source, set: Settings = None, variant: str | None = None, store: Folder = None, **params: Any
) -> Checked:
    """A graph, or one of its variants, without faults; else GraphErrors tells all of them."""
    if variant is not None and not isinstance(variant, str):
        wrong("variant", variant, "the name of a variant")
    checked = _judged(current_session().check, graph, set, store, params, variant=variant)
    _warn_of(checked.notes)
    return checked


def check(
    graph: Source, *, set: Settings = None, variant: str | None = None, session: Session | None = None, **params: Any
) -> Checked:
    """Check a graph and all variants that it declares, or the one that is named; gives what would run.

    Raises GraphErrors with everything that is wrong: each fault with its place, what was expected, and how to mend it.
    """
    with using(session):
        if variant:
            return checked_graph(graph, set, variant, **params)
        return checked_variants(graph, set, repeats=False, **params)[0].checked


def checked_variants(
    graph: Source, set: Settings = None, store: Folder = None, *, only: Iterable[str] | None = None,
    repeats: bool = True, **params: Any,
) -> list[CheckedVariant]:  # fmt: skip
    """A graph and all variants that it declares, checked."""
    rows = _judged(current_session().check_variants, graph, set, store, params, only=only, repeats=repeats)
    _warn_of(note for row in rows for note in row.checked.notes)
    return rows


def using(session: Session | None) -> contextlib.AbstractContextManager[Any]:
    """Work in a session, or in the current one."""
    from exmesh_graph.graph.session import Session

    if session is not None and not isinstance(session, Session):
        wrong("session", session, "an ex.Session")
    return contextlib.nullcontext() if session is None else session


def packs() -> Packs:
    """The node types at hand, and the modules that cannot be imported."""
    return current_session().packs()


def open_store(folder: Folder = None, shared: str | None = None) -> Store:
    """The store in `folder`, by default $EXMESH_STORE or ./.exmesh."""
    if shared is not None:
        path_of(shared, "shared", "the path of a folder")
    return current_session().open_store(folder, shared)


def stem_of(graph: Source) -> str:
    """What runs of a graph are called by."""
    return graph.name if isinstance(graph, Graph) else file_of(graph).stem


def texts_of(set: Settings, params: Mapping[str, Any] | None = None) -> list[str]:
    """Settings as `--set` takes them: `name=value`, the value as in a graph file."""
    if set is not None and not isinstance(set, Mapping):
        texts = [set] if isinstance(set, str) else list(set) if isinstance(set, Iterable) else [set]
        for text in texts:
            if not isinstance(text, str):
                wrong("set", text, 'values by name, {"pbr.iterations": 800}, or texts: "pbr.iterations=800"')
    else:
        texts = [f"{name}={_text(name, value)}" for name, value in (set or {}).items()]
    return [*texts, *(f"{name}={_text(name, value)}" for name, value in (params or {}).items())]


def _text(name: str, value: Any) -> str:
    where, problems = here(), Problems()
    told = plain(str(value) if isinstance(value, Node) else value, name, where, problems)  # a node: its link
    problems.raise_if_any()
    if isinstance(told, float) and not math.isfinite(told):
        return ".nan" if math.isnan(told) else f"{'-' if told < 0 else ''}.inf"
    if isinstance(told, str) and (told.startswith("@") or _reads_as_text(told)):
        return told
    return json.dumps(told, ensure_ascii=False)


def _reads_as_text(text: str) -> bool:
    """Whether a text needs no quotes to be read as itself."""
    from exmesh_graph.graph.language.yamlfile import parse_yaml

    try:
        return text != "" and bool(parse_yaml(text, None) == text)
    except GraphErrors:
        return False


def _judged(
    check: Callable[..., T], graph: Source, set: Settings, store: Folder, params: Mapping[str, Any], **options: Any
) -> T:
    """What a session's `check` gives; faults of what was set in a call are placed at the call."""
    if store is not None:
        path_of(store, "store", "the path of a folder")
    place, sets = here(), texts_of(set, params)
    try:
        file, top = (graph.file, graph.merged()) if isinstance(graph, Graph) else (file_of(graph), None)
        return check(file, sets, store=store, top=top, **options)
    except GraphErrors as error:
        if place.file is None or all(problem.where.file is not None for problem in error.problems):
            raise
        at = [replace(p, where=place) if p.where.file is None else p for p in error.problems]
        raise GraphErrors(at) from None


def _warn_of(notes: Iterable[str]) -> None:
    for note in dict.fromkeys(notes):
        warnings.warn(note, stacklevel=4)
