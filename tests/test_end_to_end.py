"""Photographs to USD through the real command on a tiny scene: the sample at 64x64 with few views and iterations."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.thorough  # all of them, for what they share costs most

ROOT = Path(__file__).resolve().parents[1]
TINY = f"""
extends: {ROOT / "graphs" / "quickstart.yaml"}
name: tiny
params: {{faces: 1200, texels: 64, thorough: false}}  # test_probe_scene.py holds what the thorough probe adds
nodes:
  views: {{downscale: 4, max_views: 14, max_test_views: 2}}
  coarse: {{resolution: 40, faces: 500}}
  rounds:
    repeat: 2
    nodes:
      refine: {{iterations: 40, total_iterations: 200}}
  settle: {{iterations: 120, total_iterations: 200}}
  light: {{directions: 64, points: 1000}}
  pbr: {{texture_size: 64, environment_height: 16, iterations: 60, corrections: 1, correction_samples: 4}}
  reshape: {{iterations: 20, lobe_samples: 4}}
  retouch: {{directions: 64, points: 1000, iterations: 20, corrections: 1, correction_samples: 4}}
  score: {{directions: 64, supersampling: 1, specular_samples: 4}}
"""


def _exmesh(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from exmesh_graph.cli import main; main()", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)


def _states(folder: Path) -> dict[str, str]:
    record = json.loads((folder / "runs" / "latest" / "run.json").read_text())
    return {node["name"]: node["state"] for node in record["nodes"]}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chain")
    (folder / "tiny.yaml").write_text(TINY)
    done = _exmesh(folder, "run", "tiny.yaml")
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_asset_and_report_come_out(finished: Path) -> None:
    from exmesh_graph.export.usd import validate_usd

    run = finished / "runs" / "latest"
    for name in ("asset.usdz", "asset.usda", "report.html", "report.json", "run.json"):
        assert (run / name).stat().st_size > 0, name
    assert any((run / "textures").iterdir())
    assert validate_usd(run / "asset.usdz") == []
    assert validate_usd(run / "asset.usda") == []


def test_the_asset_beats_an_uninformed_guess(finished: Path) -> None:
    headline = json.loads((finished / "runs" / "latest" / "report.json").read_text())["headline"]
    for label in ("Held-out PSNR", "Relit PSNR"):
        assert headline[label]["value"] > headline[label]["floor"] + 1.0, headline


def test_second_run_hits_and_a_stage_two_parameter_reruns_stage_two_only(finished: Path) -> None:
    again = _exmesh(finished, "run", "tiny.yaml")
    assert again.returncode == 0, again.stdout + again.stderr
    assert set(_states(finished).values()) == {"hit"}

    changed = _exmesh(finished, "run", "tiny.yaml", "--set", "pbr.environment_weight=0.2")
    assert changed.returncode == 0, changed.stdout + changed.stderr
    rerun = {name for name, state in _states(finished).items() if state != "hit"}
    assert rerun == {"pbr", "reshape", "retouch", "usd", "shape", "score", "score_pictures"}


def test_run_never_trains_on_test_views(finished: Path) -> None:
    (finished / "leak.yaml").write_text("extends: tiny.yaml\nnodes:\n  start: {views: '@views.test'}\n")
    refused = _exmesh(finished, "check", "leak.yaml")
    assert refused.returncode != 0
    assert "split" in refused.stdout + refused.stderr
    assert "leak.yaml:3" in refused.stdout + refused.stderr
