"""The rooms and their arrows: who may import whom, what must stay light, how large the core may grow."""

from __future__ import annotations

import json
import subprocess
import sys
import tokenize
import tomllib
from pathlib import Path

import networkx as nx
import pytest

from docs.architecture import LIBRARY, PAGE, ROOT, arrows, imports, modules, page, room_of, rooms

HEAVY = ("torch", "open3d", "pymeshlab", "pxr", "warp", "OpenImageIO", "scipy", "skimage", "numpy", "embreex", "xatlas")
ROOMS = list(rooms())
INSIDE_GRAPH = list(rooms("graph"))
FRONT_DOOR = (
    "exmesh_graph.api",
    "exmesh_graph.notebook",
    "exmesh_graph.version",
)  # what `import exmesh_graph` gives, when it is asked for


def files(folder: Path) -> list[Path]:
    listed = sorted(folder.rglob("*.py"))
    assert listed
    return listed


def upward(order: list[str], inside: str = "") -> list[str]:
    """Imports that do not go down in `order`, over all modules; those inside one room do not count."""
    place = {room: row for row, room in enumerate(order)}
    faults = []
    for module, ends in arrows().items():
        if module == "exmesh_graph":
            assert all(end in FRONT_DOOR for end in ends), ends
            continue
        for end in ends:
            rooms_of = room_of(module, inside), room_of(end, inside)
            if "" not in rooms_of and rooms_of[0] != rooms_of[1] and place[rooms_of[0]] > place[rooms_of[1]]:
                faults.append(f"{module} imports {end}, which lies above it")
    return faults


def test_the_import_finder_sees_what_it_must(tmp_path: Path) -> None:
    module = tmp_path / "m.py"
    module.write_text(
        "import a.b\nfrom c import d\nfrom . import e\nif TYPE_CHECKING:\n    import hidden\n"
        "def f():\n    from ..g import h\n"
    )
    assert set(imports(module, "top.room.m")) == {"a.b", "c.d", "top.room.e", "top.g.h"}
    assert set(imports(module, "top.room.m", top_only=True)) == {"a.b", "c.d", "top.room.e"}
    assert "exmesh_graph.params" in arrows()["exmesh_graph.graph.declare.ports"]
    assert "exmesh_graph.types.edges" in arrows()["exmesh_graph.types.mesh"]  # inside a function


def test_every_room_has_its_row() -> None:
    assert {room_of(module) for module in modules()} - {""} <= set(ROOMS)
    assert {room_of(module, "graph") for module in modules()} - {""} <= set(INSIDE_GRAPH)


def test_imports_go_down() -> None:
    assert upward(ROOMS) == []


def test_imports_inside_the_framework_go_down() -> None:
    assert upward(INSIDE_GRAPH, "graph") == []


def test_no_circle_of_files() -> None:
    graph = nx.DiGraph([(module, end) for module, ends in arrows().items() for end in ends])
    assert [sorted(circle) for circle in nx.strongly_connected_components(graph) if len(circle) > 1] == []


def test_the_framework_knows_nothing_of_3d() -> None:
    """Above it only; of the wire types it knows the base class and those that pages read."""
    below = ROOMS[ROOMS.index("graph") + 1 :]
    names = {room_of(end) for module, ends in arrows().items() if room_of(module) == "graph" for end in ends}
    assert names - {"graph"} <= set(below)
    assert [
        f"{module} imports {name}"
        for module, path in modules().items()
        if room_of(module) == "graph"
        for name in imports(path, module)
        if name.split(".")[0] in HEAVY
    ] == []


def test_solvers_do_not_know_the_framework() -> None:
    knowing = {room_of(module) for module, ends in arrows().items() if any(room_of(end) == "graph" for end in ends)}
    assert knowing <= {"cli", "nodes", "api", "notebook", "studio", "report", "graph", ""}


def test_the_picture_in_the_docs_is_that_of_the_code() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python -m docs.architecture writes it"


@pytest.mark.parametrize("room", ["types", "nodes"])
def test_nothing_heavy_at_the_top(room: str) -> None:
    exempt = {"exmesh_graph.types.edges"}  # not imported by the package itself
    for module, path in modules().items():
        if room_of(module) == room and module not in exempt:
            assert {n.split(".")[0] for n in imports(path, module, top_only=True)}.isdisjoint(HEAVY), module


KERNELS = ("raster", "rays", "shading", "splat")
OTHERS = ("pydantic", "open3d", "pymeshlab", "pxr", "OpenImageIO", "skimage", "embreex", "xatlas", "networkx")


@pytest.fixture(scope="module")
def loaded_by_kernels() -> dict[str, set[str]]:
    """{room: those of OTHERS that are imported once its modules are}, the rooms one after another in one process."""
    rooms = {}
    for room in KERNELS:
        names = sorted(module for module in modules() if room_of(module) == room and "kernels" not in module)
        # parameters are declared for nodes; the kernels' functions take any object with these attributes
        rooms[room] = [name for name in names if name != "exmesh_graph.rays.embree" and not name.endswith(".settings")]
        assert rooms[room]
    code = f"""
import importlib, json, sys
loaded = {{}}
for room, names in {rooms!r}.items():
    for name in names:
        importlib.import_module(name)
    loaded[room] = [name for name in {OTHERS!r} if name in sys.modules]
print("LOADED" + json.dumps(loaded))
"""
    return {room: set(names) for room, names in json.loads(printed_by(code)).items()}


@pytest.mark.parametrize("room", KERNELS)
def test_kernels_need_torch_numpy_and_warp_only(room: str, loaded_by_kernels: dict[str, set[str]]) -> None:
    """So that they run on a machine with a GPU and little else."""
    assert loaded_by_kernels[room] == set()


def printed_by(code: str) -> str:
    """What a new process that runs `code` prints after the word LOADED."""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split("LOADED")[1]


def loaded_by(code: str, of: tuple[str, ...] = HEAVY) -> set[str]:
    """Those of the libraries `of` that `code` leaves imported."""
    probe = f"{code}\nimport sys\nprint('LOADED', *[name for name in {of!r} if name in sys.modules])"
    return set(printed_by(probe).split())


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


@pytest.mark.thorough
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


BUDGET = 7000  # code lines of all of graph/; never above 7000


def framework_size() -> dict[str, int]:
    """Code lines of the modules directly in graph/ and of each room below it."""
    graph = LIBRARY / "graph"
    rooms = sorted(path for path in graph.iterdir() if (path / "__init__.py").exists())
    sizes = {"core": sum(code_lines(path) for path in graph.glob("*.py"))}
    return sizes | {f"{room.name}/": sum(code_lines(path) for path in files(room)) for room in rooms}


def test_code_lines_leave_out_what_is_no_code(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text('"""Doc.\n\nMore."""\n\nX = """a\nb"""  # two\n\n\ndef f():\n    "doc"\n    # no\n    return X\n')
    assert code_lines(path) == 4


def test_the_framework_stays_small() -> None:
    sizes = framework_size()
    assert sum(sizes.values()) <= BUDGET, sizes
    lines = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in files(LIBRARY / "graph")}
    assert max(lines.values()) <= 400, lines


def test_a_wheel_holds_every_room() -> None:
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    there = {".".join(path.parent.relative_to(ROOT).parts) for path in LIBRARY.rglob("__init__.py")}
    assert listed == there | {"exmesh_nodes"}


def test_the_command_line_stands_on_the_front_door() -> None:
    """It presents; what it does, Python can do by exmesh_graph.api."""
    names = [
        f"{module} takes {end}"
        for module, ends in arrows().items()
        for end in ends
        if room_of(module) == "cli" and room_of(end) == "graph"
    ]
    assert len(names) <= 2, names
