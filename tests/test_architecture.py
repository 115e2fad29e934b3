"""The rooms and their arrows: who may import whom, what must stay light, how large the core may grow."""

from __future__ import annotations

import ast
import subprocess
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
LIBRARY, NODES = ROOT / "exmesh_graph", ROOT / "nodes"
FRAMEWORK = ("graph", "cli", "report")
ROOMS_3D = sorted(
    path.name
    for path in LIBRARY.iterdir()
    if path.is_dir() and (path / "__init__.py").exists() and path.name not in (*FRAMEWORK, "types")
)
HEAVY = ("torch", "open3d", "pymeshlab", "pxr", "warp", "OpenImageIO", "scipy", "skimage", "numpy", "embreex", "xatlas")


def imports(path: Path, *, top_only: bool) -> Iterator[str]:
    """Absolute names of the modules a file imports; `top_only` leaves out functions and TYPE_CHECKING blocks."""
    package = path.relative_to(ROOT).parent.parts
    todo: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while todo:
        item = todo.pop()
        if top_only and isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if top_only and isinstance(item, ast.If) and "TYPE_CHECKING" in ast.dump(item.test):
            todo += item.orelse
            continue
        if isinstance(item, ast.Import):
            yield from (alias.name for alias in item.names)
        elif isinstance(item, ast.ImportFrom):
            base = ".".join([*package[: len(package) - item.level + 1], item.module or ""]) if item.level else ""
            name = base.rstrip(".") or item.module or ""
            yield from (f"{name}.{alias.name}" for alias in item.names)
        else:
            todo += ast.iter_child_nodes(item)


def files(folder: Path) -> list[Path]:
    found = sorted(folder.rglob("*.py"))
    assert found
    return found


def offences(folder: Path, forbidden: tuple[str, ...], *, top_only: bool) -> list[str]:
    return [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in files(folder)
        for name in imports(path, top_only=top_only)
        if any(name == f or name.startswith(f + ".") for f in forbidden)
    ]


def test_the_import_finder_sees_what_it_must(tmp_path: Path) -> None:
    path = LIBRARY / "graph" / "node.py"
    assert "pydantic.BaseModel" in set(imports(path, top_only=True))
    assert "exmesh_graph.io.blender.load_blender" not in set(imports(path, top_only=False))
    assert any(name.startswith("numpy") for name in imports(LIBRARY / "types" / "artifact.py", top_only=False))
    assert not any(name.startswith("numpy") for name in imports(LIBRARY / "types" / "artifact.py", top_only=True))


def test_graph_knows_nothing_of_3d() -> None:
    rooms = tuple(f"exmesh_graph.{room}" for room in ROOMS_3D)
    assert "exmesh_graph.geometry" in rooms
    above = ("exmesh_graph.cli", "exmesh_graph.report", "exmesh_nodes")
    losses = ("exmesh_graph.losses", "exmesh_graph.gpu.torch_setup")
    assert offences(LIBRARY / "graph", (*rooms, *losses, *above, *HEAVY), top_only=False) == []


def test_types_import_no_room_when_imported() -> None:
    rooms = tuple(f"exmesh_graph.{room}" for room in (*ROOMS_3D, *FRAMEWORK))
    assert offences(LIBRARY / "types", (*rooms, "exmesh_nodes", *HEAVY), top_only=True) == []


@pytest.mark.parametrize("room", ROOMS_3D)
def test_rooms_do_not_know_the_framework(room: str) -> None:
    above = tuple(f"exmesh_graph.{name}" for name in FRAMEWORK)
    assert offences(LIBRARY / room, (*above, "exmesh_nodes"), top_only=False) == []


def test_the_framework_does_not_know_the_nodes() -> None:
    for room in (*FRAMEWORK, "types"):
        assert offences(LIBRARY / room, ("exmesh_nodes",), top_only=False) == []


def test_nodes_import_nothing_heavy_at_the_top() -> None:
    assert offences(NODES, HEAVY, top_only=True) == []


def loaded_by(code: str) -> set[str]:
    """The heavy libraries that `code` leaves imported."""
    probe = f"{code}\nimport sys\nprint('LOADED', *[name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split("LOADED")[1].split())


@pytest.mark.parametrize("module", ["exmesh_graph.types", "exmesh_graph.graph", "exmesh_graph.cli.app", "exmesh_nodes"])
def test_imports_stay_light(module: str) -> None:
    code = f"import {module}"
    if module == "exmesh_nodes":
        code = "from exmesh_graph.graph.declare.packs import load_packs\nassert not load_packs().broken"
    assert loaded_by(code) == set()


CALL = """
import sys
from exmesh_graph.cli import main
sys.argv = ["exmesh", *{words!r}]
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
"""


@pytest.mark.parametrize(
    "words",
    [["--help"], ["nodes"], ["check", "graphs/quickstart.yaml"], ["plan", "graphs/quickstart.yaml"]],
    ids=lambda words: words[0],
)
def test_quick_commands_load_nothing_slow(words: list[str], tmp_path: Path) -> None:
    """Listing a scene's files may take numpy and OpenImageIO (0.1 s); nothing slower."""
    extra = ["--store", str(tmp_path / "store")] if words[0] == "plan" else []
    assert loaded_by(CALL.format(words=[*words, *extra])) <= {"numpy", "OpenImageIO"}


def code_lines(path: Path) -> int:
    """Lines of a module that hold code: blank lines, comments and docstrings do not count."""
    with path.open("rb") as file:
        tokens = [t for t in tokenize.tokenize(file.readline) if t.type not in (tokenize.COMMENT, tokenize.NL)]
    breaks = (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING, tokenize.ENDMARKER)
    kept: set[int] = set()
    for before, token, after in zip([tokens[0], *tokens], tokens, [*tokens[1:], tokens[-1]], strict=False):
        text = token.type == tokenize.STRING and before.type in breaks and after.type == tokenize.NEWLINE
        if token.type not in breaks and not text:
            kept.update(range(token.start[0], token.end[0] + 1))
    return len(kept)


def framework_size() -> dict[str, int]:
    """Code lines of the core (the modules directly in graph/) and of each room below it."""
    graph = LIBRARY / "graph"
    rooms = sorted(path for path in graph.iterdir() if (path / "__init__.py").exists())
    sizes = {"core": sum(code_lines(path) for path in graph.glob("*.py"))}
    return sizes | {f"{room.name}/": sum(code_lines(path) for path in files(room)) for room in rooms}


def test_code_lines_leave_out_what_is_no_code(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text('"""Doc.\n\nMore."""\n\nX = """a\nb"""  # two\n\n\ndef f():\n    "doc"\n    # no\n    return X\n')
    assert code_lines(path) == 4


def test_the_core_stays_small() -> None:
    sizes = framework_size()
    print(sizes)
    assert sizes["core"] <= 3000, sizes
    lines = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in files(LIBRARY / "graph")}
    assert max(lines.values()) <= 400, lines


def test_a_wheel_holds_every_room() -> None:
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    there = {".".join(path.parent.relative_to(ROOT).parts) for path in LIBRARY.rglob("__init__.py")}
    assert listed == there | {"exmesh_nodes"}
