"""The table of speed: its arithmetic, and graphs that both sides can read."""

from __future__ import annotations

import json

import pytest

import exmesh_graph as ex
from benchmarks import speed
from exmesh_graph.errors import ExmeshError


def test_the_serial_share_of_what_two_cores_gain():
    assert speed.serial_share(2.0) == 0
    assert speed.serial_share(1.0) == 1
    assert speed.serial_share(1 / (0.25 + 0.75 / 2)) == pytest.approx(0.25)
    assert speed.serial_share(2.3) == 0  # noise
    assert speed.serial_share(0.8) == 1


def test_a_row_holds_ratios_and_the_model():
    row = speed.figures({"before": 1.0, "now": 0.125, "one core": 0.2}, 1 / 8)
    assert row["ratio"] == row["goal"] == 8
    assert row["two/one"] == pytest.approx(1.6)
    assert row["8 cores"] == pytest.approx(0.2 * (0.25 + 0.75 / 8))


@pytest.mark.thorough
@pytest.mark.parametrize("name", speed.CASES)
def test_the_graphs_of_the_cases_are_sound(name, tmp_path):
    scene = speed.photographs(tmp_path / "scene", (80, 64), 9)
    assert len(json.loads((scene / "transforms_train.json").read_text())["frames"]) == 9
    file = tmp_path / "g.yaml"
    params = {"scene": {"type": "path", "default": str(scene)}}
    file.write_text(json.dumps({"name": name, "params": params, "nodes": speed.CASES[name].nodes}))
    assert ex.check(file).nodes["node"]


def test_an_unknown_revision_is_named(tmp_path):
    with pytest.raises(ExmeshError, match="no revision 'nothing-such'"):
        speed.checkout("nothing-such", tmp_path / "a")


def test_the_files_here_are_linked_and_come_first(tmp_path):
    folder = speed.checkout("", tmp_path / "now")
    assert (folder / "exmesh_nodes" / "stage1.py").samefile(speed.ROOT / "nodes" / "stage1.py")
