"""Variants on the command line: run, plan, check and why of one of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Exmesh = Callable[..., Any]

GRAPH = """
name: toy
nodes:
  one: {type: toy.const, value: 2}
  two: {type: toy.const, value: 5}
  sum: {type: toy.add, a: "@one.number", b: "@two.number"}
  shown: {type: toy.metrics, number: "@sum.number"}
outputs: {figure: "@shown.metrics"}
"""
VARIANTS = """
extends: toy.yaml
variants:
  lone: [{disconnect: sum.b}]
  more: [{set: two.value, to: 7}]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "toy.yaml").write_text(GRAPH)
    (tmp_path / "study.yaml").write_text(VARIANTS)
    return tmp_path


def test_one_variant_is_checked_planned_run_and_explained(exmesh: Exmesh, folder: Path) -> None:
    assert exmesh("check", "study.yaml", "--variant", "lone").stdout.startswith("study-lone: 4 nodes")
    exmesh("run", "toy.yaml")
    assert "1 hit, 1 to run, 2 unknown" in exmesh("plan", "study.yaml", "--variant", "more").stdout
    assert "parameter value: 5 -> 7" in exmesh("why", "two", "study.yaml", "--variant", "more").stdout
    exmesh("run", "study.yaml", "--variant", "more")
    record = json.loads((folder / "runs/latest/run.json").read_text())
    assert record["resolved"]["variant"] == "more"
    assert record["command"].endswith("--variant more")
    assert json.loads((folder / "runs/latest/figure/metrics.json").read_text())["value"] == 9
    assert "by two of study-more" in exmesh("why", "two").stdout  # the variant of the latest run


def test_an_unknown_variant_is_refused(exmesh: Exmesh, folder: Path) -> None:
    shown = exmesh("run", "study.yaml", "--variant", "lon", code=2).stderr
    assert "no variant 'lon'" in shown
    assert "nearest: lone" in shown
    assert "declare variants:" in exmesh("run", "toy.yaml", "--variant", "lone", code=2).stderr
