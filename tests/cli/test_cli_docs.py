"""What README and docs tell a reader to run exists, and a section that states a figure says what to run for it."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest
import typer

from exmesh_graph.cli.app import app

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "dcc").glob("*.md"))]
OPTION = re.compile(r"(?<![\w=/-])--?[a-z][a-z-]*")
COMMAND = re.compile(r"\b(?:python|exmesh|pytest) ")
FIGURE = re.compile(r"\d ?(?:dB|ms|MiB|GB/s|thousandths)\b|\d\.\d+ s\b")


def page_id(path):
    return str(path.relative_to(ROOT))


@cache
def code(path: Path) -> tuple[str, ...]:
    """The lines of a page's code blocks without their comments, and its code in running text."""
    text = re.sub(r" *\\\n *", " ", path.read_text(encoding="utf-8"))
    found = []
    for block in re.split(r"\n\s*\n", re.sub(r"(?m)^```.*$", "\n\n", text)):
        lines = block.split("\n")
        indented = all(line.startswith("    ") for line in lines if line)
        if indented or any(re.match(r"(\S*/)?(exmesh|python|pytest) ", line) for line in lines):
            found += [re.split(r" {3,}| #", line.strip())[0] for line in lines]
        found += re.findall(r"`([^`]+)`", " ".join(line.strip() for line in lines))
    return tuple(found)


@cache
def benchmark_options(name: str) -> set[str]:
    """What a module of benchmarks/ hands to argparse; empty where there is no such module."""
    folder, name = ROOT / "benchmarks", name.replace(".", "/")
    path = folder / name / "__main__.py" if (folder / name).is_dir() else folder / f"{name}.py"
    if not path.is_file():
        return set()
    calls = (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call))
    told = (call.args for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "add_argument")
    return {"--help"} | {a.value for args in told for a in args if isinstance(a, ast.Constant)}


@cache
def exmesh_options() -> dict[str, set[str]]:
    commands = typer.main.get_command(app).commands
    return {
        name: {"--help"} | {option for given in command.params for option in (*given.opts, *given.secondary_opts)}
        for name, command in commands.items()
    }


def faults(line: str) -> list[str]:
    """What in a line of code names nothing."""
    found = []
    for name, rest in re.findall(
        r"python3? (?:-m benchmarks\.|benchmarks/)(\w+(?:\.(?!py\b)\w+)*)(?:\.py)?([^;&]*)", line
    ):
        known = benchmark_options(name)
        found += [f"no benchmarks/{name}"] if not known else []
        found += [f"benchmarks/{name} has no {o}" for o in OPTION.findall(rest) if known and o not in known]
    for name, rest in re.findall(r"(?:^|[\s/;])exmesh ([a-z][a-z-]*)([^;&]*)", line):
        known = exmesh_options().get(name, set())
        found += [f"no exmesh {name}"] if not known else []
        found += [f"exmesh {name} has no {o}" for o in OPTION.findall(rest) if known and o not in known]
    if COMMAND.search(line):
        named = re.findall(r"(?<![\w/.])((?:tests|graphs|benchmarks)/[\w/.{},*-]*\w)", line)
        found += [f"no {path}" for path in named if "{" not in path and not any(ROOT.glob(path))]
    return found


@pytest.mark.parametrize("path", PAGES, ids=page_id)
def test_every_command_of_a_page_exists(path):
    wrong = {line: bad for line in code(path) if (bad := faults(line))}
    assert not wrong


@pytest.mark.parametrize("path", PAGES, ids=page_id)
def test_a_section_with_a_measured_figure_names_a_command(path):
    """In the unit of a measurement; each heading begins a section."""
    sections = re.split(r"(?m)^(?=#+ )", path.read_text(encoding="utf-8"))
    bare = [part.split("\n")[0] for part in sections if FIGURE.search(part) and not COMMAND.search(part)]
    assert not bare


def test_faults_are_found_and_many_commands_are_looked_at():
    assert sum(bool(COMMAND.search(line)) for path in PAGES for line in code(path)) > 150
    for line, fault in [
        ("python -m benchmarks.nothing --quick", "no benchmarks/nothing"),
        ("python benchmarks/rays.py --quickly", "benchmarks/rays has no --quickly"),
        ("python -m benchmarks.stability --only rays --slow", "benchmarks/stability has no --slow"),
        ("exmesh walk graphs/quickstart.yaml", "no exmesh walk"),
        ("exmesh run graphs/quickstart.yaml --sett a=1", "exmesh run has no --sett"),
        ("exmesh run graphs/slowstart.yaml", "no graphs/slowstart.yaml"),
        ("pytest tests/nowhere", "no tests/nowhere"),
    ]:
        assert faults(line) == [fault]
