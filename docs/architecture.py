"""`python -m docs.architecture`: the picture of the rooms in docs/architecture.md, from docs/rooms.toml and the code.

Each row is a room, what it is for, and the rooms that it imports from. `--lines` prints files and lines instead.
"""

from __future__ import annotations

import ast
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parent.parent
LIBRARY, NODES, PAGE = ROOT / "exmesh_graph", ROOT / "nodes", ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- rooms: written by python -m docs.architecture -->\n", "<!-- end of rooms -->\n"
Arrows = dict[str, set[str]]
HOLDS_STATEMENTS = (ast.stmt, ast.ExceptHandler, ast.match_case)  # an expression holds no import


def rooms(table: str = "rooms") -> dict[str, str]:
    """{room: what it is for} from the top down; `table` is `rooms`, or `graph` for the rooms inside the framework."""
    return dict(tomllib.loads((ROOT / "docs" / "rooms.toml").read_text(encoding="utf-8"))[table])


def modules() -> dict[str, Path]:
    """{import name: file} of the library and of the node packs."""
    named = {f"exmesh_graph.{_dotted(path, LIBRARY)}".rstrip("."): path for path in sorted(LIBRARY.rglob("*.py"))}
    return named | {f"exmesh_nodes.{_dotted(path, NODES)}".rstrip("."): path for path in sorted(NODES.rglob("*.py"))}


def imports(path: Path, name: str, *, top_only: bool = False) -> Iterator[str]:
    """Absolute names of what a file imports, `module.attribute` for `from module import attribute`.

    Imports for type checkers only (`if TYPE_CHECKING:`) do not count; `top_only` leaves out those inside functions.
    """
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    todo: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while todo:
        item = todo.pop()
        if top_only and isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(item, ast.If) and "TYPE_CHECKING" in ast.dump(item.test):
            todo += item.orelse
        elif isinstance(item, ast.Import):
            yield from (alias.name for alias in item.names)
        elif isinstance(item, ast.ImportFrom):
            above = package[: len(package) - item.level + 1] if item.level else []
            base = ".".join([*above, *([item.module] if item.module else [])])
            yield from (f"{base}.{alias.name}" for alias in item.names)
        else:
            todo += [child for child in ast.iter_child_nodes(item) if isinstance(child, HOLDS_STATEMENTS)]


@cache
def arrows() -> Arrows:
    """{module: modules of this project that it imports}, imports inside functions included; read once per process."""
    known = modules()
    graph: Arrows = {}
    for name, path in known.items():
        ends = (end if end in known else end.rpartition(".")[0] for end in imports(path, name))
        graph[name] = {end for end in ends if end in known and end != name}
    return graph


def room_of(module: str, inside: str = "") -> str:
    """The room of a module: `stage1` for exmesh_graph.stage1.refine; with `inside`, the room inside that room."""
    parts = module.split(".")
    if inside:
        return parts[2] if parts[1:2] == [inside] and len(parts) > 2 else ""
    if parts[0] == "exmesh_nodes":
        return "nodes"
    return parts[1] if len(parts) > 1 else ""


def table(inside: str = "") -> str:
    """The rooms as a Markdown table, from the top down."""
    order = rooms(inside or "rooms")
    graph, files = arrows(), modules()
    rows = ["| room | what it is for | imports from |", "| --- | --- | --- |"]
    for room, purpose in order.items():
        own = [module for module in files if room_of(module, inside) == room]
        below = {room_of(end, inside) for module in own for end in graph[module]} - {room, ""}
        imported = " ".join(name for name in order if name in below)
        rows.append(f"| {room} | {purpose} | {imported} |")
    return "\n".join(rows) + "\n"


def sizes() -> str:
    """Files and lines of every room."""
    files = modules()
    rows = []
    for room in rooms():
        own = [path for module, path in files.items() if room_of(module) == room]
        rows.append(f"{room:<10}{len(own):>5} files{sum(len(p.read_text().splitlines()) for p in own):>7} lines")
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files.values())
    return "\n".join([*rows, f"{'all':<10}{len(files):>5} files{lines:>7} lines"])


def page() -> str:
    """docs/architecture.md with the tables as the code now has them."""
    text = PAGE.read_text(encoding="utf-8")
    head, rest = text.split(BEGIN)
    tail = rest.split(END)[1]
    return f"{head}{BEGIN}\n{table()}\nInside `graph`:\n\n{table('graph')}\n{END}{tail}"


def _dotted(path: Path, top: Path) -> str:
    parts = path.relative_to(top).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


if __name__ == "__main__":
    if "--lines" in sys.argv:
        print(sizes())
    else:
        PAGE.write_text(page(), encoding="utf-8")
