"""Commands for those who write graphs and nodes: `exmesh nodes`, `schema`, `stubs`, `new-node`."""

from __future__ import annotations

import enum
import keyword
import re
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exmesh_graph.cli.options import AsJson, put_json
from exmesh_graph.errors import GraphError

if TYPE_CHECKING:
    from exmesh_graph.api.described import ParameterInfo, TypeInfo

_TEMPLATES = Path(__file__).with_name("templates")
Output = Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE", help="Write it to a file.")]


class Kind(enum.Enum):
    """What `new-node` writes."""

    node = "node"
    wire = "wire"
    component = "component"
    loader = "loader"


def nodes(
    type: Annotated[str | None, typer.Argument(help="A node type, for its ports and parameters.")] = None,
    markdown: Annotated[
        Path | None, typer.Option("--markdown", metavar="DIR", help="Write a page for every family of nodes.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the node types, or describe one."""
    from exmesh_graph.api import described

    if markdown is not None:
        from exmesh_graph.cli.pages import write_pages

        typer.echo(f"{len(write_pages(described.node_types(), markdown))} pages in {markdown}")
        return
    listed = list(described.node_types().values()) if type is None else [described.describe(type)]
    if as_json:
        put_json(described.as_json(listed))
    elif type is None:
        _show_nodes(listed, described.broken())
    else:
        _show_node(listed[0])


def _show_nodes(types: Sequence[TypeInfo], broken: Mapping[str, str]) -> None:
    """All node types, one line each."""
    width = max((len(info.type) for info in types), default=0)
    for info in types:
        typer.echo(f"{info.type:<{width + 2}}{info.title}".rstrip())
    for name, why in broken.items():
        typer.echo(f"{name} {why}", err=True)


def _show_node(info: TypeInfo) -> None:
    """Ports, parameters with units and ranges, and the documentation of one node type."""
    kind = ["component"] if info.component else []
    typer.echo(f"{info.type}  ({', '.join([*kind, f'version {info.version}', *info.traits])})")
    if info.doc:
        typer.echo(textwrap.indent(info.doc, "  "))
    for title, ports in (("components" if info.component else "inputs", info.inputs), ("outputs", info.outputs)):
        if title == "outputs" and info.component:
            continue
        typer.echo(f"{title}:")
        for port in ports:
            typer.echo(f"  {port.name}: {port.type}{'  (optional)' if port.optional else ''}")
    typer.echo("parameters:")
    for parameter in info.parameters:
        typer.echo("  " + _parameter(parameter))


def _parameter(one: ParameterInfo) -> str:
    notes = [*one.limits, *(["not part of the key"] if one.tuning else [])]
    shown = "required" if one.default is None else f"= {one.default}"
    tail = f"  ({', '.join(notes)})" if notes else ""
    return f"{one.name}: {one.type} {shown}{f' {one.unit}' if one.unit else ''}{tail}  {one.doc}".rstrip()


def new_node(
    type: Annotated[str, typer.Argument(help="The new type, family.name: geometry.smooth.")],
    into: Annotated[
        Path,
        typer.Option(
            "--into", metavar="DIR", help="The package of your nodes; pyproject.toml and tests/ lie beside it."
        ),
    ] = Path("my_nodes/my_nodes"),
    kind: Annotated[
        Kind, typer.Option("--type", help="What to write: a node, a wire type, a component, a loader of files.")
    ] = Kind.node,
) -> None:
    """Write a working node (or wire type, component, loader) with its test, in a package that graphs find when it is
    installed.
    """
    from exmesh_graph.api.described import node_types

    if type in node_types():
        raise GraphError(f"there is a node type {type!r} already", fix=f"exmesh nodes {type}")
    made = _write_node(type, into, kind)
    for path in made:
        typer.echo(str(path))
    root, package = into.resolve().parent, into.resolve().name
    if not _offered(root / "pyproject.toml", package):
        typer.echo(f"{root / 'pyproject.toml'} is not from here and must list the package {package!r} and say:")
        typer.echo(f'  [project.entry-points."exmesh.nodes"]\n  {package} = "{package}"')
    typer.echo(
        f"test it: pytest {root / 'tests'}\ninstall it: pip install -e {root}\n"
        + ("" if kind is Kind.wire else f"see it: exmesh nodes {type}")
    )


def _write_node(kind: str, folder: Path, template: Kind = Kind.node) -> list[Path]:
    """Write the type `kind` into the node pack `folder`; returns the new files. Raises GraphError."""
    match = re.fullmatch(r"([a-z][a-z0-9_]*)\.([a-z][a-z0-9_]*)", kind)
    if match is None or keyword.iskeyword(match[2]):
        raise GraphError(
            f"{kind!r} cannot name a node type",
            expected="family.name in small letters, no word of Python: geometry.smooth",
        )
    package, root = folder.resolve().name, folder.resolve().parent
    if not package.isidentifier():
        raise GraphError(f"the folder {package!r} cannot be a Python package", fix="--into my_nodes")
    names = {
        "type": kind, "module": f"{match[1]}_{match[2]}", "function": match[2], "package": package,
        "project": package.replace("_", "-"), "Class": "".join(word.capitalize() for word in match[2].split("_")),
    }  # fmt: skip
    texts = {
        folder / f"{names['module']}.py": f"{template.value}.txt",
        root / "tests" / f"test_{names['module']}.py": f"test_{template.value}.txt",
        folder / "__init__.py": "package.txt",
        root / "pyproject.toml": "pyproject.txt",
    }
    taken = [path for path in list(texts)[:2] if path.exists()]
    if taken:
        raise GraphError(f"{taken[0]} is there already", fix="choose another name, or remove it")
    made = [path for path in texts if not path.exists()]
    for path in made:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = (_TEMPLATES / texts[path]).read_text(encoding="utf-8")
        text = re.sub(r"\{(\w+)\}", lambda match: names.get(match[1], match[0]), text)
        path.write_text(text, encoding="utf-8")
    return made


def _offered(project: Path, package: str) -> bool:
    """Whether the pyproject.toml `project` names the `package` as one of node types."""
    import tomllib

    try:
        said = tomllib.loads(project.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise GraphError(f"{project} cannot be read: {error}") from None
    return package in said.get("project", {}).get("entry-points", {}).get("exmesh.nodes", {}).values()


def schema(output: Output = None) -> None:
    """Print the JSON schema of graph files with the node types at hand, for editors."""
    from exmesh_graph.api.described import schema_text

    _put_text(schema_text(), output)


def stubs(
    output: Output = None,
    install: Annotated[bool, typer.Option("--install", help="Write it where editors look: into the package.")] = False,
) -> None:
    """Print the types of all node types at hand, with which editors complete graphs that are built in Python."""
    from exmesh_graph.api.stubs import SHIPPED, stub_text

    _put_text(stub_text(), SHIPPED if install else output)


def _put_text(text: str, target: Path | None) -> None:
    """Print a text, or write it to a file."""
    if target is None:
        typer.echo(text, nl=False)
    else:
        target.write_text(text, encoding="utf-8")
        typer.echo(str(target))
