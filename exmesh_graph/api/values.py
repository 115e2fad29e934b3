"""What a graph that is built in Python holds: outputs of nodes, graph parameters, components; where they were written.

A value becomes what a graph file would hold in its place: `views.train` the text `@views.train`, a graph parameter
`${faces}`, a path its text, a tuple a list. Strings mean what they mean in a graph file, `"@views.train"` and
`"${faces}"` too; `"@@"` begins a literal `@`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.problems import GraphErrors, Problem, Problems, Where, nearest

if TYPE_CHECKING:
    from exmesh_graph.api.scope import NodeScope

T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True)
class Place(Where):
    """A line of Python; relative paths written there start from the folder that was the working folder then."""

    folder: Path = field(default_factory=Path.cwd)

    def __str__(self) -> str:
        name = str(self.file)
        if "ipykernel_" in name or name.startswith("<ipython"):
            return f"notebook cell, line {self.line}"
        return f"{name}, line {self.line}" if name.startswith("<") else super().__str__()

    @property
    def base(self) -> Path:
        return self.folder


def here() -> Place:
    """The line of Python that called into this package; no file where that is its own command line."""
    frame = sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__", "")).startswith("exmesh_graph.api"):
        frame = frame.f_back
    if str(frame.f_globals.get("__name__", "")).startswith("exmesh_graph.cli"):
        return Place(None)
    return Place(Path(frame.f_code.co_filename), frame.f_lineno)


class NoValue(GraphError, AttributeError):
    """An output of a graph's node was used as if it were the value that a run makes."""


class Wire(Generic[T_co]):
    """An output of a node of a graph, to be given to another node: `views.train`. Its text is that of a graph file."""

    def __init__(self, scope: NodeScope, node: str, port: str) -> None:
        self.scope, self.node, self.port = scope, node, port

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name in ("scope", "node", "port"):
            raise AttributeError(name)
        what = f"{self.node}.{self.port} has no {name!r}: it is an output in a graph, which has no value yet"
        fix = f'run the graph, and ask the run: ex.run(graph)["{self.node}"].{self.port}.{name}'
        raise NoValue(what, where=str(here()), expected="an output, to be given to another node", fix=fix)

    def __str__(self) -> str:
        return f"@{self.node}.{self.port}"

    def __repr__(self) -> str:
        return f"<output {self.node}.{self.port}>"


class UnknownPort(GraphErrors, AttributeError):
    """A node was asked for an output that it does not have."""


class Node:
    """A node of a graph; its outputs are its attributes: `views.train`, or `views["train"]`. Made by `add`."""

    def __init__(self, scope: NodeScope, name: str) -> None:
        self._scope, self._name = scope, name

    def __getattr__(self, port: str) -> Wire[Any]:
        if port.startswith("_"):
            raise AttributeError(port)
        return self[port]

    def __getitem__(self, port: str) -> Wire[Any]:
        known = self._scope.outputs_of(self._name)
        kind = self._scope.graph.signature(self._scope.type_of(self._name))
        if known is not None and port not in known and not (kind and port in kind.renamed_outputs):
            what = f"{self._name} ({self._scope.type_of(self._name)}) has no output {port!r}"
            fix = "" if known else "a component has none: give the component itself"
            problem = Problem("unknown-port", here(), what, expected=", ".join(known), fix=fix,
                              nearest=tuple(nearest(port, known) or known))  # fmt: skip
            raise UnknownPort([problem])
        return Wire(self._scope, self._name, port)

    __iter__ = None  # it has names, no order

    def __dir__(self) -> list[str]:
        return list(self._scope.outputs_of(self._name) or ())

    def __str__(self) -> str:
        return f"@{self._name}"

    def __repr__(self) -> str:
        outputs = ", ".join(self._scope.outputs_of(self._name) or ())
        return f"<{self._scope.type_of(self._name)} {self._name}{': ' + outputs if outputs else ''}>"


class Parameter:
    """A parameter of the graph, to be given to nodes: its text is `${name}`."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __str__(self) -> str:
        return f"${{{self.name}}}"

    def __repr__(self) -> str:
        return f"<graph parameter {self.name}>"


@dataclass(frozen=True)
class Plug(Generic[T_co]):
    """A component with its parameters, before it is part of a graph; made by `component`."""

    type: str
    fields: Mapping[str, Any]


def component(type: str, /, **fields: Any) -> Plug[Any]:
    """A component to plug into a node: `texture = ex.component("appearance.uv_texture")`; other components may nest."""
    return Plug(type, fields)


def plain(value: Any, what: str, where: Where, problems: Problems) -> Any:
    """A value as a graph file would hold it; anything that is none is noted. Wires and plugs are handled before."""
    from exmesh_graph.graph.language.yamlfile import Map

    if isinstance(value, Wire | Parameter):
        return str(value)
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        result = Map(where)
        for key, item in value.items():
            if not isinstance(key, str | int) or isinstance(key, bool):
                problems.add("parameter", where, f"{what}: a key must be a name or a whole number", found=repr(key))
                continue
            result.put(key, plain(item, f"{what}.{key}", where, problems), where)
        return result
    if isinstance(value, list | tuple):
        return [plain(item, what, where, problems) for item in value]
    shape = getattr(value, "shape", None)
    if shape == () and hasattr(value, "item"):  # a number of numpy or torch
        return plain(value.item(), what, where, problems)
    if isinstance(value, bool | int | float | str):  # an enum or another subclass
        return plain(getattr(value, "value", None), what, where, problems)
    _refuse(value, shape, what, where, problems)
    return None


def told(value: Any) -> str:
    """A value that was given by mistake, in a few words."""
    if isinstance(value, bool | int | float | str | Wire | Parameter):
        return repr(value) if len(repr(value)) <= 60 else f"{repr(value)[:57]}..."
    if value is None:
        return "None"
    shape = getattr(value, "shape", None)
    of = f" of shape {tuple(shape)}" if isinstance(shape, tuple) else ""
    return f"{'an' if type(value).__name__[0] in 'AEIOUaeiou' else 'a'} {type(value).__name__}{of}"


def _refuse(value: Any, shape: Any, what: str, where: Where, problems: Problems) -> None:
    """Note what cannot stand in a graph, with what to do instead."""
    from exmesh_graph.types import Artifact

    expected = "a number, text, true or false, nothing, a path, lists and mappings of these, or an output of a node"
    shown, fix = f"a {type(value).__name__}", ""
    if isinstance(value, Artifact):
        shown, expected = f"a {value.type_name} in memory", "an output of a node of this graph"
        fix = "save it to a file and read it by a node (init.mesh_file for meshes), or call the node with ex.call"
    elif shape is not None:
        shown = f"{shown} of shape {tuple(shape)}"
        fix = "a short one as a list: .tolist(); data comes from files, through a node of the family data"
    problems.add("parameter", where, f"{what} cannot be part of a graph", expected=expected, found=shown, fix=fix)
