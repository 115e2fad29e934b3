"""Pages on node types, one for each family, made from signatures and docstrings: `exmesh nodes --markdown DIR`."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from pathlib import Path

from exmesh_graph.cli.show import parameter_facts, traits
from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Port, Signature, link_form, signature

_MARK = "<!-- made by `exmesh nodes --markdown`; edits are lost -->"


def node_pages(packs: Packs) -> dict[str, str]:
    """{file name: text}: README.md with the list of all types, and FAMILY.md for every family."""
    families: dict[str, list[NodeDef]] = {}
    for definition in packs.types.values():
        families.setdefault(definition.type.partition(".")[0], []).append(definition)
    index = [_MARK, "", "# Node types", ""]
    pages = {}
    for family, members in families.items():
        index += [f"## [{family}]({family}.md)", "", "| type | what it does |", "| --- | --- |"]
        index += [f"| [`{d.type}`]({family}.md#{_anchor(d.type)}) | {_cell(_title(d))} |" for d in members] + [""]
        intro = {inspect.getdoc(sys.modules[d.function.__module__]) or "" for d in members}
        parts = [
            _MARK,
            f"# {family}",
            *sorted(text for text in intro if text and len(intro) == 1),
            *map(_node, members),
        ]
        pages[f"{family}.md"] = "\n\n".join(parts) + "\n"
    return {"README.md": "\n".join(index).rstrip() + "\n", **pages}


def write_pages(packs: Packs, folder: Path) -> list[Path]:
    """Write all pages and remove those of families that are gone. Raises ExmeshError before it harms other files."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = node_pages(packs)
    for old in folder.glob("*.md"):
        own = old.read_text(encoding="utf-8").startswith(_MARK)
        if own and old.name not in pages:
            old.unlink()
        elif not own and old.name in pages:
            raise ExmeshError(f"{old} was not made by this command", fix="name a folder of its own: docs/nodes")
    for name, text in pages.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in pages]


def _node(definition: NodeDef) -> str:
    found = signature(definition)
    facts = ["component" if found.component else "node", f"version {definition.version}"]
    facts += traits(definition)
    facts += ["libraries " + ", ".join(definition.libraries)] if definition.libraries else []
    parts = [f"## {definition.type}", found.doc, f"```yaml\n{_example(definition.type, found)}\n```", "; ".join(facts)]
    parts += _ports("component" if found.component else "input", found.inputs) + _ports("output", found.outputs)
    rows = [name for name in found.params.model_fields if name not in found.inputs]
    if rows:
        head = ["| parameter | type | default | range | unit | meaning |", "| --- | --- | --- | --- | --- | --- |"]
        parts.append("\n".join([*head, *(_parameter(found, name) for name in rows)]))
    return "\n\n".join(part for part in parts if part)


def _example(kind: str, found: Signature) -> str:
    """The shortest entry of a graph file that can be right."""
    needed = [f"{port.name}: {link_form(port)}" for port in found.inputs.values() if not port.optional]
    names = [name for name, info in found.params.model_fields.items() if info.is_required()]
    needed += [f"{name}: ..." for name in names if name not in found.inputs]
    return "name: {" + ", ".join([f"type: {kind}", *needed]) + "}"


def _ports(title: str, ports: Mapping[str, Port]) -> list[str]:
    if not ports:
        return []
    rows = [f"| `{p.name}` | {_cell(str(p))}{', optional' if p.optional else ''} |" for p in ports.values()]
    return ["\n".join([f"| {title} | type |", "| --- | --- |", *rows])]


def _parameter(found: Signature, name: str) -> str:
    kind, default, limits, unit, doc, tuning = parameter_facts(found, name)
    doc += " Not part of the key." if tuning else ""
    cells = (f"`{name}`", kind, "required" if default is None else f"`{default}`", ", ".join(limits), unit, doc)
    return "| " + " | ".join(map(_cell, cells)) + " |"


def _title(definition: NodeDef) -> str:
    return signature(definition).doc.partition("\n")[0]


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _anchor(kind: str) -> str:
    return "".join(c for c in kind.lower() if c.isalnum() or c in "_-")
