"""The two graphs of the paper's length: what they say, that all that is turned back is the paper, and that they run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

import exmesh_graph as ex

ROOT = Path(__file__).resolve().parents[1]
GRAPHS = ROOT / "graphs"
#: Table 1 and section 6.1 of the paper: node, parameter, value.
PAPER = [
    ("gaussians", "iterations", 5000), ("fused", "resolution", 256), ("fused", "solid", False),
    ("atlas", "texture_size", 2048), ("smooth", "weight", 1000), ("smooth", "units", "world"),
    ("rounds[1].refine", "iterations", 1000), ("rounds[2].refine", "iterations", 500),
    ("settle", "iterations", 4000), ("settle", "vertex_lr", 5e-4), ("settle", "vertex_units", "world"),
    ("settle", "texture_lr", 2.5e-3), ("settle", "ssim_weight", 0.2), ("settle", "gradient_decay", 0.95),
    ("settle", "depth_weight", 0.01), ("settle", "silhouette", "bce"), ("settle", "silhouette_weight", 0.005),
    ("settle", "deviation_weight", 1000), ("settle", "deviation_units", "world"),
    ("rounds[1].split", "gradient_weight", 0.6), ("rounds[1].split", "curvature_weight", 0.4),
    ("rounds[1].split", "score", "values"), ("rounds[1].split", "edge_degrees", "endpoints"),
    ("rounds[1].split", "max_faces", 200_000), ("rounds[1].merge", "degenerate", 0.05),
    ("light", "samples", 8), ("light", "secondary_rays", 16), ("light", "secondary_samples", 4),
    ("light", "half_resolution", True), ("light", "technique", "environment"), ("light", "bounces", 1),
    ("neutral", "base_color", "texture"), ("pbr", "iterations", 10_000), ("pbr", "material_rate", 2.5e-3),
    ("pbr", "environment_rate", 1.5e-2), ("pbr", "environment_height", 256), ("pbr", "ssim_weight", 0.2),
    ("pbr", "material_weight", 0.1), ("pbr", "environment_weight", 0.1), ("pbr", "chroma_weight", 0.1),
    ("pbr", "indirect_weight", 1.0), ("pbr", "indirect_ramp", 1000), ("pbr", "metallic", False),
    ("pbr", "normal_map", True), ("pbr", "texture_size", 0),
]  # fmt: skip
SHARED = ("smooth", "rounds[1].refine", "rounds[2].split", "rounds[2].merge", "settle", "neutral", "pbr", "drawn")
#: Lengths, sizes and rates that the short table sets, and D-SSIM's factor, which stands for 1 - SSIM there.
OWN = {"iterations", "total_iterations", "share", "max_faces", "growth", "texture_size", "environment_height",
       "material_rate", "environment_rate", "indirect_ramp", "ssim_weight", "depth_weight", "corrections"}  # fmt: skip


def test_paper_yaml_has_the_papers_numbers() -> None:
    nodes = _parameters(ex.check(GRAPHS / "paper.yaml"))
    assert {(n, p): nodes[n][p] for n, p, _ in PAPER} == {(n, p): value for n, p, value in PAPER}


def test_topology_every_500_and_a_new_atlas_at_2_4_and_6_thousand() -> None:
    checked = ex.check(GRAPHS / "paper.yaml")
    at, atlases = 0, []
    for k in range(1, 12):
        at += _parameters(checked)[f"rounds[{k}].refine"]["iterations"]
        if checked.nodes[f"rounds[{k}].uv"].definition.type == "uv.xatlas_regen":
            atlases.append(at)
    assert (at, atlases) == (6000, [2000, 4000, 6000])
    assert not any(node.definition.type == "mesh.flip" for node in checked.nodes.values())


def test_exmeshpp_has_the_same_length_and_less_in_stage_2() -> None:
    paper, ours = (_parameters(ex.check(GRAPHS / f"{name}.yaml")) for name in ("paper", "exmeshpp"))
    for node in (*(f"rounds[{k}].refine" for k in range(1, 12)), "settle"):
        assert ours[node]["iterations"] == paper[node]["iterations"], node
    assert ours["pbr"]["iterations"] < paper["pbr"]["iterations"]


def test_all_departures_turned_back_are_the_paper() -> None:
    """The rows paper_stage1 and paper_stage2 of the table say of every shared node what paper.yaml says."""
    paper = _parameters(ex.check(GRAPHS / "paper.yaml"))
    paper["drawn"] = paper["light"]
    for variant, names in (("paper_stage1", SHARED[:5]), ("paper_stage2", SHARED[5:])):
        row = _parameters(ex.check(GRAPHS / "departures.yaml", variant=variant))
        for name in names:
            own, theirs = ({k: v for k, v in of[name].items() if k not in OWN} for of in (row, paper))
            assert own == theirs, name


@pytest.mark.parametrize(
    ("graph", "base"),
    [("dtu", "paper"), ("nerf_synthetic", "paper"), ("synthetic4relight", "exmeshpp"), ("stanford_orb", "exmeshpp")],
)
def test_benchmark_graphs_say_what_they_extend_and_dtu_begins_without_a_hull(graph: str, base: str) -> None:
    text = (GRAPHS / f"{graph}.yaml").read_text()
    assert f"extends: {base}.yaml" in text
    comment = text.split("extends:")[0]
    assert f"by {base}.yaml" in comment
    if base == "paper":
        inner = (GRAPHS / "paper.yaml").read_text()
        assert "visual_hull" not in text + inner
        assert "start: random" in inner


def test_every_row_of_the_sweep_stands_in_the_table_of_departures() -> None:
    text = (ROOT / "docs" / "departures.md").read_text()
    rows = YAML(typ="safe").load(GRAPHS / "departures.yaml")["variants"]
    assert [name for name in rows if name != "carrier" and f"`{name}`" not in text] == []


TINY = {
    "paper": {
        "gaussians": {"iterations": 150, "count": 3000, "max_gaussians": 5000},
        "fused": {"resolution": 40},
        "pbr": {"texture_size": 64, "environment_height": 16, "iterations": 30, "indirect_ramp": 10},
    },
    "exmeshpp": {
        "coarse": {"iterations": 60, "resolution": 40, "count": 1500},
        "light": {"directions": 64, "points": 1000},
        "pbr": {"texture_size": 64, "environment_height": 16, "iterations": 30, "indirect_ramp": 10, "corrections": 1},
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("graph", ["paper", "exmeshpp"])
def test_it_runs_from_photographs_to_usd(graph: str, tmp_path: Path) -> None:
    refine = {"iterations": 20, "total_iterations": 140}
    nodes: dict[str, Any] = {
        "views": {"downscale": 4, "max_views": 14, "max_test_views": 2},
        "rounds": {"repeat": 3, "nodes": {"refine": refine | {"at": {1: {"iterations": 20}}}, "progress": None,
                                          "pictures": None}},
        "settle": {"iterations": 80, "total_iterations": 140},
        "shape": {"samples": 5000},
        "score": {"directions": 64, "supersampling": 1, "specular_samples": 4, "max_views": 1},
    }  # fmt: skip
    own = TINY[graph]
    nodes |= own | {"coarse": {"faces": 500} | own.get("coarse", {})}
    file = tmp_path / "tiny.yaml"
    whole = {"extends": str(GRAPHS / f"{graph}.yaml"), "params": {"faces": 1500, "texels": 64}, "nodes": nodes}
    YAML().dump(whole, file)
    words = [sys.executable, "-c", "from exmesh_graph.cli import main; main()", "run", "tiny.yaml", "--workers", "0"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "runs" / "latest" / "asset.usdz").stat().st_size > 0


def _parameters(checked: Any) -> dict[str, dict[str, Any]]:
    """{node or component: {parameter: value}}, defaults included."""
    found = {name: dict(node.params) for name, node in checked.nodes.items()}
    return found | {name: dict(part.value) for name, part in checked.components.items()}
