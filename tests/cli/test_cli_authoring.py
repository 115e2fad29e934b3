"""Commands for authors: `nodes --markdown`, `schema`, `new-node`, and packs that are found once installed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent.parent
PAGES = ROOT / "docs" / "nodes"
COMMAND = "import sys; from exmesh_graph.cli import main; sys.argv = ['exmesh', *sys.argv[1:]]; main()"


def fresh(*words: str, path: str = "", cwd: Path | None = None) -> str:
    """`exmesh` in a new process with the packs that are installed, and those in `path`."""
    paths = [path, os.environ.get("PYTHONPATH", ""), str(ROOT)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in paths if p)}
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, *words], capture_output=True, text=True, cwd=cwd, env=environment, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_pages_of_nodes_are_current(tmp_path: Path) -> None:
    fresh("nodes", "--markdown", str(tmp_path / "nodes"))
    made = {path.name: path.read_text() for path in (tmp_path / "nodes").iterdir()}
    kept = {path.name: path.read_text() for path in PAGES.iterdir()}
    assert made == kept, "exmesh nodes --markdown docs/nodes"


def test_pages_tell_ports_parameters_units_and_ranges(exmesh: Any, tmp_path: Path) -> None:
    (tmp_path / "pages").mkdir()
    (tmp_path / "pages" / "gone.md").write_text("<!-- made by `exmesh nodes --markdown`; edits are lost -->\n# gone")
    (tmp_path / "pages" / "mine.md").write_text("# by hand")
    exmesh("nodes", "--markdown", "pages")
    page = (tmp_path / "pages" / "curve.md").read_text()
    assert "| `slope` | float | `1.0` | >= -10, <= 10 | per x | Rise per x. |" in page
    assert "Not part of the key." in page
    assert 'name: {type: curve.sum, first: "@component"}' in page
    assert "| `second` | Curve, optional |" in page
    toy = (tmp_path / "pages" / "toy.md").read_text()
    assert "| `number` | Number[split='train'] |" in toy
    assert 'name: {type: toy.add, a: "@node.port"}' in toy
    assert "(curve.md#curvesum)" in (tmp_path / "pages" / "README.md").read_text()
    assert not (tmp_path / "pages" / "gone.md").exists()
    assert (tmp_path / "pages" / "mine.md").read_text() == "# by hand"


def test_pages_do_not_harm_what_others_wrote(exmesh: Any, tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("# by hand")
    assert "was not made by this command" in exmesh("nodes", "--markdown", ".", code=1).stderr
    assert [path.name for path in tmp_path.glob("*.md")] == ["README.md"]


def test_schema_goes_to_a_file_or_the_terminal(exmesh: Any, tmp_path: Path) -> None:
    shown = exmesh("schema").stdout
    exmesh("schema", "-o", "schema.json")
    assert json.loads(shown) == json.loads((tmp_path / "schema.json").read_text())


def test_check_lists_what_can_be_set(exmesh: Any, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(
        "params: {plain: 3, typed: {type: int, default: 4, ge: 1, unit: px, doc: Size.}}\nnodes: {x: {type: toy.const}}"
    )
    shown = exmesh("check", "g.yaml", "--set", "typed=5").stdout
    assert "  plain = 3\n" in shown
    assert "  typed = 5  (int, >= 1 [px]: Size.)\n" in shown


@pytest.fixture
def pack(exmesh: Callable[..., Any], tmp_path: Path) -> Path:
    done = exmesh("new-node", "geometry.smooth", "--into", "pack/my_nodes")
    assert "pip install -e" in done.stdout
    return tmp_path / "pack"


@pytest.mark.thorough
def test_new_node_passes_its_own_test(pack: Path) -> None:
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", str(pack / "pyproject.toml")]
    quick = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
    done = subprocess.run([*words, str(pack)], capture_output=True, text=True, check=False, cwd=pack, env=quick)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 passed" in done.stdout


@pytest.mark.slow
def test_wire_types_components_and_loaders_pass_their_own_tests(exmesh: Any, pack: Path) -> None:
    for kind in ("wire", "component", "loader"):
        exmesh("new-node", f"my.{kind}", "--into", "pack/my_nodes", "--type", kind)
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", str(pack / "pyproject.toml")]
    quick = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": "", "PYTHONPATH": str(pack)}
    files = [str(pack / "tests" / f"test_my_{kind}.py") for kind in ("wire", "component", "loader")]
    script = (
        "import sys, pytest; from exmesh_graph.graph.session import Session; Session(packs=['my_nodes']).__enter__()"
    )
    script += f"; sys.exit(pytest.main({[*words[3:], *files]!r}))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, env=quick)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "11 passed" in done.stdout


def test_new_node_is_clean(pack: Path) -> None:
    """What it writes has no line that is too long and no name left to fill in."""
    for path in [*(pack / "my_nodes").glob("*.py"), *(pack / "tests").glob("*.py")]:
        text = path.read_text()
        compile(text, str(path), "exec")
        assert max(map(len, text.splitlines())) <= 120
        assert "{type}" not in text
        assert "{Class}" not in text


@pytest.mark.thorough
def test_new_node_refuses_what_is_there_or_no_name(exmesh: Any, pack: Path) -> None:
    assert "is there already" in exmesh("new-node", "geometry.smooth", "--into", "pack/my_nodes", code=2).stderr
    again = exmesh("new-node", "geometry.other", "--into", "pack/my_nodes").stdout
    assert "must list" not in again
    assert "already" in exmesh("new-node", "toy.const", code=2).stderr
    for name in ("smooth", "Geometry.smooth", "a.b.c", "a.class", "../a.b"):
        assert "cannot name a node type" in exmesh("new-node", name, code=2).stderr
    assert "Python package" in exmesh("new-node", "a.b", "--into", "my-nodes", code=2).stderr


def test_new_node_beside_another_project(exmesh: Any, tmp_path: Path) -> None:
    """As in a clone of this repository: the pack is a project of its own, or says what the other one lacks."""
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "other"\n')
    done = exmesh("new-node", "my.smooth")
    assert "must list" not in done.stdout
    assert f"pip install -e {tmp_path / 'my_nodes'}\n" in done.stdout
    assert (tmp_path / "my_nodes" / "my_nodes" / "my_smooth.py").is_file()
    assert (tmp_path / "my_nodes" / "pyproject.toml").is_file()
    assert "must list the package 'nodes'" in exmesh("new-node", "my.other", "--into", "nodes").stdout


@pytest.mark.thorough
def test_an_installed_pack_is_found_by_its_entry_point(pack: Path, tmp_path: Path) -> None:
    """pip builds and installs the pack that new-node wrote, without a network; a graph then runs its node."""
    pytest.importorskip("setuptools", minversion="77", reason="building a pack needs setuptools >= 77")
    pytest.importorskip("pip")
    site = tmp_path / "site"
    words = ["install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", str(site), str(pack)]
    done = subprocess.run([sys.executable, "-m", "pip", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    shown = fresh("nodes", "geometry.smooth", path=str(site))
    assert "strength: float = 0.5  (>= 0, <= 1)" in shown
    (tmp_path / "cube.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    (tmp_path / "g.yaml").write_text("""
nodes:
  file: {type: init.mesh_file, path: cube.obj, units: normalised}
  smooth: {type: geometry.smooth, mesh: "@file.mesh", steps: 2}
outputs: {mesh: "@smooth.mesh"}
""")
    assert "2 nodes, 1 source files, no faults" in fresh("check", "g.yaml", path=str(site), cwd=tmp_path)
    fresh("run", "g.yaml", "--workers", "0", path=str(site), cwd=tmp_path)
    assert (tmp_path / "runs" / "latest" / "mesh" / "arrays.safetensors").is_file()


def test_the_sub_graph_and_the_parameters_in_the_docs(tmp_path: Path) -> None:
    from exmesh_graph.graph.declare.packs import load_packs
    from exmesh_graph.graph.language.check import check_file

    blocks = [part.split("```")[0] for part in (ROOT / "docs" / "graph_files.md").read_text().split("```yaml\n")[1:]]
    params, part, use = (
        next(b for b in blocks if b.startswith(word)) for word in ("params:", "# refine.yaml", "once:")
    )
    (tmp_path / "refine.yaml").write_text(part)
    start = blocks[0].split("  rounds:\n")[0].split("nodes:\n")[1]
    body = start + "".join(f"  {line}\n" for line in use.splitlines())
    text = params + f"nodes:\n{body}"
    (tmp_path / "doc.yaml").write_text(text)
    graph = check_file(tmp_path / "doc.yaml", [f"scene={ROOT}/graphs/samples/spot"], load_packs())
    assert graph.nodes["once.refine"].params.iterations == 900
    assert graph.nodes["once.uv"].params.dilation == 4
    assert str(graph.nodes["light"].inputs["mesh"]) == "@once.uv.state"
    assert graph.params["faces"] == 20000


def test_the_choices_in_the_docs(tmp_path: Path) -> None:
    from exmesh_graph.graph.declare.packs import load_packs
    from exmesh_graph.graph.language.check import check_file

    blocks = [part.split("```")[0] for part in (ROOT / "docs" / "graph_files.md").read_text().split("```yaml\n")[1:]]
    node = "a: {type: init.sphere}"
    loader = f"v: {{type: data.blender, path: {ROOT}/graphs/samples/spot}}"
    (tmp_path / "doc.yaml").write_text(f"{blocks[3]}nodes:\n  {loader}\n  {node}\n")

    def given(*settings: str) -> tuple[object, object]:
        params = check_file(tmp_path / "doc.yaml", list(settings), load_packs()).params
        return params["rounds"], params["faces"]

    assert given() == (4, 26000)
    assert given("budget=1min") == (2, 8000)
    assert given("budget=1min", "rounds=3") == (3, 8000)
    assert given("budget=5min") == (5, 40000)


@pytest.mark.thorough
def test_commands_on_components(exmesh: Any, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text("""
nodes:
  two: {type: toy.const, value: 2}
  line: {type: curve.line, slope: 3}
  end: {type: toy.evaluate, number: "@two.number", curve: "@line"}
""")
    exmesh("run", "g.yaml", "--workers", "0")
    assert "2 nodes" in exmesh("check", "g.yaml").stdout
    why = exmesh("why", "end", "g.yaml", "--set", "line.slope=4").stdout
    assert "component curve: parameter slope 3 -> 4" in why
    assert "components: curve" in why
    plan = exmesh("plan", "g.yaml", "--set", "line.slope=4").stdout
    assert "1 hit, 1 to run" in plan
    assert "component curve: parameter slope 3 -> 4" in plan
    refused = exmesh("run", "g.yaml", "--node", "line", code=2).stderr
    assert "line is a component, which never runs by itself" in refused
    assert "name a node that uses it: end" in refused
    shown = exmesh("nodes", "curve.sum").stdout
    assert "curve.sum  (component, version 1)" in shown
    assert "outputs:" not in shown
    assert "stage2.fit  (version 1, resumable" in fresh("nodes", "stage2.fit")
    assert "second: Curve  (optional)" in shown
