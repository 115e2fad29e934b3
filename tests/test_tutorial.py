"""docs/tutorial.ipynb: cells use only what there is, stored outputs are small, and it runs from a clean kernel."""

from __future__ import annotations

import ast
import builtins
import importlib
import shutil
from pathlib import Path
from typing import Any

import nbformat
import pytest

import exmesh_graph as ex
from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.graph.declare.ports import signature

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "tutorial.ipynb"


def code_cells() -> list[Any]:
    return [cell for cell in nbformat.read(PAGE, as_version=4).cells if cell.cell_type == "code"]


def faults(code: str, defined: set[str]) -> list[str]:
    """Names that a cell uses and nothing defines; `defined` grows by what the cell defines."""
    tree = ast.parse(code)
    wrong = []
    for item in ast.walk(tree):
        if isinstance(item, ast.ImportFrom):
            module = importlib.import_module(str(item.module))
            wrong += [f"{item.module}.{alias.name}" for alias in item.names if not hasattr(module, alias.name)]
        if isinstance(item, ast.Import | ast.ImportFrom):
            defined |= {alias.asname or alias.name for alias in item.names}
        elif isinstance(item, ast.FunctionDef | ast.ClassDef):
            defined.add(item.name)
        elif isinstance(item, ast.arg):
            defined.add(item.arg)
        elif isinstance(item, ast.Name) and isinstance(item.ctx, ast.Store):
            defined.add(item.id)
    for item in ast.walk(tree):
        if isinstance(item, ast.Name) and item.id not in defined and not hasattr(builtins, item.id):
            wrong.append(item.id)
        if isinstance(item, ast.Attribute) and isinstance(item.value, ast.Name) and item.value.id == "ex":
            wrong += [] if hasattr(ex, item.attr) else [f"ex.{item.attr}"]
        if isinstance(item, ast.Call) and isinstance(item.func, ast.Attribute) and item.func.attr in ("add", "call"):
            wrong += fields(item)
    return wrong


def fields(call: ast.Call) -> list[str]:
    """Node types, ports and parameters of an `add` or `call` that there are not."""
    kinds = [arg.value for arg in call.args if isinstance(arg, ast.Constant) and "." in str(arg.value)]
    wrong = []
    for kind in kinds:
        definition = load_packs().types.get(kind)
        if definition is None:
            wrong.append(kind)
            continue
        declared = signature(definition)
        known = {*declared.inputs, *declared.params.model_fields}
        wrong += [f"{kind}: {word.arg}" for word in call.keywords if word.arg not in known]
    return wrong


def test_cells_use_only_what_there_is() -> None:
    defined: set[str] = set()
    for cell in code_cells():
        assert faults(cell.source, defined) == [], cell.source


@pytest.mark.parametrize(
    ("code", "wrong"),
    [
        ("ex.runn(1)", ["ex.runn"]),
        ('g.add("x", "init.hull")', ["init.hull"]),
        ('g.add("x", "init.sphere", face=3)', ["init.sphere: face"]),
        ("from exmesh_graph.types import Mush", ["exmesh_graph.types.Mush"]),
        ("print(nothing)", ["nothing"]),
    ],
)
def test_what_there_is_not_is_found(code: str, wrong: list[str]) -> None:
    assert faults(code, {"ex", "g"}) == wrong


def test_stored_outputs_are_small_and_without_faults() -> None:
    assert PAGE.stat().st_size < 600_000
    for cell in code_cells():
        for output in cell.outputs:
            assert output.output_type != "error"
            assert "<iframe" not in str(output.get("data", {}).get("text/html", "")), "models are not stored"
            assert str(ROOT.parent) not in str(output), "no paths of a machine"
    assert any(cell.outputs for cell in code_cells())


@pytest.mark.slow
def test_it_runs_from_a_clean_kernel(tmp_path: Path) -> None:
    from nbclient import NotebookClient

    docs = tmp_path / "docs"
    docs.mkdir()
    (tmp_path / "graphs").symlink_to(ROOT / "graphs")
    shutil.copy(PAGE, docs)
    page = nbformat.read(docs / PAGE.name, as_version=4)
    NotebookClient(page, timeout=900, kernel_name="python3", resources={"metadata": {"path": str(docs)}}).execute()
    shown = {cell.source: cell.outputs for cell in page.cells if cell.cell_type == "code"}
    (model,) = [outputs for source, outputs in shown.items() if source == "final.asset"]
    assert "<iframe" in model[0].data["text/html"]
    (summary,) = [outputs for source, outputs in shown.items() if source.startswith("run = ex.run(g)")]
    assert "Held-out PSNR" in summary[-1].data["text/html"]
    assert list((docs / "runs").glob("*/asset.usdz"))
    assert ex.open_run(next(docs.glob("runs/*-tutorial"))).state == "done"
