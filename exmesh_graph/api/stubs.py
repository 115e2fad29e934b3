"""families.pyi: what an editor knows of `g.nodes.init.visual_hull(views=...)`, made from the node types.

One class for each family, one method for each type: inputs as wires of their types, parameters with type and default,
documentation; what it gives has the type's outputs as attributes.
"""

from __future__ import annotations

import keyword
import types
import typing
from pathlib import Path, PurePath
from typing import Any

from exmesh_graph.api.described import TypeInfo, node_types
from exmesh_graph.api.opening import packs
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.ports import Port, Signature, signature

#: The stub that is shipped, beside the module that it describes.
SHIPPED = Path(__file__).with_name("families.pyi")
_PLAIN = {bool: "bool", int: "int", float: "float", str: "str", type(None): "None"}
_HEAD = '''# Made by `exmesh stubs` from the node types; edits are lost.
"""Node types by family: `g.nodes.init.visual_hull(views=views.train)`."""

from os import PathLike
from typing import Any, Literal

from exmesh_graph.api.scope import NodeScope
from exmesh_graph.api.values import Node, Parameter, Plug, Wire
'''


def stub_text(builtin: bool = False) -> str:
    """The text of families.pyi for the node types at hand; with `builtin` for those that come with the package."""
    described = node_types()
    definitions = {
        kind: definition
        for kind, definition in packs().types.items()
        if not builtin or definition.function.__module__.startswith(("exmesh_nodes", "exmesh_graph"))
    }
    families: dict[str, list[str]] = {}
    results: dict[tuple[tuple[str, str], ...], str] = {}
    used: set[type] = set()
    for kind, definition in definitions.items():
        family, _, name = kind.partition(".")
        if name.isidentifier() and not keyword.iskeyword(name) and family.isidentifier():
            families.setdefault(family, []).append(_method(definition, described[kind], results, used))
    homes: dict[str, list[str]] = {}
    for one in sorted(used, key=lambda one: one.__qualname__):
        homes.setdefault(one.__module__, []).append(one.__qualname__)
    imports = [f"from {home} import {', '.join(names)}" for home, names in sorted(homes.items())]
    outputs = [
        f"class {name}(Node):\n" + "\n".join(f"    {port}: Wire[{kind}]" for port, kind in ports)
        for ports, name in results.items()
        if ports
    ]
    classes = [f"class {_class(family)}(Family):\n" + "\n".join(methods) for family, methods in families.items()]
    whole = "class Families:\n    def __init__(self, scope: NodeScope) -> None: ...\n"
    whole += "    def __getattr__(self, name: str) -> Family: ...\n"
    whole += "\n".join(f"    {family}: {_class(family)}" for family in families)
    family = (
        "class Family:\n    def __init__(self, scope: NodeScope, family: str) -> None: ...\n"
        "    def __getattr__(self, name: str) -> Any: ..."
    )
    return "\n".join([_HEAD + "\n".join(imports), *outputs, family, *classes, whole]) + "\n"


def _method(definition: NodeDef, info: TypeInfo, results: dict[Any, str], used: set[type]) -> str:
    known = signature(definition)
    words: dict[bool, list[str]] = {True: [], False: []}  # what must be given, what may be
    for port in known.inputs.values():
        kind = _wire(port, used)
        kind = f"list[{kind}] | {kind}" if port.many else kind
        words[not port.optional].append(f"{port.name}: {kind}" + (" | None = None" if port.optional else ""))
    for parameter in info.parameters:
        field = known.params.model_fields[parameter.name]
        kind = _annotation(field.annotation)
        kind += ' | Literal["auto"]' if parameter.name in known.decided_by() and "auto" not in kind else ""
        needed = field.is_required()
        default = "" if needed else f" = {_default(field.get_default(call_default_factory=True))}"
        words[needed].append(f"{parameter.name}: {kind} | Parameter{default}")
    if known.component is None:
        words[False] += ["seed: int | Parameter = 0", "at: dict[int, Any] = {}", "every: dict[int, Any] = {}",
                         "each: str | list[str] = []", "limits: dict[str, Any] = {}"]  # fmt: skip
    taken = "name" in known.params.model_fields or "name" in known.inputs
    first = ["self", *(['node_name: str = ""', "/"] if taken else ['name: str = ""'])]
    given = ", ".join([*first, *(["*", *words[True], *words[False]] if any(words.values()) else [])])
    name = definition.type.partition(".")[2]
    result = _result(known, results, used)
    return f"    def {name}({given}) -> {result}:\n{_doc(info)}"


def _result(known: Signature, results: dict[Any, str], used: set[type]) -> str:
    """The class whose attributes are the outputs, shared by types with equal ones."""
    ports = tuple((port.name, _name(port.type, used)) for port in known.outputs.values())
    if not ports:
        return "Node"
    if ports not in results:
        name = "".join(word.capitalize() for port, _ in ports for word in port.split("_"))
        taken = sum(other.rstrip("0123456789") == f"{name}Node" for other in results.values())
        results[ports] = f"{name}Node{taken + 1 if taken else ''}"
    return results[ports]


def _wire(port: Port, used: set[type]) -> str:
    """What a port takes: a wire or a node; for components also what `component(...)` gives."""
    kinds = " | ".join(_name(kind, used) for kind in port.types)
    if port.plugged:
        return f"Plug[{kinds}] | {kinds} | Node"
    return f"Wire[{kinds}] | Node" + (" | Plug[Any]" if port.mixed else "")


def _name(kind: Any, used: set[type]) -> str:
    if "." in kind.__qualname__:
        return "Any"
    used.add(kind)
    return str(kind.__qualname__)


def _annotation(hint: Any) -> str:
    """A parameter's type as a stub writes it; Any for what it cannot."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if hint in _PLAIN:
        return _PLAIN[hint]
    if isinstance(hint, type) and issubclass(hint, PurePath):
        return "str | PathLike[str]"
    if origin is typing.Annotated:
        return _annotation(args[0])
    if origin in (typing.Union, types.UnionType):
        return " | ".join(dict.fromkeys(_annotation(arg) for arg in args))
    if origin is typing.Literal:
        return f"Literal[{', '.join(map(_quoted, args))}]"
    if origin in (tuple, list):
        inner = " | ".join(dict.fromkeys(_annotation(arg) for arg in args if arg is not ...))
        return f"tuple[{inner}, ...] | list[{inner}]"
    return "Any"


def _default(value: Any) -> str:
    return _quoted(value) if isinstance(value, str | bool | int | float | None) else "..."


def _quoted(value: Any) -> str:
    return '"' + value.replace('"', '\\"') + '"' if isinstance(value, str) else repr(value)


def _doc(info: TypeInfo) -> str:
    """The title and the parameters' meanings."""
    lines = []
    for one in info.parameters:
        notes = ", ".join(filter(None, [one.unit, *one.limits]))
        lines.append(f"\n        {one.name}: {' '.join(one.doc.split())}" + (f" [{notes}]" if notes else ""))
    text = info.title + ("\n" + "".join(lines) + "\n        " if lines else "")
    text = text.replace("\\", "\\\\").replace('"""', "'''")
    return f'        """{text}"""'


def _class(family: str) -> str:
    return f"_{''.join(word.capitalize() for word in family.split('_'))}"
