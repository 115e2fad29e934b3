"""Pages on node types, one for each family, made from signatures and docstrings: `exmesh nodes --markdown DIR`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from exmesh_graph.api.described import ParameterInfo, PortInfo, TypeInfo
from exmesh_graph.errors import ExmeshError

_MARK = "<!-- made by `exmesh nodes --markdown`; edits are lost -->"


def node_pages(types: Mapping[str, TypeInfo]) -> dict[str, str]:
    """{file name: text}: README.md with the list of all types, and FAMILY.md for every family."""
    families: dict[str, list[TypeInfo]] = {}
    for info in types.values():
        families.setdefault(info.type.partition(".")[0], []).append(info)
    index = [_MARK, "", "# Node types", ""]
    pages = {}
    for family, members in families.items():
        index += [f"## [{family}]({family}.md)", "", "| type | what it does |", "| --- | --- |"]
        index += [f"| [`{d.type}`]({family}.md#{_anchor(d.type)}) | {_cell(d.title)} |" for d in members] + [""]
        intro = {member.family for member in members}
        parts = [
            _MARK,
            f"# {family}",
            *sorted(text for text in intro if text and len(intro) == 1),
            *map(_node, members),
        ]
        pages[f"{family}.md"] = "\n\n".join(parts) + "\n"
    return {"README.md": "\n".join(index).rstrip() + "\n", **pages}


def write_pages(types: Mapping[str, TypeInfo], folder: Path) -> list[Path]:
    """Write all pages and remove those of families that are gone. Raises ExmeshError before it harms other files."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = node_pages(types)
    for old in folder.glob("*.md"):
        own = old.read_text(encoding="utf-8").startswith(_MARK)
        if own and old.name not in pages:
            old.unlink()
        elif not own and old.name in pages:
            raise ExmeshError(f"{old} was not made by this command", fix="name a folder of its own: docs/nodes")
    for name, text in pages.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in pages]


def _node(info: TypeInfo) -> str:
    facts = ["component" if info.component else "node", f"version {info.version}", *info.traits]
    facts += ["libraries " + ", ".join(info.libraries)] if info.libraries else []
    parts = [f"## {info.type}", info.doc, f"```yaml\n{_example(info)}\n```", "; ".join(facts)]
    parts += _ports("component" if info.component else "input", info.inputs) + _ports("output", info.outputs)
    if info.parameters:
        head = ["| parameter | type | default | range | unit | meaning |", "| --- | --- | --- | --- | --- | --- |"]
        parts.append("\n".join([*head, *map(_parameter, info.parameters)]))
    return "\n\n".join(part for part in parts if part)


def _example(info: TypeInfo) -> str:
    """The shortest entry of a graph file that can be right."""
    needed = [f"{port.name}: {port.link}" for port in info.inputs if not port.optional]
    needed += [f"{one.name}: ..." for one in info.parameters if one.default is None]
    return "name: {" + ", ".join([f"type: {info.type}", *needed]) + "}"


def _ports(title: str, ports: Iterable[PortInfo]) -> list[str]:
    rows = [f"| `{p.name}` | {_cell(p.type)}{', optional' if p.optional else ''} |" for p in ports]
    return ["\n".join([f"| {title} | type |", "| --- | --- |", *rows])] if rows else []


def _parameter(one: ParameterInfo) -> str:
    doc = one.doc + (" Not part of the key." if one.tuning else "")
    default = "required" if one.default is None else f"`{one.default}`"
    return (
        "| " + " | ".join(map(_cell, (f"`{one.name}`", one.type, default, ", ".join(one.limits), one.unit, doc))) + " |"
    )


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _anchor(kind: str) -> str:
    return "".join(c for c in kind.lower() if c.isalnum() or c in "_-")
