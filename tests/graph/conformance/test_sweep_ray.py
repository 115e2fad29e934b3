"""A sweep of scenes and variants on a Ray cluster with one store, one worker of which is killed on the way."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[3]
TOY = Path(__file__).parent.parent / "toy"
pytest.importorskip("ray", reason="Ray is not installed (pip install 'exmesh-graph[ray]')")
pytestmark = [pytest.mark.ray, pytest.mark.slow]
GRAPH = """
params: {scene: {type: float, default: 1}}
nodes:
  a: {type: toy.const, value: "${scene}"}
  n: {type: toy.slow, number: "@a.number", steps: 60, seconds: 3}
  t: {type: toy.add, a: "@n.number", b: "@a.number"}
  s: {type: toy.score, number: "@t.number"}
variants: {single: [{disconnect: t.b}]}
matrix: {scene: [2, 3], variant: [base, single]}
"""


@pytest.mark.reliability("a sweep on a Ray cluster with one store; one worker killed mid-run",
                         "one table, with the figures of an undisturbed sweep in one process")  # fmt: skip
def test_a_worker_lost_in_a_sweep_changes_nothing_in_its_table(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.distributed import sweep

    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(TOY), str(ROOT), os.environ.get("PYTHONPATH", "")]))
    graph = bench.write(GRAPH)
    told = sweep(graph, bench.root / "cluster", [], machines=2, kill="worker")
    assert "SIGKILL" in told["killed"]
    assert any("Ray lost its worker" in line for line in told["messages"])
    words = [
        "sweep",
        str(graph),
        "--workers",
        "0",
        "--store",
        str(bench.root / "own"),
        "--runs",
        str(bench.root / "alone"),
    ]
    command = [sys.executable, "-c", "from exmesh_graph.cli import main; main()", *words]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    table = json.loads(next((bench.root / "alone").glob("*/sweep.json")).read_text())
    alone = {row["variant"]: row for row in table["variants"]}
    assert len(alone) == 5  # the base and four combinations
    assert list(told["variants"]) == list(alone)
    for name, row in alone.items():
        assert told["variants"][name]["state"] == row["state"] == "done"
        assert told["variants"][name]["figures"]["Value"]["values"] == row["figures"]["Value"]["values"]
